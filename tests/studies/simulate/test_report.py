"""The report of a run: from the numbers to the cells of its tables."""

import math
from dataclasses import replace

import numpy as np
import pytest

from kneexo.analysis import track
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.studies.markdown import number
from kneexo.studies.simulate.report import report


@pytest.fixture(scope="module")
def leg():
    """A run of full order whose command saturates."""
    scenario = Scenario.preset("leg")
    step = {"kind": "step", "start_deg": 30.0, "end_deg": 40.0, "time_s": 0.2}
    scenario = changed(scenario, {"reference": step, "simulation.duration_s": 1.5})
    return track(scenario, all_signals=True)


def test_findings_come_first(leg):
    lines = report(leg).splitlines()
    assert lines[0].startswith("# ")
    assert lines[2:5] == [f"- {line}" for line in leg.verdict.lines]


def test_each_limit_has_its_value_and_verdict(leg, rows_of):
    rows = rows_of(report(leg))
    command = np.abs(leg["motor_speed_command_rad_s"]) * 30.0 / math.pi
    share = 100.0 * np.mean(command >= 5000.0 - 1e-6)
    assert 5.0 < share < 50.0
    at_limit = f"at the limit for {float(f'{share:.3g}'):g} %"
    assert rows["motor speed command"] == ["5000 rpm", "5000 rpm", at_limit]
    pressure = 1e-6 * np.max(np.abs(leg["load_pressure_pa"]))
    assert rows["load pressure"] == [f"{pressure:.3g} MPa", "3.5 MPa", "below the limit"]
    chamber = 1e-6 * max(leg["cap_pressure_pa"].max(), leg["rod_side_pressure_pa"].max())
    assert rows["pressure of a chamber"] == [f"{chamber:.3g} MPa", "3.5 MPa", "below the limit"]
    power = np.max(np.abs(leg["shaft_power_w"]))
    assert rows["motor power"] == [f"{power:.3g} W", "200 W", "below the limit"]
    error = f"{40.0 - math.degrees(leg['knee_angle_rad'][-1]):.3g}° at the end"
    assert rows["error after the step"] == [error, "0.2° (2 % of the step)", "settles"]
    assert rows["eigenvalue of the sampled loop at 35°"][1:] == ["1", "stable"]


def test_numbers_without_limit_have_units(leg, rows_of):
    rows, step = rows_of(report(leg)), leg.step
    assert rows["rise time, 10 … 90 %"] == [f"{step.rise_time_s:.3g} s"]
    assert rows["overshoot"] == [f"{step.overshoot_percent:.3g} %"]
    assert rows["settling time"] == [f"{step.settling_time_s:.3g} s"]
    assert rows["final error"] == [f"{step.final_error_deg:.3g}°"]
    assert "limit cycle at rest, period" not in rows  # the rest is too short for one
    power, time = leg["shaft_power_w"], leg["time_s"]
    delivered, back = (np.trapezoid(np.maximum(sign * power, 0.0), time) for sign in (1, -1))
    assert rows["work of the motor on the pump"] == [f"{delivered:.3g} J"]
    # 3 digits; the rectangles where the sign changes differ from trapezoids
    assert float(rows["work that flows back to the motor"][0][:-2]) == pytest.approx(back, rel=0.05)
    rms = np.sqrt(np.mean(leg.error_deg**2))
    assert rows["error, root mean square"] == [f"{rms:.3g}°"]
    change = f"{leg.metrics.mean_command_change_rpm:.3g} rpm per sample"
    assert rows["mean change of the command"] == [change]
    work = f"{leg.metrics.hydraulic_energy_j:.3g} J"
    assert rows["work of the pump on the cylinder"] == [work]


def test_a_limit_cycle_has_amplitude_period_and_pressures(leg, rows_of):
    """A knee that is made to swing by 0.25° with 0.2 s about 40°, and its pressure with it."""
    time = leg["time_s"]
    wave = np.sin(10.0 * math.pi * time)
    data = leg.run.data | {
        "knee_reference_rad": np.full_like(time, np.radians(40.0)),
        "knee_angle_rad": np.radians(40.0 + 0.25 * wave),
        "load_pressure_pa": 1e6 * (-0.5 + wave),
    }
    result = replace(leg, run=replace(leg.run, data=data))
    rows = rows_of(report(result))
    assert rows["limit cycle at rest, amplitude"] == ["0.25° of the knee"]
    assert rows["limit cycle at rest, period"] == ["0.2 s"]
    assert rows["limit cycle at rest, load pressure"] == ["-1.5 … 0.5 MPa"]


def test_a_run_shorter_than_two_periods_is_reported_whole(rows_of):
    scenario = changed(Scenario(), {"simulation.duration_s": 0.5})
    result = track(scenario, all_signals=True)
    rows = rows_of(report(result))
    rms, error = np.sqrt(np.mean(result.error_deg**2)), np.max(np.abs(result.error_deg))
    assert rows["error, root mean square"] == [f"{rms:.3g}°"]
    assert not any("first period" in name or "whole run" in name for name in rows)
    value, bound, verdict = rows["tracking error"]
    assert value.startswith(f"{error:.3g}° at ")
    # 30°(1 − cos(0.1·2π·0.5))/2/15 = 0.049°, less than a count of the encoder
    assert (bound, verdict) == (f"{result.verdict.error_bound_deg:.3g}°", "tracks")
    assert 0.049 < result.verdict.error_bound_deg < 0.08


def test_a_run_that_does_not_track_says_so(rows_of):
    slow = {"reference.frequency_hz": 1.0, "simulation.duration_s": 2.5}
    result = track(changed(Scenario(), slow), all_signals=True)
    assert rows_of(report(result))["tracking error"][2] == "does not track"


@pytest.mark.slow
def test_a_run_that_is_stopped_has_a_current_and_no_error(rows_of):
    adds = {"place": "command", "kind": "offset", "size": 1000.0, "start_s": 1.0}
    values = {"faults": (adds,), "simulation.duration_s": 2.0}
    result = track(Scenario.preset("protected").changed(values), all_signals=True)
    rows = rows_of(report(result))
    assert "tracking error" not in rows
    current = number(result.verdict.peak_motor_current_a)
    assert rows["motor current, largest"] == [f"{current} A"]


def test_a_run_with_a_wearer_has_its_torques_in_place_of_tracking(rows_of):
    values = {
        "plant.load": {"kind": "knee"},
        "wearer": {"kind": "leg", "moment": {"times_s": (0, 1), "moments_n_m": (1, 5)}},
        "controller": {"kind": "torque", "mode": "assist"},
        "reference.frequency_hz": 2.5,
        "simulation.duration_s": 0.8,
    }
    result = track(changed(Scenario(), values), all_signals=True)
    text = report(result)
    rows, late = rows_of(text), result["time_s"] >= 0.4 - 1e-9
    assert text.startswith("# A run under torque control")
    assert "tracking error" not in rows
    torque, rate = (result[name][late] for name in ("interaction_torque_n_m", "wearer_rate_rad_s"))
    moment = result["biological_moment_n_m"][late]
    actuator = (result["moment_arm_m"] * result["rod_force_n"])[late]

    def mean(values):
        return np.trapezoid(values) / (values.size - 1)

    for name, value, unit in (
        ("interaction torque, root mean square", np.sqrt(mean(torque**2)), " N·m"),
        ("interaction torque, mean magnitude", mean(np.abs(torque)), " N·m"),
        ("interaction torque, largest", np.abs(torque).max(), " N·m"),
        ("mean power that the wearer gives", mean((torque * rate).clip(0.0)), " W"),
        ("mean power that the wearer gets", mean((-torque * rate).clip(0.0)), " W"),
        ("assistance ratio", -100.0 * mean(torque * moment) / mean(moment**2), " %"),
        (
            "torque error, root mean square",
            np.sqrt(np.mean((result["desired_torque_n_m"][late] + actuator) ** 2)),
            " N·m",
        ),
        ("distance from the reference, root mean square", result.metrics.rms_error_deg, "°"),
    ):
        cell = rows[f"{name} after the first period"][0]
        assert cell.endswith(unit)
        assert float(cell.removesuffix(unit)) == pytest.approx(value, rel=6e-3), name
