"""Numbers of the nodes of a graph, without machine code."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import reduce
from typing import Any

import numpy as np

from .graph import UNARY, Graph

_NUMPY = {"acos": "arccos", "asin": "arcsin", "atan": "arctan"}
_OPERATIONS: dict[str, Any] = {
    "add": lambda *terms: reduce(np.add, terms),
    "multiply": lambda *factors: reduce(np.multiply, factors),
    "divide": np.divide,
    "power": np.power,
    "atan2": np.arctan2,
    "min": lambda a, b: np.where(b < a, b, a),  # as std::min: the first where one is nan
    "max": lambda a, b: np.where(a < b, b, a),
    "where": np.where,
    "and": lambda *conditions: reduce(np.logical_and, conditions),
    "or": lambda *conditions: reduce(np.logical_or, conditions),
    "not": np.logical_not,
    "gt": np.greater,
    "ge": np.greater_equal,
    "lt": np.less,
    "le": np.less_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    **{name: getattr(np, _NUMPY.get(name, name)) for name in UNARY},
}


def values_of(graph: Graph, roots: Iterable[int], sources: Mapping[str, Any]) -> list[Any]:
    """Values of nodes: numbers, or arrays where a source is one; what is undefined is nan or inf.

    ``sources``: of each kind of source but constants that the nodes depend on, the values by index.
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
                values[node] = _OPERATIONS[kind](*(values[argument] for argument in rest))
    return [values[root] for root in roots]
