"""Tables of what depends on one whole-number input alone, such as the count of an encoder.

A table is computed in double precision when the model is exported and rounded once. In single
precision that is more exact than to compute the same for each step, and it takes no time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ..equations.graph import Graph
from ..equations.graph_values import values_of
from ..equations.partition import nodes_by_count
from ..run_data import Array


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
    elements = {graph.source("input", element): element for element in ranges}
    by_count = nodes_by_count(
        graph,
        list(roots),
        elements.__contains__,
        lambda operation: 0 if operation.simple else 1,
        0,
    )
    tables = []
    for node, count in sorted((n, count) for count, nodes in by_count.items() for n in nodes):
        element = elements[count]
        first, last = ranges[element]
        counts = np.arange(first, last + 1.0)
        (values,) = values_of(graph, [node], {"parameter": parameters, "input": {element: counts}})
        tables.append(Table(node, element, first, values * np.ones_like(counts)))
    return tables
