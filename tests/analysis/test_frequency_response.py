import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from kneexo.analysis import (
    Run,
    crossing,
    draw_trials,
    frequency_response,
    fundamental,
    linearize_loop,
    nominal_trial,
    sinestream,
)
from kneexo.analysis.frequency_response import (
    MINUS_3_DB,
    FrequencyResponse,
    SineEstimateSettings,
    SinestreamSettings,
    cycle_responses,
    estimate_sine,
    response_uncertainty,
    settled_cycles,
)
from kneexo.errors import ParameterError
from kneexo.parameters import (
    BldcPumpParameters,
    PlantParameters,
    RampReference,
    Scenario,
    SimulationParameters,
    SineReference,
)
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
    settings = SinestreamSettings(trials=40)
    trials = draw_trials(Scenario(), settings)
    assert trials == draw_trials(Scenario(), settings)
    assert trials != draw_trials(Scenario(), SinestreamSettings(trials=40, seed=7))
    masses = [trial.mass_kg for trial in trials]
    assert 1.4 <= min(masses) < 1.5 < 1.7 < max(masses) <= 1.8
    limits = [trial.acceleration_limit_rad_s2 for trial in trials]
    assert min(limits) >= settings.acceleration_limit_min_rad_s2
    assert max(limits) <= settings.acceleration_limit_max_rad_s2
    assert np.median(limits) < 6e3  # log-uniform: half of them below the geometric mean
    count = 2 * math.pi / 4096
    assert all(0.0 <= trial.encoder_phase_rad <= count for trial in trials)


def test_trials_are_drawn_in_a_fixed_order():
    """Each range in turn, log-uniform where only the order of magnitude is known."""
    random = np.random.default_rng(2020)
    for trial in draw_trials(Scenario(), SinestreamSettings(trials=3)):
        leakage, limit, modulus, mass, phase = random.random(5)
        assert vars(trial) == pytest.approx(
            {
                "internal_leakage_m3_per_s_pa": 2e-14 * 100.0**leakage,
                "acceleration_limit_rad_s2": 2e3 * 5.0**limit,
                "bulk_modulus_pa": 0.2e9 * 8.6**modulus,
                "mass_kg": 1.4 + 0.4 * mass,
                "encoder_phase_rad": 2.0 * math.pi / 4096.0 * phase,
            },
            rel=1e-9,
            abs=0.0,
        )


def test_a_trial_changes_the_plant_and_not_what_the_controller_believes():
    scenario = Scenario()
    trial = draw_trials(scenario, SinestreamSettings())[0]
    applied = trial.applied(scenario)
    assert applied.plant.pump.internal_leakage_m3_per_s_pa == trial.internal_leakage_m3_per_s_pa
    assert applied.plant.pump.acceleration_limit_rad_s2 == trial.acceleration_limit_rad_s2
    assert applied.plant.cylinder.bulk_modulus_pa == trial.bulk_modulus_pa
    assert applied.plant.cylinder.mass_kg == trial.mass_kg
    assert applied.encoder.phase_rad == trial.encoder_phase_rad
    assert applied.believed_plant == scenario.plant
    wrong = changed(scenario, {"nominal": {"ideal_motor": True}})
    assert trial.applied(wrong).believed_plant == wrong.nominal
    assert nominal_trial(scenario).applied(scenario).plant == scenario.plant


def test_the_default_frequencies_hold_those_of_the_paper():
    frequencies = SinestreamSettings().frequencies_hz
    assert len(frequencies) >= 14
    assert {0.05, 0.1, 0.2, 0.21, 0.22, 0.24, 0.5} <= set(frequencies)


def test_ranges_that_cross_are_refused():
    with pytest.raises(
        ParameterError, match=r"mass_min_kg = 1.7 kg must not exceed mass_max_kg = 1.6 kg"
    ):
        SinestreamSettings(mass_min_kg=1.7, mass_max_kg=1.6)


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
        sinestream(scenario, SinestreamSettings(frequencies_hz=frequencies), trials=trials)


def test_repeated_frequencies_are_refused():
    with pytest.raises(ParameterError, match="must not repeat"):
        SinestreamSettings(frequencies_hz=(0.1, 0.2, 0.1))


def test_a_sinestream_needs_a_sine():
    with pytest.raises(ParameterError, match=r"reference = ramp: "):
        sinestream(Scenario(reference=RampReference()))


def test_a_small_sine_within_the_speed_limit_is_followed():
    result = sinestream(
        Scenario(reference=SineReference(amplitude_deg=2.0)),
        SinestreamSettings(frequencies_hz=(0.4, 0.5, 0.6), trials=1, measured_cycles=1),
    )
    assert result.response.shape == (1, 3)
    # Far below the speed limit; the observer's lag leaves 2 % at 0.5 Hz, growing with f².
    assert np.abs(result.response - 1.0).max() < 0.04
    assert math.isnan(result.bandwidth_hz)
    assert len(result.plot()) == 2


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
        assert "1 trials" in lines
        fine, curve = lines["PCHIP"]
        assert (fine[0], fine[-1]) == (0.2, 0.8)
        assert curve[[0, -1]] == pytest.approx(values[[0, -1]], abs=1e-9)
        assert set(lines["−3 dB at 0.500 Hz"][0]) == {0.5}
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
        return columns_run(time, knee, np.sin(phase))

    monkeypatch.setattr(frequency_response, "simulate", simulate)
    # Orthogonal to the fundamental over whole periods, of 1000, 500 and 250 samples, alone.
    found = sinestream(settings=SinestreamSettings(frequencies_hz=(0.5, 1.0, 2.0), trials=1))
    assert found.response == pytest.approx(np.ones((1, 3)), abs=1e-9)


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


# ------------------------------------------------------------------------- one sine, settled


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

    monkeypatch.setattr(frequency_response, "simulate", simulate)
    return durations


def test_a_loop_that_settles_slowly_is_waited_for(monkeypatch):
    durations = fake_loop(monkeypatch, time_constant=1.0)
    scenario = Scenario(reference=SineReference(frequency_hz=2.0))
    found = estimate_sine(scenario, SineEstimateSettings(largest_cycles=100))
    assert found.settled
    assert found.cycles == 16  # 4, 8, then 16
    assert durations == pytest.approx([0.5 + n / 2.0 for n in (4, 8, 16)])
    # Cycles count from a change of 0.2 % on: e^(−t/τ) < 0.002/(e^0.5 − 1) = 0.3 %.
    assert abs(found.response - 1.0) < 3e-3
    assert 0.5 * abs(found.response - 1.0) < found.uncertainty < 3e-3
    more = estimate_sine(scenario, SineEstimateSettings(averaged_cycles=12, largest_cycles=100))
    assert more.averaged_cycles >= 12


def test_a_loop_that_does_not_settle_is_told(monkeypatch):
    fake_loop(monkeypatch, time_constant=20.0)
    scenario = Scenario(reference=SineReference(frequency_hz=2.0))
    found = estimate_sine(scenario, SineEstimateSettings(largest_cycles=10))
    assert not found.settled
    assert (found.cycles, found.averaged_cycles) == (10, 5)
    assert found.uncertainty > 0.02  # it drifts by 2.5 % a cycle


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
    predicted = linearize_loop(scenario, 40.0).output_response(13.7)[0]
    found = estimate_sine(scenario)
    assert found.settled
    assert (found.speed_limited_share, found.acceleration_limited_share) == (0.0, 0.0)
    # The response of the samples holds what folds back from 500 ± 13.7 Hz: 2e-4.
    assert abs(found.response - predicted) <= 5e-4 * abs(predicted)
    assert abs(found.response - predicted) <= found.uncertainty + 3e-4


def test_a_fast_sine_meets_the_acceleration_limit_and_its_bound():
    scenario = Scenario(reference=SineReference(amplitude_deg=30.0, frequency_hz=20.0))
    found = estimate_sine(scenario)
    assert found.speed_limited_share == 0.0
    assert found.acceleration_limited_share > 0.8  # at 2 ms a reversal takes a sample of each 12
    # (4/π) A/(aω²), A = 1e4 rad/s² through gear and pump, a = 50.06 mm: no controller does more.
    # It does 10 % less, because the lag rounds each reversal.
    bound = 4 / math.pi * 0.77197 / (50.06e-3 * (40 * math.pi) ** 2)
    assert 0.8 * bound < found.gain < 1.02 * bound
    assert found.mean_deg > 42.0  # saturated all the time, it loses hold of the mean


@pytest.mark.parametrize(
    ("reference", "told"),
    [
        (SineReference(amplitude_deg=0.0), "moves"),
        (RampReference(), "reference = ramp"),
        (SineReference(frequency_hz=51.0), r"51 Hz is too high: must be <= 50 Hz, ten"),
        (SineReference(frequency_hz=249.0), r"must be <= 50 Hz"),
    ],
)
def test_a_sine_that_means_nothing_is_refused(reference, told):
    with pytest.raises(ParameterError, match=told):
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
