"""Describes the leaf systems of a diagram as a list of parts.

The list is used by the builder of the diagram, compiled runs, linear analysis and export as FMU.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

from kneexo.systems import StateVariable

NO_FAULTS: Mapping[str, tuple[str, ...]] = MappingProxyType({})
"""No Context parameters that faults change, of no systems."""


class Part(NamedTuple):
    """Description of a leaf system: name, factory, Context parameters and continuous states."""

    name: str
    """Name of the leaf system in the diagram."""
    make: Callable[..., Any]
    """Function that returns a new system; compiled runs do not call it.

    The makers of plant and wearer take ``fault_names``: the Context parameters that faults change.
    """
    values: Callable[[], dict[str, float]]
    """Function that returns a dictionary from the name of a Context parameter to its value.

    A parameter without a name, in a further vector, is called ``vector[index]``.
    """
    states: tuple[StateVariable, ...] = ()
    """Continuous states of the system, in the order of the Context."""
    start: Callable[[], Sequence[float]] | None = None
    """Function that returns the initial ``states`` in the units of their columns; None: zeros."""

    def start_state(self) -> list[float]:
        """Return the initial values of ``states`` in the units of the Context."""
        start = [0.0] * len(self.states) if self.start is None else self.start()
        return [value / state.factor for value, state in zip(start, self.states, strict=True)]


def leaf_part(name: str, component: Any, module: Any, *arguments: Any) -> Part:
    """Return the part of a leaf system without continuous states.

    Parameters
    ----------
    name
        Name of the leaf system in the diagram.
    component
        Class of the leaf system.
    module
        Module of the class. Its function ``context_values`` takes the same arguments as the class.
    arguments
        Positional arguments of both.
    """
    return Part(name, partial(component, *arguments), partial(module.context_values, *arguments))


def state_names(part: Part, path: str) -> list[str]:
    """Return the names that a compiled model gives the continuous states of a part.

    ``path`` is the path of the subsystem that contains the part, such as ``plant``, or empty.
    """
    system = f"{path}/{part.name}" if path else part.name
    return [f"{system}.x[{index}]" for index in range(len(part.states))]


def add_parts(
    builder: Any, parts: Iterable[Part], fault_names: Mapping[str, tuple[str, ...]] = NO_FAULTS
) -> dict[str, Any]:
    """Add the systems of ``parts`` to a DiagramBuilder; return a dictionary from name to system.

    ``fault_names`` has the Context parameters that faults change, by the name of the part.
    """
    systems = {}
    for part in parts:
        names = fault_names.get(part.name)
        system = part.make(fault_names=names) if names else part.make()
        systems[part.name] = builder.AddNamedSystem(part.name, system)
    return systems


def connect(builder: Any, source: Any, output: str, target: Any, input_: str) -> None:
    """Connect the port ``output`` of ``source`` to the port ``input_`` of ``target``."""
    builder.Connect(source.GetOutputPort(output), target.GetInputPort(input_))
