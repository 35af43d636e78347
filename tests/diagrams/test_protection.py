"""Loops with protection: what a fault does, both engines, laws of users, exports, the verdict."""

import math
import re
from typing import get_args

import numpy as np
import pytest

from kneexo.analysis import track
from kneexo.common.ports import input_ports
from kneexo.diagrams import make_closed_loop, make_controller
from kneexo.diagrams.protection import reading_range_rad
from kneexo.errors import ParameterError
from kneexo.export.firmware import export_firmware, export_sil
from kneexo.export.fmu import export_fmu
from kneexo.export.target import count_range, make_target
from kneexo.geometry.linkage import moment_arm, pose
from kneexo.parameters import Scenario
from kneexo.parameters.device.safety_states import REASONS, STATES, SafeState
from kneexo.simulation import simulate
from kneexo.simulation.compiled import scenario_values, simulate_together

T = 0.002
STATES_ = list(STATES)
BASE = Scenario(protection={}, simulation={"duration_s": 0.3})


def with_faults(*faults, base=BASE):
    return base.changed({"faults": faults})


def end(run):
    return STATES_[int(run["safety_state"][-1])], REASONS[int(run["safety_reason"][-1])]


def test_protection_leaves_a_healthy_run_as_it_is():
    plain = simulate(BASE.changed({"protection": None}))
    run = simulate(BASE)
    assert end(run) == ("operating", "none")
    # The equations are evaluated in another order.
    np.testing.assert_allclose(run["knee_angle_rad"], plain["knee_angle_rad"], rtol=0, atol=1e-12)


def test_without_protection_the_controller_is_as_before():
    controller = make_controller(BASE.changed({"protection": None}))
    assert not controller.HasSubsystemNamed("supervisor")
    assert [*input_ports(controller)] == ["knee_reference", "encoder_reading"]
    names = scenario_values(BASE.changed({"protection": None}))
    assert not [name for name in names if "detectors" in name or "supervisor" in name]


DEAD = {"place": "command", "kind": "scale", "size": 0.0}
FAULTS = [
    ({"kind": "offset", "size": 2.0}, "rate"),
    ({"kind": "offset", "size": -160.0}, "range"),
    ({"kind": "bit_flip", "size": 6.0}, "rate"),
    (DEAD, "speed"),
    ({"kind": "drift", "size": 20.0}, "flow"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "reason"), FAULTS)
@pytest.mark.parametrize("preset", ["paper", "leg"])
def test_a_fault_is_detected_and_the_motor_stands(fault, reason, preset):
    base = Scenario.preset(preset).changed({"protection": {}, "simulation.duration_s": 4.0})
    run = simulate(with_faults({"start_s": 3.0} | fault, base=base))
    assert end(run) == ("stopped", reason)
    assert np.all(run["safety_reason"][: int(3.0 / T) + 1] == 0.0)
    assert abs(run["motor_speed_rad_s"][-1]) < 1.0


def press(button, start_s, duration_s=0.1):
    return {"place": button, "kind": "value", "size": 1.0, "start_s": start_s} | {
        "duration_s": duration_s
    }


@pytest.mark.slow
def test_buttons_stop_the_motor_at_their_sample_and_start_it_again():
    """The command falls at ``stop_rad_s2``. A reset while the stop is pressed has no effect."""
    base = BASE.changed({"simulation.duration_s": 1.0})
    faults = press("emergency_stop", 0.5), press("reset", 0.58, T), press("reset", 0.62)
    run = simulate(with_faults(*faults, base=base))
    state, pressed = run["safety_state"], round(0.5 / T)
    changes = np.flatnonzero(np.diff(state)) + 1
    assert [STATES_[int(state[at])] for at in changes] == [
        *("operating", "stopping", "stopped", "starting", "operating")
    ]
    # The record is that before the update of its sample, and so one sample later than the press.
    assert changes[1] == pressed + 1
    assert changes[3] == round(0.62 / T) + 1
    assert REASONS[int(run["safety_reason"][changes[2]])] == "emergency stop"
    drake = simulate(with_faults(*faults, base=base).with_engine("drake"))
    np.testing.assert_array_equal(drake["safety_state"], state)
    assert run["safety_reason"][-1] == 0.0
    speed = abs(run["motor_speed_command_rad_s"][pressed])
    ramp = math.ceil(speed / (base.protection.stop_rad_s2 * T))
    assert np.all(run["motor_speed_command_rad_s"][pressed + ramp + 2 : changes[3]] == 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [("frozen", 0.0), ("dropped", 1.0)])
def test_a_lost_command_trips_the_watchdog_of_the_drive(kind):
    """Ten samples keep the last command; then it falls by 4 rad/s a sample, in both engines."""
    fault = {"place": "command", "kind": kind[0], "size": kind[1], "start_s": 0.2}
    scenario = with_faults(fault)
    step, watched = BASE.protection.stop_rad_s2 * T, round(BASE.protection.watchdog_s / T)
    for engine in ("compiled", "drake"):
        command = simulate(scenario.with_engine(engine))["motor_speed_command_rad_s"]
        held = command[100]  # the record at 0.2 s is the command until then
        count = int(np.flatnonzero(command[101:] != held)[0])
        assert count == watched
        falling = np.maximum(abs(held) - step * np.arange(1, command.size - 100 - count), 0.0)
        np.testing.assert_allclose(np.abs(command[101 + count :]), falling, rtol=0, atol=1e-9)
    assert abs(held) > 2 * step
    unwatched = simulate(scenario.changed({"protection": None}))["motor_speed_command_rad_s"]
    np.testing.assert_allclose(unwatched[101:], unwatched[100], rtol=0, atol=1e-9)


@pytest.mark.slow
def test_outliers_and_a_wrap_do_nothing():
    """Four wrong samples do not reach the law, and a whole turn is no jump."""
    healthy = simulate(BASE)
    faults = [{"kind": "offset", "size": 5.0, "start_s": 0.2, "duration_s": 4 * T}]
    run = simulate(with_faults(*faults))
    assert end(run) == ("operating", "none")
    # For four samples the law sees the reading before. The reference moves slowly.
    moved = np.abs(run["knee_angle_rad"] - healthy["knee_angle_rad"]).max()
    assert math.degrees(moved) < 0.1
    turned = simulate(with_faults({"kind": "offset", "size": 360.0, "start_s": 0.2}))
    assert end(turned) == ("operating", "none")
    np.testing.assert_allclose(
        turned["knee_angle_rad"], healthy["knee_angle_rad"], rtol=0, atol=1e-9
    )


@pytest.mark.slow
def test_a_reading_at_which_the_linkage_cannot_close_does_not_end_the_run():
    fault = {"kind": "offset", "size": 150.0, "start_s": 0.2}
    run = simulate(with_faults(fault))
    assert end(run)[1] == "range"
    assert np.isfinite(run["motor_speed_command_rad_s"]).all()


@pytest.mark.slow
def test_drake_and_the_compiled_engine_switch_at_the_same_samples():
    base = BASE.changed({"plant.load": "knee"})
    wrong = {"place": "command", "kind": "offset", "size": 2000.0}
    for fault in ({"kind": "offset", "size": 2.0}, wrong):
        scenario = with_faults({"start_s": 0.12} | fault, base=base)
        compiled = simulate(scenario)
        drake = simulate(scenario.with_engine("drake").with_steps(2e-4))
        for name in ("safety_state", "safety_reason"):
            np.testing.assert_array_equal(compiled[name], drake[name])
        assert compiled["safety_reason"].any()
        difference = compiled["flow_residual_m"] - drake["flow_residual_m"]
        assert np.abs(difference).max() < 1e-6


@pytest.mark.slow
def test_runs_that_differ_in_thresholds_share_a_batch():
    fault = {"kind": "offset", "size": 2.0, "start_s": 0.2}
    scenarios = [
        with_faults(fault).changed({"protection.rate_deg_s": rate}) for rate in (150.0, 2000.0)
    ]
    runs = simulate_together(scenarios)
    assert [end(run)[1] for run in runs] == ["rate", "none"]
    np.testing.assert_array_equal(
        runs[0]["knee_angle_rad"], simulate(scenarios[0])["knee_angle_rad"]
    )


@pytest.mark.slow
def test_laws_of_users_are_protected():
    raw = BASE.with_law(lambda encoder_reading, knee_reference: 100.0 + 0.0 * encoder_reading)
    base = raw.changed({"protection.following_deg": 1.0, "protection.overdue_s": 0.2})
    assert end(simulate(base))[1] == "following"

    def python_law(rod_extension, rod_reference):
        return 1.3e5 * float(np.ravel(rod_reference[0] - rod_extension)[0])

    run = simulate(BASE.with_law(python_law))
    assert end(run) == ("operating", "none")


def test_the_torque_controller_follows_no_reference():
    system = make_controller(Scenario.preset("wearer").changed({"protection": {}}))
    detectors = system.GetSubsystemByName("detectors")
    assert not detectors.HasInputPort("knee_reference")
    assert detectors.HasInputPort("measured_force")
    assert not make_controller(BASE).GetSubsystemByName("detectors").HasInputPort("measured_force")


def test_the_range_of_readings_is_that_of_the_linkage():
    base = BASE.changed({"encoder.mounting_error_rad": 0.01, "encoder.phase_rad": 0.3})
    low, high = reading_range_rad(base)
    angles = pose(base.plant.linkage, np.radians(np.linspace(-0.5, 90.5, 500))).theta_4 - 0.3
    slack = 0.01 + base.encoder.resolution_rad
    assert low == pytest.approx(angles.min() - slack, abs=1e-9)
    assert high == pytest.approx(angles.max() + slack, abs=1e-9)


# ---------------------------------------------------------------------------------- exports


def test_ports_of_the_exported_controller():
    target = make_target(BASE, "controller", counts=True)
    assert set(target.inputs) == {
        "encoder_count", "knee_reference", "motor_speed", "emergency_stop", "reset"
    }  # fmt: skip
    assert target.outputs == (
        "motor_speed_command", "residuals", "safety_state", "safety_reason", "release"
    )  # fmt: skip
    turn = BASE.encoder.counts_per_revolution
    plain = count_range(BASE.changed({"protection": None}))
    assert count_range(BASE) == (plain[0] - turn, plain[1] + turn)


@pytest.mark.slow(gate=0)
def test_exports_have_the_protection(tmp_path):
    scenario = with_faults({"kind": "offset", "size": 2.0, "start_s": 0.2})
    for what, precision in (("controller", "double"), ("controller", "float"), ("loop", "double")):
        folder = tmp_path / what / precision
        replay = export_firmware(scenario, folder, what, precision=precision).replay
        assert replay.passed
        assert replay.largest["safety_reason"] == REASONS.index("rate")
        assert replay.difference["safety_state"] == 0.0
    assert {"safety_state", "flow_residual_m"} <= set(
        export_fmu(scenario, tmp_path, "loop").outputs
    )
    assert export_sil(BASE, tmp_path / "sil").replay.passed


@pytest.mark.slow
def test_an_exported_plant_has_the_inputs_of_the_releases(tmp_path):
    scenario = Scenario.preset("protected").changed({"plant.bypass": {}})
    assert export_firmware(scenario, tmp_path, "plant").replay.passed
    (header,) = (path for path in tmp_path.glob("*.h") if "dynamic_brake" in path.read_text())
    assert {"torque_off", "bypass_command"} <= set(re.findall(r"\w+", header.read_text()))


def test_tables_by_the_count_refuse_protection(tmp_path):
    with pytest.raises(ParameterError, match="look_up: the tables have no row for a count"):
        export_firmware(BASE, tmp_path, look_up=True)


# ---------------------------------------------------------------------------------- verdict


def test_the_verdict_says_when_and_why_the_protection_acted():
    result = track(with_faults({"kind": "offset", "size": 2.0, "start_s": 0.2}))
    stop, line = result.verdict.stop, result.verdict.lines[0]
    assert line.startswith(f"Stopped at 0.21 s by the detector rate ({stop.residual:.4g} > 150 ")
    # Five samples after the last plausible reading.
    assert stop.residual == pytest.approx(2.0 / (5 * T), rel=0.1)
    assert not [line for line in result.verdict.lines if "error" in line or "Nothing" in line]
    free = track(BASE)
    assert free.verdict.stop is None
    assert free.verdict.lines[0].startswith("Tracks: ")


def test_responses_are_measured_without_protection():
    assert BASE.undisturbed().protection is None
    assert BASE.without_quantizers().protection is None


def test_the_supervisor_drives_the_bypass_of_the_plant():
    plant = {"plant.full_order": {}, "plant.bypass": {}}
    for protection, inputs in ((None, {"bypass"}), ({}, set())):
        loop = make_closed_loop(Scenario().changed(plant | {"protection": protection}))
        assert {"bypass"} & set(input_ports(loop)) == inputs


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["exact_hold", "radau3"])
def test_a_release_reaches_a_motor_that_does_not_obey(engine):
    """A drive adds 1,000 rpm: at zero speed the motor turns on; a release takes it the torque."""
    plant = {"plant.bypass": {}, "simulation.duration_s": 0.3, "simulation.integrator": engine}
    base = Scenario.preset("protected").changed(plant)
    adds = {"place": "command", "kind": "offset", "size": 1000.0, "start_s": 0.15}
    runs = {}
    for name in get_args(SafeState):
        runs[name] = simulate(with_faults(adds, base=base.changed({"protection.safe_state": name})))
        assert end(runs[name]) == ("stopping" if name == "zero_speed" else "released", "speed")
    speeds = {name: run["motor_speed_rad_s"][-1] for name, run in runs.items()}
    assert speeds["zero_speed"] > 80.0
    assert runs["bypass"]["bypass_opening"][-1] > 0.9
    assert runs["torque_off"]["motor_current_a"][-1] == 0.0
    braked, motor = runs["dynamic_brake"], base.plant.motor
    current = -motor.torque_constant_n_m_per_a * speeds["dynamic_brake"] / motor.resistance_ohm
    assert braked["motor_current_a"][-1] == pytest.approx(current, rel=1e-12)
    assert abs(speeds["dynamic_brake"]) < 1.0


def peaks_of_a_walking_wearer(safe_state):
    """Largest torques in N·m on a wearer who walks on at a speed command of zero."""
    values = {"plant.bypass": {}, "protection": {"safe_state": safe_state}}
    base = Scenario.preset("wearer").changed(values | {"simulation.duration_s": 14.0})
    run = simulate(with_faults({"start_s": 4.0} | DEAD, base=base))
    assert end(run)[0] == {"zero_speed": "stopped", "bypass": "released"}[safe_state]
    torque = run["interaction_torque_n_m"][run.time_s >= 4.0]
    return torque.min(), torque.max()


@pytest.mark.slow
def test_a_wearer_who_walks_on_feels_the_relief_valves_or_hardly_anything_with_a_bypass():
    """At zero speed the torque is that of 3.5 MPa on a chamber's area at the knee's largest arm."""
    extending, flexing = peaks_of_a_walking_wearer("zero_speed")
    plant = Scenario.preset("wearer").plant
    angles = np.radians(np.linspace(0.0, 90.0, 91))
    arm_m = np.abs(moment_arm(plant.linkage, angles)).max()
    cylinder, relief_pa = plant.cylinder, plant.full_order.relief_pressure_pa
    friction_n = plant.full_order.coulomb_friction_n
    for torque, area_m2 in (
        (flexing, cylinder.cap_area_m2),
        (-extending, cylinder.rod_side_area_m2),
    ):
        most = (1.1 * relief_pa * area_m2 + friction_n) * arm_m
        assert 0.5 * most < torque < 1.2 * most
    extending, flexing = peaks_of_a_walking_wearer("bypass")
    assert -10.0 < extending < 0.0 < flexing < 20.0
