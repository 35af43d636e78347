"""The plan of a model in C: nodes of a step, compensated sums."""

import pytest

from diagramc.c.plan import compensated_sums, step_nodes
from diagramc.c.printer import DOUBLE, FLOAT
from diagramc.equations.equations import Equations, Limit, Update


def discrete_equations(next_value):
    """A discrete state x and an input u; ``next_value(graph, x, u)`` is the node of x⁺."""
    equations = Equations(discrete=["law.0[0]"], inputs={"u": 1})
    g = equations.graph
    x, u = g.source("discrete", 0), g.source("input", 0)
    equations.updates = [Update(0.1, 0.0, ((0, next_value(g, x, u)),))]
    equations.initial_discrete, equations.outputs = [x], {"y": [x]}
    return equations, x, u


def test_a_sum_of_the_state_and_others_is_compensated_in_single_precision():
    equations, _, u = discrete_equations(lambda g, x, u: g.add(x, u, g.constant(2.0)))
    (terms,) = compensated_sums(equations, FLOAT).values()
    assert set(terms) == {u, equations.graph.constant(2.0)}
    assert compensated_sums(equations, DOUBLE) == {}


@pytest.mark.parametrize(
    "next_value",
    [
        lambda g, x, u: u,
        lambda g, x, u: g.multiply(x, u),
        lambda g, x, u: g.add(u, g.constant(2.0)),
        lambda g, x, u: g.add(g.multiply(g.constant(2.0), x), u),
    ],
    ids=["input", "product", "sum without the state", "twice the state"],
)
def test_other_updates_are_not_compensated(next_value):
    equations, *_ = discrete_equations(next_value)
    assert compensated_sums(equations, FLOAT) == {}


def test_a_step_computes_updates_limits_derivatives_and_outputs():
    equations = Equations()
    g = equations.graph
    a, b, c, d, e = (g.constant(float(i)) for i in range(10, 15))
    equations.updates = [Update(0.1, 0.0, ((0, a), (1, b)))]
    equations.limits, equations.derivatives = [Limit("law", c)], [d]
    assert sorted(step_nodes(equations, (e,))) == sorted([a, b, c, d, e])
