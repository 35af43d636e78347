"""Functions in C of a model: the operations of a step, the variables that they read."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.primitives import LinearSystem

from diagramc import read_diagram
from diagramc.c.functions import Function
from diagramc.c.source import CSource, source_of
from diagramc.equations.equations import Equations, Section, Update
from diagramc.run_data import State


def test_operations_of_a_step_count_all_stages():
    system = LinearSystem([[0.0, 1.0], [-400.0, -4.0]], [[0.0], [400.0]], [[1.0, 0.0]], [[0.0]])
    source = source_of(read_diagram(system, inputs=["u0"]), "m", tick_s=0.01, step_s=0.002)
    one_step = replace(source, step_s=0.01)
    assert source.plan.schedule.steps == 5
    # x1' = 400 u - 400 x0 - 4 x1: the input is constant over a tick. The output is a state.
    assert one_step.operations == {"*": 1 + 4 * 2, "+": 4 * 2}
    assert source.operations == {"*": 1 + 20 * 2, "+": 20 * 2}


def test_a_value_that_is_constant_over_a_tick_is_computed_before_the_loops(built):
    equations = Equations(states=["x"], discrete=["d"], inputs={"u": 1})  # x' = exp(u) sin(x) + d
    g = equations.graph
    x, d, u = (g.source(kind) for kind in ("state", "discrete", "input"))
    equations.derivatives = [g.add(g.multiply(g.node("exp", u), g.node("sin", x)), d)]
    equations.outputs, equations.initial_discrete = {"y": [x]}, [d]
    equations.updates = [Update(0.1, 0.0, ((0, d),))]
    source = CSource(equations, "m", np.zeros(0), State(np.array([1.0]), np.array([3.0])))
    assert source.functions.tick_values.statements == ["    const real held0 = exp(in->u);"]
    assert not source.functions.rates.reads("in")
    assert source.functions.rates.reads("held0")
    assert source.operations["exp"] == 1
    h, state = source.plan.schedule.step_s, 1.0
    for _ in range(source.plan.schedule.steps):
        rates = [0.0]
        for part in (0.0, 0.5, 0.5, 1.0):
            rates.append(math.exp(0.2) * math.sin(state + part * h * rates[-1]) + 3.0)
        state += h / 6.0 * (rates[1] + 2.0 * rates[2] + 2.0 * rates[3] + rates[4])
    assert built(source).replay([[0.2]])[0, 0] == pytest.approx(state, rel=1e-14)


def test_derivatives_of_many_terms_are_a_function_of_their_own():
    """A dense matrix of 40 states has 1600 products, 1560 sums, and their arguments."""
    matrix = np.random.default_rng(0).normal(size=(40, 40))
    for size, is_large in ((4, False), (40, True)):
        a, c = matrix[:size, :size], np.eye(1, size)
        diagram = read_diagram(LinearSystem(a, np.ones((size, 1)), c, [[0.0]]), inputs=["u0"])
        functions = source_of(diagram, "m", tick_s=0.01, step_s=0.01).functions
        assert functions.is_large is is_large
        assert ("rate_at" in [f.name for f in functions.of_an_instant]) is is_large
        assert bool(functions.rates.statements) is not is_large


def test_a_comment_asks_for_no_variable(built):
    """The comment names x and d, which the model does not have."""

    equations = Equations(inputs={"u": 1})
    g = equations.graph
    y = g.multiply(g.constant(2.0), g.source("input", 0))
    equations.outputs = {"y": [y]}
    equations.sections = [Section("d: output y", "y = x + c", (y,))]
    source = CSource(equations, "m", np.zeros(0), State(np.zeros(0), np.zeros(0)), tick_s=0.1)
    assert built(source).replay([[4.0]]).tolist() == [[8.0]]


@pytest.mark.parametrize(
    ("port", "name"), [("gain", "law_gain"), ("and", "law_and"), ("t", "law_t")]
)
def test_a_variable_has_the_name_of_its_signal(built, port, name):
    source = CSource(*model_of("law", port), tick_s=0.1)
    assert f"const real {name} = 2.0 * in->u;" in source.files()["law.c"]
    assert built(source).replay([[4.0]]).tolist() == [[9.0]]


@pytest.mark.parametrize("port", ["step", "params_t", "init", "inputs_t"])
def test_no_signal_has_the_name_of_a_function_or_type(built, port):
    source = CSource(*model_of("law", port), tick_s=0.1)
    assert f"law_{port} = 2.0" not in source.files()["law.c"]
    assert built(source).replay([[4.0]]).tolist() == [[9.0]]


def model_of(name, port):
    """The equations of y = 1 + a, where a = 2 u is the output ``port`` of the leaf ``name``."""
    equations = Equations(inputs={"u": 1})
    g = equations.graph
    a = g.multiply(g.constant(2.0), g.source("input", 0))
    y = g.add(g.one, a)
    equations.outputs = {"y": [y]}
    equations.sections = [
        Section(f"{name}: output port {port}", "", (a,)),
        Section("y: output port y", "", (y,)),
    ]
    return equations, name, np.zeros(0), State(np.zeros(0), np.zeros(0))


@pytest.mark.parametrize(
    ("statement", "reads_x"),
    [
        ("y = x[0];", True),
        ("y = 2.0*x;", True),
        ("y = 1.0; /* x\nis x */", False),
        ("y = p->x;", False),
        ("y = in.x + max + x_0;", False),
    ],
)
def test_a_function_reads_what_its_code_names(statement, reads_x):
    assert Function("f", "", ["real y;", statement]).reads("x") is reads_x
