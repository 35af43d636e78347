"""The graph of operations against numpy, and its derivatives against differences."""

import math

import numpy as np
import pytest
from kneexo.compilation.codegen import _Writer

from kneexo.compilation.graph import UNARY, Graph

POINTS = {"asin": 0.3, "acos": 0.3, "log": 1.7, "sqrt": 1.7}


def evaluate(graph, roots, x, p=()):
    writer = _Writer(graph)
    targets = [(f"y[{i}]", root) for i, root in enumerate(roots)]
    text = writer.function("f", ("t", "x", "d", "u", "p", "y"), [("", targets)])
    y = [0.0] * len(roots)
    names = {"math": math, "np": np, "inner": lambda f: f}
    exec(text, names)
    names["f"](0.0, x, (), (), p, y)
    return y


def check_gradient(make, x):
    graph = Graph()
    root = make(graph, *(graph.source("state", i) for i in range(len(x))))
    (gradient,) = graph.gradients([root])
    exact = evaluate(graph, [gradient.get(i, graph.zero) for i in range(len(x))], x)
    for i in range(len(x)):
        up, down = list(x), list(x)
        up[i] += 1e-6
        down[i] -= 1e-6
        slope = (evaluate(graph, [root], up)[0] - evaluate(graph, [root], down)[0]) / 2e-6
        assert exact[i] == pytest.approx(slope, rel=1e-8, abs=1e-8)


@pytest.mark.parametrize("name", UNARY)
def test_derivative_of_each_function_of_one_argument(name):
    check_gradient(lambda g, a: g.unary(name, a), [POINTS.get(name, -0.6)])


@pytest.mark.parametrize("x", [(1.3, 0.4), (0.4, 1.3)])
@pytest.mark.parametrize("name", ["min", "max", "atan2", "power", "divide", "where"])
def test_derivative_of_each_function_of_two_arguments(name, x):
    makers = {
        "power": lambda g, a, b: g.power(a, b),
        "divide": lambda g, a, b: g.divide(a, b),
        "where": lambda g, a, b: g.where(
            g.compare("lt", a, b), g.multiply(a, a), g.unary("sin", b)
        ),
    }
    check_gradient(makers.get(name, lambda g, a, b: g.binary(name, a, b)), x)


def test_derivative_of_a_product_with_a_repeated_factor_and_a_quotient():
    check_gradient(
        lambda g, a, b: g.add(
            g.multiply(a, a, b, g.constant(3.0)), g.divide(a, b), g.power(a, g.constant(-1.5))
        ),
        (1.3, 0.4),
    )


def test_equal_operations_are_one_node():
    graph = Graph()
    a = graph.source("state", 0)
    assert graph.multiply(a, a) == graph.multiply(a, a)
    assert graph.power(a, graph.constant(3.0)) == graph.multiply(a, a, a)
    assert graph.add(a, graph.zero) == a
    assert graph.multiply(a, graph.zero) == graph.zero


def test_horner_is_regrouped_to_the_same_polynomial():
    rng = np.random.default_rng(1)
    coefficients = rng.normal(size=26)
    graph = Graph()
    t = graph.source("state", 0)
    node = graph.source("parameter", 0)
    for i in range(1, 26):
        node = graph.add(graph.source("parameter", i), graph.multiply(node, t))
    for x in (-1.0, -0.3, 0.0, 0.9):
        value = evaluate(graph, [node], [x], coefficients)[0]
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
def test_wrap_by_atan2_becomes_whole_turns(angle):
    graph = Graph()
    a = graph.source("state", 0)
    node = graph.binary("atan2", graph.unary("sin", a), graph.unary("cos", a))
    assert "sin" not in {graph.nodes[n][0] for n in graph.reachable([node])}
    expected = math.atan2(math.sin(angle), math.cos(angle))
    assert evaluate(graph, [node], [angle])[0] == pytest.approx(expected, abs=1e-13)
