"""Drake's expressions as nodes of a graph."""

import numpy as np
import pydrake.math as drake_math
import pytest
from pydrake.symbolic import Expression, Variable, if_then_else
from pydrake.systems.primitives import SymbolicVectorSystem

from diagramc import CompilationError, ExpressionGraph, State, compile_diagram
from diagramc.equations.reader import read_equations


def test_an_expression_of_a_thousand_levels_is_read(diagram_of, leaf):
    def output(context, out):
        value = context.get_time()
        for _ in range(1000):
            value = drake_math.sin(value)
        out.SetAtIndex(0, value)

    diagram = diagram_of(
        leaf("Deep", lambda self, T: self.DeclareVectorOutputPort("out", 1, output))
    )
    kinds = [kind for kind, *_ in read_equations(diagram).graph.nodes]
    assert kinds.count("sin") == 1000


def test_a_quotient_that_is_used_twice_is_read_once(diagram_of, leaf):
    # As a tree the first value has 2²⁰ leaves, more than a reading allows.
    def output(context, out):
        time = context.get_time()
        value = time
        for _ in range(20):
            value = (value + 1.0) / (value + 2.0)
        for index, element in enumerate((value, 1.0 / (time + 2.0), 2.0 / (time + 2.0))):
            out.SetAtIndex(index, element)

    diagram = diagram_of(
        leaf("Deep", lambda self, T: self.DeclareVectorOutputPort("out", 3, output))
    )
    kinds = [kind for kind, *_ in read_equations(diagram).graph.nodes]
    assert kinds.count("divide") == 22
    model = compile_diagram(diagram)
    run = model.simulate(model.parameters(), model.state(), 1.0, record_period_s=1.0)
    (values,) = (run[name][-1] for name in model.outputs)
    # The fixed point of v = (v + 1)/(v + 2) is (√5 − 1)/2.
    assert values == pytest.approx([(5.0**0.5 - 1.0) / 2.0, 1.0 / 3.0, 2.0 / 3.0], rel=1e-12)


def test_a_part_that_is_used_again_is_read_once_in_a_large_expression():
    # As a tree the sum has 2⁶⁰ leaves.
    x = Variable("x")
    value = Expression(x)
    for _ in range(60):
        value = value * value + value
    graph = ExpressionGraph([value], [x])
    expected = 0.01
    for _ in range(60):
        expected = expected * expected + expected
    assert graph.values(np.array([[0.01]]))[0] == pytest.approx([expected], rel=1e-12)


def test_a_large_expression_is_an_error():
    x = Variable("x")
    value = Expression(x)
    for n in range(1, 11_000):
        value = drake_math.sin(n * value)
    with pytest.raises(CompilationError, match="more than 20000 nodes"):
        ExpressionGraph([value], [x])


def test_a_case_distinction_takes_its_branch():
    x = Variable("x")
    rate = if_then_else(Expression(x) > 1.0, -2.0 * x, Expression(3.0))
    system = SymbolicVectorSystem(state=[x], dynamics=[rate], output=[2.0 * x])
    model = compile_diagram(system)
    for start, slope in ((0.0, 3.0), (0.5, 3.0), (4.0, -8.0)):
        run = model.simulate(model.parameters(), State([start], []), 1e-6, record_period_s=1e-6)
        first, last = run["y0"][:, 0]
        assert (last - first) / 2e-6 == pytest.approx(slope, rel=1e-5)
