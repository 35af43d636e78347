"""The graph of operations against numpy, and its derivatives against differences."""

import math

import numpy as np
import pytest

from kneexo.compiler.equations.graph import UNARY, Graph

POINTS = {"asin": 0.3, "acos": 0.3, "log": 1.7, "sqrt": 1.7}


def check_gradient(interpreted, make, x):
    graph = Graph()
    root = make(graph, *(graph.source("state", i) for i in range(len(x))))
    (gradient,) = graph.gradients([root])
    exact = interpreted(graph, [gradient.get(i, graph.zero) for i in range(len(x))], state=x)
    for i in range(len(x)):
        up, down = list(x), list(x)
        up[i] += 1e-6
        down[i] -= 1e-6
        values = [interpreted(graph, [root], state=near)[0] for near in (up, down)]
        slope = (values[0] - values[1]) / 2e-6
        assert exact[i] == pytest.approx(slope, rel=1e-8, abs=1e-8)


@pytest.mark.parametrize("name", UNARY)
def test_derivative_of_each_function_of_one_argument(interpreted, name):
    check_gradient(interpreted, lambda g, a: g.unary(name, a), [POINTS.get(name, -0.6)])


@pytest.mark.parametrize("x", [(1.3, 0.4), (0.4, 1.3)])
@pytest.mark.parametrize("name", ["min", "max", "atan2", "power", "divide", "where"])
def test_derivative_of_each_function_of_two_arguments(interpreted, name, x):
    makers = {
        "power": lambda g, a, b: g.power(a, b),
        "divide": lambda g, a, b: g.divide(a, b),
        "where": lambda g, a, b: g.where(
            g.compare("lt", a, b), g.multiply(a, a), g.unary("sin", b)
        ),
    }
    check_gradient(interpreted, makers.get(name, lambda g, a, b: g.binary(name, a, b)), x)


def test_derivative_of_a_product_with_a_repeated_factor_and_a_quotient(interpreted):
    check_gradient(
        interpreted,
        lambda g, a, b: g.add(
            g.multiply(a, a, b, g.constant(3.0)), g.divide(a, b), g.power(a, g.constant(-1.5))
        ),
        (1.3, 0.4),
    )


def test_a_node_of_whole_numbers_has_no_gradient():
    graph = Graph()
    a, b = (graph.source("state", i) for i in range(2))
    (gradient,) = graph.gradients([graph.add(graph.unary("floor", a), graph.multiply(b, b))])
    assert list(gradient) == [1]


def test_equal_operations_are_one_node():
    graph = Graph()
    a = graph.source("state", 0)
    assert graph.multiply(a, a) == graph.multiply(a, a)
    assert graph.power(a, graph.constant(3.0)) == graph.multiply(a, a, a)
    assert graph.add(a, graph.zero) == a
    assert graph.multiply(a, graph.zero) == graph.zero


def test_simplifications():
    graph = Graph()
    a = graph.source("state", 0)
    assert graph.multiply(a, graph.one) == a
    assert graph.divide(a, graph.one) == a
    assert graph.divide(graph.zero, a) == graph.zero
    assert graph.power(a, graph.zero) == graph.one
    assert graph.power(a, graph.one) == a
    assert graph.where(graph.compare("lt", a, graph.one), a, a) == a
    assert graph.negate(graph.constant(2.0)) == graph.constant(-2.0)
    minus = graph.constant(-1.0)
    assert graph.nodes[graph.divide(a, minus)][0] == "divide"


@pytest.mark.parametrize("exponent", [-1.0, 0.5, 17.0, math.inf, -math.inf, math.nan])
def test_other_powers_are_left_to_the_library(exponent):
    graph = Graph()
    node = graph.power(graph.source("state", 0), graph.constant(exponent))
    assert graph.nodes[node][0] == "power"


def test_zeros_of_both_signs_are_two_nodes():
    for zeros in ((0.0, -0.0), (-0.0, 0.0)):
        graph = Graph()
        values = [graph.value(graph.constant(zero)) for zero in (*zeros, *zeros)]
        assert [math.copysign(1.0, value) for value in values] == [
            math.copysign(1.0, zero) for zero in (*zeros, *zeros)
        ]
        assert len(graph.nodes) == 2


def test_horner_is_regrouped_to_the_same_polynomial(interpreted):
    rng = np.random.default_rng(1)
    coefficients = rng.normal(size=26)
    graph = Graph()
    t = graph.source("state", 0)
    node = graph.source("parameter", 0)
    for i in range(1, 26):
        node = graph.add(graph.source("parameter", i), graph.multiply(node, t))
    for x in (-1.0, -0.3, 0.0, 0.9):
        (value,) = interpreted(graph, [node], state=[x], parameter=coefficients)
        assert value == pytest.approx(np.polyval(coefficients, x), rel=1e-14, abs=1e-14)


def _depth(graph, node):
    return 1 + max((_depth(graph, argument) for argument in graph.arguments(node)), default=0)


def test_regrouped_polynomial_is_shallow():
    graph = Graph()
    t = graph.source("state", 0)
    node = graph.source("parameter", 0)
    for i in range(1, 26):
        node = graph.add(graph.multiply(t, node), graph.source("parameter", i))
    assert _depth(graph, node) < 20  # Horner: 51


@pytest.mark.parametrize("angle", [-7.0, -math.pi + 1e-9, -1.0, 0.0, 3.0, math.pi, 3.3, 100.0])
def test_wrap_by_atan2_becomes_whole_turns(interpreted, angle):
    graph = Graph()
    a = graph.source("state", 0)
    node = graph.binary("atan2", graph.unary("sin", a), graph.unary("cos", a))
    assert "sin" not in {graph.nodes[n][0] for n in graph.reachable([node])}
    expected = math.atan2(math.sin(angle), math.cos(angle))
    (value,) = interpreted(graph, [node], state=[angle])
    assert value == pytest.approx(expected, abs=1e-13)
