"""The leaf systems of a diagram as a list of parts, with Context parameters and states.

The builder of the diagram, compiled runs, the linear analysis and the export as FMU read the list.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from kneexo.systems import StateVariable


class Part(NamedTuple):
    """A leaf system of a diagram: how to make it, its Context parameters and its states."""

    name: str
    """Name of the system in the diagram."""
    make: Callable[[], Any]
    """Returns a new system; compiled runs do not call it."""
    values: Callable[[], dict[str, float]]
    """Returns the Context parameters by name; those of further vectors by ``vector[index]``."""
    states: tuple[StateVariable, ...] = ()
    """The continuous states in the order of the Context."""
    start: Callable[[], Sequence[float]] | None = None
    """Returns the initial values of ``states`` in the units of their columns; None: all zero."""

    def start_state(self) -> list[float]:
        """Return the initial values of ``states`` in the units of the Context."""
        start = [0.0] * len(self.states) if self.start is None else self.start()
        return [value / state.factor for value, state in zip(start, self.states, strict=True)]


def state_names(part: Part, path: str) -> list[str]:
    """Return the names that a compiled model gives the continuous states of a part.

    ``path``: subsystem that contains the part, such as ``plant``.
    """
    return [f"{path}/{part.name}.x[{index}]" for index in range(len(part.states))]


def add_parts(builder: Any, parts: Iterable[Part]) -> dict[str, Any]:
    """Make the systems of ``parts``, add them to a DiagramBuilder and return them by name."""
    return {part.name: builder.AddNamedSystem(part.name, part.make()) for part in parts}


def connect(builder: Any, source: Any, output: str, target: Any, input_: str) -> None:
    """Connect the port ``output`` of ``source`` to the port ``input_`` of ``target``."""
    builder.Connect(source.GetOutputPort(output), target.GetInputPort(input_))
