"""Sample periods of the leaf systems of a diagram, and which of them hold an output port."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..errors import CompilationError
from .ports import find_port, route_of
from .tree import Node, upstream


def timing_of(leaf: Node) -> Any:
    """Return Drake's timing of the discrete update of a leaf with discrete states.

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
    period_s: float
    offset_s: float
    holds_output: bool
    """Whether the leaf is the first with discrete states on a way back from the output port."""


def sampled_leaves(diagram: Any, output: str) -> list[SampledLeaf]:
    """Return the leaf systems of a diagram that have discrete states; ``output`` is a port's name.

    Raises `CompilationError` for a leaf with discrete states and not exactly one period.
    """
    root = Node(diagram)
    *_, (source, _, _) = route_of(find_port(root, output, "output"))
    holders = upstream([source], until=_is_sampled)
    leaves = [leaf for leaf in root.leaves() if _is_sampled(leaf)]
    timings = [(leaf, timing_of(leaf)) for leaf in leaves]
    return [
        SampledLeaf(leaf.name or leaf.type_name, t.period_sec(), t.offset_sec(), leaf in holders)
        for leaf, t in timings
    ]


def _is_sampled(leaf: Node) -> bool:
    return bool(leaf.system.num_discrete_state_groups())
