"""Values of the nodes of a graph, without machine code."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from .graph import Graph
from .operations import OPERATIONS


def values_of(graph: Graph, roots: Iterable[int], sources: Mapping[str, Any]) -> list[Any]:
    """Return the values of nodes; undefined ones are nan or inf.

    ``sources``: for each kind of source that the nodes depend on, except constants, the values by
    index. Values that are arrays give arrays.
    """
    roots = list(roots)
    values: dict[int, Any] = {}
    with np.errstate(all="ignore"):
        for node in graph.reachable(roots):
            kind, *rest = graph.nodes[node]
            if kind == "constant":
                values[node] = np.float64(rest[0])
            elif kind in sources:
                values[node] = sources[kind][rest[0]]
            else:
                values[node] = OPERATIONS[kind].value(*(values[argument] for argument in rest))
    return [values[root] for root in roots]
