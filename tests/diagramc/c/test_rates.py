"""Faster derivatives: values stay, switches act, factors and early terms come together."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from diagramc.c.rates import fast_rates
from diagramc.c.source import CSource
from diagramc.equations.equations import Equations, Section
from diagramc.equations.graph import Graph
from diagramc.run_data import State

EXACT = ("add", "multiply", "min", "max", "where", "gt", "floor", "add", "multiply")


@settings(max_examples=12, derandomize=True)
@given(data=st.data(), seed=st.integers(0, 2**32 - 1))
def test_values_stay(interpreted, random_graphs, data, seed):
    """Small whole numbers and powers of two make every operation exact, in any order."""
    graph, roots = data.draw(random_graphs.graphs(EXACT, nodes=12, constants=(0.0, 1.0, -1.0, 0.5)))
    rng = np.random.default_rng(seed)
    values = {
        kind: rng.choice([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0], (size, 16))
        for kind, size in random_graphs.sizes.items()
    }
    values["parameter"] = values["parameter"][:, :1] * np.ones(16)
    p = graph.source("parameter", 0)
    if values["parameter"][0, 0]:
        roots = [*roots, *(graph.divide(root, p) for root in roots)]
    scale = 2.0**20
    for value in interpreted(graph, graph.reachable(roots), **values):
        if (np.abs(value) > scale).any() or (scale * value % 1.0 != 0.0).any():
            return  # an operation in another order might round
    before = interpreted(graph, roots, **values)
    new = fast_rates(graph, roots, values["parameter"][:, 0])
    after = interpreted(graph, [new[root] for root in roots], **values)
    for a, b in zip(after, before, strict=True):
        np.testing.assert_array_equal(*np.broadcast_arrays(a, b))


@pytest.mark.parametrize("amplitude", [0.0, 2.0])
def test_a_function_with_the_factor_zero_is_skipped_until_the_factor_changes(
    interpreted, amplitude
):
    g = Graph()
    p, t, x = g.source("parameter"), g.source("time"), g.source("state")
    root = g.add(x, g.multiply(p, g.node("sin", t)))
    faster = fast_rates(g, [root], np.array([amplitude]))[root]
    kinds = [g.nodes[node][0] for node in g.reachable([faster])]
    assert ("where" in kinds) == (amplitude == 0.0)
    for value in (0.0, 3.0):
        sources = {"parameter": [value], "time": [0.5], "state": [0.25]}
        assert interpreted(g, [faster], **sources) == [0.25 + value * math.sin(0.5)]


def test_a_cheap_product_is_no_choice():
    g = Graph()
    root = g.multiply(g.source("parameter"), g.source("state"))
    assert fast_rates(g, [root], np.zeros(1)) == {node: node for node in g.reachable([root])}


def test_a_number_joins_the_factors_behind_a_limit():
    """0.001 min(x / p, q) = min((0.001 / p) x, 0.001 q)."""
    g = Graph()
    p, q, x = g.source("parameter", 0), g.source("parameter", 1), g.source("state")
    limited = g.node("min", g.divide(x, p), q)
    root = g.multiply(g.constant(0.001), limited)
    faster = fast_rates(g, [root], np.ones(2))[root]
    kind, product, limit = g.nodes[faster]
    assert kind == "min"
    assert g.is_fixed(limit)
    name, factor, state = g.nodes[product]
    assert (name, state) == ("multiply", x)
    assert g.is_fixed(factor)


@pytest.mark.parametrize("case", ["negative", "used twice"])
def test_a_number_stays_before_a_limit(case):
    g = Graph()
    limited = g.node("min", g.source("state"), g.source("parameter"))
    factor = g.constant(-2.0 if case == "negative" else 2.0)
    root = g.multiply(factor, limited)
    roots = [root, limited] if case == "used twice" else [root]
    assert g.nodes[fast_rates(g, roots, np.ones(1))[root]] == ("multiply", factor, limited)


def test_early_terms_are_added_first():
    """The input is constant over a tick; the sine is late."""
    g = Graph()
    x, y, u = g.source("state", 0), g.source("state", 1), g.source("input")
    sine, square = g.node("sin", x), g.multiply(x, y)
    root = g.add(sine, square, x, u)
    faster = fast_rates(g, [root], np.zeros(0))[root]
    inner = g.node("add", square, g.node("add", x, u))
    assert faster == g.node("add", inner, sine)


def test_a_sum_that_is_compared_keeps_its_order():
    g = Graph()
    sine = g.node("sin", g.source("state"))
    total = g.add(sine, g.source("input", 0), g.source("input", 1))
    root = g.where(g.node("gt", total, g.zero), g.one, g.zero)
    assert fast_rates(g, [root], np.zeros(0))[root] == root


def test_signals_keep_names_and_comments():
    """The faster derivative s + s² reads the signal s = sin(x / p) too."""
    equations = Equations(parameters=["a/b.p"], states=["x"])
    g = equations.graph
    sine = g.node("sin", g.divide(g.source("state"), g.source("parameter")))
    rate = g.add(sine, g.multiply(sine, sine))
    equations.derivatives, equations.outputs = [rate], {"y": [sine]}
    equations.sections = [
        Section("a/b: output port y", "y = sin(x / p)", (sine,)),
        Section("a/b: time derivatives", "x' = y + y^2", (rate,)),
    ]
    source = CSource(equations, "m", np.ones(1), State(np.zeros(1), np.zeros(0)), tick_s=0.1)
    assert source.functions.rates.statements == [
        "            /* a/b: output port y. y = sin(x / p) */",
        "            const real b_y = sin(c[0] * z0);",
        "            /* a/b: time derivatives. x' = y + y^2 */",
        "            rate0 = b_y + (b_y * b_y);",
    ]
