"""Margins against closed forms, python-control and eigenvalues on the boundary of stability."""

import cmath
import dataclasses
import math

import control
import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import minimize_scalar

from diagramc import margins
from diagramc.errors import ParameterError
from diagramc.linear.loops import Transfer

S = control.tf("s")
STATIC = (np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), -0.5)


def integrator_with_delay(gain, samples, period_s=1e-3):
    """L = g z⁻ⁿ/(z − 1) as (A, B, C, D, T)."""
    a = np.eye(samples + 1, k=-1)
    a[0, 0] = 1.0
    return a, gain * np.eye(samples + 1, 1), np.eye(samples + 1)[-1:], 0.0, period_s


def test_a_triple_lag_has_the_margins_of_the_closed_form():
    # L = 4/(s + 1)³ is real at ω = √3, where it is −1/2, and has magnitude 1 at ω² = ∛16 − 1.
    m = margins(4.0 / (S + 1.0) ** 3)
    crossover = math.sqrt(4.0 ** (2.0 / 3.0) - 1.0)
    lag = math.pi - 3.0 * math.atan(crossover)
    assert m.stable
    assert m.gain_margin == pytest.approx(2.0, rel=1e-12)
    assert 2.0 * math.pi * m.gain_margin_frequency_hz == pytest.approx(math.sqrt(3.0), rel=1e-12)
    assert m.lower_gain_margin == 0.0
    assert m.phase_margin_deg == pytest.approx(math.degrees(lag), rel=1e-12)
    assert m.phase_lead_margin_deg == pytest.approx(360.0 - math.degrees(lag), rel=1e-12)
    assert m.delay_margin_s == pytest.approx(lag / crossover, rel=1e-12)
    assert 2.0 * math.pi * m.delay_margin_frequency_hz == pytest.approx(crossover, rel=1e-12)


def test_an_unstable_pole_needs_gain():
    # L = 2/(s − 1): the pole of the loop is 1 − 2 k, and |L| = 1 at ω = √3, 60° before −180°.
    m = margins(2.0 / (S - 1.0))
    assert m.stable
    assert m.lower_gain_margin == pytest.approx(0.5, rel=1e-14)
    assert m.gain_margin == math.inf
    assert m.phase_margin_deg == pytest.approx(60.0, rel=1e-12)
    assert m.delay_margin_s == pytest.approx(math.pi / 3.0 / math.sqrt(3.0), rel=1e-12)
    # |(1 + L)/(1 − L)| = |s + 1|/|s − 3| is smallest at s = 0.
    assert (m.disk_margin, m.disk_margin_frequency_hz) == pytest.approx((2.0 / 3.0, 0.0))
    assert not margins(0.9 / (S - 1.0)).stable


@pytest.mark.parametrize(("kp", "kd", "stable"), [(2.0, 0.5, False), (0.5, -0.1, True)])
def test_a_pole_at_the_nyquist_frequency_is_no_obstacle(kp, kd, stable):
    """A Tustin derivative: k_p + k_d (2/T)(z − 1)/(z + 1) before 1/(s(s + 1)) behind a hold."""
    period_s = 0.1
    decay = math.exp(-period_s)
    a = np.array([[1.0, 1.0 - decay], [0.0, decay]])
    b = np.array([[period_s - 1.0 + decay], [1.0 - decay]])
    slope = 2.0 * kd / period_s
    a = np.block([[a, -2.0 * slope * b], [np.zeros((1, 2)), -np.ones((1, 1))]])
    loop = a, np.vstack([(kp + slope) * b, [[1.0]]]), np.array([[1.0, 0.0, 0.0]]), 0.0, period_s
    m = margins(loop)
    hz = np.linspace(1e-3, 4.9999, 500_001)
    z = np.exp(2j * math.pi * hz * period_s)
    plant = (b[0] * (z - decay) + (1.0 - decay) * b[1]) / ((z - 1.0) * (z - decay))
    response = plant * (kp + slope * (z - 1.0) / (z + 1.0))
    lag = np.degrees(np.angle(-response)) % 360.0
    at = np.flatnonzero(np.diff(np.abs(response) > 1.0))
    assert m.stable is stable
    assert m.phase_margin_deg == pytest.approx(lag[at].min(), abs=0.01)
    assert m.phase_lead_margin_deg == pytest.approx(360.0 - lag[at].max(), abs=0.01)
    assert m.delay_margin_s == pytest.approx((lag[at] / 360.0 / hz[at]).min(), rel=1e-4)
    disk = np.min(2.0 * np.abs((1.0 + response) / (1.0 - response)))
    assert m.disk_margin == pytest.approx(disk, rel=1e-4)


@pytest.mark.parametrize("loop", [-0.5 / (S + 1.0), STATIC])
def test_a_loop_can_lose_stability_at_zero_frequency(loop):
    m = margins(loop)
    assert m.stable
    assert (m.gain_margin, m.gain_margin_frequency_hz) == (2.0, 0.0)
    assert (m.phase_margin_deg, m.delay_margin_s) == (math.inf, math.inf)
    # (1 + ε)/(1 − ε) = 2 with ε = 1/3, half of the disk margin
    assert (m.disk_margin, m.disk_gain_margin) == pytest.approx((2.0 / 3.0, 2.0))


def test_a_sampled_loop_can_lose_stability_at_the_nyquist_frequency():
    # The pole of g/(z − 1) in feedback is 1 − g: −1 at g = 2.
    m = margins((1.0, 0.5, 1.0, 0.0, 0.02))
    assert (m.gain_margin, m.gain_margin_frequency_hz) == pytest.approx((4.0, 25.0))


def test_a_loop_with_feedthrough_above_one_tolerates_no_delay():
    m = margins((-1.0, 1.0, 1.0, 2.0))
    assert m.stable
    assert (m.delay_margin_s, m.delay_margin_frequency_hz) == (0.0, math.inf)
    # L = −0.5 s/(s + 1) is real at infinite frequency.
    m = margins((-1.0, 0.5, 1.0, -0.5))
    assert (m.gain_margin, m.gain_margin_frequency_hz) == (2.0, math.inf)


def test_an_integrator_is_a_half_plane_away_from_its_limit():
    m = margins(1.0 / S)
    assert (m.gain_margin, m.lower_gain_margin) == (math.inf, 0.0)
    assert m.phase_margin_deg == pytest.approx(90.0, rel=1e-14)
    assert m.disk_margin == pytest.approx(2.0, rel=1e-12)
    assert m.disk_gain_margin == math.inf


def test_python_control_loses_the_margins_of_a_long_delay():
    # The polynomials of python-control have roots that move by 1e-3 and more with the last bit.
    samples = 60
    gain = 0.5 * math.pi / (2 * samples + 1)
    loop = integrator_with_delay(gain, samples)
    m = margins(loop)
    angle = 2.0 * math.asin(0.5 * gain)
    assert m.phase_margin_deg == pytest.approx(90.0 - math.degrees((samples + 0.5) * angle))
    critical = math.pi / (2 * samples + 1)
    assert m.gain_margin == pytest.approx(2.0 * math.sin(0.5 * critical) / gain, rel=1e-10)
    with np.errstate(all="ignore"):
        gain_margin, phase_margin, *_ = control.stability_margins(control.ss(*loop))
    assert abs(gain_margin / m.gain_margin - 1.0) > 1e-3
    assert abs(phase_margin / m.phase_margin_deg - 1.0) > 1e-3


def test_a_loop_delayed_by_its_delay_margin_has_an_eigenvalue_on_the_unit_circle():
    # The phase margin 90° − (n + ½) ωT is that of 3 samples, 3 ωT.
    angle = 0.5 * math.pi / 5.5
    gain = 2.0 * math.sin(0.5 * angle)
    m = margins(integrator_with_delay(gain, 2))
    assert m.delay_margin_s == pytest.approx(3e-3, rel=1e-12)
    a, b, c, _, _ = integrator_with_delay(gain, 5)
    values = np.linalg.eigvals(a - b @ c)
    assert np.abs(values - np.exp(1j * angle)).min() < 1e-9
    assert np.abs(values).max() == pytest.approx(1.0, abs=1e-9)


def random_loop(seed, period_s):
    """A loop with a stable closed loop, resonances and feedthrough, as (A, B, C, D, T)."""
    rng = np.random.default_rng(seed)
    modes = [
        10.0 ** rng.uniform(0.0, 3.0) * np.array([[-z, -1.0], [1.0, -z]])
        for z in 10.0 ** rng.uniform(-3.0, 0.0, rng.integers(1, 4))
    ]
    a = block_diag(-1.0, *modes)
    n = len(a)
    b, c = rng.normal(size=(n, 1)), rng.normal(size=(1, n)) * np.abs(np.diag(a))
    d = 0.3 * rng.normal()
    if period_s is not None:
        exact = control.ss(a, b, c, d).sample(period_s)
        a, b, c = exact.A, exact.B, exact.C
    while not is_stable((a, b, c, d, period_s), 1.0):
        c, d = 0.5 * c, 0.5 * d
    return a, b, c, d, period_s


def closed(loop, factor):
    """Eigenvalues of the loop closed with a complex factor."""
    a, b, c, d, _ = loop
    return np.linalg.eigvals(a - factor * b @ c / (1.0 + factor * d))


def is_stable(loop, factor):
    values = closed(loop, factor)
    return bool(np.all(values.real < 0.0 if loop[-1] is None else np.abs(values) < 1.0))


def critical(loop, frequency_hz):
    s = 2j * math.pi * frequency_hz
    return s if loop[-1] is None else np.exp(s * loop[-1])


SEEDS = [(seed, period_s) for period_s in (None, 1e-3) for seed in range(12)]


@pytest.mark.parametrize(("seed", "period_s"), SEEDS)
def test_a_change_by_a_margin_puts_an_eigenvalue_on_the_boundary(seed, period_s):
    loop = random_loop(seed, period_s)
    m = margins(loop)
    changes = [(m.gain_margin, m.gain_margin_frequency_hz)]
    if math.isfinite(m.phase_margin_deg):
        changes += [
            (cmath.rect(1.0, -math.radians(m.phase_margin_deg)), m.phase_margin_frequency_hz),
            (
                cmath.rect(1.0, math.radians(m.phase_lead_margin_deg)),
                m.phase_lead_margin_frequency_hz,
            ),
            (
                cmath.rect(1.0, -2.0 * math.pi * m.delay_margin_frequency_hz * m.delay_margin_s),
                m.delay_margin_frequency_hz,
            ),
        ]
    for factor, frequency in (change for change in changes if math.isfinite(change[1])):
        at = critical(loop, frequency)
        assert np.abs(closed(loop, factor) - at).min() < 1e-9 * max(1.0, abs(at))


@pytest.mark.parametrize(("seed", "period_s"), SEEDS)
def test_a_change_inside_the_margins_keeps_the_loop_stable(seed, period_s):
    loop = random_loop(seed, period_s)
    m = margins(loop)
    inside = np.linspace(0.001, 0.999, 60)
    top = min(m.gain_margin, 1e3)
    assert all(is_stable(loop, 1.0 + share * (top - 1.0)) for share in inside)
    low = m.lower_gain_margin
    assert all(is_stable(loop, low + share * (1.0 - low)) for share in inside)
    # A complex factor is a lag at positive frequencies and a lead at negative ones.
    turn = math.radians(min(m.phase_margin_deg, m.phase_lead_margin_deg, 180.0))
    assert all(is_stable(loop, np.exp(1j * share * turn)) for share in inside)
    # The disk of factors: any complex gain on a circle inside it, too.
    reach = 0.4999 * m.disk_margin
    turns = reach * np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 60))
    assert all(is_stable(loop, (1.0 + turn) / (1.0 - turn)) for turn in turns)


@pytest.mark.filterwarnings("ignore::UserWarning:control")
@pytest.mark.parametrize("seed", range(12))
def test_margins_of_continuous_loops_are_those_of_python_control(seed):
    *matrices, _ = loop = random_loop(seed, None)
    m = margins(loop)
    gains, phases, *_ = control.stability_margins(control.ss(*matrices), returnall=True)
    assert m.gain_margin == pytest.approx(min(gains[gains > 1.0], default=math.inf), rel=1e-5)
    lags = np.mod(phases, 360.0)
    assert m.phase_margin_deg == pytest.approx(min(lags, default=math.inf), rel=1e-5)


@pytest.mark.filterwarnings("ignore:Setting the shape:DeprecationWarning:control")  # its own code
def test_the_disk_margin_is_the_minimum_of_python_control():
    loop = 4.0 / (S + 1.0) ** 3
    m = margins(loop)
    omega = 2.0 * math.pi * m.disk_margin_frequency_hz * (1.0 + np.linspace(-0.01, 0.01, 101))
    disk, gain_db, phase = control.disk_margins(control.ss(loop), omega, skew=0.0)
    assert m.disk_margin == pytest.approx(disk, rel=1e-9)
    # The minimum of |(1 + L)/(1 − L)|, at ω = x with L = 4/(1 + jω)³
    least = minimize_scalar(
        lambda x: abs(((1.0 + 1j * x) ** 3 + 4.0) / ((1.0 + 1j * x) ** 3 - 4.0)),
        bounds=(1.0, 2.0),
        options={"xatol": 1e-12},
    )
    assert 2.0 * math.pi * m.disk_margin_frequency_hz == pytest.approx(least.x, rel=1e-6)
    assert 20.0 * math.log10(m.disk_gain_margin) == pytest.approx(gain_db, rel=1e-9)
    assert m.disk_phase_margin_deg == pytest.approx(phase, rel=1e-9)


@pytest.mark.parametrize("damping", [1e-3, 1e-7])
def test_no_resonance_is_too_narrow(damping):
    # ε/(s² + 2ζs + 1) with ε = 4 ζ has magnitude 1 where |s² + 2ζs + 1| = ε.
    loop = (np.array([[0.0, 1.0], [-1.0, -2.0 * damping]]), np.eye(2, 1, k=-1))
    m = margins((*loop, 4.0 * damping * np.eye(1, 2), 0.0))
    square = 1.0 - 2.0 * damping**2 + damping * math.sqrt(12.0 + 4.0 * damping**2)
    omega = math.sqrt(square)
    lag = math.atan2(2.0 * damping * omega, square - 1.0)  # of −1/(s² + 2ζs + 1) against 1
    assert 2.0 * math.pi * m.phase_margin_frequency_hz == pytest.approx(omega, rel=1e-12)
    assert m.phase_margin_deg == pytest.approx(math.degrees(lag), rel=1e-6)


def test_an_undamped_resonance_has_its_margins():
    # ε s/(s² + 1) has magnitude 1 where |1 − ω²| = ε ω, with the phase −90° at the higher ω.
    loop = (np.array([[0.0, 1.0], [-1.0, 0.0]]), np.eye(2, 1, k=-1), 1e-3 * np.eye(1, 2, k=1), 0.0)
    m = margins(loop)
    higher = 5e-4 + math.sqrt(1.0 + 25e-8)
    assert 2.0 * math.pi * m.phase_margin_frequency_hz == pytest.approx(higher, rel=1e-9)
    assert m.phase_margin_deg == pytest.approx(90.0, rel=1e-9)
    lower = higher - 1e-3
    assert 2.0 * math.pi * m.phase_lead_margin_frequency_hz == pytest.approx(lower, rel=1e-9)


def test_the_rounding_of_an_integrator_is_no_gain_margin():
    m = margins((1.0 + 1e-12, 0.5, 1.0, 0.0, 0.02))
    assert (m.lower_gain_margin, m.gain_margin) == (0.0, pytest.approx(4.0))


@pytest.mark.parametrize("at_zero", [-0.6 - 3e13j, 7e12 + 3e12j])
def test_the_rounding_of_a_complex_response_at_a_pole_is_no_gain_margin(at_zero, monkeypatch):
    """On some machines the eigenvalue 1 of an integrator is 1 + 4e-15j, which makes L complex."""
    exact = margins((1.0, 0.5, 1.0, 0.0, 0.02))
    response = Transfer.response

    def rounded(loop, frequency):
        return np.where(np.asarray(frequency) == 0.0, at_zero, response(loop, frequency))

    monkeypatch.setattr(Transfer, "response", rounded)
    assert dataclasses.astuple(margins((1.0, 0.5, 1.0, 0.0, 0.02))) == dataclasses.astuple(exact)


def test_margins_are_numbers_without_arrays():
    m = margins(1.0 / (S + 1.0))
    assert {type(value) for value in dataclasses.asdict(m).values()} == {bool, float}


Z_INVERSE = (0.0, 1.0, 1.0, 0.0, 1e-2)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("loop", "frequency_hz"),
    [
        (60.0 / ((S + 1.0) * (S + 2.0) * (S + 3.0)), math.sqrt(11.0) / (2.0 * math.pi)),
        (1.0 / S**2, 1.0 / (2.0 * math.pi)),
        (-1.0 / (S + 1.0), 0.0),
        (Z_INVERSE, 50.0),
    ],
)
def test_a_loop_through_minus_one_has_no_margin(loop, frequency_hz):
    m = margins(loop)
    assert not m.stable
    assert (m.gain_margin, m.lower_gain_margin, m.disk_gain_margin) == (1.0, 1.0, 1.0)
    assert (m.phase_margin_deg, m.phase_lead_margin_deg, m.delay_margin_s) == (0.0, 0.0, 0.0)
    assert (m.disk_margin, m.disk_phase_margin_deg) == (0.0, 0.0)
    assert m.gain_margin_frequency_hz == pytest.approx(frequency_hz, abs=1e-9)


def test_a_loop_just_inside_the_boundary_has_its_margins():
    loop = 60.0 * (1.0 - 1e-9) / ((S + 1.0) * (S + 2.0) * (S + 3.0))
    m = margins(loop)
    assert m.stable
    assert m.gain_margin - 1.0 == pytest.approx(1e-9, rel=1e-4)


def test_a_free_mode_is_not_stable_and_changes_no_margin():
    # A speed loop 5/(s + 1), and an angle that rounding puts at −1e-15, which nothing measures.
    for pole in (-1e-15, 0.0, 1e-15):
        m = margins(([[-1.0, 0.0], [1.0, pole]], [[1.0], [0.0]], [[5.0, 0.0]], [[0.0]]))
        assert not m.stable
        assert m.phase_margin_deg == pytest.approx(180.0 - math.degrees(math.atan(math.sqrt(24.0))))
        assert m.gain_margin == math.inf


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("period_s", [None, 1e-2])
def test_a_loop_of_magnitude_one_loses_stability_by_half_a_turn(period_s):
    m = margins((*STATIC[:3], 1.0, period_s))
    assert m.stable
    assert (m.phase_margin_deg, m.phase_lead_margin_deg) == (180.0, 180.0)
    assert m.gain_margin == math.inf


@pytest.mark.parametrize("seed", [168, 200, 254, 1191])
def test_a_pole_at_a_frequency_of_the_search_is_no_crossing(seed):
    # The search for crossings meets the undamped resonance exactly, where L is not finite.
    def resonance(radius):
        rng = np.random.default_rng(seed)
        angle = rng.uniform(0.0, np.pi)
        cos, sin = np.cos(angle), np.sin(angle)
        a = radius * np.array([[cos, -sin], [sin, cos]])
        return a, rng.normal(size=(2, 1)), rng.normal(size=(1, 2)), [[0.0]], 1.0

    undamped, damped = (margins(resonance(radius)) for radius in (1.0, 1.0 - 1e-9))
    for name in ("gain_margin", "lower_gain_margin", "phase_margin_deg", "disk_margin"):
        assert getattr(undamped, name) == pytest.approx(getattr(damped, name), rel=1e-6)


@pytest.mark.filterwarnings("ignore:Badly conditioned")
def test_a_transfer_function_whose_digits_are_lost_is_refused():
    poles = np.arange(1.0, 6.0)
    a = np.diag(-poles) + np.diag(poles[1:], -1)
    states = control.ss(a, np.eye(5)[:, :1], 2.0 * np.eye(5)[-1:], 0)  # 2·5!/((s+1)…(s+5))
    slow, fast = (control.c2d(states, period_s) for period_s in (0.1, 1e-3))
    assert margins(control.ss2tf(slow)).gain_margin == pytest.approx(margins(slow).gain_margin)
    assert margins(fast).gain_margin == pytest.approx(margins(states).gain_margin, rel=1e-2)
    with pytest.raises(ParameterError, match=r"loop: rounding its numbers changes L at .* control"):
        margins(control.ss2tf(fast))
