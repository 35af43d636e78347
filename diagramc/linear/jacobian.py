"""Evaluates nodes of a graph together with their derivatives, as machine code."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import cached_property

import numpy as np

from ..equations.graph import SOURCES, Graph
from ..equations.operations import OPERATIONS, Role
from ..equations.passes import Place
from ..native.machine_code import library
from ..native.node_values import CHAIN, VALUES, node_values_text
from ..native.runner import address
from ..run_data import Array


class Derivatives:
    """Values of nodes of a graph, and their derivatives by sources such as the states.

    The nodes are ``roots`` and all nodes that the roots depend on. The variables are the elements
    of the sources of ``kinds``, all elements of the first kind, then all elements of the second
    kind, and so on. The derivatives are exact, by the chain rule in forward mode. At a corner
    (`Role.CORNER`) they are the derivatives on one side. Zero times a derivative is zero, even if
    the derivative is not finite. A branch that is not taken therefore has no effect.
    """

    def __init__(self, graph: Graph, roots: Iterable[int], kinds: Collection[str]) -> None:
        """Compile the machine code, or load it from the cache. ``graph`` gets no new nodes."""
        roots, graph = list(roots), graph.copy()
        self.nodes = graph.reachable(roots)
        self.place = {node: place for place, node in enumerate(self.nodes)}
        """The row of each node in the results of `at`."""
        self.roots = [self.place[root] for root in roots]
        """The rows of the roots."""
        self._kinds = kinds
        self._variables = [
            (place, *graph.nodes[node])
            for place, node in enumerate(self.nodes)
            if graph.nodes[node][0] in kinds
        ]
        self._slots: dict[Place, int] = {}
        """Index of each partial derivative: that of a node of the graph, or of a quantizer."""
        edges = []
        for place, node in enumerate(self.nodes):
            for argument, slot in self._factors(graph, node):
                edges.append((place, self.place[argument], slot))
        self._edges = np.array(edges, dtype=np.int64).reshape(-1, 3)
        targets: list[tuple[Place, int]] = []
        targets += [(("values", place), node) for place, node in enumerate(self.nodes)]
        self._timed = set()
        for (name, partial), slot in self._slots.items():
            if name == "partial":
                targets.append((("partials", slot), partial))
                if "time" in graph.depends[partial]:
                    self._timed.add(slot)
        key = hashlib.sha256(repr((targets, graph.nodes)).encode()).hexdigest()
        # The code runs for microseconds, so that optimization would cost more than it saves. A
        # further operating point of the knee takes 4.2 ms by this code, and took 22 ms in Python.
        code = library(key, "node values", lambda: node_values_text(graph, targets), level=0)
        self._values = code.function("values", len(VALUES))
        self._chain = code.function("chain", len(CHAIN))

    def _factors(self, graph: Graph, node: int) -> Iterator[tuple[int, int]]:
        """Yield the arguments of a node that depend on the variables, with slots of derivatives.

        The derivatives become new nodes of the graph.
        """
        name = str(graph.nodes[node][0])
        if name in SOURCES or graph.depends[node].isdisjoint(self._kinds):
            return
        arguments = graph.arguments(node)
        if OPERATIONS[name].role is Role.ROUNDING:
            yield arguments[0], self._slot("quantizer", node)
            return
        partials = OPERATIONS[name].partials(graph, arguments, node)
        for argument, partial in zip(arguments, partials, strict=True):
            if partial is not None and not graph.depends[argument].isdisjoint(self._kinds):
                yield argument, self._slot("partial", partial)

    def _slot(self, name: str, node: int) -> int:
        return self._slots.setdefault((name, node), len(self._slots))

    def at(self, sources: Mapping[str, Array], smooth: Iterable[int] = ()) -> tuple[Array, Array]:
        """Return the values (nodes,) and the derivatives (nodes, variables).

        ``sources`` maps each kind of source, such as ``state``, to the values of its elements.
        Kinds that no node depends on may be missing. A quantizer has the derivative 0. The
        quantizers among the nodes ``smooth`` have the derivative 1, as if they did not round.
        """
        first, columns = {}, 0
        for kind in self._kinds:
            first[kind] = columns
            columns += len(sources[kind])
        values, partials = np.empty(len(self.nodes)), np.zeros(len(self._slots))
        rows = np.zeros((len(self.nodes), columns))
        for place, kind, element in self._variables:
            rows[place, first[kind] + element] = 1.0
        for node in smooth:
            if ("quantizer", node) in self._slots:  # a rounded parameter has no derivative
                partials[self._slots["quantizer", node]] = 1.0
        given = [np.ascontiguousarray(sources.get(kind, ()), dtype=float) for kind in VALUES[:-2]]
        sizes = np.array([len(self._edges), columns])
        # The names keep the arrays alive while the machine code uses their addresses.
        self._values(*map(address, (*given, values, partials)))
        self._chain(*map(address, (sizes, self._edges, partials, rows)))
        return values, rows

    @cached_property
    def time_varying(self) -> list[bool]:
        """For each root, whether its derivatives depend on the time."""
        varying: set[int] = set()
        for place, argument, slot in self._edges.tolist():
            if argument in varying or slot in self._timed:
                varying.add(place)
        return [root in varying for root in self.roots]
