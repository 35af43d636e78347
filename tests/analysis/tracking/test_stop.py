"""The first stop of the protection: sentence, times, turns, torque, and current of the brake."""

import math

import numpy as np
import pytest

from kneexo.analysis import track
from kneexo.analysis.tracking.stop import first_stop, peak_motor_current_a
from kneexo.parameters import Scenario
from kneexo.parameters.device.safety_states import STATES
from kneexo.simulation import Run

PROTECTED = Scenario.preset("protected")


def run_of(**changed):
    """A run of ten rows: fault from row 2, stopped at row 4, brake on at row 6, reset at row 8."""
    columns = {
        "safety_state": [1, 1, 1, 1, 1, 2, 2, 4, 4, 0],
        "safety_reason": 5 * [0] + 4 * [2] + [0],  # rate
        "rate_residual_rad_s": np.radians([0, 0, 170, 200, 300, 0, 0, 0, 0, 0]),
        "active_faults": [0, 0, 1, 1, 1, 1, 1, 1, 1, 1],
        "knee_angle_rad": np.radians([9, 0, 1, 2, 4, 3, 3, 5, 8, 30]),
        "motor_speed_rad_s": [90, 90, 90, 90, 90, 80, 60, -20, 6, 0],
        "motor_current_a": [1, 1, 1, 1, 1, 1, 1, 5, -1.5, 2],
        "rod_force_n": [900, 900, 900, 900, 900, 900, 900, 40, -60, 900],
        "moment_arm_m": 10 * [0.05],
    }
    data = {name: np.array(values, dtype=float) for name, values in (columns | changed).items()}
    return Run(5.0 + 0.002 * np.arange(10), data, PROTECTED.simulation)


def test_a_stop_has_cause_turns_and_torque_of_its_rows():
    assert first_stop(PROTECTED, run_of()).line == (
        "Stopped at 5.008 s by the detector rate (200 > 150 deg/s), 4 ms after the fault; safe 8 "
        "ms after the fault (dynamic_brake: the windings are shorted). Until then the knee turns "
        "4° at up to 45 N·m, and then 3° at up to 3 N·m."
    )


def test_a_stop_without_fault_detector_or_safe_motor_says_so():
    """The motor does not obey: in the state stopped it turns on at 90 rad/s."""
    held = PROTECTED.changed({"protection.safe_state": "zero_speed"})
    run = run_of(
        safety_state=[1, 1, 1, 1, 1, 2, 2, 3, 3, 3],
        safety_reason=5 * [0] + 5 * [7],
        active_faults=10 * [0],
        motor_speed_rad_s=10 * [90],
    )
    assert first_stop(held, run).line == (
        "Stopped at 5.008 s by the emergency stop; the motor is not safe when the run ends "
        "(zero_speed: the motor stands). Until then the knee turns 26° at up to 45 N·m."
    )
    line = first_stop(PROTECTED, run_of(active_faults=10 * [0])).line
    assert "emergency" not in line
    assert "; safe 4 ms after it (dynamic_brake" in line
    assert first_stop(held, run_of(safety_reason=10 * [0])) is None
    assert first_stop(Scenario(), run) is None


def test_the_current_of_a_brake_is_that_of_the_speed_at_which_it_engages():
    """k_t/R is 5 A/20 rad/s, and the brake engages at 60 rad/s, after the row before."""
    assert peak_motor_current_a(PROTECTED, run_of()) == (15.0, 5.0)
    other = PROTECTED.changed({"protection.safe_state": "torque_off"})
    assert peak_motor_current_a(other, run_of()) == (5.0, 5.0)
    run = run_of()
    del run.data["motor_current_a"]
    assert all(map(math.isnan, peak_motor_current_a(PROTECTED, run)))


@pytest.mark.slow
def test_a_run_that_is_stopped_says_what_matters_first_and_marks_it(curves):
    """A command that is 1,000 rpm too high also turns the motor during the stop."""
    adds = {"place": "command", "kind": "offset", "size": 1000.0, "start_s": 1.0}
    result = track(PROTECTED.changed({"faults": (adds,), "simulation.duration_s": 2.0}))
    verdict, stop, motor = result.verdict, result.verdict.stop, result.scenario.plant.motor
    assert verdict.lines[0] == stop.line
    assert not [line for line in verdict.lines if "error" in line or "Nothing" in line]
    speed = np.interp(stop.safe_s, result["time_s"], np.abs(result["motor_speed_rad_s"]))
    current = motor.torque_constant_n_m_per_a * speed / motor.resistance_ohm
    assert verdict.peak_motor_current_a == pytest.approx(current, rel=1e-9)
    assert current > 2.0 * np.abs(result["motor_current_a"]).max()
    assert any(f"reaches {current:.3g} A" in notice for notice in verdict.notices)
    axes = result.plot()
    assert curves(axes[0])["stop"][0][0] == pytest.approx(stop.time_s)
    assert stop.fault_s == pytest.approx(1.0)
    time_s, states = axes[-1].lines[-1].get_data()
    assert time_s[np.argmax(states == 4)] == pytest.approx(stop.safe_s + 0.002)
    assert [label.get_text() for label in axes[-1].get_yticklabels()] == list(STATES)
