"""Which nodes are computed when: once for fixed parameters, once for each count, or at each tick.

Both printers use it. A *count* is a node whose value is a whole number, such as the reading of an
encoder. Nodes that one count alone decides are looked up in a table.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any

from .graph import SOURCES, Graph
from .operations import OPERATIONS, Operation, Role


def is_condition(graph: Graph, node: int) -> bool:
    """Whether the value of a node is a truth value."""
    kind = graph.nodes[node][0]
    return kind not in SOURCES and OPERATIONS[kind].is_condition


def is_rounded(graph: Graph, node: int) -> bool:
    """Whether a node is rounded to a whole number."""
    kind = graph.nodes[node][0]
    return kind not in SOURCES and OPERATIONS[kind].role is Role.ROUNDING


def fixed_nodes(
    graph: Graph, roots: Iterable[int], looked_up: Collection[int] = frozenset()
) -> list[int]:
    """Return the numbers that depend on parameters alone and that other code reads.

    A root or a node that is not fixed reads them. Parameters are among them, constants are not. A
    fixed condition is computed where it is used, so the numbers behind it are returned. Nodes that
    are ``looked_up`` read nothing. Arguments come first.
    """
    roots = list(roots)
    used = set(roots)
    fixed = []
    for node in reversed(graph.reachable(roots)):
        if node not in used:
            continue
        if graph.is_fixed(node) and not is_condition(graph, node):
            if graph.value(node) is None:
                fixed.append(node)
        elif node not in looked_up:
            used.update(graph.arguments(node))
    return fixed[::-1]


def nodes_by_count(
    graph: Graph,
    roots: Sequence[int],
    is_count: Callable[[int], bool],
    cost: Callable[[Operation], int],
    cost_of_look_up: int,
) -> dict[int, list[int]]:
    """Return the nodes that a table should hold, by the count that decides their values.

    A node is in the table if one count alone decides its value, it is no condition, code that does
    not depend on this count alone reads it, and it costs more than a look-up.

    Parameters
    ----------
    graph, roots
        All code that is printed.
    is_count
        Whether a node is a count, if its value does not follow from another count.
    cost
        Cost of an operation. The cost of a node is the sum for all operations behind it; what is
        fixed is free, and so is the count.
    cost_of_look_up
        Cost above which a node is worth a table.
    """
    free = frozenset("*")  # in the place of counts where a value follows from something else too
    counts_of: dict[int, frozenset[Any]] = {}
    cost_of: dict[int, int] = {}
    nodes = graph.reachable(roots)
    for node in nodes:
        kind, arguments = graph.nodes[node][0], graph.arguments(node)
        counts: frozenset[Any] = frozenset().union(*(counts_of[a] for a in arguments))
        if kind in SOURCES and not graph.is_fixed(node):
            counts = free
        is_new_count = free <= counts and is_count(node)
        counts_of[node] = frozenset([node]) if is_new_count else counts
        cost_of[node] = 0
        if not (is_new_count or graph.is_fixed(node) or kind in SOURCES):
            cost_of[node] = cost(OPERATIONS[kind]) + sum(cost_of[a] for a in arguments)

    def is_worthwhile(node: int) -> bool:
        counts = counts_of[node]
        return len(counts) == 1 and not free <= counts and cost_of[node] > cost_of_look_up

    readers = [(root, frozenset[Any]()) for root in roots]
    readers += [(argument, counts_of[node]) for node in nodes for argument in graph.arguments(node)]
    held: dict[int, set[int]] = {}
    for node, counts_of_reader in readers:
        if (
            is_worthwhile(node)
            and counts_of_reader != counts_of[node]
            and not is_condition(graph, node)
        ):
            (count,) = counts_of[node]
            held.setdefault(count, set()).add(node)
    return {count: sorted(held[count]) for count in sorted(held)}
