"""Evaluates nodes of a graph together with their derivatives, in Python."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

import numpy as np

from ..equations.graph import SOURCES, Graph
from ..equations.graph_values import values_of
from ..equations.operations import OPERATIONS
from ..run_data import Array


def values_and_jacobian(
    graph: Graph,
    roots: Iterable[int],
    sources: Mapping[str, Array],
    kinds: Collection[str],
    slopes: Mapping[int, float] | None = None,
) -> tuple[Array, Array]:
    """Return the values of nodes (roots,) and their Jacobian (roots, variables).

    The derivatives are exact, by the chain rule in forward mode. At a corner (`Role.CORNER`) they
    are those on one side. Zero times a derivative is zero, even if the derivative is not finite. So
    the branch of a choice that is not taken has no effect.

    Parameters
    ----------
    graph, roots
        The graph and the nodes. The graph gets no new nodes.
    sources
        Dictionary from each kind of source, such as ``state``, to the values of its elements.
    kinds
        Kinds of sources that are the variables, all elements of the first kind, then all elements
        of the second kind, and so on.
    slopes
        Dictionary from a node of one argument to the derivative that replaces its derivative, such
        as 1 for a quantizer.
    """
    roots, slopes = list(roots), slopes or {}
    graph = graph.copy()
    sizes = [len(sources[kind]) for kind in kinds]
    first = dict(zip(kinds, np.cumsum([0, *sizes[:-1]]).tolist(), strict=True))
    order = [n for n in graph.reachable(roots) if not graph.depends[n].isdisjoint(kinds)]
    factors = _factors(graph, order, kinds, slopes)
    needed = sorted({partial for pairs in factors.values() for _, partial in pairs})
    numbers = values_of(graph, [*roots, *needed], sources)
    slope_of = dict(zip(needed, map(float, numbers[len(roots) :]), strict=True))
    rows: dict[int, Array] = {}
    for node in order:
        rows[node] = row = np.zeros(sum(sizes))
        if node not in factors:
            kind, element = graph.nodes[node]
            row[first[kind] + element] = 1.0
        for argument, partial in factors.get(node, ()):
            slope = slope_of[partial]
            if slope != 0.0:
                below = rows[argument]
                row += np.multiply(slope, below, out=np.zeros_like(row), where=below != 0.0)
    constant = np.zeros(sum(sizes))
    jacobian = [rows.get(root, constant) for root in roots]
    values = np.array([float(value) for value in numbers[: len(roots)]])
    return values, np.array(jacobian).reshape(len(roots), sum(sizes))


def time_varying(graph: Graph, roots: Iterable[int], kinds: Collection[str]) -> list[bool]:
    """Return for each root whether its derivatives by ``kinds`` of sources depend on the time."""
    roots = list(roots)
    if not any("time" in graph.depends[root] for root in roots):
        return [False] * len(roots)
    graph = graph.copy()
    order = [n for n in graph.reachable(roots) if not graph.depends[n].isdisjoint(kinds)]
    varying = set()
    for node, pairs in _factors(graph, order, kinds, {}).items():
        if any(argument in varying or "time" in graph.depends[p] for argument, p in pairs):
            varying.add(node)
    return [root in varying for root in roots]


def _factors(
    graph: Graph, nodes: Iterable[int], kinds: Collection[str], slopes: Mapping[int, float]
) -> dict[int, list[tuple[int, int]]]:
    """Return for each operation the arguments that depend on ``kinds``, with its derivatives.

    The derivatives become new nodes of the graph. For ``slopes`` see `values_and_jacobian`.
    """
    factors = {}
    for node in nodes:
        name, arguments = graph.nodes[node][0], graph.arguments(node)
        if name not in SOURCES:
            partials = OPERATIONS[name].partials(graph, arguments, node)
            if node in slopes:
                partials = [graph.constant(slopes[node])]
            factors[node] = [
                (argument, partial)
                for argument, partial in zip(arguments, partials, strict=True)
                if partial is not None and not graph.depends[argument].isdisjoint(kinds)
            ]
    return factors
