"""Derivatives of all operations against central differences, and at undefined points."""

import math

import numpy as np
import pytest

from diagramc.equations.graph import Graph
from diagramc.equations.graph_values import values_of
from diagramc.equations.operations import OPERATIONS, Role
from diagramc.linear.jacobian import Derivatives

SMOOTH = [
    name
    for name, row in OPERATIONS.items()
    if row.role in (Role.SMOOTH, Role.CORNER) and name != "where"
]
POINT = {"state": np.array([0.37, 0.62]), "discrete": np.array([0.81])}


def values_and_jacobian(graph, roots, sources, kinds, smooth=()):
    """The values of the roots and their derivatives."""
    found = Derivatives(graph, roots, kinds)
    values, rows = found.at(sources, smooth)
    return values[found.roots], rows[found.roots]


def two_sources(graph):
    return graph.source("state", 0), graph.source("discrete", 0)


@pytest.mark.parametrize("discrete", [0.81, 1.81])  # the smaller argument is the first or second
@pytest.mark.parametrize("name", SMOOTH)
def test_an_operation_has_the_derivative_of_its_differences(name, discrete):
    graph, point = Graph(), POINT | {"discrete": np.array([discrete])}
    x, d = two_sources(graph)
    product = graph.node("multiply", x, d)
    arguments = [product] if OPERATIONS[name].arguments == 1 else [product, x]
    root = graph.node(name, *arguments)
    size = len(graph.nodes)
    (value,), jacobian = values_and_jacobian(graph, [root], point, ("state", "discrete"))
    assert len(graph.nodes) == size
    step = 1e-6
    for column, (kind, index) in enumerate((("state", 0), ("state", 1), ("discrete", 0))):
        ends = []
        for sign in (1.0, -1.0):
            moved = {key: values.copy() for key, values in point.items()}
            moved[kind][index] += sign * step
            ends += values_of(graph, [root], moved)
        # Central differences err by step² of the third derivative and 1e-16/step.
        expected = (ends[0] - ends[1]) / (2.0 * step)
        assert jacobian[0, column] == pytest.approx(expected, rel=1e-8, abs=1e-8)
    # The elementary functions of NumPy differ in the last bits.
    assert value == pytest.approx(values_of(graph, [root], point)[0], rel=1e-15)


def test_the_columns_have_the_order_of_the_kinds():
    graph = Graph()
    x, d = two_sources(graph)
    root = graph.add(graph.multiply(graph.constant(2.0), x), graph.multiply(graph.constant(5.0), d))
    _, jacobian = values_and_jacobian(graph, [root, d, graph.one], POINT, ("discrete", "state"))
    assert jacobian.tolist() == [[5.0, 2.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]


def test_a_branch_that_is_not_taken_has_no_effect():
    graph = Graph()
    x, d = two_sources(graph)
    zero = graph.subtract(x, x)
    undefined = graph.node("sqrt", zero)  # an infinite derivative
    root = graph.where(graph.node("gt", x, d), undefined, graph.multiply(x, d))
    (value,), jacobian = values_and_jacobian(graph, [root], POINT, ("state", "discrete"))
    assert value == pytest.approx(0.37 * 0.81)
    assert jacobian[0].tolist() == [0.81, 0.0, 0.37]


def test_a_root_of_a_rounded_value_has_the_derivative_zero():
    graph = Graph()
    x, _ = two_sources(graph)
    root = graph.node("sqrt", graph.node("floor", x))  # sqrt has an infinite derivative at 0
    _, jacobian = values_and_jacobian(graph, [root], POINT, ("state", "discrete"))
    assert not jacobian.any()


def test_a_derivative_that_is_infinite_stays_infinite():
    graph = Graph()
    x, _ = two_sources(graph)
    point = POINT | {"state": np.array([0.0, 1.0])}
    _, jacobian = values_and_jacobian(graph, [graph.node("sqrt", x)], point, ("state",))
    assert jacobian[0].tolist() == [math.inf, 0.0]


def test_a_quantizer_has_the_derivative_zero_or_one():
    graph = Graph()
    x, d = two_sources(graph)
    quantized = graph.node("floor", graph.multiply(graph.constant(4.0), x))
    root = graph.multiply(quantized, d)
    kinds = ("state", "discrete")
    (value,), jacobian = values_and_jacobian(graph, [root], POINT, kinds, [quantized])
    assert value == 0.81  # floor(4 · 0.37) d
    assert jacobian[0].tolist() == [4.0 * 0.81, 0.0, 1.0]
    assert values_and_jacobian(graph, [root], POINT, kinds)[1].tolist() == [[0.0, 0.0, 1.0]]


def test_a_rounded_parameter_has_no_derivative():
    graph = Graph()
    rounded = graph.node("floor", graph.source("parameter", 0))
    root = graph.multiply(rounded, graph.source("state", 1))
    point = POINT | {"parameter": np.array([3.7])}
    (value,), jacobian = values_and_jacobian(graph, [root], point, ("state",), [rounded])
    assert value == 3.0 * 0.62
    assert jacobian[0].tolist() == [0.0, 3.0]


def test_the_rows_are_those_of_all_nodes():
    graph = Graph()
    x, d = two_sources(graph)
    aside = graph.node("cos", x)
    product = graph.multiply(x, d)
    found = Derivatives(graph, [graph.node("gt", x, d), product], ("discrete", "state"))
    values, rows = found.at(POINT)
    assert aside not in found.place
    assert found.nodes == sorted(found.place)
    of = {node: (values[place], rows[place].tolist()) for node, place in found.place.items()}
    assert of[x] == (0.37, [0.0, 1.0, 0.0])
    assert of[product] == (0.37 * 0.81, [0.37, 0.81, 0.0])
    assert of[found.nodes[found.roots[0]]] == (0.0, [0.0, 0.0, 0.0])  # false


def test_derivatives_that_depend_on_the_time_are_known():
    graph = Graph()
    (x, _), t = two_sources(graph), graph.source("time")
    additive, product = graph.add(x, t), graph.multiply(x, graph.node("sin", t))
    behind = graph.add(product, x)  # whose own partial derivatives are 1
    roots = [additive, product, behind, t, graph.node("sin", x)]
    assert Derivatives(graph, roots, ("state",)).time_varying == [False, True, True, False, False]
    assert Derivatives(graph, roots[:1], ("state",)).time_varying == [False]
    # A sine of x + t has the derivative cos(x + t).
    assert Derivatives(graph, [graph.node("sin", additive)], ("state",)).time_varying == [True]
