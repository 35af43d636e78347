"""Rewrites the derivatives of a model for speed: RK4 evaluates them many times in a tick.

The rewriting changes last bits. Values that are compared or rounded keep the operations that Drake
makes.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Sequence

from ..equations.graph import SOURCES, Graph
from ..equations.graph_values import values_of
from ..equations.operations import OPERATIONS
from ..equations.partition import TICK_SOURCES
from ..equations.passes import deciding_nodes, regrouping
from ..run_data import Array

_LONGEST_SUM = 12
"""Largest number of terms that are reordered: the partial sums of more would fill the registers."""

_Rule = Callable[[int, tuple[int, ...]], int | None]
"""Function of an old node and its new arguments; returns the new node, or None: no change."""


def fast_rates(graph: Graph, derivatives: Sequence[int], parameters: Array) -> dict[int, int]:
    """Return a dictionary from each node that ``derivatives`` require to a faster node.

    The new node computes the same value up to rounding, in a graph that gets these nodes. Four
    rewritings follow each other. (1) A product of an elementary function and a fixed factor that
    ``parameters`` make zero becomes a choice, so the function is computed only if the factor is not
    zero. The factor can change later. (2) A positive number times min(a, b) becomes the minimum of
    the products, and likewise for max, so that the number can join other factors. (3) `regrouped`
    puts fixed factors together. (4) A sum of several terms adds early terms first: in a chain from
    left to right, every addition would wait for the addition before.
    """
    passes: list[Callable[[list[int]], dict[int, int]]] = [
        lambda roots: _rewritten(graph, roots, _switches(graph, parameters)),
        lambda roots: _rewritten(graph, roots, _scaled_limits(graph, roots)),
        lambda roots: regrouping(graph, roots),
        lambda roots: _rewritten(graph, roots, _short_sums(graph, roots)),
    ]
    total = {node: node for node in graph.reachable(derivatives)}
    for rewrite in passes:
        new = rewrite([total[root] for root in derivatives])
        total = {node: new[before] for node, before in total.items() if before in new}
    return total


def _rewritten(graph: Graph, roots: Sequence[int], rule: _Rule) -> dict[int, int]:
    """Return a dictionary from each node that ``roots`` require to its node after ``rule``."""
    new: dict[int, int] = {}
    for node in graph.reachable(roots):
        kind, *_ = graph.nodes[node]
        if kind in SOURCES:
            new[node] = node
            continue
        arguments = tuple(new[argument] for argument in graph.arguments(node))
        changed = rule(node, arguments)
        new[node] = graph.operation(kind, *arguments) if changed is None else changed
    return new


def _switches(graph: Graph, parameters: Array) -> _Rule:
    """Return the rule that skips elementary functions whose fixed factor is zero."""

    def is_zero(node: int) -> bool:
        return graph.is_fixed(node) and values_of(graph, [node], {"parameter": parameters})[0] == 0

    def is_costly(node: int) -> bool:
        kind = graph.nodes[node][0]
        return kind not in SOURCES and not (OPERATIONS[kind].simple or graph.is_fixed(node))

    def rule(node: int, arguments: tuple[int, ...]) -> int | None:
        if graph.nodes[node][0] != "multiply" or not any(map(is_costly, arguments)):
            return None
        zeros = [argument for argument in arguments if is_zero(argument)]
        if not zeros:
            return None
        product = graph.operation("multiply", *arguments)
        return graph.where(graph.compare("ne", zeros[0], graph.zero), product, graph.zero)

    return rule


def _scaled_limits(graph: Graph, roots: Sequence[int]) -> _Rule:
    """Return the rule that moves a positive number into the minimum or maximum that it scales."""
    nodes = graph.reachable(roots)
    uses = Counter(argument for node in nodes for argument in graph.arguments(node))
    uses.update(roots)

    def scaled(factor: int, node: int) -> int:
        kind, *arguments = graph.nodes[node]
        if kind in ("min", "max"):
            return graph.operation(kind, *(scaled(factor, argument) for argument in arguments))
        return graph.operation("multiply", factor, node)

    def rule(node: int, arguments: tuple[int, ...]) -> int | None:
        if graph.nodes[node][0] != "multiply" or len(arguments) != 2:
            return None
        for factor, limited, old in zip(
            arguments, arguments[::-1], graph.arguments(node)[::-1], strict=True
        ):
            is_limited = graph.nodes[limited][0] in ("min", "max") and uses[old] == 1
            if is_limited and (graph.value(factor) or 0.0) > 0.0:
                return scaled(factor, limited)
        return None

    return rule


def _short_sums(graph: Graph, roots: Sequence[int]) -> _Rule:
    """Return the rule that adds terms in the order in which their values are available.

    A time counts from the start of a stage, in durations of an addition; see `Operation.cost`.
    """
    deciding = deciding_nodes(graph, graph.reachable(roots))
    times: list[int] = []

    def time_of(node: int) -> int:
        for number in range(len(times), node + 1):  # arguments have smaller numbers
            kind, behind = graph.nodes[number][0], graph.arguments(number)
            is_early = kind in SOURCES or graph.depends[number] <= TICK_SOURCES
            times.append(0 if is_early else _cost(kind) + max(times[a] for a in behind))
        return times[node]

    def rule(node: int, arguments: tuple[int, ...]) -> int | None:
        if graph.nodes[node][0] != "add" or node in deciding or len(arguments) > _LONGEST_SUM:
            return None
        terms = [(time_of(term), place, term) for place, term in enumerate(arguments)]
        heapq.heapify(terms)
        while len(terms) > 1:
            (_, _, a), (_, place, b) = heapq.heappop(terms), heapq.heappop(terms)
            total = graph.operation("add", a, b)
            heapq.heappush(terms, (time_of(total), place, total))
        return terms[0][2]

    return rule


def _cost(kind: str) -> int:
    operation = OPERATIONS[kind]
    return 1 if operation.simple else operation.cost
