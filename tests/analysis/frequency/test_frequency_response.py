import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from kneexo.analysis import Run, crossing, draw_trials, fundamental, sinestream
from kneexo.analysis.frequency import frequency_response
from kneexo.analysis.frequency.frequency_response import FrequencyResponse, SinestreamSettings
from kneexo.errors import ParameterError
from kneexo.parameters import (
    BldcPumpParameters,
    PlantParameters,
    RampReference,
    Scenario,
    SimulationParameters,
    SineReference,
)
from kneexo.parameters.criteria import MINUS_3_DB
from kneexo.parameters.paths import changed


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
    settings = SinestreamSettings(trials=40)
    trials = draw_trials(Scenario(), settings)
    assert trials == draw_trials(Scenario(), settings)
    assert trials != draw_trials(Scenario(), SinestreamSettings(trials=40, seed=7))
    masses = [values["plant.cylinder.mass_kg"] for values in trials]
    assert 1.4 <= min(masses) < 1.5 < 1.7 < max(masses) <= 1.8
    limits = [values["plant.pump.acceleration_limit_rad_s2"] for values in trials]
    assert min(limits) >= settings.acceleration_limit_min_rad_s2
    assert max(limits) <= settings.acceleration_limit_max_rad_s2
    assert np.median(limits) < 6e3  # log-uniform: half of them below the geometric mean
    count = 2 * math.pi / 4096
    assert all(0.0 <= values["encoder.phase_rad"] <= count for values in trials)


def test_a_trial_changes_the_plant_and_not_what_the_controller_believes(monkeypatch):
    simulated = []

    def measure(_settings, case):
        simulated.append(case[1])
        return 1.0 + 0.0j

    monkeypatch.setattr("kneexo.analysis.frequency.frequency_response._measure", measure)
    settings = SinestreamSettings(trials=1, frequencies_hz=(0.1, 0.2, 0.3))
    for scenario in (Scenario(), changed(Scenario(), {"nominal": {"ideal_motor": True}})):
        simulated.clear()
        (values,) = sinestream(scenario, settings).trials
        assert len(simulated) == 3
        assert simulated[0].plant == changed(scenario, values).plant != scenario.plant
        assert simulated[0].encoder.phase_rad == values["encoder.phase_rad"]
        assert simulated[0].believed_plant == scenario.believed_plant
        simulated.clear()
        sinestream(scenario, settings, trials=[{}])
        assert simulated[0].plant == scenario.plant


TOO_FAST = SinestreamSettings(frequencies_hz=(0.1, 0.2, 51.0))


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: sinestream(Scenario(reference=SineReference(amplitude_deg=0.0))), "moves"),
        (lambda: sinestream(Scenario(reference=RampReference())), r"reference = ramp: "),
        (lambda: sinestream(settings=TOO_FAST), "51 Hz is too high: must be <= 50 Hz"),
        (lambda: sinestream(trials=[]), "at least one"),
        (lambda: SinestreamSettings(frequencies_hz=(0.1, 0.2, 0.1)), "must not repeat"),
        (
            lambda: SinestreamSettings(mass_min_kg=1.7, mass_max_kg=1.6),
            "mass_min_kg = 1.7 kg must not exceed mass_max_kg = 1.6 kg",
        ),
    ],
)
def test_a_sinestream_that_means_nothing_is_refused(call, told):
    with pytest.raises(ParameterError, match=told):
        call()


def test_the_plot_marks_3_db_and_has_plain_ticks():
    f = np.array([0.2, 0.4, 0.8])
    response = np.array([[1.0, 0.8, 0.4]]) * np.exp(-1j * f)
    plotted = FrequencyResponse(f, response, 0.5, -40.0, (), Scenario(), SinestreamSettings())
    magnitude, phase = plotted.plot()
    for axis, label, values in (
        (magnitude, "magnitude (dB)", 20.0 * np.log10([1.0, 0.8, 0.4])),
        (phase, "phase (deg)", np.degrees(-f)),
    ):
        assert (axis.get_xlabel(), axis.get_ylabel()) == ("frequency (Hz)", label)
        assert axis.get_xscale() == "log"
        lines = {line.get_label(): line.get_data() for line in axis.lines}
        np.testing.assert_allclose(lines["mean"], (f, values), atol=1e-12)
        np.testing.assert_allclose(axis.lines[0].get_data(), (f, values), atol=1e-12)
        assert "1 trial" in lines
        fine, curve = lines["interpolation"]
        assert (fine[0], fine[-1]) == (0.2, 0.8)
        assert curve[[0, -1]] == pytest.approx(values[[0, -1]], abs=1e-9)
        assert set(lines["−3 dB at 0.5 Hz"][0]) == {0.5}
    (level,) = (line for line in magnitude.lines if len(set(line.get_ydata())) == 1)
    assert level.get_ydata()[0] == pytest.approx(-10.0 * math.log10(2.0))
    for axis in (magnitude, phase):
        assert list(axis.get_xticks()) == [0.2, 0.3, 0.5]
        assert [label.get_text() for label in axis.get_xticklabels()] == ["0.2", "0.3", "0.5"]


def test_harmonics_of_the_knee_stay_out_of_a_sinestream(monkeypatch):
    def simulate(scenario, *, signals):
        time = np.arange(round(scenario.simulation.duration_s / 0.002) + 1) * 0.002
        frequency = scenario.reference.frequency_hz
        phase = 2 * np.pi * frequency * time
        knee = 3 + np.sin(phase) + 0.5 * np.cos(2 * phase)
        # Neither the cycle of the transient nor the last sample, a fourth period's first, counts.
        assert time[-1] == pytest.approx(4 / frequency)
        knee[time < 1 / frequency - 1e-9] = knee[-1] = 100.0
        data = {"knee_angle_rad": knee, "knee_reference_rad": np.sin(phase)}
        return Run(time, data, SimulationParameters())

    monkeypatch.setattr(frequency_response, "simulate", simulate)
    # Orthogonal to the fundamental over whole periods, of 1000, 500 and 250 samples, alone.
    response = sinestream(settings=SinestreamSettings(frequencies_hz=(0.5, 1.0, 2.0), trials=1))
    assert response.response == pytest.approx(np.ones((1, 3)), abs=1e-9)


def test_the_bandwidth_is_that_of_a_rate_limited_follower_and_scales_with_flow_over_amplitude():
    # Kinematic follower of a sine in the knee angle at 40.4 mm/s: 0.2247 Hz; twice the flow or
    # half the amplitude doubles it, but for the knee's own nonlinearity.
    settings = SinestreamSettings(frequencies_hz=(0.2, 0.21, 0.22, 0.23, 0.24), trials=1)
    base = sinestream(Scenario(), settings)
    assert np.abs(base.gain[[0, 1, 2, 4]] - [0.79, 0.755, 0.72, 0.66]).max() <= 0.01
    assert 0.220 <= base.bandwidth_hz <= 0.226
    assert -36.0 <= base.phase_at_bandwidth_deg <= -26.0
    double = SinestreamSettings(frequencies_hz=(0.4, 0.42, 0.44, 0.46, 0.48), trials=1)
    faster = sinestream(
        Scenario(plant=PlantParameters(pump=BldcPumpParameters(gear_ratio=3.0))), double
    )
    smaller = sinestream(Scenario(reference=SineReference(amplitude_deg=15.0)), double)
    for scaled in (faster, smaller):
        assert 1.90 <= scaled.bandwidth_hz / base.bandwidth_hz <= 2.02
