"""Tables of what depends on one whole-number input alone."""

import math

import numpy as np
import pytest

from diagramc.c.interface import Interface
from diagramc.c.source import CSource
from diagramc.c.tables import tables_of
from diagramc.equations.equations import Equations, Update
from diagramc.equations.graph import Graph
from diagramc.equations.operations import UNARY
from diagramc.errors import CompilationError
from diagramc.run_data import State

RANGES = {"count": (-3.0, 5.0)}


def counting(**options):
    """x⁺ = sin(a n) x + u, y = (x, cos(a n)), for a count n and a number u."""
    equations = Equations(parameters=["m.a"], discrete=["m.0[0]"], inputs={"count": 1, "u": 1})
    g = equations.graph
    a, n, u, x = (
        g.source(*of) for of in (("parameter",), ("input", 0), ("input", 1), ("discrete",))
    )
    angle = g.multiply(a, n)
    total = g.add(g.multiply(g.node("sin", angle), x), u)
    equations.updates = [Update(0.1, 0.0, ((0, total),))]
    equations.initial_discrete = [x]
    equations.outputs = {"y": [x, g.node("cos", angle)]}
    interface = Interface(integers=frozenset(["count"]), ranges=RANGES)
    state = State(np.zeros(0), np.array([0.5]))
    given = {"interface": interface, "look_up": True} | options
    return CSource(equations, "m", np.array([0.3]), state, **given)


@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_table_has_the_values_of_what_it_replaces(built, precision):
    source = counting(precision=precision)
    assert [table.first for table in source.plan.tables] == [-3, -3]
    counts = np.arange(-3.0, 6.0)
    expected = np.array([np.sin(0.3 * counts), np.cos(0.3 * counts)])
    np.testing.assert_allclose([table.values for table in source.plan.tables], expected, rtol=1e-15)
    inputs = np.column_stack([np.tile(counts, 3), np.linspace(-1.0, 1.0, 27)])
    outputs = built(source).replay(inputs)
    plain = built(counting(precision=precision, look_up=False)).replay(inputs)
    tolerance = 1e-14 if precision == "double" else 1e-6
    np.testing.assert_allclose(outputs, plain, rtol=0, atol=tolerance)
    x = 0.5
    for (n, u), (y, cosine) in zip(inputs, outputs, strict=True):
        x = math.sin(0.3 * n) * x + u
        assert y == pytest.approx(x, abs=tolerance)
        assert cosine == pytest.approx(math.cos(0.3 * n), abs=tolerance)


def test_a_count_outside_is_refused_before_it_is_looked_up(built):
    model = built(counting())
    assert model.init([6, 0.0]) == 1
    assert model.init([0, 0.0]) == 0
    assert [model.step([n, 0.0]) for n in (-4, 6, -(2**31), 2**31 - 1, 5)] == [1, 1, 1, 1, 0]


def test_a_step_neither_computes_nor_keeps_what_is_looked_up():
    source, plain = counting(), counting(look_up=False)
    assert {"sin", "cos"} <= set(plain.operations)
    assert not {"sin", "cos"} & set(source.operations)
    assert "m_table_1[9]" in source.files()["m.h"]
    assert "m_table" not in "".join(plain.files().values())
    assert source.files()["m.c"].count("p->m.a") == 1  # whether it is finite


def test_a_value_that_is_not_finite_is_refused():
    g = Graph()
    node = g.node("log", g.source("input", 0))
    (table,) = tables_of(g, [node], {0: (-1, 2)}, np.zeros(0))
    assert np.isnan(table.values[0])
    equations = Equations(graph=g, inputs={"count": 1}, outputs={"y": [node]})
    interface = Interface(integers=frozenset(["count"]), ranges={"count": (-1, 2)})
    source = CSource(
        *(equations, "m", np.zeros(0), State(np.zeros(0), np.zeros(0))),
        interface=interface,
        look_up=True,
        tick_s=0.1,
    )
    with pytest.raises(CompilationError, match="a value of a table = nan: must be finite"):
        source.files()


def test_every_operation_has_the_value_of_the_interpreter(interpreted):
    g = Graph()
    n, p = g.source("input", 0), g.source("parameter", 0)
    x = g.multiply(n, g.constant(0.125))
    smaller, unequal = g.node("lt", x, p), g.node("ne", x, g.constant(0.25))
    roots = [g.node(name, x) for name in UNARY]
    roots += [g.node(name, g.node("exp", x), p) for name in ("divide", "power", "atan2")]
    roots += [g.node(name, g.node("exp", x), p) for name in ("min", "max", "add", "multiply")]
    for name in ("gt", "ge", "le", "eq"):
        roots.append(g.where(g.node(name, x, p), g.node("sin", x), g.node("exp", x)))
    for condition in (g.simplified("and", smaller, unequal), g.simplified("or", smaller, unequal)):
        roots.append(g.where(g.simplified("not", condition), g.node("sin", x), g.node("exp", x)))
    counts = np.arange(1.0, 8.0)
    tables = tables_of(g, roots, {0: (1, 7)}, np.array([0.4]))
    values = {table.node: table.values for table in tables}
    expected = interpreted(
        g, roots, input=counts[None], parameter=np.full((1, 7), 0.4), time=np.zeros((1, 7))
    )
    looked_up = 0
    for root, right in zip(roots, expected, strict=True):
        if root in values:
            np.testing.assert_allclose(values[root], right, rtol=1e-15)
            looked_up += 1
    assert looked_up >= len(roots) - 1  # |x| is cheap
