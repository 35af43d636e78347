"""Numbers of the nodes of a graph, against what machine code and C make of them."""

import math

import numpy as np
import pytest

from diagramc.equations.graph import Graph
from diagramc.equations.graph_values import values_of

NAN = math.nan


@pytest.mark.parametrize(
    ("kind", "first", "second", "expected"),
    [
        ("min", 2.0, 1.0, 1.0),
        ("max", 2.0, 1.0, 2.0),
        # std::min and std::max, and Drake with them, give the first where one is no number.
        *((kind, 1.0, NAN, 1.0) for kind in ("min", "max")),
        *((kind, NAN, 1.0, NAN) for kind in ("min", "max")),
        *((kind, 0.0, -0.0, 0.0) for kind in ("min", "max")),
        *((kind, -0.0, 0.0, -0.0) for kind in ("min", "max")),
    ],
)
def test_the_smaller_and_the_larger_one(kind, first, second, expected):
    graph = Graph()
    node = graph.node(kind, graph.source("input", 0), graph.source("input", 1))
    (value,) = values_of(graph, [node], {"input": [np.array([first]), np.array([second])]})
    np.testing.assert_array_equal(value, [expected])
    assert np.signbit(value[0]) == np.signbit(expected)


def test_values_of_numbers_and_of_arrays():
    graph = Graph()
    a, n = graph.source("parameter", 0), graph.source("input", 0)
    angle = graph.multiply(a, n)
    roots = [graph.node("sin", angle), graph.add(a, graph.constant(2.0)), graph.node("sqrt", n)]
    sine, total, root = values_of(
        graph, roots, {"parameter": [0.3], "input": {0: np.array([-1.0, 4.0])}}
    )
    np.testing.assert_allclose(sine, [math.sin(-0.3), math.sin(1.2)], rtol=1e-15)
    assert total == 2.3
    np.testing.assert_array_equal(root, [NAN, 2.0])
