"""Derivatives of nodes by states and by the time, against differences."""

import math

import pytest

from diagramc.equations.gradients import gradients, time_derivatives
from diagramc.equations.graph import Graph
from diagramc.equations.operations import UNARY

POINTS = {"asin": 0.3, "acos": 0.3, "log": 1.7, "sqrt": 1.7}


def check_gradient(interpreted, make, x):
    graph = Graph()
    root = make(graph, *(graph.source("state", i) for i in range(len(x))))
    (gradient,) = gradients(graph, [root])
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
    check_gradient(interpreted, lambda g, a: g.node(name, a), [POINTS.get(name, -0.6)])


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
    (gradient,) = gradients(graph, [graph.add(graph.node("floor", a), graph.multiply(b, b))])
    assert list(gradient) == [1]


def test_the_time_alone_gives_the_partial_derivative_by_the_time(interpreted):
    graph = Graph()
    t, x = graph.source("time"), graph.source("state", 0)
    roots = [graph.multiply(graph.node("sin", t), x), x]
    by_time, of_state = time_derivatives(graph, roots, {t: graph.one})
    assert of_state == graph.zero
    (value,) = interpreted(graph, [by_time], state=[3.0], time=[0.5])
    assert value == pytest.approx(3.0 * math.cos(0.5))


def test_time_derivative_follows_all_sources_that_change(interpreted):
    graph = Graph()
    t, x, y, p = (
        graph.source(*kind) for kind in (("time",), ("state",), ("state", 1), ("parameter",))
    )
    root = graph.add(graph.multiply(p, graph.node("sin", t), x), graph.divide(x, y))
    still = graph.multiply(p, graph.node("floor", t))
    rates = {t: graph.one, x: graph.multiply(x, y), y: graph.constant(-0.3)}
    derivative, of_still = time_derivatives(graph, [root, still], rates)
    assert of_still == graph.zero

    def at(dt):
        sources = {"time": [0.7 + dt], "state": [1.3 + 1.3 * 0.4 * dt, 0.4 - 0.3 * dt]}
        return sources | {"parameter": [2.5]}

    (exact,) = interpreted(graph, [derivative], **at(0.0))
    ends = [interpreted(graph, [root], **at(dt))[0] for dt in (1e-6, -1e-6)]
    assert exact == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-8)
