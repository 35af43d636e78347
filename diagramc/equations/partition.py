"""Decides when nodes are computed: once for fixed parameters, once for each count, or at each tick.

Machine code and C both follow these decisions. A *count* is a node whose value is a whole number,
such as the reading of an encoder. Nodes that depend on one count alone are looked up in a table. A
node is *fixed* if its value depends on parameters alone.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any

from .graph import SOURCES, Graph
from .operations import OPERATIONS, Operation, Role

TICK_SOURCES = frozenset({"parameter", "discrete", "input"})
"""Sources that change at ticks only, if inputs do."""


def is_condition(graph: Graph, node: int) -> bool:
    """Return whether the value of a node is a truth value."""
    kind = graph.nodes[node][0]
    return kind not in SOURCES and OPERATIONS[kind].is_condition


def is_rounded(graph: Graph, node: int) -> bool:
    """Return whether the operation of a node rounds to a whole number."""
    kind = graph.nodes[node][0]
    return kind not in SOURCES and OPERATIONS[kind].role is Role.ROUNDING


def fixed_nodes(
    graph: Graph,
    roots: Iterable[int],
    looked_up: Collection[int] = frozenset(),
    kinds: frozenset[str] = frozenset({"parameter"}),
) -> list[int]:
    """Return the nodes whose values code computes once in advance, arguments before their readers.

    A node is fixed if its value depends only on the ``kinds`` of sources. A fixed node is returned
    if it is a root, or if a node that is not fixed reads it. Parameters are among the returned
    nodes, and literal constants are not. Code computes a fixed truth value at each use, so the
    arguments of the truth value are returned in its place. The nodes in ``looked_up`` come from
    tables, and therefore need no fixed nodes.
    """
    roots = list(roots)
    used = set(roots)
    fixed = []
    for node in reversed(graph.reachable(roots)):
        if node not in used:
            continue
        # Not a truth value, because the constants are doubles.
        if graph.depends[node] <= kinds and not is_condition(graph, node):
            if graph.value(node) is None:
                fixed.append(node)
        elif node not in looked_up:
            used.update(graph.arguments(node))
    return fixed[::-1]


def zero_factors(
    graph: Graph,
    roots: Iterable[int],
    fixed: Collection[int],
    arguments: Callable[[int], Sequence[int]],
) -> dict[int, frozenset[int]]:
    """Map each node to the ``fixed`` nodes that multiply it on every path to the ``roots``.

    The paths lead through sums, products and numerators. If such a factor is zero, code may use 0
    in place of the node, provided that the node is finite. For example, the volume of air in oil
    multiplies a power of the pressure. So code without air need not compute this power.
    ``arguments(node)`` returns the arguments that the code for
    ``roots`` reads.
    """
    roots = list(roots)
    # A root has no factor: its own value is asked for. A node with two readers keeps the factors
    # that both have.
    factors_of = dict.fromkeys(roots, frozenset[int]())
    for node in reversed(graph.reachable(roots, arguments)):
        linear = set(_linear_arguments(graph, node))
        factors = factors_of[node]
        if graph.nodes[node][0] == "multiply":
            factors = factors.union(*(_factors(graph, a, fixed) for a in arguments(node)))
        for argument in arguments(node):
            passed = factors if argument in linear else frozenset[int]()
            factors_of[argument] = passed & factors_of.get(argument, passed)
    return factors_of


def _linear_arguments(graph: Graph, node: int) -> tuple[int, ...]:
    """Return the arguments that may become zero while the value of the node stays finite.

    These are all arguments of a sum or product, and the numerator of a quotient unless the same
    node is the divisor too.
    """
    kind, arguments = graph.nodes[node][0], graph.arguments(node)
    if kind == "divide":
        return arguments[: int(arguments[0] != arguments[1])]
    return arguments if kind in ("add", "multiply") else ()


def _factors(graph: Graph, node: int, fixed: Collection[int]) -> set[int]:
    """Return the ``fixed`` nodes that make ``node`` zero if one of them is zero.

    The result is empty for a node that depends on more than parameters.
    """
    if not graph.is_fixed(node):
        return set()
    factors = {node}.intersection(fixed)
    if graph.nodes[node][0] in ("multiply", "divide"):
        read = _linear_arguments(graph, node)
        factors = factors.union(*(_factors(graph, a, fixed) for a in read))
    return factors


def nodes_by_count(
    graph: Graph,
    roots: Sequence[int],
    is_count: Callable[[int], bool],
    cost: Callable[[Operation], int],
    cost_of_look_up: int,
) -> dict[int, list[int]]:
    """Choose nodes whose values a table holds, with a row for each value of a whole number.

    The whole number, such as an encoder count, is a node called count. The result maps each count
    to the nodes in its table. A node is in the table of a count if

    1. the node depends on the count alone,
    2. it is no truth value,
    3. it is a root, or a node that does not depend on the count alone reads it,
    4. its computation costs more than a look-up.

    Parameters
    ----------
    graph, roots
        The graph, and the nodes whose values the code is to compute.
    is_count
        Returns whether a node is a count. The function is called for nodes whose value does
        not depend on counts alone.
    cost
        Returns the cost of an operation. The cost of a node is the sum over this node and all nodes
        that it depends on. Fixed nodes and the count cost nothing.
    cost_of_look_up
        Cost above which a node is worth a table, in the same unit.
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
