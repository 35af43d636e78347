"""The leaf systems of a diagram as a list: what builds it and what sets its parameters read it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple


class Part(NamedTuple):
    """A leaf system of a diagram."""

    name: str
    make: Callable[[], Any]
    """Makes the system; compiled runs never need it."""
    values: dict[str, float]
    """Its Context parameters: by name, or ``group[index]`` beyond the first vector."""


def add_parts(builder: Any, parts: Iterable[Part]) -> dict[str, Any]:
    """Add the systems of a diagram to its builder; returns them by name."""
    return {part.name: builder.AddNamedSystem(part.name, part.make()) for part in parts}


def connect(builder: Any, source: Any, output: str, target: Any, input_: str) -> None:
    """Connect two ports by their names."""
    builder.Connect(source.GetOutputPort(output), target.GetInputPort(input_))
