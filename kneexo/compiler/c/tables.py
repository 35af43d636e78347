"""Tables of what depends on one whole-number input alone, such as the count of an encoder.

A table is computed in double precision when the model is exported and rounded once. In single
precision that is more exact than to compute the same for each step, and it takes no time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..equations.graph import COMPARISONS, SOURCES, Graph
from ..equations.graph_values import values_of
from ..run_data import Array

_CHEAP = ("add", "multiply", "min", "max", "where", "abs", *COMPARISONS, "and", "or", "not")
_CONDITIONS = (*COMPARISONS, "and", "or", "not")


@dataclass(frozen=True)
class Table:
    """Values of a node for each whole number from ``first`` on of an element of the inputs."""

    node: int
    element: int
    first: int
    values: Array


def tables_of(
    graph: Graph,
    roots: Iterable[int],
    ranges: Mapping[int, tuple[int, int]],
    parameters: Array,
) -> list[Table]:
    """Tables that save more than sums and products.

    ``ranges``: of an element of the inputs that is a whole number, its lowest and highest value.
    """
    roots = list(roots)
    nodes = graph.reachable(roots)
    of: dict[int, frozenset[Any]] = {}
    costly: dict[int, bool] = {}
    for node in nodes:
        kind, *rest = graph.nodes[node]
        arguments = graph.arguments(node)
        if graph.is_fixed(node):
            of[node], costly[node] = frozenset(), False
        elif kind in SOURCES:
            alone = kind == "input" and rest[0] in ranges
            of[node], costly[node] = frozenset([rest[0] if alone else "other"]), False
        else:
            of[node] = frozenset().union(*(of[argument] for argument in arguments))
            costly[node] = kind not in _CHEAP or any(costly[argument] for argument in arguments)
    users = [(root, frozenset(["root"])) for root in roots]
    users += [(argument, of[node]) for node in nodes for argument in graph.arguments(node)]
    wanted = {
        node
        for node, by in users
        if len(of[node]) == 1
        and "other" not in of[node]
        and by != of[node]
        and costly[node]
        and graph.nodes[node][0] not in _CONDITIONS
    }
    tables = []
    for node in sorted(wanted):
        (element,) = of[node]
        first, last = ranges[element]
        counts = np.arange(first, last + 1.0)
        (values,) = values_of(graph, [node], {"parameter": parameters, "input": {element: counts}})
        tables.append(Table(node, element, first, values * np.ones_like(counts)))
    return tables
