import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kneexo.analysis import crossing, draw_trials, fundamental, sinestream
from kneexo.analysis.frequency_response import MINUS_3_DB
from kneexo.errors import ParameterError
from kneexo.parameters import (
    BldcPumpParameters,
    PlantParameters,
    RampReference,
    Scenario,
    SineReference,
    SinestreamParameters,
)


@given(
    real=st.floats(-10, 10),
    imaginary=st.floats(-10, 10),
    offset=st.floats(-10, 10),
    third=st.floats(-3, 3),
)
def test_fundamental_ignores_offset_and_harmonics(real, imaginary, offset, third):
    time = np.arange(3000) * 0.002  # three whole periods of 0.5 Hz
    omega = 2 * np.pi * 0.5
    signal = offset + third * np.cos(3 * omega * time)
    signal += real * np.cos(omega * time) - imaginary * np.sin(omega * time)
    assert fundamental(time, signal, 0.5) == pytest.approx(complex(real, imaginary), abs=1e-9)


def test_a_delay_gives_a_negative_phase():
    time = np.arange(2000) * 0.002
    omega = 2 * np.pi * 0.25
    ratio = fundamental(time, np.sin(omega * time - 0.3), 0.25) / fundamental(
        time, np.sin(omega * time), 0.25
    )
    assert math.atan2(ratio.imag, ratio.real) == pytest.approx(-0.3, abs=1e-9)


def test_crossing_of_a_first_order_lag_is_its_corner():
    frequencies = np.geomspace(0.05, 2.0, 60)
    gain = 1.0 / np.sqrt(1.0 + (frequencies / 0.4) ** 2)
    # PCHIP through 60 points of a smooth curve: error of order h^3.
    assert crossing(frequencies, gain) == pytest.approx(0.4, rel=1e-4)


def test_crossing_is_nan_when_the_gain_stays_above_or_starts_below():
    frequencies = np.array([0.1, 0.2, 0.3])
    assert math.isnan(crossing(frequencies, np.array([1.0, 0.9, 0.8])))
    assert math.isnan(crossing(frequencies, np.array([0.6, 0.5, 0.4])))


def test_crossing_takes_a_mean_exactly_at_the_threshold():
    frequencies = np.array([0.1, 0.2, 0.3])
    assert crossing(frequencies, np.array([1.0, MINUS_3_DB, 0.5])) == pytest.approx(0.2, abs=1e-12)


def test_trials_are_seeded_and_within_their_ranges():
    settings = SinestreamParameters(trials=40)
    trials = draw_trials(Scenario(), settings)
    assert trials == draw_trials(Scenario(), settings)
    assert trials != draw_trials(Scenario(), SinestreamParameters(trials=40, seed=7))
    masses = [trial.mass_kg for trial in trials]
    assert 1.4 <= min(masses) < 1.5 < 1.7 < max(masses) <= 1.8
    limits = [trial.acceleration_limit_rad_s2 for trial in trials]
    assert min(limits) >= settings.acceleration_limit_min_rad_s2
    assert max(limits) <= settings.acceleration_limit_max_rad_s2
    assert np.median(limits) < 6e3  # log-uniform: half of them below the geometric mean
    count = 2 * math.pi / 4096
    assert all(0.0 <= trial.encoder_phase_rad <= count for trial in trials)


def test_the_default_frequencies_hold_those_of_the_paper():
    frequencies = SinestreamParameters().frequencies_hz
    assert len(frequencies) >= 14
    assert {0.05, 0.1, 0.2, 0.21, 0.22, 0.24, 0.5} <= set(frequencies)


def test_ranges_that_cross_are_refused():
    with pytest.raises(
        ParameterError, match=r"mass_min_kg = 1.7 must not exceed mass_max_kg = 1.6"
    ):
        SinestreamParameters(mass_min_kg=1.7, mass_max_kg=1.6)


@pytest.mark.parametrize(
    ("scenario", "frequencies", "trials", "told"),
    [
        (Scenario(reference=SineReference(amplitude_deg=0.0)), (0.1, 0.2, 0.3), None, "moves"),
        (Scenario(), (0.1, 0.2, 51.0), None, "51 Hz is too high: must be <= 50 Hz"),
        (Scenario(), (0.1, 0.2, 0.3), [], "at least one"),
    ],
)
def test_a_sinestream_that_means_nothing_is_refused(scenario, frequencies, trials, told):
    with pytest.raises(ParameterError, match=told):
        sinestream(scenario, SinestreamParameters(frequencies_hz=frequencies), trials=trials)


def test_repeated_frequencies_are_refused():
    with pytest.raises(ParameterError, match="must not repeat"):
        SinestreamParameters(frequencies_hz=(0.1, 0.2, 0.1))


def test_a_sinestream_needs_a_sine():
    with pytest.raises(ParameterError, match=r"reference = ramp: "):
        sinestream(Scenario(reference=RampReference()))


def test_a_small_sine_within_the_speed_limit_is_followed():
    result = sinestream(
        Scenario(reference=SineReference(amplitude_deg=2.0)),
        SinestreamParameters(frequencies_hz=(0.4, 0.5, 0.6), trials=1, measured_cycles=1),
    )
    assert result.response.shape == (1, 3)
    # Far below the speed limit; the observer's lag leaves 2 % at 0.5 Hz, growing with f².
    assert np.abs(result.response - 1.0).max() < 0.04
    assert math.isnan(result.bandwidth_hz)
    assert len(result.plot()) == 2


@pytest.mark.slow
def test_the_bandwidth_is_that_of_a_rate_limited_follower_and_scales_with_flow_over_amplitude():
    # Kinematic follower of a sine in the knee angle at 40.4 mm/s: 0.2247 Hz; twice the flow or
    # half the amplitude doubles it, but for the knee's own nonlinearity.
    settings = SinestreamParameters(frequencies_hz=(0.2, 0.21, 0.22, 0.23, 0.24), trials=1)
    base = sinestream(Scenario(), settings)
    assert np.abs(base.gain[[0, 1, 2, 4]] - [0.79, 0.755, 0.72, 0.66]).max() <= 0.01
    assert 0.220 <= base.bandwidth_hz <= 0.226
    assert -36.0 <= base.phase_at_bandwidth_deg <= -26.0
    double = SinestreamParameters(frequencies_hz=(0.4, 0.42, 0.44, 0.46, 0.48), trials=1)
    faster = sinestream(
        Scenario(plant=PlantParameters(pump=BldcPumpParameters(gear_ratio=3.0))), double
    )
    smaller = sinestream(Scenario(reference=SineReference(amplitude_deg=15.0)), double)
    for scaled in (faster, smaller):
        assert 1.90 <= scaled.bandwidth_hz / base.bandwidth_hz <= 2.02
