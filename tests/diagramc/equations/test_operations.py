"""The table of operations: each row agrees with itself and with Drake."""

import numpy as np
import pydrake.math as drake_math
import pytest
from pydrake.symbolic import Expression, ExpressionKind, FormulaKind, Variable, if_then_else

from diagramc.equations.gradients import gradients
from diagramc.equations.graph import Graph
from diagramc.equations.graph_values import values_of
from diagramc.equations.operations import OPERATIONS, UNARY, Role

X, Y = Variable("x"), Variable("y")
DRAKE = {
    "add": X + Y,
    "multiply": X * Y,
    "divide": X / Y,
    "power": drake_math.pow(Expression(X), Expression(Y)),
    "gt": X > Y,
    "ge": X >= Y,
    "lt": X < Y,
    "le": X <= Y,
    "eq": X == Y,
    "ne": X != Y,
} | {name: getattr(drake_math, name)(Expression(X)) for name in UNARY}
DRAKE |= {name: getattr(drake_math, name)(Expression(X), Y) for name in ("min", "max", "atan2")}


@pytest.mark.parametrize("name", DRAKE)
def test_values_are_those_of_drake(name):
    drake = DRAKE[name]
    row = OPERATIONS[name]
    kinds = FormulaKind if row.is_condition else ExpressionKind
    assert drake.get_kind() == getattr(kinds, row.drake)
    for x, y in ((0.4, 0.7), (0.7, 0.4), (0.5, 0.5)):
        values = (x,) if row.arguments == 1 else (x, y)
        expected = drake.Evaluate({X: x, Y: y})
        assert row.value(*values) == pytest.approx(expected, rel=1e-15)


def test_every_operation_but_logic_and_choice_is_compared_with_drake():
    assert set(OPERATIONS) - set(DRAKE) == {"and", "or", "not", "where"}
    choice = if_then_else(X > Y, Expression(X), Expression(Y))
    assert choice.get_kind() == getattr(ExpressionKind, OPERATIONS["where"].drake)


@pytest.mark.parametrize("name", [n for n, row in OPERATIONS.items() if row.role is Role.SMOOTH])
def test_derivatives_of_smooth_operations_are_continuous(name):
    graph = Graph()
    arguments = [graph.source("state", i) for i in range(OPERATIONS[name].arguments or 2)]
    (gradient,) = gradients(graph, [graph.node(name, *arguments)])
    points = np.linspace(0.2, 0.8, 601)
    for index in range(len(arguments)):
        state = [np.full_like(points, 0.5) for _ in arguments]
        state[index] = points
        (slope,) = values_of(graph, [gradient[index]], {"state": state})
        assert np.abs(np.diff(slope * np.ones_like(points))).max() < 0.2


@pytest.mark.parametrize("name", [n for n, row in OPERATIONS.items() if row.role is Role.ROUNDING])
def test_rounded_values_are_whole_and_constant_in_between(name):
    values = OPERATIONS[name].value(np.linspace(0.1, 0.9, 9))
    assert (values == values[0]).all()
    assert values[0] == round(values[0])
    graph = Graph()
    (gradient,) = gradients(graph, [graph.node(name, graph.source("state"))])
    assert gradient == {}
