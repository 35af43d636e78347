"""Tables of the exact hold against the matrix exponential."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.special
from pydrake.symbolic import Variable, sin, sqrt, tanh
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LinearSystem, SymbolicVectorSystem

from diagramc import InputTable, State, StiffnessError, compile_diagram
from diagramc.native import exact_hold, phi_functions
from diagramc.native.exact_hold import ExactHold, Shared
from diagramc.native.integrators import Tick
from diagramc.native.ir import Array, Module
from diagramc.native.jacobian_slots import Memory, define_choose_slot
from diagramc.native.llvm import Library, compile_text
from diagramc.native.runner import Runner
from diagramc.native.types import BOOL, DOUBLE, INT, POINTER

SQUARED_MODULUS = 0.7
"""Of the elliptic functions sn, cn, dn, which turn as a rigid body without torque."""


@pytest.fixture(scope="module")
def rigid_body():
    return make_rigid_body()


@pytest.fixture(scope="module")
def without_explicit_steps():
    """`make_rigid_body`, where no number of halvings makes a step explicit."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exact_hold, "_EXPLICIT", phi_functions.FINEST + 1)
        return make_rigid_body()


@pytest.fixture(scope="module")
def driven():
    """`without_explicit_steps`, whose steps are driven once a step has missed the tolerance."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exact_hold, "_EXPLICIT", phi_functions.FINEST + 1)
        return make_rigid_body(second_rate=True)


def make_rigid_body(second_rate=False):
    """``run(start, tick_s, matrices, tolerance)``: state at the end, and how many rates it took.

    There is a tick for each of the matrices; they take the place of the Jacobian at the start of a
    step, unless they are None.
    """
    module = Module()
    choose_slot = define_choose_slot(module, 3)
    names = ("x", "matrix", "numbers", "memory", "shared", "failed")
    f = module.function("run", dict.fromkeys(names, POINTER), internal=False)
    x, matrix, numbers, memory, shared = (Array(f.arguments[n], DOUBLE) for n in names[:-1])
    tick_s, tolerance, fixed = (numbers[i] for i in range(3))

    def rate(_time, x, out):
        numbers[3] = numbers[3] + 1.0
        out[0] = x[1] * x[2]
        out[1] = -x[0] * x[2]
        out[2] = -SQUARED_MODULUS * x[0] * x[1]

    def second(_time, x, out):
        rate(_time, x, out)
        out[3] = out[1] * x[2] + x[1] * out[2]
        out[4] = -out[0] * x[2] - x[0] * out[2]
        out[5] = -SQUARED_MODULUS * (out[0] * x[1] + x[0] * out[1])

    def choose(_tick, _lane, own, _time):
        zero = f.constant(0.0)
        by_columns = [
            *(zero, -x[2], -SQUARED_MODULUS * x[1]),
            *(x[2], zero, -SQUARED_MODULUS * x[0]),
            *(x[1], -x[0], zero),
        ]
        candidate = own.shifted(Memory(3).candidate)
        for i, element in enumerate(by_columns):
            candidate[i] = f.select(fixed.differs(0.0), matrix[i], element)
        f.call(choose_slot, x.pointer, own.pointer)

    running = f.constant(1, BOOL)
    tick = Tick(f, 3, DOUBLE, f.constant(0.0), tick_s, x, running, rate, tick_s)
    if second_rate:
        tick = replace(tick, second_rate=second)
    hold = ExactHold(tick_s, tolerance, memory, shared, choose)
    hold.prepare(tick)
    Array(f.arguments["failed"], INT)[0] = f.flags(hold.advance(tick)[0])
    library = Library(compile_text(module.text()))
    advance = library.function("run", len(names))

    def run(start, tick_s, matrices, tolerance):
        at = Memory(3)
        x, memory, shared = np.array(start), np.zeros(at.size), np.zeros(Shared(3).size)
        numbers, failed = np.array([tick_s, tolerance, 0.0, 0.0]), np.zeros(1, dtype=np.int64)
        for matrix in matrices:
            numbers[2] = matrix is not None
            by_columns = np.zeros(9) if matrix is None else matrix.T.ravel()
            arrays = (x, by_columns, numbers, memory, shared, failed)
            advance(*(array.ctypes.data for array in arrays))
            assert not failed[0]
        return x, round(numbers[3])

    return run


SOME_MATRIX = np.array([[-0.2, 0.9, 0.3], [-1.1, -0.4, 0.2], [0.5, -0.6, -0.3]])


def turned(time_s):
    """The state that was 0, 1, 1."""
    return np.array(scipy.special.ellipj(time_s, SQUARED_MODULUS)[:3])


@pytest.mark.parametrize(
    ("body", "matrix", "order"),
    [
        pytest.param("without_explicit_steps", np.zeros((3, 3)), 3, id="no matrix"),
        pytest.param("without_explicit_steps", SOME_MATRIX, 3, id="some matrix"),
        pytest.param("without_explicit_steps", None, 4, id="Jacobian"),
        pytest.param("driven", np.zeros((3, 3)), 4, id="driven, no matrix"),
        pytest.param("driven", SOME_MATRIX, 4, id="driven, some matrix"),
    ],
)
def test_order(request, body, matrix, order):
    """All steps miss such a tolerance, so they are the finest."""
    run, errors = request.getfixturevalue(body), []
    for ticks in (1, 2):
        end, _ = run(turned(0.0), 40.0 / ticks, [matrix] * ticks, 1e-18)
        errors.append(np.abs(end - turned(40.0)).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)


def test_short_steps_are_explicit(rigid_body, without_explicit_steps):
    """All steps are the finest; all but the first evaluate six rates and are of order five."""
    errors, rates = [], []
    for run in (rigid_body, without_explicit_steps):
        end, count = run(turned(0.0), 100.0, [np.zeros((3, 3))], 1e-18)
        errors.append(np.abs(end - turned(100.0)).max())
        rates.append(count)
    assert rates[0] > 1.9 * rates[1] > 5.7 * 2**phi_functions.FINEST
    assert errors[0] < 1e-2 * errors[1]


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8])
def test_many_steps_share_the_tolerance(without_explicit_steps, tolerance):
    """With the whole tolerance for each step the error is 24 and 30 times the tolerance."""
    end, _ = without_explicit_steps(turned(0.0), 2.0, [SOME_MATRIX] * 20, tolerance)
    assert np.abs(end - turned(40.0)).max() <= 10.0 * tolerance


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8])
def test_explicit_steps_follow_the_tolerance(rigid_body, tolerance):
    """Ticks so long that even with the right Jacobian all steps are among many."""
    end, _ = rigid_body(turned(0.0), 20.0, [None] * 2, tolerance)
    assert np.abs(end - turned(40.0)).max() <= 10.0 * tolerance


def test_small_steps_that_pass_find_a_better_jacobian(without_explicit_steps):
    """A body that turns and sways a little, and a matrix that was far off at the first tick."""
    start = np.array([1e-3, 0.0, 1.0])
    _, first = without_explicit_steps(start, 2.0, [SOME_MATRIX], 1e-8)
    _, count = without_explicit_steps(start, 2.0, [SOME_MATRIX] + 9 * [None], 1e-8)
    assert count <= 3 * first


def test_steps_are_as_small_as_each_run_needs():
    """Where x' = k x(1 − x) and y' = −k x y: x grows as the logistic function, y/(1 − x) stays."""
    x, y, k = (Variable(name) for name in "xyk")
    system = SymbolicVectorSystem(
        state=[x, y], parameter=[k], dynamics=[k * x * (1.0 - x), -k * x * y], output=[x, y]
    )
    model = compile_diagram(system)
    rates, starts = np.geomspace(1.0, 3e3, 9), np.geomspace(1e-6, 0.5, 9)[::-1]
    states = [State([start, 2.0], []) for start in starts]
    # One tick is from a hundredth to thirty times the time constant.
    runs = model.simulate_batch(rates[:, None], states, 0.1, record_period_s=0.01, threads=1)
    for rate, start, run in zip(rates, starts, runs, strict=True):
        grown = 1.0 / (1.0 + (1.0 / start - 1.0) * np.exp(-rate * run.time_s))
        exact = np.column_stack([grown, 2.0 * (1.0 - grown) / (1.0 - start)])
        np.testing.assert_allclose(run["y0"], exact, rtol=0, atol=1e-5)


def test_a_linear_system_of_many_states_is_the_matrix_exponential():
    size = 12  # more than are unrolled
    rng = np.random.default_rng(7)
    a = rng.normal(size=(size, size)) - 10.0 * np.eye(size)
    nothing = np.zeros((size, 0))
    model = compile_diagram(LinearSystem(a, nothing, np.eye(size), nothing, 0.0))
    start = rng.normal(size=size)
    run = model.simulate(model.parameters(), State(start, []), 0.3, record_period_s=0.1)
    for time, row in zip(run.time_s, run["y0"], strict=True):
        np.testing.assert_allclose(row, scipy.linalg.expm(a * time) @ start, rtol=0, atol=1e-9)


BAND_M_S = 1e-3
SPRING_N_M = 6e6
REVERSAL_S = 0.052


@pytest.fixture(scope="module")
def friction():
    """A mass of 1 kg that a moving spring pulls against k N of friction: p' = c (u − v), 390 Hz.

    In the band of velocities where the friction changes its sign, its slope of k/v_0 is a damping
    of many thousand N s/m.
    """
    v, p, k, t = (Variable(name) for name in "vpkt")
    speed = 0.02 * sin(np.pi / REVERSAL_S * t)
    rates = [p - k * tanh(v / BAND_M_S), SPRING_N_M * (speed - v)]
    return compile_diagram(
        SymbolicVectorSystem(time=t, state=[v, p], parameter=[k], dynamics=rates, output=[v, p])
    )


def test_errors_follow_the_tolerance_where_friction_changes_sign(friction):
    force_n, times = 5.0, np.linspace(0.0, 0.12, 13)

    def rates(t, state):
        v, p = state
        speed = 0.02 * np.sin(np.pi / REVERSAL_S * t)
        return [p - force_n * np.tanh(v / BAND_M_S), SPRING_N_M * (speed - v)]

    exact = scipy.integrate.solve_ivp(
        rates, (0.0, times[-1]), [0.0, 0.0], method="DOP853", t_eval=times, rtol=1e-12, atol=1e-12
    ).y.T
    # A method of order two has errors of 17,000 and 107,000 times the tolerance.
    for tolerance in (1e-8, 1e-10):
        start = State([0.0, 0.0], [])
        run = friction.simulate(
            [force_n], start, times[-1], record_period_s=0.01, tolerance=tolerance
        )
        error = np.abs(run["y0"] - exact) / np.abs(exact).max(axis=0)
        assert error.max() <= 3000.0 * tolerance


def test_lanes_and_pieces_have_the_bits_of_a_run_alone_through_friction(friction):
    start, ticks = np.zeros((2, 1)), 60
    forces = np.geomspace(1.0, 50.0, 8)[:, None]
    batch = friction.simulate_batch(forces, State(start[:, 0], []), 0.12, record_period_s=0.002)
    for force, run in zip(forces, batch, strict=True):
        runner = Runner(friction.code, record_period_s=0.002).restart(force[None])
        x, d = start.copy(), np.zeros((0, 1))
        for tick in range(ticks):
            np.testing.assert_array_equal(x[:, 0], run["y0"][tick])
            runner.run(x, d, tick, np.array([tick + 1]), [friction.no_inputs])
        np.testing.assert_array_equal(x[:, 0], run["y0"][ticks])


SPRING_RAD_S, PULL_RAD_S, DAMPING_PER_S = 2000.0, 0.5, 400.0
RESPONSE = SPRING_RAD_S**2 / (SPRING_RAD_S**2 - PULL_RAD_S**2 + 1j * DAMPING_PER_S * PULL_RAD_S)


def make_pulled(pull, inputs=()):
    """A mass at x on a stiff damped spring, whose other end is at ``pull``: 318 Hz."""
    x, v, t, u = (Variable(name) for name in "xvtu")
    rates = [v, SPRING_RAD_S**2 * (pull(t, u) - x) - DAMPING_PER_S * v]
    system = SymbolicVectorSystem(
        time=t, state=[x, v], input=[u] * len(inputs), dynamics=rates, output=[x, v]
    )
    return compile_diagram(system, inputs=inputs)


def pulled(times):
    """The steady motion x and v, (times, 2), of a mass whose pull is sin(PULL_RAD_S t)."""
    turning = RESPONSE * np.exp(1j * PULL_RAD_S * np.atleast_1d(times))
    return np.column_stack([turning.imag, (1j * PULL_RAD_S * turning).imag])


def taylor(start_s, width_s):
    """Powers of the time since ``start_s`` of the sine, up to rounding within ``width_s``."""
    shifts = PULL_RAD_S * start_s + 0.5 * np.pi * np.arange(8)
    assert (PULL_RAD_S * width_s) ** 8 < 1e-16 * scipy.special.factorial(8)
    return np.sin(shifts) * PULL_RAD_S ** np.arange(8) / scipy.special.factorial(np.arange(8))


WIDTH_S = 0.0123  # not a multiple of half a tick, so that some breaks lie within steps
BREAKS_S = WIDTH_S * np.arange(0, 20)
TABLE = InputTable(BREAKS_S, [[taylor(b, WIDTH_S)] for b in (0.0, *BREAKS_S)])


@pytest.mark.parametrize("source", ["time", "table"])
def test_a_pulled_stiff_spring_is_exact_in_two_steps_a_tick(source):
    """Steps that are not driven need 4 to 16 in a tick, as the estimate demands."""
    if source == "time":
        model = make_pulled(lambda t, u: sin(PULL_RAD_S * t))
        table = model.no_inputs
    else:
        model, table = make_pulled(lambda t, u: u, ["u0"]), TABLE
    runner = Runner(model.code, record_period_s=0.002).restart(model.parameters()[None])
    x, d, levels = pulled(0.0).T.copy(), np.zeros((0, 1)), []
    for tick in range(100):
        runner.run(x, d, tick, np.array([tick + 1]), [table])
        levels.append(int(runner._shared.view(np.int64)[Shared(2).level]))
        (exact,) = pulled(0.002 * (tick + 1))
        assert (np.abs(x[:, 0] - exact) / (1.0 + np.abs(exact))).max() <= 1e-9
    assert max(levels) == 1


@pytest.mark.parametrize("source", ["time", "table"])
def test_records_within_driven_steps_are_right(source):
    """The table has breaks within steps."""
    model, table = make_pulled(lambda t, u: sin(PULL_RAD_S * t)), None
    if source == "table":
        model, table = make_pulled(lambda t, u: u, ["u0"]), TABLE
    times = np.sort(np.random.default_rng(1).uniform(0.0, 0.2, 500))
    start = State(pulled(0.0)[0], np.empty(0))
    run = model.simulate(model.parameters(), start, 0.2, record_times_s=times, inputs=table)
    error = np.abs(run["y0"] - pulled(times)) / (1.0 + np.abs(pulled(times)))
    assert error.max() <= 1e-9


P, W = 50.0, 500.0  # pole and frequency in 1/s


def test_records_within_explicit_steps_are_right(friction):
    start, times = State([0.0, 0.0], []), np.sort(np.random.default_rng(1).uniform(0.0, 0.1, 300))
    fine = {"integrator": "rk4", "step_s": 1e-6}
    ours, right = (
        friction.simulate([20.0], start, 0.1, record_times_s=times, record_period_s=2e-3, **way)
        for way in ({}, fine)
    )
    error = np.abs(ours["y0"] - right["y0"]) / np.ptp(right["y0"], axis=0)
    assert error.max() <= 3e-5
    forces = np.geomspace(1.0, 50.0, 8)[:, None]  # lanes with steps of different lengths
    for force, run in zip(
        forces, friction.simulate_batch(forces, start, 0.1, record_times_s=times), strict=True
    ):
        alone = friction.simulate(force, start, 0.1, record_times_s=times)
        np.testing.assert_array_equal(run["y0"], alone["y0"])


def test_records_within_steps_of_a_slow_lag_are_right():
    """Records in the second half of a step are computed from its end."""
    x, t = Variable("x"), Variable("t")
    system = SymbolicVectorSystem(time=t, state=[x], dynamics=[sin(W * t) - P * x], output=[x])
    model, times = compile_diagram(system), np.sort(np.random.default_rng(1).uniform(0, 0.1, 300))
    run = model.simulate(np.empty(0), model.state(), 0.1, record_times_s=times)
    right = P * np.sin(W * times) - W * np.cos(W * times) + W * np.exp(-P * times)
    np.testing.assert_allclose(run["y0"][:, 0], right / (P**2 + W**2), rtol=0, atol=3e-8)


def test_a_root_at_zero_whose_second_derivative_is_not_finite():
    x, v, y, t = (Variable(name) for name in "xvyt")
    pull = SPRING_RAD_S**2 * (sin(PULL_RAD_S * t) - x) - DAMPING_PER_S * v
    system = SymbolicVectorSystem(
        time=t, state=[x, v, y], dynamics=[v, pull, sqrt(y)], output=[x, v, y]
    )
    model = compile_diagram(system)
    runner = Runner(model.code, record_period_s=0.002).restart(model.parameters()[None])
    state = np.append(pulled(0.0), 0.0)[:, None]
    runner.run(state, np.zeros((0, 1)), 0, np.array([5]), [model.no_inputs])
    np.testing.assert_allclose(state[:2, 0], pulled(0.01)[0], rtol=0, atol=1e-9)
    assert state[2, 0] == 0.0
    assert runner._shared.view(np.int64)[Shared(3).level] == 1  # as without the root


def lags(poles_per_s):
    """The model of a chain of lags x_i' = p_i (x_(i-1) - x_i) behind a step, with output x."""
    count = len(poles_per_s)
    a = np.diag(poles_per_s) @ (np.eye(count, k=-1) - np.eye(count))
    b = np.eye(count)[:, :1] * poles_per_s[0]
    builder = DiagramBuilder()
    plant = builder.AddSystem(LinearSystem(a, b, np.eye(count), np.zeros((count, 1))))
    one = builder.AddSystem(ConstantVectorSource([1.0]))
    builder.Connect(one.get_output_port(), plant.get_input_port())
    builder.ExportOutput(plant.get_output_port(), "x")
    return compile_diagram(builder.Build())


@pytest.mark.parametrize(
    "poles_per_s",
    [(1e-3, 1e12, 1.0), (1e12, 1e6, 1e-2), (3e5, 40.0, 1e8), (2e4, 3e3, 50.0), (2e3, 50.0)],
    ids=str,
)
def test_linear_chains_with_fast_poles_are_right(poles_per_s):
    """The poles are far apart, so the sum of exponentials keeps its digits."""
    model = lags(poles_per_s)
    times = np.sort(np.random.default_rng(1).uniform(0.0, 0.2, 300))
    for records in ({"record_period_s": 0.02}, {"record_times_s": times}):
        run = model.simulate(model.parameters(), model.state(), 0.2, **records)
        right = np.ones_like(run.time_s)
        for q in poles_per_s:
            weight = np.prod([p / (p - q) for p in poles_per_s if p != q])
            right -= weight * np.exp(-q * run.time_s)
        np.testing.assert_allclose(run["x"][:, -1], right, rtol=0, atol=1e-13)


def test_a_pole_beyond_the_limit_of_the_exact_hold_ends_the_run():
    model = lags((1.0, 1e14))
    with pytest.raises(StiffnessError, match=r"faster than 1e\+13 1/s.*use rosenbrock"):
        model.simulate(model.parameters(), model.state(), 0.2, record_period_s=0.02)
