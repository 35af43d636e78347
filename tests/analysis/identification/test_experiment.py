"""Motions that tell most about a knee: information by closed forms, choice, limits, file."""

import numpy as np
import pytest

from kneexo.analysis.identification import experiment
from kneexo.analysis.identification.experiment import (
    STEP_S,
    Experiment,
    design_experiment,
    standard_candidates,
)
from kneexo.errors import ParameterError
from kneexo.parameters import CsvReference, SampledReference, Scenario
from kneexo.parameters.paths import value_at
from kneexo.simulation.compiled import simulate_together

LAG, FLOW = "plant.pump.lag_s", "plant.pump.displacement_m3_per_rad"
LIMIT = "plant.pump.acceleration_limit_rad_s2"
SPEED, ENCODER = "motor_speed_rad_s", "encoder_reading_rad"
TIME_S = np.arange(41) * STEP_S
SWING = np.sin(np.pi * TIME_S / TIME_S[-1]) ** 2
GENTLE = {"gentle": 40.0 + 0.3 * SWING}  # deg


def designed(ranges, noise, candidates=GENTLE, **options):
    options = {"duration_s": TIME_S[-1]} | options
    return design_experiment(Scenario(), ranges, noise, candidates=candidates, **options)


def run_of(angles):
    """The whole loop along a motion, by the engine for runs."""
    scenario = (
        Scenario()
        .without_quantizers()
        .changed(
            {
                "reference": SampledReference(
                    times_s=np.arange(len(angles)) * STEP_S, angles_deg=angles
                )
            }
        )
    )
    names = ("motor_speed_command", "motor_speed", "encoder_reading", "rod_extension")
    (run,) = simulate_together([scenario], names)
    return run


def half_width(derivative, sigma, slope):
    """1.96 deviations with the derivative (n,) by the place, and an even spread over the range."""
    return 1.96 / np.sqrt(12.0 + derivative @ derivative / sigma**2) * slope


def test_what_the_speed_tells_of_the_lag_is_that_of_a_first_order_lag():
    run, lag, slope = run_of(GENTLE["gentle"]), 0.01, 0.01 * np.log(0.1 / 0.001)
    held = run["motor_speed_command_rad_s"][1:]  # a row has the command that was held until it
    kept, time_s = np.exp(-0.002 / lag), 0.002
    speed, change = [0.0], [0.0]
    for u in held:
        change.append(change[-1] * kept + (speed[-1] - u) * kept * time_s / lag**2)
        speed.append(u + (speed[-1] - u) * kept)
    np.testing.assert_allclose(run[SPEED], speed, atol=1e-3 * np.ptp(speed))
    expected = half_width(np.array(change) * slope, 3.0, slope)
    found = designed({LAG: (0.001, 0.1)}, {SPEED: 3.0})
    assert found.half_width[LAG] == pytest.approx(expected, rel=2e-3)


def test_what_the_encoder_tells_of_the_flow_is_the_way_of_the_rod_less_its_unknown_start():
    run, sigma = run_of(GENTLE["gentle"]), 1e-5
    rod, reading = run["rod_extension_m"], run[ENCODER]
    per_m = np.polyval(np.polyder(np.polyfit(rod - rod[0], reading, 2)), rod - rod[0])
    slope = 1.2732395e-7 * np.log(100.0)
    way = per_m * (rod - rod[0]) * np.log(100.0)  # the rod's way has the factor of the flow
    way -= per_m * (per_m @ way) / (per_m @ per_m)
    found = designed({FLOW: (1.2732395e-8, 1.2732395e-6)}, {ENCODER: sigma})
    assert found.half_width[FLOW] == pytest.approx(half_width(way, sigma, slope), rel=0.02)


def test_the_sine_is_that_of_fig_12_and_noise_counts_for_each_sensor():
    ranges = {LAG: (0.001, 0.1)}
    time_s = np.arange(41) * STEP_S
    fig_12 = {"sine": 40.0 - 30.0 * np.cos(2.0 * np.pi * 0.1 * time_s)}
    found = designed(ranges, {SPEED: 3.0}, fig_12)
    assert found.half_width == found.half_width_of_sine
    both = designed(ranges, {ENCODER: 1e9, SPEED: 3.0}, fig_12)
    assert both.half_width[LAG] == pytest.approx(found.half_width[LAG], rel=1e-9)


def test_the_next_segment_raises_the_determinant_most_for_its_time(monkeypatch):
    known = {"a": np.diag([9.0, 0.0]), "b": np.diag([8.0, 1.0]), "c": np.diag([1.0, 20.0])}
    motions = {"a": GENTLE["gentle"], "b": 40.0 + 0.2 * SWING, "c": np.full(61, 40.0)}
    names = iter([*known, "whole", "sine"])
    told = known | {"whole": 100.0 * np.eye(2), "sine": 25.0 * np.eye(2)}
    monkeypatch.setattr(experiment, "_information", lambda *_: told[next(names)])
    found = designed({LAG: (0.001, 0.1), LIMIT: (1e3, 1e5)}, {SPEED: 1.0}, motions, duration_s=1.4)
    total, chosen, left, duration = 12.0 * np.eye(2), [], 140, {"a": 40, "b": 40, "c": 60}
    while fitting := [n for n in known if duration[n] <= left]:
        values = {
            n: np.log(np.linalg.det(total + known[n]) / np.linalg.det(total)) / duration[n]
            for n in fitting
        }
        chosen.append(max(values, key=values.get))
        total, left = total + known[chosen[-1]], left - duration[chosen[-1]]
    assert found.chosen == tuple(chosen)
    assert len(set(chosen)) > 1
    expected = 1.96 / np.sqrt(112.0) * 0.01 * np.log(100.0)
    assert found.half_width[LAG] == pytest.approx(expected)
    assert found.half_width_of_sine[LAG] == pytest.approx(expected * np.sqrt(112.0 / 37.0))
    np.testing.assert_allclose(
        found.reference.times_s, np.arange(len(found.reference.times_s)) / 100
    )
    assert found.reference.times_s[-1] == pytest.approx(sum(duration[n] for n in chosen) / 100)


def test_a_motion_beyond_a_limit_is_refused_with_the_reason():
    motions = GENTLE | {
        "fast": 40.0 + 20.0 * SWING,
        "far": 95.0 + 0.3 * SWING,
    }
    found = designed({LAG: (0.001, 0.1)}, {SPEED: 3.0}, motions)
    assert found.chosen == ("gentle",)
    assert found.refused["fast"] == "motor_speed_command_rad_s: reaches its limit, 523.6"
    assert "range" in found.refused["far"]
    assert "2 candidates refused, the first is fast: motor" in str(found)
    weak = Scenario().changed(
        {"plant.cylinder.pressure_rating_pa": 1e3, "plant.cylinder.mass_kg": 90.0}
    )
    with pytest.raises(
        ParameterError, match=r"no candidate .* load_pressure_pa: reaches its limit"
    ):
        design_experiment(weak, {LAG: (0.001, 0.1)}, {SPEED: 3.0}, candidates=GENTLE)


def test_the_motion_is_a_reference_file_and_the_table_says_what_becomes_bounded(tmp_path):
    found = designed({LAG: (0.001, 0.02), LIMIT: (1e3, 1e5)}, {SPEED: 3.0})
    found.write_csv(tmp_path / "motion.csv")
    read = CsvReference(file="motion.csv").samples(tmp_path)
    assert read.times_s == found.reference.times_s
    np.testing.assert_allclose(read.angles_deg, found.reference.angles_deg, atol=1e-6)
    widths = {LAG: 0.01, LIMIT: 100.0}, {LAG: 0.01, LIMIT: 1e5}  # the lag is near its upper end
    table = Experiment(found.reference, ("b", "a", "b"), {}, found.unknowns, *widths)
    assert str(table).endswith("\n3 segments:\n  2 of b\n  1 of a")
    assert table.words == {LAG: "not bounded", LIMIT: "bounded, by the sine not bounded"}
    assert "10000  1e+02     1e+05          bounded, by the sine not bounded" in str(table)


def test_standard_candidates_begin_and_end_at_rest_and_have_their_bands_and_rates():
    motions = standard_candidates(Scenario())
    assert len(motions) == 48
    for angles in motions.values():
        assert angles.size == 1001
        np.testing.assert_allclose(angles[[0, 1, -2, -1]], 40.0, atol=1e-3)
    wave = motions["multisine of 1.9 deg to 3 Hz"] - 40.0
    assert np.max(np.abs(wave)) == pytest.approx(30.0 / 16.0)
    assert np.sqrt(np.mean(wave**2)) > 0.3 * 30.0 / 16.0  # cosines in phase: 0.13
    power = np.abs(np.fft.rfft(wave[:-1])) ** 2
    assert np.sum(power[:32]) > 0.99 * np.sum(power)
    assert np.sum(power[25:]) > 0.1 * np.sum(power)
    stairs = motions["staircase of 3 x 5 deg at 8 deg/s"] - 40.0
    assert (stairs.min(), stairs.max()) == pytest.approx((-15.0, 15.0))
    assert np.max(np.abs(np.diff(stairs))) == pytest.approx(8.0 * STEP_S)
    both = motions["staircase of 3 x 5 deg at 8 deg/s + multisine of 1.9 deg to 3 Hz"]
    np.testing.assert_allclose(both - 40.0, stairs + wave)


@pytest.mark.parametrize(
    ("ranges", "noise", "message"),
    [
        ({"plant.pump.lags": (1.0, 2.0)}, {SPEED: 1.0}, "lags"),
        ({LAG: (0.02, 0.1)}, {SPEED: 1.0}, "start = 0.01 must be within"),
        ({LAG: (0.001, 0.1)}, {"motor_speed": 1.0}, "motor_speed is no column of a run"),
        ({LAG: (0.001, 2.0)}, {SPEED: 1.0}, "the range 0.001 … 2 must"),
        ({"controller.kind": (1.0, 2.0)}, {SPEED: 1.0}, "must be a real number with a range"),
        ({LAG: (0.001, 0.1)}, {SPEED: 0.0}, "motor_speed_rad_s = 0: must be finite and above 0"),
        ({LAG: (0.001, 0.1)}, {SPEED: np.nan}, "= nan: must be finite"),
        ({}, {SPEED: 1.0}, "needs a range, a noise"),
        ({LAG: (0.001, 0.1)}, {}, "needs a range, a noise"),
    ],
)
def test_a_wrong_argument_is_refused(ranges, noise, message):
    with pytest.raises(ParameterError, match=message):
        designed(ranges, noise)
    with pytest.raises(ParameterError, match="duration_s of 0"):
        designed({LAG: (0.001, 0.1)}, {SPEED: 1.0}, duration_s=np.nan)
    with pytest.raises(ParameterError, match="leave the wearer out"):
        design_experiment(Scenario.preset("wearer"), ranges, noise)


@pytest.mark.slow(gate=0)
def test_a_minute_tells_twice_as_much_of_ten_numbers_as_the_sine():
    leg = Scenario.preset("leg")
    paths = [
        *(LAG, LIMIT, FLOW, "plant.pump.internal_leakage_m3_per_s_pa"),
        *(f"plant.cylinder.{name}" for name in ("bulk_modulus_pa", "mass_kg", "damping_n_s_per_m")),
        *("plant.full_order.coulomb_friction_n", "plant.full_order.dead_volume_m3"),
        "plant.load.segment_mass_kg",
    ]
    ranges = {path: (0.1 * value_at(leg, path), 10.0 * value_at(leg, path)) for path in paths}
    noise = {ENCODER: leg.encoder.resolution_rad / 12**0.5, SPEED: 1.0}
    noise |= dict.fromkeys(("cap_pressure_pa", "rod_side_pressure_pa"), 1e4)
    found = design_experiment(leg, ranges, noise)
    ratios = np.array([found.half_width[path] / found.half_width_of_sine[path] for path in paths])
    assert np.exp(np.mean(np.log(ratios))) <= 0.5
    assert ratios.max() <= 1.1
    assert found.words[LIMIT] == "bounded, by the sine not bounded"
