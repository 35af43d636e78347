"""The graph of operations: equal nodes, and simplified ones against numpy."""

import math

import numpy as np
import pytest

from diagramc.equations.graph import Graph


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
    assert graph.where(graph.node("lt", a, graph.one), a, a) == a
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


def _depth(graph, node):
    return 1 + max((_depth(graph, argument) for argument in graph.arguments(node)), default=0)


def test_horner_is_regrouped_to_the_same_polynomial_and_shallow(interpreted):
    rng = np.random.default_rng(1)
    coefficients = rng.normal(size=26)
    graph = Graph()
    t = graph.source("state", 0)
    node = graph.source("parameter", 0)
    for i in range(1, 26):
        product = graph.multiply(node, t) if i % 2 else graph.multiply(t, node)
        terms = [graph.source("parameter", i), product]
        node = graph.add(*(terms if i % 3 else terms[::-1]))
    assert _depth(graph, node) < 20  # Horner: 51
    for x in (-1.0, -0.3, 0.0, 0.9):
        (value,) = interpreted(graph, [node], state=[x], parameter=coefficients)
        assert value == pytest.approx(np.polyval(coefficients, x), rel=1e-14, abs=1e-14)


@pytest.mark.parametrize("angle", [-7.0, -math.pi + 1e-9, -1.0, 0.0, 3.0, math.pi, 3.3, 100.0])
def test_wrap_by_atan2_becomes_whole_turns(interpreted, angle):
    graph = Graph()
    a = graph.source("state", 0)
    node = graph.atan2(graph.node("sin", a), graph.node("cos", a))
    assert "sin" not in {graph.nodes[n][0] for n in graph.reachable([node])}
    expected = math.atan2(math.sin(angle), math.cos(angle))
    (value,) = interpreted(graph, [node], state=[angle])
    assert value == pytest.approx(expected, abs=1e-13)
