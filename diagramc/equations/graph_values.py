"""Evaluates nodes of a graph in Python, without machine code."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..run_data import Array
from .graph import Graph
from .operations import OPERATIONS


def values_of(graph: Graph, roots: Iterable[int], sources: Mapping[str, Any]) -> list[Any]:
    """Return the value of each root; an undefined value is nan or inf.

    ``sources`` maps each kind of source, such as ``state``, to the values of all its elements, such
    as all states. Constants need no entry. If each element is an array, each result is an array of
    the same shape.
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


def values_at(points: int, graph: Graph, roots: Iterable[int], sources: Any) -> Array:
    """Return the value of each root at each of some points, (points, roots): see `values_of`."""
    values = values_of(graph, roots, sources)
    return np.array([np.broadcast_to(v, points) for v in values]).reshape(-1, points).T
