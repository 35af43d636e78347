"""Adds the derivatives of nodes to their graph, as further nodes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from .graph import SOURCES, Graph
from .operations import OPERATIONS


def gradients(graph: Graph, roots: Iterable[int]) -> list[dict[int, int]]:
    """Return the gradient of each root by the continuous states.

    A gradient is a dictionary from the index of a state to the node of the partial derivative by
    this state. Derivatives that are zero are left out. At a corner (`Role.CORNER`) the node gives
    the derivative on one side of the corner.
    """
    roots = list(roots)
    of_node: dict[int, dict[int, int]] = {}
    for node in graph.reachable(roots):
        kind, *index = graph.nodes[node]
        if kind == "state":
            of_node[node] = {int(index[0]): graph.one}
        elif kind in SOURCES:
            of_node[node] = {}
        else:
            of_node[node] = _gradient(graph, node, of_node)
    return [of_node[root] for root in roots]


def _gradient(graph: Graph, node: int, gradient_of: dict[int, dict[int, int]]) -> dict[int, int]:
    """Return the gradient of an operation by the chain rule.

    ``gradient_of``: dictionary from each argument of the node to the gradient of this argument.
    """
    name = str(graph.nodes[node][0])
    arguments = graph.arguments(node)
    indices = sorted({index for argument in arguments for index in gradient_of[argument]})
    if not indices:
        return {}
    partials = OPERATIONS[name].partials(graph, arguments, node)
    total = {}
    for index in indices:
        terms = [
            graph.multiply(partial, gradient_of[argument][index])
            for partial, argument in zip(partials, arguments, strict=True)
            if partial is not None and index in gradient_of[argument]
        ]
        total[index] = graph.add(*terms)
    return {index: term for index, term in total.items() if term != graph.zero}


def time_derivatives(graph: Graph, roots: Iterable[int], rates: Mapping[int, int]) -> list[int]:
    """Return, for each root, the node of its derivative by the time.

    ``rates`` is a dictionary from the node of each source that changes with the time, such as a
    state, to the node of its time derivative. Sources that are not in it count as constant, so the
    time alone with the rate 1 gives the partial derivative by the time. At a corner (`Role.CORNER`)
    the node gives the derivative on one side of the corner.
    """
    roots = list(roots)
    of_node: dict[int, int] = dict(rates)
    for node in graph.reachable(roots):
        if node not in of_node:
            of_node[node] = _time_derivative(graph, node, of_node)
    return [of_node[root] for root in roots]


def _time_derivative(graph: Graph, node: int, of_node: Mapping[int, int]) -> int:
    arguments = graph.arguments(node)
    rates = [of_node[argument] for argument in arguments]
    if all(rate == graph.zero for rate in rates):
        return graph.zero
    partials = OPERATIONS[str(graph.nodes[node][0])].partials(graph, arguments, node)
    terms = (
        graph.multiply(partial, rate)
        for partial, rate in zip(partials, rates, strict=True)
        if partial is not None
    )
    return graph.add(*terms)
