"""Margins of loops that are known in closed form."""

import json
import math

import numpy as np
import pytest

PERIOD_S = 0.01
NYQUIST_HZ = 50.0

MARGINS = """(() => {
  const [loop, period] = [%s, %g];
  const response = (f) => LinearLoop.transfer(loop, 2 * Math.PI * f * period);
  return LinearLoop.marginsOf(response, LinearLoop.gridOf(loop, period), 0.5 / period);
})()"""


def margins_of(worker, a, b, c):
    loop = json.dumps({"a": a, "b": b, "c": c})
    return worker.evaluate(MARGINS % (loop, PERIOD_S))


@pytest.mark.parametrize("gain", [0.3, 1.2])
def test_an_integrator_has_the_margins_of_its_formula(worker, gain):
    """L = g/(z − 1): |L| = g/(2 sin ωT/2), and its phase is −90° − ωT/2."""
    margins = margins_of(worker, [[1.0]], [gain], [1.0])
    crossover = 2.0 * math.asin(gain / 2.0) / PERIOD_S / math.tau
    phase = 90.0 - 180.0 * crossover * PERIOD_S
    expected = {
        "gain_margin": 2.0 / gain,
        "gain_margin_frequency_hz": NYQUIST_HZ,
        "lower_gain_margin": 0.0,
        "phase_margin_deg": phase,
        "phase_margin_frequency_hz": crossover,
        "delay_margin_s": phase / 360.0 / crossover,
        "delay_margin_frequency_hz": crossover,
        "sensitivity_peak": 2.0 / (2.0 - gain),  # |z − 1|/|z − 1 + g| at z = −1
        "sensitivity_peak_frequency_hz": NYQUIST_HZ,
    }
    assert margins == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_an_unstable_process_has_a_lower_gain_margin(worker):
    """L = g/(z − p) closes to the pole p − g: stable for p − 1 < g < p + 1."""
    margins = margins_of(worker, [[1.5]], [1.0], [1.0])
    assert margins["gain_margin"] == pytest.approx(2.5, rel=1e-12)
    assert margins["lower_gain_margin"] == pytest.approx(0.5, rel=1e-12)


def test_a_loop_that_nothing_destabilizes_has_infinite_margins(worker):
    margins = margins_of(worker, [[0.5]], [0.1], [1.0])  # |L| is at most 0.2
    assert margins["phase_margin_deg"] == margins["delay_margin_s"] == math.inf
    assert math.isnan(margins["phase_margin_frequency_hz"])


def test_a_narrow_resonance_is_not_missed(worker):
    """A mode that is 10,000 times narrower than the distance of two frequencies of the grid."""
    angle, radius = 1.234567, 1.0 - 1e-7
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    a = radius * turn
    b, c = np.array([1.0, 0.0]), np.array([4e-7, 0.0])
    margins = margins_of(worker, a.tolist(), b.tolist(), c.tolist())
    f = angle / PERIOD_S / math.tau + np.linspace(-1e-4, 1e-4, 20001)
    z = np.exp(2j * np.pi * f * PERIOD_S)
    values = 4e-7 * (z - a[0, 0]) / ((z - a[0, 0]) ** 2 - a[0, 1] * a[1, 0])
    peak = np.max(1.0 / np.abs(1.0 + values))
    assert margins["sensitivity_peak"] == pytest.approx(peak, rel=1e-3)
    assert margins["sensitivity_peak"] > 1.5


@pytest.mark.parametrize(
    ("matrix", "radius"),
    [
        ([[0.5, 1e3], [0.0, 0.9]], 0.9),
        ([[0.0, 0.8], [-0.8, 0.0]], 0.8),
        ([[1.0, 1.0], [0.0, 1.0]], 1.0),
        ([[0.0, 1.0], [0.0, 0.0]], 0.0),
    ],
)
def test_the_spectral_radius(worker, matrix, radius):
    value = worker.evaluate(f"LinearLoop.spectralRadius({json.dumps(matrix)})")
    assert value == pytest.approx(radius, abs=1e-11)


def test_an_unknown_without_influence_is_zero(worker):
    singular = [[0.0, 2.0, 0.0], [0.0, 0.0, 0.0], [1.0, 1.0, 0.0]]
    solution = worker.evaluate(f"LinearLoop.solve({json.dumps(singular)}, [4, 0, 5])")
    assert solution == pytest.approx([3.0, 2.0, 0.0])


def test_the_transfer_of_a_system_of_higher_order(worker):
    rng = np.random.default_rng(2)
    a, b, c = rng.normal(size=(6, 6)), rng.normal(size=6), rng.normal(size=6)
    a[0, 0] = a[1, 0] = 0.0  # requires a pivot
    z = np.exp(0.7j)
    expected = c @ np.linalg.solve(z * np.eye(6) - a, b)
    loop = json.dumps({"a": a.tolist(), "b": b.tolist(), "c": c.tolist()})
    value = complex(*worker.evaluate(f"LinearLoop.transfer({loop}, 0.7)"))
    assert value == pytest.approx(expected, rel=1e-12)
