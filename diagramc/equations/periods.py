"""Sample periods of the leaf systems of a diagram, and which of them hold an output port."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..errors import CompilationError
from .tree import Node, upstream


def timing_of(leaf: Node) -> Any:
    """Return Drake's object with period and offset of the update of a leaf with discrete states.

    Raises `CompilationError` unless the leaf has exactly one period.
    """
    timing = leaf.system.GetUniquePeriodicDiscreteUpdateAttribute()
    if timing is None:
        raise CompilationError(
            f"{leaf.name or leaf.type_name}: has a discrete state but not exactly one sample "
            f"period; split it"
        )
    return timing


class SampledLeaf(NamedTuple):
    """A leaf system with discrete states."""

    name: str
    timing: Any
    """Drake's timing of its update."""
    holds_output: bool
    """Whether the output port reads this leaf without another sampled leaf in between."""


def sampled_leaves(diagram: Any, output: str) -> list[SampledLeaf]:
    """Return the leaf systems of a diagram that have discrete states; ``output`` is a port's name.

    Raises `CompilationError` for a leaf with discrete states and not exactly one period.
    """
    root = Node(diagram)
    leaves = [leaf for leaf in root.leaves() if leaf.system.num_discrete_state_groups()]
    source, _ = root.output(diagram.GetOutputPort(output).get_index())
    holders = upstream([source], ends=leaves)
    return [
        SampledLeaf(leaf.name or leaf.type_name, timing_of(leaf), leaf in holders)
        for leaf in leaves
    ]
