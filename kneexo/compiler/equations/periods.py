"""Sample periods of the leaf systems of a diagram, and those at which an output port is held."""

from __future__ import annotations

from typing import Any

from ..errors import CompilationError
from .ports import find_port, route_of
from .tree import Node


def timing_of(leaf: Node) -> Any:
    """Return Drake's timing of the discrete update of a leaf with discrete states.

    Raises `CompilationError` unless the leaf has exactly one period.
    """
    timing = leaf.system.GetUniquePeriodicDiscreteUpdateAttribute()
    if timing is None:
        raise CompilationError(
            f"{_name(leaf)}: has a discrete state but not exactly one sample period; split it"
        )
    return timing


def sample_timings(diagram: Any) -> dict[str, tuple[float, float]]:
    """Return {name: (period, offset)} in s of the leaf systems that have discrete states.

    Raises `CompilationError` for a leaf with discrete states and not exactly one period.
    """
    leaves = [leaf for leaf in Node(diagram).leaves() if leaf.system.num_discrete_state_groups()]
    timings = {_name(leaf): timing_of(leaf) for leaf in leaves}
    return {name: (t.period_sec(), t.offset_sec()) for name, t in timings.items()}


def holders_of(diagram: Any, output: str) -> set[str]:
    """Return the names of the leaf systems that hold the signal of an output port.

    They are the first leaf systems with discrete states on each way back from the port.
    """
    *_, (source, _, _) = route_of(find_port(Node(diagram), output, "output"))
    holders, pending, seen = set(), [source], set()
    while pending:
        leaf = pending.pop()
        if leaf in seen:
            continue
        seen.add(leaf)
        if leaf.system.num_discrete_state_groups():
            holders.add(_name(leaf))
        else:
            drivers = map(leaf.driver, range(leaf.system.num_input_ports()))
            pending += [driver[0] for driver in drivers if isinstance(driver, tuple)]
    return holders


def _name(leaf: Node) -> str:
    return leaf.name or leaf.type_name
