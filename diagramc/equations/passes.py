"""Rewrites the graph for speed and assigns its nodes to functions of the machine code.

A value is fixed if it depends on parameters alone. Fixed factors of a product are put together, and
fixed values are computed once a run. Functions of one whole number, such as an encoder count, are
looked up in a table. The rewriting changes last bits. Values that are compared or rounded keep the
operations that Drake makes, so each comparison and rounding has the same result as in Drake.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

from .equations import Equations
from .gradients import gradients, time_derivatives
from .graph import SOURCES, Graph
from .operations import OPERATIONS
from .partition import fixed_nodes, is_rounded, nodes_by_count

ALWAYS = ("always", 0)
"""Condition of a group that is computed at every tick with a record or an update."""

Place = tuple[str, int]
"""The destination of a value: a kind, and the index among the destinations of this kind.

``margin`` is the margin of a leaf, ``after`` a discrete state after the updates, ``output`` an
element of all outputs.
"""

# The number decides little: runs of the presets ``paper`` and ``leg`` take the same time with 1, 6
# and 100.
_TERMS = 6  # terms of the longest sum that a fixed factor is distributed over
# In durations of a sum. Without tables, the exact hold takes a fifth longer for the default knee,
# whose encoder count decides the knee angle. With 5 in place of 30 it takes the same time.
_COST_OF_LOOK_UP = 30


@dataclass(frozen=True)
class Group:
    """Nodes that are computed under the same condition, with the destinations of their values."""

    condition: tuple[str, int]
    """`ALWAYS`, or ("update", index of the update that is due), or ("requested", index of the
    output port that is recorded)."""
    targets: tuple[tuple[Place, int], ...]
    """Destination and node of each value."""


@dataclass(frozen=True)
class Memo:
    """Nodes whose values depend on one whole number alone, so that a table can hold the values.

    ``count`` is the node of the whole number.
    """

    count: int
    nodes: tuple[int, ...]


@dataclass(frozen=True)
class Layout:
    """Names and sizes of a compiled model, which a run requires besides the machine code."""

    parameters: tuple[str, ...]
    states: tuple[str, ...]
    discrete: tuple[str, ...]
    inputs: tuple[tuple[str, int], ...]
    """Name and size of each open input port."""
    outputs: tuple[tuple[str, int], ...]
    """Name and size of each output port."""
    feedthrough: tuple[str, ...]
    """Names of the output ports whose value depends on an open input at the same time."""
    periods: tuple[tuple[float, float], ...]
    """Sample period and offset in s of each discrete update."""
    limits: tuple[str, ...]
    """Paths of the systems that stop a run when their margin falls below zero."""
    constants: int
    """Number of values that depend on parameters alone."""
    memos: tuple[int, ...]
    """For each look-up table of functions of a whole number, the number of values in a row."""

    @property
    def input_count(self) -> int:
        """Number of elements of all open input ports together."""
        return sum(size for _, size in self.inputs)

    def plain(self) -> dict[str, Any]:
        """Return the layout as a dictionary that JSON can store."""
        return asdict(self)

    @classmethod
    def from_plain(cls, data: dict[str, Any]) -> Layout:
        """Return the layout from the result of `plain`, in which JSON has made tuples lists."""

        def tuples(value: Any) -> Any:
            return tuple(map(tuples, value)) if isinstance(value, list | tuple) else value

        return cls(**{name: tuples(value) for name, value in data.items()})


class Program:
    """The equations of a model, prepared for machine code.

    The nodes are rewritten for speed and assigned to the functions of the machine code.
    """

    def __init__(self, equations: Equations) -> None:
        self.equations = equations
        # A copy, because the key of the machine code is a hash of all nodes of the equations.
        self.graph = graph = equations.graph.copy()
        self.size = len(equations.states)
        rows = gradients(graph, equations.derivatives)
        elements = [
            (column * self.size + row, node)
            for row, gradient in enumerate(rows)
            for column, node in gradient.items()
        ]
        nodes = regrouped(graph, [node for _, node in elements])
        self.jacobian = [(at, node) for (at, _), node in zip(elements, nodes, strict=True)]
        """Pairs (index, node), one for each element of the Jacobian that is not zero.

        The Jacobian has the derivatives of dx/dt by the continuous states x. The index counts the
        elements column by column.
        """
        self.derivatives = regrouped(graph, equations.derivatives)
        self.second_derivatives = self._second_derivatives()
        """Nodes of dx/dt and then of d²x/dt² along a solution; none if dx/dt follows from x alone.

        The rates of the open inputs count as further elements of the inputs.
        """
        self.by_time = self._by_time()
        """Nodes of the partial derivatives of dx/dt by the time; none if all are always zero.

        The open inputs count as functions of time, whose rates are further elements of the inputs.
        """
        self.initial_discrete = equations.initial_discrete
        self.groups = self._groups()
        self.instant = [node for group in self.groups for _, node in group.targets]
        self.hoisted = self._hoisted()
        """Dictionary from a node that depends on parameters alone to its index in the constants."""
        self.memos = self._memos()
        self.deciding = deciding_nodes(graph, graph.reachable(self._roots()))
        """Nodes whose last bit can change a comparison or rounding; they keep Drake's last bits."""

    @property
    def jacobian_rows(self) -> list[dict[int, int]]:
        """The Jacobian row by row, as dictionaries from column to node without zeros."""
        rows: list[dict[int, int]] = [{} for _ in range(self.size)]
        for at, node in self.jacobian:
            rows[at % self.size][at // self.size] = node
        return rows

    @property
    def layout(self) -> Layout:
        """What a run needs besides the machine code: names, sizes and sample times."""
        equations, graph = self.equations, self.graph
        return Layout(
            parameters=tuple(equations.parameters),
            states=tuple(equations.states),
            discrete=tuple(equations.discrete),
            inputs=tuple(equations.inputs.items()),
            outputs=tuple((port, len(nodes)) for port, nodes in equations.outputs.items()),
            feedthrough=tuple(
                port
                for port, nodes in equations.outputs.items()
                if any("input" in graph.depends[node] for node in nodes)
            ),
            periods=tuple((update.period_s, update.offset_s) for update in equations.updates),
            limits=tuple(limit.system for limit in equations.limits),
            constants=len(self.hoisted),
            memos=tuple(len(memo.nodes) for memo in self.memos),
        )

    def _second_derivatives(self) -> list[int]:
        equations, graph = self.equations, self.graph
        if not any(graph.depends[node] & {"time", "input"} for node in equations.derivatives):
            return []
        rates = self._rates_of_sources()
        for i, node in enumerate(equations.derivatives):
            rates[graph.source("state", i)] = node
        second = time_derivatives(graph, equations.derivatives, rates)
        return regrouped(graph, [*equations.derivatives, *second])

    def _by_time(self) -> list[int]:
        graph, derivatives = self.graph, self.equations.derivatives
        nodes = time_derivatives(graph, derivatives, self._rates_of_sources())
        return regrouped(graph, nodes) if any(node != graph.zero for node in nodes) else []

    def _rates_of_sources(self) -> dict[int, int]:
        """Return the rates of time and open inputs for `time_derivatives`."""
        graph, count = self.graph, sum(self.equations.inputs.values())
        rates = {graph.source("time"): graph.one}
        for i in range(count):
            rates[graph.source("input", i)] = graph.source("input", count + i)
        return rates

    def _groups(self) -> list[Group]:
        """Return one group for all margins, one for each update, and one for each output port."""
        equations = self.equations
        groups = [
            Group(
                ALWAYS,
                tuple((("margin", i), limit.margin) for i, limit in enumerate(equations.limits)),
            )
        ]
        for number, update in enumerate(equations.updates):
            # With one sample period nearly every instant updates: share freely.
            condition = ALWAYS if len(equations.updates) == 1 else ("update", number)
            groups.append(Group(condition, tuple((("after", i), n) for i, n in update.values)))
        first = 0
        for number, nodes in enumerate(equations.outputs.values()):
            targets = tuple((("output", first + i), node) for i, node in enumerate(nodes))
            groups.append(Group(("requested", number), targets))
            first += len(nodes)
        faster = iter(regrouped(self.graph, [n for group in groups for _, n in group.targets]))
        return [
            Group(group.condition, tuple((place, next(faster)) for place, _ in group.targets))
            for group in groups
        ]

    def _roots(self) -> list[int]:
        elements = [node for _, node in self.jacobian]
        rates = [*self.derivatives, *self.second_derivatives, *self.by_time]
        return [*rates, *self.initial_discrete, *self.instant, *elements]

    def _hoisted(self) -> dict[int, int]:
        nodes = fixed_nodes(self.graph, self._roots())
        return {node: number for number, node in enumerate(nodes)}

    def _memos(self) -> tuple[Memo, ...]:
        graph = self.graph
        by_count = nodes_by_count(
            graph,
            self.instant,
            lambda node: is_rounded(graph, node),
            lambda operation: operation.cost,
            _COST_OF_LOOK_UP,
        )
        return tuple(Memo(count, tuple(nodes)) for count, nodes in by_count.items())


# ------------------------------------------------------------------------------- regrouping


class _Sum(NamedTuple):
    """A sum of products with fixed factors, and of a fixed term."""

    factors: dict[int, int]
    """Dictionary from a node that is not fixed to its fixed factor."""
    fixed_term: int | None
    """Node of the fixed term, or None without a fixed term."""


def regrouped(graph: Graph, roots: Sequence[int]) -> list[int]:
    """Return, for each root, a node that computes the same value in fewer operations.

    The value is the same up to rounding.

    A quotient by a fixed value becomes a product. Fixed factors and fixed terms are put together. A
    fixed factor of a sum goes into the sum's terms. A product of four equal factors x becomes
    (x²)².
    """
    new = regrouping(graph, roots)
    return [new[root] for root in roots]


def regrouping(graph: Graph, roots: Sequence[int]) -> dict[int, int]:
    """Rewrite sums and products with fewer operations, as `regrouped` does.

    Returns a dictionary from each old node that ``roots`` require to its new node.
    """
    return _Regrouping(graph, roots).new


class _Regrouping:
    """Rewrites the nodes that ``roots`` require, arguments first; see `regrouped`."""

    def __init__(self, graph: Graph, roots: Sequence[int]) -> None:
        self.graph = graph
        nodes = graph.reachable(roots)
        self.deciding = deciding_nodes(graph, nodes)
        self.uses = Counter(argument for node in nodes for argument in graph.arguments(node))
        self.uses.update(roots)
        self.sums: dict[int, _Sum] = {}  # new nodes with a single use, as sums
        self.new: dict[int, int] = {}
        for node in nodes:
            self.new[node] = self._rewritten(node)

    def _rewritten(self, node: int) -> int:
        graph = self.graph
        kind, *_ = graph.nodes[node]
        if kind in SOURCES:
            return node
        arguments = [self.new[argument] for argument in graph.arguments(node)]
        if node not in self.deciding and not all(map(graph.is_fixed, arguments)):
            if kind == "divide" and graph.is_fixed(arguments[1]):
                numerator, denominator = arguments
                reciprocal = graph.node("divide", graph.one, denominator)
                return self._product(node, [reciprocal, numerator])
            if kind == "multiply":
                return self._product(node, arguments)
            if kind == "add":
                return self._sum(node, arguments)
        return graph.node(kind, *arguments)

    def _as_sum(self, node: int) -> _Sum:
        """Return the stored sum of a new node, or the node itself as the only term."""
        return self.sums.get(node) or _Sum({node: self.graph.one}, None)

    def _product(self, node: int, factors: list[int]) -> int:
        """Make the product of ``factors``, which replaces ``node``.

        If it is a fixed factor times a sum, the factor goes into the terms of the sum.
        """
        graph = self.graph
        fixed = [factor for factor in factors if graph.is_fixed(factor)]
        varying = [factor for factor in factors if not graph.is_fixed(factor)]
        if len(fixed) > 1:
            fixed = [graph.node("multiply", *fixed)]
        if fixed and len(varying) == 1:
            inner = self._as_sum(varying[0])
            # Scaling a sum with two plain terms would cost a product more.
            if sum(factor == graph.one for factor in inner.factors.values()) <= 1:
                scaled = {
                    term: self._times(factor, fixed[0]) for term, factor in inner.factors.items()
                }
                fixed_term = inner.fixed_term
                if fixed_term is not None:
                    fixed_term = self._times(fixed_term, fixed[0])
                return self._made(node, _Sum(scaled, fixed_term))
        for factor, count in Counter(varying).items():
            # With x⁴ the square saves a product. With x² and x³ it saves none.
            if count == 4:
                square = graph.node("multiply", factor, factor)
                varying = [*(other for other in varying if other != factor), square, square]
        return graph.node("multiply", *fixed, *varying)

    def _sum(self, node: int, terms: list[int]) -> int:
        """Make the sum that replaces ``node``, with the terms of sums that only ``node`` reads."""
        graph = self.graph
        factors: dict[int, int] = {}
        fixed_term: int | None = None
        for term in terms:
            if graph.is_fixed(term):
                fixed_term = self._plus(fixed_term, term)
                continue
            inner = self._as_sum(term)
            if inner.fixed_term is not None:
                fixed_term = self._plus(fixed_term, inner.fixed_term)
            for inner_term, factor in inner.factors.items():
                factors[inner_term] = self._plus(factors.get(inner_term), factor)
        return self._made(node, _Sum(factors, fixed_term))

    def _made(self, node: int, total: _Sum) -> int:
        """Make the node of the sum ``total``, which replaces ``node``; return the new node.

        If only one other node reads a short sum, store the terms of the sum. The other node can
        then absorb these terms.
        """
        graph = self.graph
        parts = [] if total.fixed_term is None else [total.fixed_term]
        parts += [
            term if factor == graph.one else graph.node("multiply", factor, term)
            for term, factor in total.factors.items()
        ]
        new = parts[0] if len(parts) == 1 else graph.node("add", *parts)
        if self.uses[node] == 1 and len(total.factors) <= _TERMS:
            self.sums[new] = total
        return new

    def _plus(self, left: int | None, right: int) -> int:
        return right if left is None else self.graph.node("add", left, right)

    def _times(self, left: int, right: int) -> int:
        if left == self.graph.one:
            return right
        if right == self.graph.one:
            return left
        return self.graph.node("multiply", left, right)


def deciding_nodes(graph: Graph, nodes: Iterable[int]) -> set[int]:
    """Return the nodes among ``nodes`` whose last bit can change a comparison or a rounding.

    Such a node is an argument of a comparison or rounding, or feeds an argument through operations
    with exact results (IEEE 754 fixes every bit).
    """
    deciding: set[int] = set()
    for node in sorted(nodes, reverse=True):
        kind = graph.nodes[node][0]
        if kind in SOURCES:
            continue
        operation = OPERATIONS[kind]
        if operation.decides or (operation.exact and node in deciding):
            deciding.update(graph.arguments(node))
    return deciding
