import math
import runpy
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from kneexo.analysis import fundamental, linearize_loop
from kneexo.analysis.frequency import bandwidth
from kneexo.analysis.frequency.bandwidth import (
    acceleration_bound_hz,
    follower_bandwidth_hz,
    follower_response,
    large_signal_bandwidth_hz,
    rod_amplitude_m,
    rod_limits,
    speed_limit_reached_hz,
)
from kneexo.analysis.frequency.rate_limit import rate_limit_bandwidth_hz
from kneexo.analysis.frequency.sine_estimate import SineEstimate
from kneexo.errors import ParameterError
from kneexo.parameters import RampReference, Scenario, SineReference
from kneexo.parameters.criteria import MINUS_3_DB
from kneexo.parameters.paths import changed
from kneexo.studies.paper import IDEAL_SMC

BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "validate_bandwidth.py"


def sine(amplitude_deg, **values):
    return changed(Scenario(), {"reference.amplitude_deg": amplitude_deg, **values})


# --------------------------------------------------------------------- limits of the motor


def test_the_rods_limits_follow_from_motor_gear_and_pump():
    speed, acceleration = rod_limits(Scenario())
    assert speed == pytest.approx(0.8e-6 * 5000 / 60 / 6 / 274.8894e-6, rel=1e-6)  # 40.4 mm/s
    assert acceleration == pytest.approx(speed * 1e4 / (5000 * math.pi / 30), rel=1e-12)


def test_an_ideal_motor_has_no_acceleration_limit():
    assert rod_limits(IDEAL_SMC)[1] == math.inf
    assert acceleration_bound_hz(math.inf, 1.0) == math.inf


def test_the_acceleration_bound_is_that_of_parabolas():
    # Full acceleration one way, then the other, 1 Hz: the position's fundamental from its samples.
    time = (np.arange(20_000) + 0.5) / 20_000
    speed = np.cumsum(np.where(time < 0.5, 1.0, -1.0)) / 20_000
    position = np.cumsum(speed - np.mean(speed)) / 20_000
    amplitude = abs(fundamental(time, position, 1.0)) / MINUS_3_DB
    assert acceleration_bound_hz(1.0, amplitude) == pytest.approx(1.0, rel=1e-4)


def test_the_speed_limit_is_reached_from_0_122_hz():
    # ReproduceResult of Fig. 12, there from Eq. 10.
    assert speed_limit_reached_hz(Scenario()) == pytest.approx(0.122, abs=5e-4)


def test_the_follower_of_the_papers_sine_falls_to_0_2247_hz():
    assert follower_bandwidth_hz(Scenario()) == pytest.approx(0.2247, abs=3e-4)


@pytest.mark.parametrize("mean_deg", [30.0, 60.0])
def test_a_slow_sine_is_followed_to_the_ends_of_the_range(mean_deg):
    slow = sine(30.0, **{"reference.mean_deg": mean_deg})
    # The map is interpolated over 20 001 points.
    assert follower_response(slow, 1e-3) == pytest.approx(1.0, abs=1e-6)


def test_the_follower_of_a_small_sine_is_the_closed_form():
    # A knee sine of 0.1° is one in the rod but for 1e-5 of curvature.
    scenario = sine(0.1)
    closed = rate_limit_bandwidth_hz(rod_limits(scenario)[0], rod_amplitude_m(scenario))
    assert follower_bandwidth_hz(scenario) == pytest.approx(closed, rel=1e-4)


@settings(max_examples=10)
@given(amplitude=st.floats(1.0, 35.0), factor=st.floats(0.2, 5.0))
def test_the_follower_depends_on_speed_over_frequency_alone(amplitude, factor):
    scenario = sine(amplitude)
    faster = changed(scenario, {"plant.pump.displacement_m3_per_rad": 0.8e-6 / math.tau * factor})
    f = 8.0 / amplitude
    assert follower_response(faster, f * factor) == pytest.approx(
        follower_response(scenario, f), abs=1e-9
    )


# ------------------------------------------------------------------- large-signal bandwidth


def measured_as(monkeypatch, gain):
    """Replace the measurement by a function of frequency; returns the frequencies asked for."""
    asked = []

    def estimate(scenario, settings):
        assert (settings.averaged_cycles, settings.largest_cycles) == (2, 6)
        frequency = scenario.reference.frequency_hz
        asked.append(frequency)
        return SineEstimate(
            frequency_hz=frequency,
            amplitude_deg=scenario.reference.amplitude_deg,
            response=complex(gain(frequency)),
            uncertainty=0.0,
            settled=True,
            averaged_cycles=2,
            cycles=3,
            mean_deg=40.0,
            speed_limited_share=0.0,
            acceleration_limited_share=0.0,
        )

    monkeypatch.setattr(bandwidth, "estimate_sine", estimate)
    return asked


@pytest.mark.parametrize("corner", [0.03, 0.19, 0.21, 0.5, 45.0])
def test_the_search_finds_the_corner_of_a_lag(monkeypatch, corner):
    asked = measured_as(monkeypatch, lambda f: 1.0 / math.hypot(1.0, f / corner))
    assert large_signal_bandwidth_hz(Scenario()) == pytest.approx(corner, rel=1e-3)
    assert len(asked) == len(set(asked))
    if 0.15 < corner < 0.3:
        assert len(asked) <= 6  # from the closed form of 0.2313 Hz


@pytest.mark.parametrize("gain", [1.0, 0.5])
def test_a_gain_that_does_not_cross_has_no_bandwidth(monkeypatch, gain):
    asked = measured_as(monkeypatch, lambda f: gain)
    assert math.isnan(large_signal_bandwidth_hz(Scenario()))
    assert max(asked) == pytest.approx(50.0) if gain == 1.0 else min(asked) == pytest.approx(0.02)


def test_the_first_of_two_crossings_counts(monkeypatch):
    # As the sliding-mode loop at small amplitude: down at 3.5 Hz, up again at 5 Hz, down at 40 Hz.
    measured_as(monkeypatch, lambda f: 0.5 if 3.5 < f < 5.0 or f > 40.0 else 1.0)
    assert large_signal_bandwidth_hz(sine(0.1)) == pytest.approx(3.5, rel=1e-3)


def test_a_small_sine_has_the_bandwidth_of_the_linear_loop():
    scenario = sine(0.3, **{"encoder.quantized": False})
    linear = linearize_loop(scenario, knee_angle_deg=40.0).bandwidth_hz()
    # Tolerance of the search 0.1 %; cycles settled to 0.2 % of a gain that falls with f.
    assert large_signal_bandwidth_hz(scenario) == pytest.approx(linear, rel=4e-3)


def test_bandwidth_needs_a_sine_that_moves():
    with pytest.raises(ParameterError, match="reference = ramp"):
        large_signal_bandwidth_hz(Scenario(reference=RampReference()))
    with pytest.raises(ParameterError, match="moves"):
        large_signal_bandwidth_hz(Scenario(reference=SineReference(amplitude_deg=0.0)))


@pytest.mark.slow
def test_minus_3_db_of_a_sine_in_the_rod_is_that_of_the_closed_form():
    measured, closed = runpy.run_path(str(BENCHMARK))["rod_sine_bandwidths_hz"](Scenario())
    assert closed == pytest.approx(0.2313, abs=1e-4)
    assert measured == pytest.approx(closed, rel=0.01)


@pytest.mark.slow
def test_minus_3_db_of_a_sine_in_the_knee_is_that_of_the_kinematic_follower():
    measured, follower = large_signal_bandwidth_hz(Scenario()), follower_bandwidth_hz(Scenario())
    assert measured == pytest.approx(follower, rel=0.015)
    assert measured == pytest.approx(0.2236, abs=1e-3)  # Fig. 13 as `kneexo reproduce` has it
