"""The judge of suspected steps, against limits of stability from textbooks and known modes."""

import numpy as np
import pytest

from diagramc.native.stability import SAFETY, excess, unstable_step

RATIO = 9.0  # the judge ignores it


def row(t, h, x):
    """A tick of a single step."""
    return np.array([RATIO, t, t + h, h, *x])


def linear(matrix):
    """``rates`` of dx/dt = A x."""
    a = np.array(matrix)
    return lambda d, u, t, x: (a @ x, a)


@pytest.mark.parametrize(
    ("integrator", "real", "turning"),
    [("rk4", 2.785293563405282, 1.902), ("runge_kutta3", 2.512745326618329, 1.492)],
)
def test_limits(integrator, real, turning):
    """Real limits: zeros of |R(z)| - 1; on the imaginary axis 20 % of the amplitude."""
    at_limit = np.array([-real, 1j * turning, -1j * turning])
    np.testing.assert_allclose(excess(integrator, at_limit), 1.0, rtol=2e-3)
    assert excess(integrator, np.array([-0.5, 0.5j, 0.5, 0.0])).max() < 0.5


@pytest.mark.parametrize(("integrator", "reach"), [("rk4", 2.7853), ("runge_kutta3", 2.5127)])
def test_the_first_unstable_step_is_told_with_its_mode_and_a_step_that_works(integrator, reach):
    rates = linear([[-1000.0, 0.0], [5.0, -1.0]])
    rows = np.array(
        [row(0.1, 1e-3, [1.0, 2.0]), row(0.2, 4e-3, [3.0, 4.0]), row(0.3, 8e-3, [1, 1])]
    )
    step = unstable_step(integrator, rates, rows, (2, 0))
    assert (step.time_s, step.step_s, step.eigenvalue) == (0.2, 4e-3, -1000.0)
    np.testing.assert_array_equal(step.state.continuous, [3.0, 4.0])
    np.testing.assert_allclose(step.shares, [1.0, 0.0], atol=1e-9)
    assert step.safe_s == pytest.approx(SAFETY * reach / 1000.0, rel=1e-3)
    assert unstable_step(integrator, rates, rows[:1], (2, 0)) is None


def test_shares_do_not_depend_on_the_units_of_the_states():
    shares = [
        unstable_step(
            "rk4",
            linear([[0.0, 1e4 * unit], [-1e4 / unit, 0.0]]),
            row(0, 1e-3, [1, 1])[None],
            (2, 0),
        ).shares
        for unit in (1.0, 1e6)
    ]
    np.testing.assert_allclose(shares, 0.5, rtol=1e-6)


@pytest.mark.parametrize("width", [0.1, 1e-3])
def test_a_steep_band_between_the_stages_is_found(width):
    """Friction -tanh(v/width): the stages lie on either side of the band, where it is flat."""

    def rates(d, u, t, x):
        slope = -1.0 / width / np.cosh(np.minimum(np.abs(x / width), 300.0)) ** 2
        return -np.tanh(x / width), np.atleast_2d(slope)

    step = unstable_step("rk4", rates, row(0.0, 2.0, [0.61])[None], (1, 0))
    assert step.eigenvalue == pytest.approx(-1.0 / width, rel=0.5)
    short = row(0.0, 0.5 * width, [0.61 * width])[None]
    assert unstable_step("rk4", rates, short, (1, 0)) is None


def test_stages_that_overflow_leave_the_mode_at_the_start():
    def rates(d, u, t, x):
        return -1e3 * x - 1e200 * x**3, np.atleast_2d(-1e3 - 3e200 * x**2)

    step = unstable_step("rk4", rates, row(0.0, 0.01, [1e-90])[None], (1, 0))
    assert step.eigenvalue.real < -1e3
    nowhere = row(0.0, 0.01, [np.inf])[None]
    assert unstable_step("rk4", rates, nowhere, (1, 0)) is None


@pytest.mark.parametrize("integrator", ["rk4", "runge_kutta3"])
def test_the_tick_is_repeated_to_its_first_unstable_step(integrator):
    """x₀ falls by 1 a second; from 0.35 on x₁ has a mode that is too fast. The run overflows."""

    def rates(d, u, t, x):
        per_s = 1e5 if x[0] < 0.35 else 1.0
        return np.array([-1.0, -per_s * x[1]]), np.array([[0.0, 0.0], [0.0, -per_s]])

    tick = np.array([np.inf, 3.0, 4.0, 0.01, 1.0, 1.0])[None]
    step = unstable_step(integrator, rates, tick, (2, 0))
    assert step.time_s == pytest.approx(3.65, abs=0.011)
    assert step.state.continuous == pytest.approx([0.35, np.exp(-0.65)], abs=0.02)
    assert step.eigenvalue == -1e5


def test_inputs_and_discrete_states_reach_the_rates():
    times = []

    def rates(d, u, t, x):
        assert (d.tolist(), u.tolist()) == ([7.0], [8.0, 9.0])
        times.append(t)
        return -x, -np.eye(1)

    assert unstable_step("rk4", rates, row(0.5, 0.1, [1.0, 7.0, 8.0, 9.0])[None], (1, 1)) is None
    assert times[:5] == pytest.approx([0.5, 0.55, 0.55, 0.6, 0.6])  # the last one begins a step


@pytest.mark.parametrize("step_s", [0.05, 0.002])
def test_the_step_that_is_named_comes_from_the_state_where_the_step_begins(step_s):
    """Van der Pol with μ = 1000 at (2, 0), where the mode is μ (1 - 4) = -3000 1/s."""

    def rates(d, u, t, x):
        y, v = x
        slope = np.array([v, 1e3 * ((1.0 - y * y) * v - y)])
        return slope, np.array([[0.0, 1.0], [1e3 * (-2.0 * y * v - 1.0), 1e3 * (1.0 - y * y)]])

    step = unstable_step("rk4", rates, row(0.0, step_s, [2.0, 0.0])[None], (2, 0))
    assert step.eigenvalue == pytest.approx(-3000.0, rel=1e-3)
    assert step.safe_s == pytest.approx(SAFETY * 2.7853 / 3000.0, rel=1e-3)
