"""Steps of RK4 by the fastest mode, for equations whose eigenvalues are known."""

import math

import numpy as np
import pytest

from diagramc.c.step_size import rk4_step_s
from diagramc.equations.equations import Equations
from diagramc.errors import CompilationError
from diagramc.native.runner import STEP_S
from diagramc.run_data import State


def linear(matrix):
    """Dx/dt = A x, with the elements of A as parameters."""
    size = len(matrix)
    equations = Equations(states=[f"x{i}" for i in range(size)])
    g = equations.graph
    for row in range(size):
        terms = [
            g.multiply(g.source("parameter", row * size + column), g.source("state", column))
            for column in range(size)
        ]
        equations.derivatives.append(g.add(*terms))
    equations.parameters = [f"a{i}" for i in range(size * size)]
    values = np.array(matrix, dtype=float)
    return rk4_step_s(equations, values.ravel(), State(np.zeros(size), np.zeros(0)))


@pytest.mark.parametrize(
    ("matrix", "fastest_per_s"),
    [
        ([[-3000.0]], 3000.0),
        ([[0.0, 1.0], [-(2807.0**2), -33.0]], 2807.0),  # an oscillator, nearly undamped
        ([[-1.0, 0.0], [7.0, -4e4]], 4e4),  # a fast mode beside a slow one
        ([[5000.0]], 5000.0),  # unstable
        ([[0.0, 4000.0], [-1000.0, 0.0]], 2000.0),
    ],
)
def test_a_step_is_a_fifth_of_the_fastest_time(matrix, fastest_per_s):
    assert linear(matrix) == pytest.approx(0.2 / fastest_per_s, rel=1e-9)


def test_a_step_is_at_most_that_of_a_run_and_not_arbitrarily_short():
    assert linear([[-999.0]]) == STEP_S == 2e-4
    assert linear([[-1001.0]]) < STEP_S
    assert linear([[0.0, 1.0], [0.0, 0.0]]) == STEP_S  # integrators
    assert rk4_step_s(Equations(), np.zeros(0), State(np.zeros(0), np.zeros(0))) == STEP_S
    assert linear([[-1.9e6]]) == pytest.approx(0.2 / 1.9e6)
    assert linear([[-1e9]]) == 1e-7


def nonlinear(rate, **known):
    """Dx/dt of a graph, one discrete state, one input, one parameter."""
    equations = Equations(parameters=["p"], states=["m.x"], discrete=["m.d"], inputs={"u": 1})
    g = equations.graph
    x, d, u, p, t = (g.source(kind) for kind in ("state", "discrete", "input", "parameter", "time"))
    equations.initial_discrete = [g.multiply(p, g.constant(10.0))]
    equations.derivatives = [rate(g, x, d, u, p, t)]
    values = {"p": 0.0, "x": 0.0, "d": 0.0} | known
    state = State(np.array([values["x"]]), np.array([values["d"]]))
    return rk4_step_s(equations, np.array([values["p"]]), state)


def test_the_mode_is_that_of_the_start():
    square = nonlinear(lambda g, x, *_: g.multiply(x, x, g.constant(-1.0)), x=2500.0)
    assert square == pytest.approx(0.2 / 5000.0)
    # The discrete state is what the initialization makes of it: 10 p.
    held = nonlinear(lambda g, x, d, u, p, t: g.multiply(d, x), p=400.0, d=1e6)
    assert held == pytest.approx(0.2 / 4000.0)
    # Inputs and time are zero.
    rest = nonlinear(
        lambda g, x, d, u, p, t: g.multiply(g.constant(-3000.0), x, g.node("cos", g.add(u, t)))
    )
    assert rest == pytest.approx(0.2 / 3000.0)


def test_a_mode_that_is_not_finite_needs_a_step():
    line = (
        r"^d\(m\.x\)/dt is not finite when it is differentiated by m\.x at the start: step_s is "
        r"needed$"
    )
    with pytest.raises(CompilationError, match=line):
        nonlinear(lambda g, x, *_: g.node("sqrt", x))
    assert math.isfinite(nonlinear(lambda g, x, *_: g.node("sqrt", x), x=1.0))
