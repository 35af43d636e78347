"""Transfer functions of loops, their sensitivities and their forms."""

import math
import re

import control
import numpy as np
import pytest
from scipy.linalg import block_diag

from diagramc import (
    ParameterError,
    PeriodicLoop,
    TickModel,
    Transfer,
    as_transfer,
    complementary_sensitivity,
    sensitivity,
)

LAG = (-np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)))  # 1/(s + 1)


def random_matrices(seed, size=5):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(size, size))
    return a, rng.normal(size=(size, 1)), rng.normal(size=(1, size)), rng.normal(size=(1, 1))


@pytest.mark.parametrize("period_s", [None, 0.01])
def test_a_response_is_that_of_python_control(period_s):
    matrices = random_matrices(3)
    f = np.array([0.0, 1e-3, 0.4, 7.0, 49.0])
    s = 2j * np.pi * f
    expected = control.ss(*matrices, period_s or 0)(s if period_s is None else np.exp(s * period_s))
    loop = as_transfer((*matrices, period_s))
    np.testing.assert_allclose(loop.response(f), expected, rtol=1e-11)
    again = loop.to_control()
    assert again.dt == (period_s or 0)
    np.testing.assert_array_equal(again.A, matrices[0])


def test_states_in_any_unit_give_all_digits():
    # 1/((s + 1)(s + 1e3)(s + 1e6)) in companion form has elements from 1 to 1e9.
    poles = (1.0, 1e3, 1e6)
    polynomial = np.poly([-pole for pole in poles])
    a = np.vstack([-polynomial[1:], np.eye(2, 3)])
    scale = np.diag([1e-9, 1.0, 1e7])
    matrices = np.linalg.inv(scale) @ a @ scale, np.eye(3, 1) * 1e9, np.eye(1, 3, k=2) * 1e7, 0.0
    f = np.geomspace(1e-3, 1e5, 11)
    expected = 1.0 / np.prod([2j * np.pi * f + pole for pole in poles], axis=0)
    np.testing.assert_allclose(as_transfer(matrices).response(f), expected, rtol=1e-10)


@pytest.mark.parametrize("period_s", [None, 0.3])
def test_the_slope_of_a_triple_pole_is_the_closed_form(period_s):
    a = -0.5 * np.eye(3) + np.eye(3, k=1)
    loop = as_transfer((a, np.eye(3, 1, k=-2), np.eye(1, 3), 0.0, period_s))
    f = 0.2
    z = 2j * math.pi * f if period_s is None else np.exp(2j * math.pi * f * period_s)
    rate = 2j * math.pi * (1.0 if period_s is None else period_s * z)
    assert loop.response(f)[0] == pytest.approx((z + 0.5) ** -3.0, rel=1e-13)
    assert loop.slope(f) == pytest.approx(-3.0 * rate * (z + 0.5) ** -4.0, rel=1e-13)


def test_a_response_at_a_pole_is_not_finite():
    integrator = as_transfer((np.zeros((1, 1)), 1.0, 1.0, 0.0))
    assert not np.isfinite(integrator.response(0.0))[0]


@pytest.mark.parametrize("period_s", [None, 0.01])
def test_sensitivities_are_those_of_the_closed_loop(period_s):
    matrices = random_matrices(8)
    loop = control.ss(*matrices, period_s or 0)
    f = np.geomspace(0.01, 40.0, 7)
    s, t = sensitivity(loop), complementary_sensitivity(loop)
    at = as_transfer(loop).response(f)
    np.testing.assert_allclose(s.response(f), 1.0 / (1.0 + at), rtol=1e-11)
    np.testing.assert_allclose(t.response(f), at / (1.0 + at), rtol=1e-11)
    # A pole of S solves 1 + L = 0.
    np.testing.assert_allclose(loop(np.linalg.eigvals(s.a)), -np.ones(5), rtol=1e-9)
    assert s.period_s == t.period_s == period_s


def test_a_grid_has_points_on_the_flank_of_each_resonance():
    # Poles at ±100j with a damping ratio of 1e-9: half a width is 1e-7 rad/s.
    a = np.array([[0.0, 1.0], [-1e4, -2e-7]])
    grid = 2.0 * math.pi * as_transfer((a, np.eye(2, 1, k=-1), np.eye(1, 2), 0.0)).frequency_grid()
    assert np.all(np.diff(grid) > 0.0)
    assert grid[0] <= 1.0
    assert grid[-1] >= 1e4
    for width in (1e-7, 1e-6, 1e-5):
        assert np.any(np.abs(grid - (100.0 + width)) < 0.5 * width)


def test_a_grid_of_a_sampled_loop_ends_at_the_nyquist_frequency():
    grid = as_transfer((0.5, 1.0, 1.0, 0.0, 0.01)).frequency_grid()
    assert grid[-1] == pytest.approx(50.0, rel=1e-12)


def test_equal_poles_give_no_two_points_that_differ_by_rounding():
    mode = np.array([[-0.05, -1.0], [1.0, -0.05]])
    a, b, c = block_diag(mode, mode), np.tile([[0.3], [1.0]], (2, 1)), np.tile([[1.0, 0.2]], (1, 2))
    grid = as_transfer((a, b, c, 0.0)).frequency_grid()
    assert (np.diff(grid) > 1e-12 * grid[1:]).all()


class Model:
    """The attributes of a linear model."""

    a, b, c, d = LAG
    period_s = None


@pytest.mark.parametrize(
    "loop",
    [
        LAG,
        (-1.0, 1.0, 1.0, 0.0),
        (*LAG, None),
        Model(),
        control.ss(*LAG),
        control.ss(*LAG, dt=None),
        control.tf([1.0], [1.0, 1.0]),
    ],
    ids=["tuple", "numbers", "period", "model", "ss", "no_dt", "tf"],
)
def test_forms_of_a_loop(loop):
    transfer = as_transfer(loop)
    assert transfer.period_s is None
    assert transfer.response([0.0, 0.5 / math.pi]) == pytest.approx([1.0, 0.5 - 0.5j], rel=1e-14)
    assert as_transfer(transfer) is transfer


def test_a_sampled_loop_of_python_control_has_its_period():
    assert as_transfer(control.tf([1.0], [1.0, -0.5], 0.2)).period_s == 0.2


@pytest.mark.parametrize(
    ("loop", "message"),
    [
        ("L", "loop = str: must be a linear model, a control.StateSpace or TransferFunction, or a"),
        ((1.0, 2.0), "loop = tuple: must be a linear model"),
        (control.frd([1.0], [1.0]), "loop = FrequencyResponseData: must be a linear model"),
        ((np.eye(2),) * 4, "loop: has 2 inputs and 2 outputs; must have one of"),
        ((np.eye(2), 1.0, 1.0, 0.0), "loop: A (2, 2), B (1, 1) and C (1, 1) do not fit; must be"),
        ((math.nan, 1.0, 1.0, 0.0), "loop: a matrix has an element that is not finite"),
        (
            (1.0j * np.eye(1), 1.0, 1.0, 0.0),
            "loop: has elements that are no real numbers; must be arrays",
        ),
        ((0.5, 1.0, 1.0, 0.0, "T"), "loop: has elements that are no real numbers; must be arrays"),
        ((0.5, 1.0, 1.0, 0.0, 0.0), "loop: period_s = 0 s: must be > 0 and finite, or None"),
        (control.ss(0.5, 1.0, 1.0, 0.0, True), "loop: dt = True: the margins need the sample"),
    ],
)
def test_what_is_no_loop_is_refused_in_one_line(loop, message):
    with pytest.raises(ParameterError, match=rf"\A{re.escape(message)}[^\n]*\Z"):
        as_transfer(loop)


def test_a_loop_without_transfer_is_refused():
    ticks = (TickModel(0.0, 0.1, *(np.eye(1),) * 4),)
    match = r"\Aloop: its signal changes several times within the period of 0\.1 s: [^\n]*\Z"
    with pytest.raises(ParameterError, match=match):
        sensitivity(PeriodicLoop(ticks, np.eye(1), 0.1))


def test_a_loop_of_minus_one_at_infinite_frequency_has_no_closed_loop():
    with pytest.raises(ParameterError, match=r"\Aloop: L = -1 at infinite frequency: [^\n]*\Z"):
        sensitivity((-1.0, 1.0, 1.0, -1.0))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((*(1e300 * matrix for matrix in LAG[:3]), 0.0, None), "loop: a matrix has an element"),
        ((np.eye(2), np.ones((1, 2)), np.ones((1, 2)), 0.0, None), "loop: A (2, 2), B (1, 2) and"),
        ((-1.0, 1.0, 1.0, 0.0, None), "loop: A (), B () and C () do not fit; must be (n, n)"),
        (("a", *LAG[1:3], 0.0, None), "loop: has elements that are no real numbers"),
        ((*LAG[:3], 1.0j, None), "loop: has elements that are no real numbers"),
        ((*LAG[:3], 0.0, math.nan), "loop: period_s = nan s: must be > 0 and finite, or None"),
    ],
)
def test_a_transfer_checks_its_arrays(arguments, message):
    with pytest.raises(ParameterError, match=rf"\A{re.escape(message)}[^\n]*\Z"):
        Transfer(*arguments)


def test_a_transfer_takes_lists():
    loop = Transfer([[-1.0]], [[1.0]], [[1.0]], 0, None)
    np.testing.assert_array_equal(loop.response(0.0), [1.0])


def test_a_numerator_of_higher_degree_is_refused():
    with pytest.raises(ParameterError, match=r"\Aloop: the transfer function has no state space"):
        as_transfer(control.tf([1.0, 0.0], [1.0]))
