"""Rewrites the derivatives of a model for speed: RK4 evaluates them many times in a tick.

The rewriting changes last bits. Values that are compared or rounded keep the operations that Drake
makes.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Sequence

from ..equations.graph import SOURCES, Graph
from ..equations.graph_values import values_of
from ..equations.operations import OPERATIONS
from ..equations.partition import TICK_SOURCES
from ..equations.passes import deciding_nodes, regrouping
from ..run_data import Array

_LONGEST_SUM = 12
"""Largest number of terms that are reordered: the partial sums of more would fill the registers."""


def fast_rates(graph: Graph, derivatives: Sequence[int], parameters: Array) -> dict[int, int]:
    """Return a dictionary from nodes of the derivatives to nodes that are computed faster.

    ``derivatives`` are the numbers of the derivatives' nodes in ``graph``. ``parameters`` decide
    which factors are zero. Each derivative is in the dictionary, and so is each node that a
    derivative still requires after all rewritings. The function adds the new nodes to ``graph``.
    They compute the same values up to rounding. Four rewritings follow each other, each a class
    below. For a parameter p, p = 0 at first, and the states x, y and z:

    - sin(x)·p → 0 if p = 0, else sin(x)·p
    - 2·min(x, y) → min(2·x, 2·y)
    - 2·(3·x) → 6·x
    - sin(x) + y + z → (y + z) + sin(x), since the sine is available last
    """
    latest = {node: node for node in graph.reachable(derivatives)}
    # Zero factors first, as they remove the most. Then limits pass factors on, which the regrouping
    # joins. Sums come last, because their order depends on the final terms.
    for rewriting in (_ZeroFactors, _ScaledLimits, _Regrouping, _ShortSums):
        roots = [latest[root] for root in derivatives]
        new = rewriting(graph, roots, parameters).nodes()
        latest = {node: new[before] for node, before in latest.items() if before in new}
    return latest


class _Rewriting:
    """Gives new nodes with the same values to the nodes that ``roots`` require."""

    def __init__(self, graph: Graph, roots: Sequence[int], parameters: Array) -> None:
        self.graph, self.roots, self.parameters = graph, roots, parameters

    def changed(self, node: int, arguments: tuple[int, ...]) -> int | None:
        """Return the new node of an old node with new arguments, or None if the operation stays."""
        raise NotImplementedError

    def nodes(self) -> dict[int, int]:
        """Return a dictionary from each node to its new node."""
        graph = self.graph
        new: dict[int, int] = {}
        for node in graph.reachable(self.roots):
            kind, *_ = graph.nodes[node]
            if kind in SOURCES:
                new[node] = node
                continue
            arguments = tuple(new[argument] for argument in graph.arguments(node))
            changed = self.changed(node, arguments)
            new[node] = graph.node(kind, *arguments) if changed is None else changed
        return new


class _ZeroFactors(_Rewriting):
    """Skips elementary functions whose fixed factor is zero.

    A product of an elementary function and a fixed factor that ``parameters`` make zero becomes a
    choice, so the function is computed only if the factor is not zero. The factor can change later.
    """

    # Machine code has another analysis, `zero_factors`, which asks at each run. Here the parameters
    # are known, so that factors which are not zero cost no comparison.

    def changed(self, node: int, arguments: tuple[int, ...]) -> int | None:
        graph = self.graph
        if graph.nodes[node][0] != "multiply" or not any(map(self._is_costly, arguments)):
            return None
        zeros = [argument for argument in arguments if self._is_zero(argument)]
        if not zeros:
            return None
        product = graph.node("multiply", *arguments)
        return graph.where(graph.node("ne", zeros[0], graph.zero), product, graph.zero)

    def _is_zero(self, node: int) -> bool:
        if not self.graph.is_fixed(node):
            return False
        return bool(values_of(self.graph, [node], {"parameter": self.parameters})[0] == 0)

    def _is_costly(self, node: int) -> bool:
        kind = self.graph.nodes[node][0]
        return kind not in SOURCES and not (OPERATIONS[kind].simple or self.graph.is_fixed(node))


class _ScaledLimits(_Rewriting):
    """Moves a positive factor k into a minimum or maximum: k·min(a, b) becomes min(k·a, k·b).

    There k can join other factors. A minimum or maximum with another use stays, because it would be
    computed twice.
    """

    def __init__(self, graph: Graph, roots: Sequence[int], parameters: Array) -> None:
        super().__init__(graph, roots, parameters)
        nodes = graph.reachable(roots)
        self.uses = Counter(argument for node in nodes for argument in graph.arguments(node))
        self.uses.update(roots)

    def changed(self, node: int, arguments: tuple[int, ...]) -> int | None:
        graph = self.graph
        if graph.nodes[node][0] != "multiply" or len(arguments) != 2:
            return None
        left, right = arguments
        old_left, old_right = graph.arguments(node)
        for factor, limit, old_limit in ((left, right, old_right), (right, left, old_left)):
            is_limit = graph.nodes[limit][0] in ("min", "max") and self.uses[old_limit] == 1
            if is_limit and (graph.value(factor) or 0.0) > 0.0:
                return self._scaled(factor, limit)
        return None

    def _scaled(self, factor: int, node: int) -> int:
        kind, *arguments = self.graph.nodes[node]
        if kind not in ("min", "max"):
            return self.graph.node("multiply", factor, node)
        return self.graph.node(kind, *(self._scaled(factor, a) for a in arguments))


class _Regrouping(_Rewriting):
    """Puts fixed factors together: see `regrouping`."""

    def nodes(self) -> dict[int, int]:
        return regrouping(self.graph, self.roots)


class _ShortSums(_Rewriting):
    """Adds the terms of a sum in the order in which their values are available.

    In a chain from left to right, every addition would wait for the addition before it. Times count
    from the start of a stage of RK4, in durations of an addition (see `Operation.cost`).
    """

    def __init__(self, graph: Graph, roots: Sequence[int], parameters: Array) -> None:
        super().__init__(graph, roots, parameters)
        self.deciding = deciding_nodes(graph, graph.reachable(roots))
        self.times: list[int] = []
        """Time at which the value of each node is available, by the number of the node."""

    def changed(self, node: int, arguments: tuple[int, ...]) -> int | None:
        graph = self.graph
        is_sum = graph.nodes[node][0] == "add" and node not in self.deciding
        if not is_sum or len(arguments) > _LONGEST_SUM:
            return None
        # The place decides between equal times, so that the order does not depend on node numbers.
        terms = [(self._available(term), place, term) for place, term in enumerate(arguments)]
        heapq.heapify(terms)
        while len(terms) > 1:
            (_, _, first), (_, place, second) = heapq.heappop(terms), heapq.heappop(terms)
            partial_sum = graph.node("add", first, second)
            heapq.heappush(terms, (self._available(partial_sum), place, partial_sum))
        _, _, sum_of_all = terms[0]
        return sum_of_all

    def _available(self, node: int) -> int:
        """Return when the value of a node is available, in durations of an addition.

        That is the latest time of its arguments plus the cost of its operation.
        """
        graph, times = self.graph, self.times
        for number in range(len(times), node + 1):  # arguments have smaller numbers
            kind, arguments = graph.nodes[number][0], graph.arguments(number)
            # A value that does not change within a tick is computed before the steps of RK4.
            is_early = kind in SOURCES or graph.depends[number] <= TICK_SOURCES
            times.append(0 if is_early else _cost(kind) + max(times[a] for a in arguments))
        return times[node]


def _cost(kind: str) -> int:
    operation = OPERATIONS[kind]
    return 1 if operation.simple else operation.cost
