"""The Rosenbrock method in C: the statements of its elimination, and its runs against SciPy."""

import math

import numpy as np
import pytest
from pydrake.symbolic import Variable, sin
from pydrake.systems.primitives import LinearSystem, SymbolicVectorSystem
from scipy.integrate import solve_ivp

from diagramc import read_diagram
from diagramc.c.printer import DOUBLE
from diagramc.c.rosenbrock import factorization, solution
from diagramc.c.source import CSource, source_of
from diagramc.c.vectors import recorded_vectors
from diagramc.diagram_equations import equations_key
from diagramc.equations.equations import Equations
from diagramc.errors import CompilationError
from diagramc.model import CompiledModel
from diagramc.native.machine_code import MachineCode
from diagramc.rosenbrock import MOST_SUBSTEPS, Elimination
from diagramc.run_data import State

# ---------------------------------------------------------------------------- elimination


def executed(statements, **arrays):
    """Execute C statements, which are Python without types and semicolons."""
    for statement in statements:
        exec(statement.strip().removeprefix("real ").removesuffix(";"), arrays)


def test_the_statements_of_the_elimination_solve_a_system():
    random = np.random.default_rng(7)
    size = 9
    jacobian = random.normal(size=(size, size)) * (random.random((size, size)) < 0.3)
    elimination = Elimination([np.flatnonzero(row).tolist() for row in jacobian], 1)
    values = [jacobian[entry] for entry in elimination.entries]
    a, b = np.zeros(elimination.size), random.normal(size=size)
    expected = np.linalg.solve(20.0 * np.eye(size) - jacobian, b)
    executed(factorization(elimination, DOUBLE), jacobian=values, diagonal=20.0, a=a)
    executed(solution(elimination, DOUBLE), a=a, b=b)
    np.testing.assert_allclose(b, expected, rtol=1e-13)


# ----------------------------------------------------------------------------------- runs


def source_with(rates_of, start, tick_s=0.1, inputs=0, **options):
    """A model whose derivatives are ``rates_of(graph, states)``; its outputs are the states."""
    names = [f"m.x[{i}]" for i in range(len(start))]
    equations = Equations(states=names, inputs={"u": inputs} if inputs else {})
    g = equations.graph
    states = [g.source("state", i) for i in range(len(start))]
    equations.derivatives = rates_of(g, states)
    equations.outputs = {"y": states}
    state = State(np.array(start), np.zeros(0))
    options = {"integrator": "rosenbrock", "tick_s": tick_s} | options
    return CSource(equations, "m", np.zeros(0), state, **options)


STIFFNESS = 1e3


def van_der_pol(g, states):
    """Dx/dt = v, dv/dt = mu ((1 - x²) v) - x with mu = 1000, which relaxes in 1/3000 s."""
    x, v = states
    damping = g.subtract(g.one, g.multiply(x, x))
    return [v, g.subtract(g.multiply(g.constant(STIFFNESS), damping, v), x)]


@pytest.mark.slow
def test_a_stiff_oscillator_is_that_of_scipy_and_its_error_falls_with_the_tolerance(built):
    def rates(_, y):
        return [y[1], STIFFNESS * (1.0 - y[0] ** 2) * y[1] - y[0]]

    ticks, tick_s = 10, 100.0  # the fast change is at 807 s
    times = tick_s * np.arange(1, ticks + 1)
    exact = solve_ivp(
        rates, (0.0, times[-1]), [2.0, 0.0], "Radau", times, rtol=1e-12, atol=1e-12
    ).y.T
    errors = []
    for tolerance in (1e-4, 1e-6, 1e-8):
        model = built(source_with(van_der_pol, [2.0, 0.0], tick_s, tolerance=tolerance))
        errors.append(np.abs(model.replay(np.zeros((ticks, 0))) - exact)[:, 0].max())
    assert errors[0] < 1e-2
    assert errors[1] < 0.1 * errors[0]
    assert errors[2] < 0.1 * errors[1]
    assert errors[2] < 1e-5


def prothero_robinson(g, states):
    """Dx/dt = -1e6 (x - cos t) - sin t, whose solution x = cos t is far slower than its mode."""
    t = g.source("time")
    error = g.subtract(states[0], g.node("cos", t))
    return [g.add(g.multiply(g.constant(-1e6), error), g.negate(g.node("sin", t)))]


def test_time_is_that_of_the_stages_and_has_a_derivative(built):
    source = source_with(prothero_robinson, [1.0], tolerance=1e-7)
    outputs = built(source).replay(np.zeros((30, 0)))
    np.testing.assert_allclose(outputs[:, 0], np.cos(0.1 * np.arange(1, 31)), atol=1e-6)


def test_the_error_is_that_of_the_tolerance(built):
    """Dx/dt = -x² from 1 is 1/(1 + t); the sum of a few substeps has a few times the tolerance."""

    def rates_of(g, states):
        return [g.negate(g.multiply(states[0], states[0]))]

    for tolerance in (1e-6, 1e-9):
        source = source_with(rates_of, [1.0], 1.0, tolerance=tolerance)
        outputs = built(source).replay(np.zeros((4, 0)))
        errors = np.abs(outputs[:, 0] - 1.0 / np.arange(2.0, 6.0))
        assert 1e-3 * tolerance < errors.max() < 10.0 * tolerance


@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_copied_state_continues_with_the_same_bits(built, precision):
    """The state has the length of the next substep."""
    source = source_with(van_der_pol, [2.0, 0.0], 100.0, precision=precision)
    model, real = built(source), {"double": np.float64, "float": np.float32}[precision]
    assert model.init() == 0
    for _ in range(7):
        assert model.step() == 0
    middle = bytes(model.state)
    *_, substep_s, _, _ = np.frombuffer(model.state, real, source.state_bytes // real().nbytes - 1)
    assert 0.0 < substep_s < 100.0

    def continued():
        outputs = []
        for _ in range(3):
            assert model.step() == 0
            outputs.append(model.get())
        return outputs

    uninterrupted = continued()
    model.state[:] = middle
    assert continued() == uninterrupted


@pytest.mark.parametrize("factor", [1.0, 1e300])
def test_a_tick_that_takes_too_many_substeps_has_its_status(built, factor):
    """Dx/dt = 1e2 x² + u: from x = 1 infinite after 10 ms."""

    def rates_of(g, states):
        square = g.multiply(g.constant(1e2 * factor), states[0], states[0])
        return [g.add(square, g.source("input"))]

    model = built(source_with(rates_of, [0.0], inputs=1))
    assert (model.init([0.0]), model.step([0.0])) == (0, 0)
    before = bytes(model.state)
    assert model.step([1e4]) == 64
    assert bytes(model.state) == before
    assert model.step([0.0]) == 0
    text = model.source.files()["m.c"]
    assert f"count < {MOST_SUBSTEPS}U" in text


def test_a_tick_at_rest_is_one_substep(built):
    """A decay of 1e4 1/s, which RK4 would follow in 400 steps of a tick."""

    def rates_of(g, states):
        return [g.multiply(g.constant(-1e4), g.subtract(states[0], g.source("input")))]

    source = source_with(rates_of, [0.0], inputs=1, tolerance=1e-6)
    model = built(source)
    lengths_s = []
    assert model.init([0.0]) == 0
    for _ in range(4):
        assert model.step([1.0]) == 0
        _, *_, last_s, _ = np.frombuffer(model.state, count=source.state_bytes // 8 - 1)
        lengths_s.append(last_s)
    assert lengths_s[-1] == pytest.approx(0.1)
    assert model.get() == pytest.approx([1.0], abs=1e-6)


def pendulum():
    """The angle q of a pendulum with ten 1/s² of gravity over length."""
    q, v = Variable("q"), Variable("v")
    system = SymbolicVectorSystem(state=[q, v], dynamics=[v, -10.0 * sin(q)], output=[q])
    context = system.CreateDefaultContext()
    context.SetContinuousState([1.0, 0.0])
    return system, context


def test_test_vectors_come_from_the_exact_hold(built):
    system, context = pendulum()
    stiff = {"tick_s": 0.1, "integrator": "rosenbrock", "tolerance": 1e-9}
    source = source_of(read_diagram(system), "m", context, **stiff)
    rows = np.zeros((20, 0))
    differences = np.abs(
        built(source).replay(rows) - recorded_vectors(system, source, rows).outputs
    )
    assert 1e-13 < differences.max() < 1e-7  # made by another method


def test_a_diagram_without_continuous_states_has_no_integrator():
    gain = LinearSystem(A=[[1.0]], B=[[1.0]], C=[[2.0]], D=[[0.0]], time_period=0.01)
    read = read_diagram(gain, inputs=["u0"])
    files = source_of(read, "m", integrator="rosenbrock").files()
    assert files == source_of(read, "m").files()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"integrator": "radau"}, "integrator = 'radau': must be one of rk4, rosenbrock"),
        ({"step_s": 1e-3}, "step_s = 0.001: integrator = 'rosenbrock' has none"),
        (
            {"integrator": "rk4", "tolerance": 1e-6},
            "tolerance = 1e-06: integrator = 'rk4' has none",
        ),
        ({"tolerance": 0.0}, "tolerance = 0: must be a number in 1e-12 … 0.01 in double precision"),
        ({"tolerance": math.nan}, "tolerance = nan: must be a number in 1e-12 … 0.01"),
        ({"tolerance": "1"}, "tolerance = '1': must be a number in"),
        ({"tolerance": 1e-7, "precision": "float"}, "in 1e-06 … 0.01 in float precision"),
    ],
)
def test_wrong_options_are_refused(options, message):
    with pytest.raises(CompilationError, match=message):
        source_with(van_der_pol, [2.0, 0.0], **options)


def test_machine_code_takes_the_same_substeps(built):
    """Else the difference were near the tolerance of 1e-4. The fast change has rejected ones."""
    source = source_with(van_der_pol, [2.0, 0.0], 100.0, tolerance=1e-4)
    model = CompiledModel(MachineCode(equations_key(source.equations), source.equations))
    options = {"integrator": "rosenbrock", "record_period_s": 100.0, "tolerance": 1e-4}
    run = model.simulate(np.zeros(0), source.state, 1000.0, **options)
    replayed = built(source).replay(np.zeros((10, 0)))
    np.testing.assert_allclose(run["y"][1:], replayed, rtol=1e-8)
