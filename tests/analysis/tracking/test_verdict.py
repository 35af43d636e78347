"""The verdict on runs that are made by hand, and on loops with and without margins."""

import dataclasses
import functools
import json
import math

import numpy as np
import pytest

from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.analysis.signals import settled_s
from kneexo.analysis.tracking.tracking import TrackingResult, run_metrics, track
from kneexo.analysis.tracking.verdict import ERROR_SHARE, Stability, loop_lines
from kneexo.command_line.output import to_json
from kneexo.geometry.linkage import encoder_angle
from kneexo.parameters import G1, RPM, Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation import Run

SINE = Scenario(reference={"kind": "sine", "frequency_hz": 0.5})  # 10…70°, period 2 s
TIME = np.arange(0.0, 6.0, 0.002)
LEG = changed(Scenario.preset("leg"), {"reference": SINE.reference})


@pytest.fixture(autouse=True)
def one_linearization(monkeypatch):
    """Linearize each loop once in all tests of this file."""
    monkeypatch.setattr("kneexo.analysis.tracking.verdict.linearize_loop", _linearized)


@functools.cache
def _linearized(scenario, *, knee_angle_deg):
    """Linearize a loop, whose reference and duration have no effect, by its other parts."""
    return linearize_loop(scenario, knee_angle_deg=knee_angle_deg)


def result(scenario=SINE, *, error_deg=0.0, time_s=TIME, **signals):
    """Return the result of a run with constant or sampled signals."""
    columns = {
        "knee_reference_rad": np.radians(error_deg),
        "knee_angle_rad": 0.0,
        "motor_speed_command_rad_s": 0.0,
        "load_pressure_pa": 0.0,
        "shaft_power_w": 0.0,
        "hydraulic_power_w": 0.0,
    } | signals
    data = {name: np.broadcast_to(values, time_s.shape) for name, values in columns.items()}
    run = Run(time_s, data, scenario.simulation)
    metrics = run_metrics(scenario, time_s, data, settled_s=settled_s(scenario))
    return TrackingResult(scenario, run, metrics)


@pytest.mark.parametrize(("worst_deg", "tracks"), [(1.99, True), (-1.99, True), (-2.01, False)])
def test_a_run_tracks_within_2_deg_at_an_amplitude_of_30_deg(worst_deg, tracks):
    error = np.where(TIME < 1.998, 5.0, 0.1)  # the first period does not count
    error[np.argmin(np.abs(TIME - 3.5))] = worst_deg
    verdict = result(error_deg=error).verdict
    assert verdict.tracks is tracks
    assert verdict.max_error_deg == pytest.approx(abs(worst_deg))
    assert verdict.max_error_time_s == pytest.approx(3.5)
    assert verdict.error_bound_deg == pytest.approx(2.0)  # Section 5: "less than 2°"
    assert verdict.lines[0] == (
        f"{'Tracks' if tracks else 'Does not track'}: largest error {abs(worst_deg):.3g}° at "
        f"3.5 s; the bound is 2° (1/15 of the amplitude of 30°)."
    )


def test_all_errors_count_in_a_run_of_less_than_two_periods_and_with_other_references():
    early = np.where(TIME < 0.5, 5.0, 0.1)
    short = TIME[TIME < 3.9955]
    part = changed(SINE, {"simulation.duration_s": 3.996})
    verdict = result(part, error_deg=early[: short.size], time_s=short).verdict
    assert (verdict.tracks, verdict.max_error_time_s) == (False, 0.0)
    ramp = {"kind": "ramp", "start_deg": 20.0, "end_deg": 60.0}
    verdict = result(changed(SINE, {"reference": ramp}), error_deg=early).verdict
    assert not verdict.tracks
    assert verdict.error_bound_deg == pytest.approx(20.0 * ERROR_SHARE)


def test_no_run_must_track_better_than_the_encoder_counts():
    still = changed(SINE, {"reference.amplitude_deg": 0.0})
    theta_4 = encoder_angle(G1, np.radians([39.99, 40.01]))
    count_deg = 360.0 / 4096.0 * math.radians(0.02) / abs(theta_4[1] - theta_4[0])
    assert result(still, error_deg=0.99 * count_deg).verdict.tracks
    verdict = result(still, error_deg=1.01 * count_deg).verdict
    assert not verdict.tracks
    assert verdict.error_bound_deg == pytest.approx(count_deg, rel=1e-4)
    assert "(one count of the encoder)" in verdict.lines[0]


@pytest.mark.parametrize(
    ("counts", "amplitude_deg", "bound_deg"), [(2, 30, 2), (64, 30, 2), (2, 1, 2)]
)
def test_a_coarse_encoder_excuses_no_large_error(counts, amplitude_deg, bound_deg):
    values = {"encoder.counts_per_revolution": counts, "reference.amplitude_deg": amplitude_deg}
    verdict = result(changed(SINE, values), error_deg=bound_deg + 0.01).verdict
    assert verdict.tracks is False
    assert verdict.error_bound_deg == pytest.approx(bound_deg)
    reason = "1/15 of the amplitude" if amplitude_deg == 30 else "one count of the encoder is "
    assert f"({reason}" in verdict.lines[0]


def test_a_limit_cycle_that_leaves_the_band_does_not_settle():
    """A cycle of ±0.3°: outside of 2 % of 10°, inside of 2 % of 20°, also where the run ends."""
    for end_deg, settles in ((40.0, False), (50.0, True)):
        step = {"kind": "step", "start_deg": 30.0, "end_deg": end_deg, "time_s": 1.0}
        angle = end_deg + 0.3 * np.sin(2.0 * math.pi * (TIME - TIME[-1]) / 0.5)
        angle = np.where(TIME <= 1.0, 30.0, angle)
        run = result(
            changed(SINE, {"reference": step}),
            error_deg=np.where(TIME <= 1.0, 30.0, end_deg),
            knee_angle_rad=np.radians(angle),
        )
        assert abs(angle[-1] - end_deg) < 1e-9
        assert run.step.settles is run.verdict.tracks is settles
        assert run.verdict.lines[1].startswith(
            "Hunts at rest: the reference is constant from 1.002"
        )
        assert run.verdict.results()["limit_cycle"]["amplitude_deg"] == pytest.approx(0.3, rel=1e-3)


def test_a_step_tracks_if_it_settles():
    step = {"kind": "step", "start_deg": 30.0, "end_deg": 40.0, "time_s": 1.0}
    scenario = changed(SINE, {"reference": step})
    for rate, tracks in ((4.0, True), (0.3, False)):
        angle = np.where(TIME < 1.0, 30.0, 40.0 - 10.0 * np.exp(-rate * (TIME - 1.0)))
        verdict = result(scenario, knee_angle_rad=np.radians(angle)).verdict
        assert verdict.tracks is tracks
        assert verdict.lines[0].startswith("Tracks: within" if tracks else "Does not track: not")


def test_what_saturates_is_named_with_its_share_of_the_run():
    limit = 5000.0 * RPM
    command = np.where(TIME < 1.5, -limit, 0.5 * limit)  # the first period counts here
    line = result(motor_speed_command_rad_s=command).verdict.lines[1]
    assert line == "Saturates: command at its limit of 5000 rpm for 25 % of the run."
    command[:-1] = limit  # and nearly always
    line = result(motor_speed_command_rad_s=command).verdict.lines[1]
    assert line == (
        "Saturated most of the time, which the margins leave out: command at its limit of 5000 rpm "
        "for 100 % of the run."
    )
    pressure = np.where(TIME < 0.6, -3.6e6, 0.0)
    power = np.where(TIME < 0.3, 201.0, 0.0)
    verdict = result(load_pressure_pa=pressure, shaft_power_w=power).verdict
    assert verdict.lines[1] == (
        "Saturates: pressure above 3.5 MPa for 10 % of the run, power above 200 W for 5 % of the "
        "run."
    )
    assert verdict.saturated_share == 0.0
    assert verdict.pressure_over_rating_share == pytest.approx(0.1)
    assert verdict.power_over_rating_share == pytest.approx(0.05)
    assert math.isnan(verdict.relief_share)


def test_open_relief_valves_saturate_the_full_order():
    chambers = {
        "cap_pressure_pa": np.where(TIME < 1.2, 3.51e6, 0.2e6),
        "rod_side_pressure_pa": np.where(TIME > 4.8 - 1e-9, 3.51e6, 0.2e6),
    }
    verdict = result(LEG, **chambers).verdict
    assert verdict.relief_share == pytest.approx(0.4)
    assert verdict.lines[1] == "Saturates: relief valves open for 40 % of the run."


@pytest.mark.parametrize(("frequency_hz", "is_named"), [(19.0, False), (21.0, True), (200.0, True)])
def test_a_load_that_changes_the_chamber_again_and_again_is_mode_switching(frequency_hz, is_named):
    """From 2.5 s on, for 1 s; before, the cap side carries the load."""
    wave = np.cos(2.0 * math.pi * frequency_hz * (TIME - 2.5005))
    load = np.where((TIME > 2.5) & (TIME < 3.5), wave, 1.0)
    chambers = {"cap_pressure_pa": 2e5 + 1e5 * load, "rod_side_pressure_pa": 2e5}
    verdict = result(LEG, load_pressure_pa=1e5 * load, **chambers).verdict
    named = [line for line in verdict.notices if line.startswith("mode switching: from 2.5")]
    assert len(named) == is_named
    if frequency_hz == 200.0:
        assert "changes the chamber 200 times within 0.5 s" in named[0]


WORN = changed(SINE, {"plant.load": {"kind": "knee"}, "wearer": "leg"})
FREE = changed(WORN, {"controller": {"kind": "torque"}})
TORQUES = {
    "interaction_torque_n_m": np.where(TIME < 1.998, 99.0, 3.0 * np.sin(math.pi * TIME)),
    "wearer_angle_rad": 0.0,
    "wearer_rate_rad_s": np.sin(math.pi * TIME),
}


def test_the_verdict_on_a_wearer_is_about_torque_first():
    # Rod: −0.1 m · 20 N = −2 N·m; desired 5 N·m, at 3 s 9 N·m.
    control = {
        "desired_torque_n_m": np.where(np.abs(TIME - 3.0) < 1e-9, 9.0, 5.0),
        "moment_arm_m": 0.1,
        "rod_force_n": 20.0,
    }
    run = result(FREE, error_deg=9.0, **TORQUES, **control)
    assert run.verdict.tracks is None
    rms = 3.0 / math.sqrt(2.0)
    error = math.sqrt((1999 * 49 + 121) / 2000)  # 2 … 6 s
    assert run.verdict.lines[:2] == (
        f"Interaction torque {rms:.3g} N·m rms, peak 3 N·m at 2.5 s; the wearer gives 1.5 W and "
        "gets 0 W.",
        f"Torque error {error:.3g} N·m rms, peak 11 N·m at 3 s; the desired torque reaches 9 N·m.",
    )
    assert len(run.verdict.lines) == 4
    printed = json.loads(to_json(run.verdict.results()))
    assert printed["tracks"] is None
    # TIME ends one sample before the end of the period
    assert printed["interaction"]["rms_torque_n_m"] == pytest.approx(rms, rel=1e-3)
    assert printed["torque_error_rms_n_m"] == pytest.approx(error)
    assert max(map(len, str(run).splitlines())) <= 100


def test_limits_of_the_desired_torque_and_of_the_load_cell_and_the_requested_share_are_lines():
    """The torque is at ±30 N·m for a tenth, and offset and force exceed 2000 N for a twentieth."""
    moment = {"times_s": (0.0, 40.0), "moments_n_m": (1.0, 5.0)}
    helping = changed(
        FREE,
        {
            "controller.mode": "assist",
            "controller.assistance": 0.25,
            "controller.torque_limit_n_m": 30.0,
            "wearer.moment": moment,
            "load_cell": {"range_n": 2000.0, "offset_n": -10.0},
        },
    )
    control = {
        "desired_torque_n_m": np.where(TIME < 0.6 - 1e-9, -30.0, 29.9),
        "moment_arm_m": 0.1,
        "rod_force_n": np.where(TIME < 0.3 - 1e-9, -1990.1, 2009.0),
        "biological_moment_n_m": -12.0 * np.sin(math.pi * TIME),
    }
    lines = result(helping, **TORQUES, **control).verdict.lines
    assert lines[0].endswith("gets 0 W; assistance ratio 0.25 (requested 0.25).")
    without = control | {"biological_moment_n_m": 0.0 * TIME}  # no moment, so no ratio
    assert result(helping, **TORQUES, **without).verdict.lines[0].endswith("gets 0 W.")
    assert lines[2] == (
        "Saturates: desired torque at its limit of 30 N·m for 10 % of the run, load cell beyond "
        "its range of 2000 N for 5 % of the run."
    )
    # position control has no such limits
    assert result(WORN, **TORQUES, **control).verdict.lines[3].startswith("Nothing saturates")


def test_with_position_control_and_a_wearer_tracking_and_torque_are_in_the_verdict():
    helped = TORQUES | {"biological_moment_n_m": -12.0 * np.sin(math.pi * TIME)}
    verdict = result(WORN, error_deg=9.0, **helped).verdict
    assert verdict.tracks is False
    assert [line.split()[0] for line in verdict.lines] == [
        "Does",
        "Interaction",
        "Nothing",
        "Stable",
    ]
    assert verdict.lines[1].endswith("gets 0 W; assistance ratio 0.25.")
    assert math.isnan(verdict.torque_error_rms_n_m)
    assert result().verdict.interaction is None


def test_a_step_under_torque_control_need_not_settle():
    step = {"kind": "step", "start_deg": 30.0, "end_deg": 40.0, "time_s": 1.0}
    run = result(changed(FREE, {"reference": step, "wearer.motion": "active"}), knee_angle_rad=0.5)
    assert (run.step, run.verdict.tracks) == (None, None)


def test_a_run_with_a_wearer_logs_the_signals_of_its_verdict():
    moment = {"times_s": (0.0, 1.0), "moments_n_m": (1.0, 5.0)}
    values = {"controller.mode": "assist", "wearer.moment": moment, "simulation.duration_s": 0.1}
    verdict = track(changed(FREE, values)).verdict
    assert 0.0 < verdict.interaction.rms_torque_n_m < 20.0
    assert math.isfinite(verdict.interaction.assistance_ratio)
    assert verdict.torque_error_rms_n_m > 0.0


@pytest.mark.parametrize("low", ["cap", "rod_side"])
def test_a_chamber_below_vacuum_is_a_notice_with_time_and_place(low):
    other = {"cap": "rod_side", "rod_side": "cap"}[low]
    pressure = np.where(np.abs(TIME - 1.5) < 1e-9, -0.27e6, -0.05e6)
    chambers = {f"{low}_pressure_pa": pressure, f"{other}_pressure_pa": 0.2e6}
    verdict = result(LEG, knee_angle_rad=np.radians(20.0 + 10.0 * TIME), **chambers).verdict
    (notice,) = [note for note in verdict.notices if "evaporates" in note]
    name = low.replace("_", " ")
    assert notice.startswith(f"the pressure of the {name} falls to -0.27 MPa at 1.5 s and 35°, ")
    assert "below -0.1 MPa" in notice
    assert "evaporates" in verdict.text
    chambers[f"{low}_pressure_pa"] = -0.0999e6
    assert not any("evaporates" in note for note in result(LEG, **chambers).verdict.notices)


def test_a_wearer_above_the_rating_in_reduced_order_needs_relief_valves():
    high = np.where(np.arange(TIME.size) == 7, -37.3e6, 1e6)
    (notice,) = result(WORN, load_pressure_pa=high).verdict.notices
    assert notice.startswith("the load pressure reaches 37.3 MPa, because the reduced order has no")
    assert notice.endswith("add plant: {full_order: true}")
    assert not result(WORN, load_pressure_pa=3.49e6).verdict.notices
    assert not result(SINE, load_pressure_pa=high).verdict.notices
    assert not result(changed(LEG, {"wearer": "leg"}), load_pressure_pa=high).verdict.notices


def test_a_run_off_its_limits_names_them():
    signals = {"motor_speed_command_rad_s": -4100.0 * RPM, "load_pressure_pa": -0.35e6}
    verdict = result(**signals, shaft_power_w=2.6).verdict
    assert verdict.lines[1] == (
        "Nothing saturates: command 4100 of 5000 rpm, pressure 0.35 of 3.5 MPa, power 2.6 of 200 W."
    )
    ideal = changed(SINE, {"plant.ideal_motor": True, "controller.command_limit_rad_s": 1e12})
    assert "command 4100 rpm, pressure" in result(ideal, **signals).verdict.lines[1]


def test_the_margins_are_those_in_the_middle_of_the_reference():
    reference = {"kind": "sine", "mean_deg": 55.0, "amplitude_deg": 10.0, "frequency_hz": 0.5}
    scenario = changed(LEG, {"reference": reference})
    verdict = result(scenario).verdict
    margins = linearize_loop(scenario, knee_angle_deg=55.0).margins()
    assert verdict.stability.stable
    assert verdict.stability.knee_angle_deg == pytest.approx(55.0, abs=0.1)
    assert vars(verdict.stability.margins) == vars(margins)
    decibel = 20.0 * math.log10(margins.gain_margin)
    assert verdict.lines[2] == (
        f"Stable at 55°: gain margin {margins.gain_margin:.3g} ({decibel:.2g} dB), phase margin "
        f"{margins.phase_margin_deg:.3g}°, delay margin {1e3 * margins.delay_margin_s:.3g} ms "
        f"({math.floor(margins.delay_margin_s / 0.002)} samples)."
    )
    assert result().verdict.lines[2] != verdict.lines[2]


def test_an_unstable_loop_has_no_margins():
    # Exact states at k/Φ = 1.3e4 1/s: docs/eq27_at_2ms.md.
    values = {"estimator": {"kind": "exact"}, "controller.phi_m_s2": 24.4}
    verdict = result(changed(SINE, values)).verdict
    assert verdict.stability.stable is False
    assert verdict.stability.margins is None
    assert verdict.lines[2].startswith(
        "Not stable at 40°: the largest eigenvalue of the sampled lo"
    )
    assert verdict.stability.largest_eigenvalue > 1.0
    assert verdict.results()["phase_margin_deg"] is not None
    assert json.loads(to_json(verdict.results()))["phase_margin_deg"] is None


def test_a_loop_that_is_not_linear_says_why():
    verdict = result(changed(SINE, {"controller.switching": "signum"})).verdict
    assert verdict.stability.stable is None
    assert verdict.lines[2] == (
        "No margins at 40°: controller.switching = signum: there is no linear sampled-data loop"
    )
    assert verdict.results()["margins_failure"].startswith("controller.switching = signum")


def test_gain_margins_in_both_directions_are_reported():
    loop = _linearized(LEG, knee_angle_deg=40.0)
    margins = loop.margins()
    both = dataclasses.replace(margins, lower_gain_margin=0.25)
    line = dataclasses.replace(Stability.of_loop(loop), margins=both).line
    assert " dB) and 0.25, phase margin" in line
    large = dataclasses.replace(margins, gain_margin=1e6)
    line = dataclasses.replace(Stability.of_loop(loop), margins=large).line
    assert "gain margin 1e+06 (120 dB), phase" in line
    none = dataclasses.replace(
        margins, gain_margin=math.inf, phase_margin_deg=math.inf, delay_margin_s=math.inf
    )
    line = dataclasses.replace(Stability.of_loop(loop), margins=none).line
    assert line.endswith("gain margin infinite, phase margin infinite, delay margin infinite.")


def test_the_lines_of_a_loop_have_its_margins_and_bandwidths():
    loop = _linearized(LEG, knee_angle_deg=40.0)
    m = loop.margins()
    stability, disk, bandwidth = loop_lines(loop)
    assert stability == Stability.of_loop(loop).line
    assert disk == (
        f"Crossover: gain {m.phase_margin_frequency_hz:.3g} Hz, phase "
        f"{m.gain_margin_frequency_hz:.3g} Hz. Disk margin {m.disk_margin:.3g}: gain "
        f"{m.disk_gain_margin:.3g}, phase {m.disk_phase_margin_deg:.3g}°."
    )
    assert bandwidth == (
        f"Bandwidth (−3 dB, small signals): {loop.bandwidth_hz():.3g} Hz; of the feedback alone: "
        f"{loop.complementary_sensitivity_bandwidth_hz():.3g} Hz."
    )


def test_the_bandwidth_under_torque_control_is_not_that_of_the_knee_reference():
    loop = _linearized(FREE, knee_angle_deg=40.0)
    *_, bandwidth = loop_lines(loop)
    hz = loop.complementary_sensitivity_bandwidth_hz()
    assert bandwidth == f"Bandwidth of the feedback (−3 dB, small signals): {hz:.3g} Hz."


def test_print_of_a_run_shows_verdict_then_what_is_left_out_and_notices():
    heavy = result(changed(SINE, {"plant.cylinder.mass_kg": 3.2}))
    lines = str(heavy).splitlines()
    assert [line.split(":")[0] for line in lines] == [
        "Tracks",
        "Nothing saturates",
        "Stable at 40°",
        "Left out",
        "  bus.",
        *2 * ["Note"],
    ]
    assert lines[3].startswith("Left out: load on the knee, full order")
    assert repr(heavy.verdict) == str(heavy.verdict) == str(heavy)
    assert repr(heavy).startswith("TrackingResult(scenario=")
    assert heavy.verdict._repr_html_().split("<br>")[0] == lines[0]
    assert max(map(len, lines)) <= 100


def test_a_run_of_leg_logs_what_its_verdict_asks_for():
    run = track(changed(LEG, {"simulation.duration_s": 0.1}))
    assert run.verdict.relief_share == 0.0
    assert run.verdict.limit_cycle is None  # the reference moves


def test_a_gap_of_the_samples_is_a_notice_with_the_errors_inside_and_outside():
    times = np.delete(np.arange(0.0, 6.01, 0.02), slice(100, 150))  # 1.98 … 3 s
    angles = 30.0 - 20.0 * np.cos(times)
    reference = {"kind": "samples", "times_s": times, "angles_deg": angles}
    error = np.where((TIME > 1.98) & (TIME < 3.0), 2.5, 0.5)
    notices = result(Scenario(reference=reference), error_deg=error).verdict.notices
    assert notices == (
        "the reference has gaps, the longest from 1.98 to 3 s, in which its curve is a guess: "
        "largest error 2.5° there, 0.5° elsewhere",
    )
    whole = {"times_s": times[:100], "angles_deg": angles[:100]}
    assert not result(Scenario(reference=reference | whole), time_s=TIME[:990]).verdict.notices
