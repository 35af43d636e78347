"""Responses to one sine: harmonics, drift, settling and uncertainty."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from kneexo.analysis import Run, linearize_loop
from kneexo.analysis.frequency import sine_estimate
from kneexo.analysis.frequency.sine_estimate import (
    SineEstimateSettings,
    cycle_responses,
    estimate_sine,
    response_uncertainty,
    settled_cycles,
    settled_run,
)
from kneexo.errors import ParameterError
from kneexo.parameters import RampReference, Scenario, SimulationParameters, SineReference
from kneexo.parameters.paths import changed


def columns_run(time, knee, reference):
    data = {"knee_angle_rad": knee, "knee_reference_rad": reference}
    return Run(time, data, SimulationParameters())


@pytest.mark.parametrize("samples", [10.0, 13.3, 36.5])
def test_harmonics_and_a_drift_stay_out_of_the_response(samples):
    frequency = 500.0 / samples
    time = np.arange(600) * 0.002
    phase = 2 * np.pi * frequency * time + 0.7
    knee = 0.5 * np.cos(phase - 0.3) + 0.1 * np.cos(2 * phase) + 0.05 * np.cos(3 * phase) + 5 * time
    responses, means = cycle_responses(
        columns_run(time, knee, np.cos(phase)), frequency, 0.1, int(frequency)
    )
    # The fit holds three harmonics and the slope of the means: exact.
    assert responses == pytest.approx(0.5 * np.exp(-0.3j), abs=1e-9)
    assert np.diff(means) * frequency == pytest.approx(5.0, rel=0.15)  # by half a sample


def test_a_slow_transient_of_the_mean_is_taken_out():
    # First-order lag of a sine that starts at t = 0, exact: its transient takes 40 cycles.
    frequency, time_constant = 20.0, 2.0
    time = np.arange(1000) * 0.002
    phase, pole = 2 * np.pi * frequency * time, 2 * np.pi * frequency * time_constant
    knee = np.sin(phase) - pole * (np.cos(phase) - np.exp(-time / time_constant))
    run = columns_run(time, knee / (1 + pole**2), np.sin(phase))
    responses, _ = cycle_responses(run, frequency, 0.0, 39)
    # What is left is the curvature of the transient, (T/2πτ)² next to the response of 1/2πfτ.
    assert responses == pytest.approx(1 / (1 + 1j * pole), abs=1e-3 / pole)


def test_a_cycle_ends_where_the_next_begins():
    # A reference that changes its amplitude on a border of cycles: each cycle sees only its own.
    frequency, time = 5.0, np.arange(1001) * 0.002  # a sample lies on the border
    reference = np.cos(2 * np.pi * frequency * time)
    knee = np.where(time < 0.5 + 3 / frequency - 1e-9, 2.0, 1.0) * reference
    responses, _ = cycle_responses(columns_run(time, knee, reference), frequency, 0.5, 6)
    assert responses[:3] == pytest.approx(2.0, abs=1e-9)
    assert responses[3:] == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(
    ("responses", "settled"),
    [
        ([1.0, 1.0, 1.0], 3),
        ([2.0, 1.0, 1.0005], 2),
        ([1.0, 1.0, 2.0], 1),
        ([1.0, 1.0j, 1.0j, 1.0j], 3),
        ([0.01, 0.0101, 0.0102], 1),  # relative: a small response has to agree as well
    ],
)
def test_settled_cycles_are_the_last_ones_that_agree(responses, settled):
    assert settled_cycles(np.array(responses, dtype=complex), 1e-3) == settled


@given(st.complex_numbers(max_magnitude=10.0), st.integers(2, 12))
def test_equal_cycles_have_no_uncertainty(response, cycles):
    assert response_uncertainty(np.full(cycles, response)) < 1e-14


def test_uncertainty_is_standard_error_plus_drift():
    # Scatter of ±0.1 about 1 with halves that agree: 0.1·√(4/3)/√4.
    steady = np.array([0.9, 1.1, 1.1, 0.9])
    assert response_uncertainty(steady) == pytest.approx(0.1 * math.sqrt(4 / 3) / 2)
    drifting = np.array([0.9, 0.9, 1.1, 1.1])
    assert response_uncertainty(drifting) == pytest.approx(0.1 * math.sqrt(4 / 3) / 2 + 0.2)


def test_the_uncertainty_covers_the_error_of_a_noisy_mean():
    random = np.random.default_rng(1)
    noise = random.normal(size=(2000, 6, 2)) @ [1.0, 1.0j]
    covered = [abs(np.mean(cycles)) <= response_uncertainty(cycles) for cycles in noise]
    # Standard error alone covers the mean of a complex normal in 1 − 1/e = 63 % of the cases.
    assert np.mean(covered) > 0.85


def fake_loop(monkeypatch, time_constant):
    """Replace the simulation by a response of 1 + e^(−t/τ); returns the durations."""
    durations = []

    def simulate(scenario, *, signals):
        durations.append(scenario.simulation.duration_s)
        time = np.arange(math.floor(durations[-1] / 0.002 + 1e-6) + 1) * 0.002
        sine = np.sin(2 * np.pi * scenario.reference.frequency_hz * time)
        run = columns_run(time, (1 + np.exp(-time / time_constant)) * sine, sine)
        return Run(time, run.data | {"motor_speed_rad_s": 0 * time}, run.settings)

    monkeypatch.setattr(sine_estimate, "simulate", simulate)
    return durations


def test_a_loop_that_settles_slowly_is_waited_for(monkeypatch):
    durations = fake_loop(monkeypatch, time_constant=1.0)
    scenario = Scenario(reference=SineReference(frequency_hz=2.0))
    estimate = estimate_sine(scenario, SineEstimateSettings(largest_cycles=100))
    assert estimate.settled
    assert estimate.cycles == 16  # 4, 8, then 16
    assert durations == pytest.approx([0.5 + n / 2.0 for n in (4, 8, 16)])
    # Cycles count from a change of 0.2 % on: e^(−t/τ) < 0.002/(e^0.5 − 1) = 0.3 %.
    assert abs(estimate.response - 1.0) < 3e-3
    assert 0.5 * abs(estimate.response - 1.0) < estimate.uncertainty < 3e-3
    more = estimate_sine(scenario, SineEstimateSettings(averaged_cycles=12, largest_cycles=100))
    assert more.averaged_cycles >= 12


@pytest.mark.parametrize("frequency", [2.0, 2.003])  # whole numbers of samples or not
@pytest.mark.parametrize(("time_constant", "cycles"), [(0.05, 3), (1.0, 6)])
def test_the_last_run_has_the_results_of_all_shorter_runs(
    monkeypatch, time_constant, cycles, frequency
):
    durations = fake_loop(monkeypatch, time_constant)
    scenario = Scenario(reference=SineReference(frequency_hz=frequency))

    def settled(largest_cycles):
        settings = SineEstimateSettings(averaged_cycles=2, largest_cycles=largest_cycles)
        return settled_run(
            frequency,
            settings,
            lambda _, duration_s: sine_estimate.simulate(
                changed(scenario, {"simulation.duration_s": duration_s}), signals=()
            ),
        )

    both, single = settled(6), settled(cycles)
    assert durations == pytest.approx([0.5 + n / frequency for n in (6, cycles)])
    assert both.cycles == single.cycles == cycles
    assert np.array_equal(both.responses, single.responses)
    assert np.array_equal(both.run.time_s, single.run.time_s)
    for name, values in single.run.data.items():
        assert np.array_equal(both.run[name], values)


def test_a_loop_that_does_not_settle_is_reported(monkeypatch):
    fake_loop(monkeypatch, time_constant=20.0)
    scenario = Scenario(reference=SineReference(frequency_hz=2.0))
    estimate = estimate_sine(scenario, SineEstimateSettings(largest_cycles=10))
    assert not estimate.settled
    assert (estimate.cycles, estimate.averaged_cycles) == (10, 5)
    assert estimate.uncertainty > 0.02  # it drifts by 2.5 % a cycle


def test_a_small_sine_without_counts_has_the_linear_response():
    # 13.7 Hz: no whole number of samples a period; 0.01° stays off the acceleration limit.
    scenario = changed(
        Scenario(),
        {
            "reference.amplitude_deg": 0.01,
            "reference.frequency_hz": 13.7,
            "encoder.quantized": False,
        },
    )
    predicted = linearize_loop(scenario, knee_angle_deg=40.0).output_response(13.7)[0]
    estimate = estimate_sine(scenario)
    assert estimate.settled
    assert (estimate.speed_limited_share, estimate.acceleration_limited_share) == (0.0, 0.0)
    # The response of the samples holds what folds back from 500 ± 13.7 Hz: 2e-4.
    assert abs(estimate.response - predicted) <= 5e-4 * abs(predicted)
    assert abs(estimate.response - predicted) <= estimate.uncertainty + 3e-4


def test_a_fast_sine_meets_the_acceleration_limit_and_its_bound():
    scenario = Scenario(reference=SineReference(amplitude_deg=30.0, frequency_hz=20.0))
    estimate = estimate_sine(scenario)
    assert estimate.speed_limited_share == 0.0
    assert estimate.acceleration_limited_share > 0.8  # at 2 ms a reversal takes a sample of each 12
    # (4/π) A/(aω²), A = 1e4 rad/s² through gear and pump, a = 50.06 mm: no controller does more.
    # It does 10 % less, because the lag rounds each reversal.
    bound = 4 / math.pi * 0.77197 / (50.06e-3 * (40 * math.pi) ** 2)
    assert 0.8 * bound < estimate.gain < 1.02 * bound
    assert estimate.mean_deg > 42.0  # saturated all the time, it loses hold of the mean


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        (SineReference(amplitude_deg=0.0), "moves"),
        (RampReference(), "reference = ramp"),
        (SineReference(frequency_hz=51.0), r"51 Hz is too high: must be <= 50 Hz, ten"),
        (SineReference(frequency_hz=249.0), r"must be <= 50 Hz"),
    ],
)
def test_a_sine_that_means_nothing_is_refused(reference, message):
    with pytest.raises(ParameterError, match=message):
        estimate_sine(Scenario(reference=reference))


def test_a_frequency_above_nyquist_says_so():
    slow = changed(Scenario(controller={"kind": "pid"}), {"controller.sample_time_s": 0.01})
    with pytest.raises(ParameterError, match=r"Nyquist frequency of 50 Hz"):
        estimate_sine(changed(slow, {"reference.frequency_hz": 60.0}))


def test_too_few_cycles_are_refused():
    with pytest.raises(ParameterError, match="averaged_cycles = 1 cycles is out of range"):
        SineEstimateSettings(averaged_cycles=1)
    with pytest.raises(ParameterError, match=r"largest_cycles = 4: too few cycles, must be mor"):
        SineEstimateSettings(averaged_cycles=4, largest_cycles=4)
