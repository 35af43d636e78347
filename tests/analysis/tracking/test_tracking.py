import dataclasses
import math

import numpy as np
import pytest

from kneexo.analysis.tracking.tracking import (
    mean_change,
    push_response,
    step_metrics,
    track,
    tracking_metrics,
)
from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import (
    BldcPumpParameters,
    CylinderParameters,
    KneeLoadParameters,
    PlantParameters,
    Scenario,
    SimulationParameters,
    SineReference,
    StepReference,
)
from kneexo.parameters.criteria import RECOVERY_BAND_DEG
from kneexo.parameters.paths import changed

TIME = np.arange(0.0, 4.0, 0.002)


def metrics(error, command=None, power=None, hydraulic=None, settled_s=0.0):
    zero = np.zeros_like(TIME)
    return tracking_metrics(
        TIME,
        error,
        zero if command is None else command,
        np.full_like(TIME, 2e6),
        zero if power is None else power,
        zero if hydraulic is None else hydraulic,
        settled_s=settled_s,
        command_limit_rad_s=100.0,
        pressure_rating_pa=3.5e6,
    )


def test_errors_are_split_at_the_first_period():
    error = np.radians(np.where(TIME < 1.0, 5.0, 0.5))
    m = metrics(error, settled_s=1.0)
    assert m.max_error_deg == pytest.approx(0.5)
    assert m.rms_error_deg == pytest.approx(0.5)
    assert m.max_error_overall_deg == pytest.approx(5.0)
    assert m.rms_error_overall_deg == pytest.approx(math.sqrt(0.25 * 25 + 0.75 * 0.25))


def test_chattering_index_is_the_mean_change_in_rpm():
    command = np.tile([1.0, -1.0], TIME.size // 2)
    assert metrics(0 * TIME, command).mean_command_change_rpm == pytest.approx(60.0 / math.pi)
    assert mean_change(np.array([0.0, 3.0, 2.0])) == 2.0


def test_the_change_of_the_command_counts_from_the_first_period_on_and_saturation_always():
    # Before 1 s: at the limit, and 200 rad/s up and down; after: 3 rad/s, a tenth at the limit.
    after = np.where(np.arange(TIME.size) % 10 == 0, 100.0, 97.0)
    before = 100.0 * (-1.0) ** np.arange(TIME.size)
    m = metrics(0 * TIME, np.where(TIME < 1.0 - 1e-9, before, after), settled_s=1.0)
    assert m.saturated_share == pytest.approx((500 + 150) / 2000)
    changes = np.count_nonzero(np.diff(after[500:])) / 1499
    assert m.mean_command_change_rpm == pytest.approx(3.0 * changes * 30.0 / math.pi)
    assert m.peak_command_rpm == pytest.approx(100.0 * 30.0 / math.pi)


def test_energy_is_the_integral_of_power_and_delivered_energy_leaves_out_returns():
    m = metrics(0 * TIME, power=np.sin(2 * np.pi * TIME))
    # Four whole periods but for the last sample: trapezoid error below 1e-4 J.
    assert m.shaft_energy_j == pytest.approx(0.0, abs=1e-4)
    assert m.shaft_energy_delivered_j == pytest.approx(4.0 / math.pi, abs=1e-4)
    assert m.peak_shaft_power_w == pytest.approx(1.0, abs=1e-4)
    braking = metrics(0 * TIME, power=np.where(TIME < 1.0, -3.0, 1.0))
    assert braking.peak_shaft_power_w == 3.0


def test_a_run_of_one_sample_is_refused():
    with pytest.raises(ParameterError, match="1 samples are too few"):
        track(Scenario(simulation=SimulationParameters(duration_s=1e-3)))


BRISK = Scenario(
    plant=PlantParameters(
        pump=BldcPumpParameters(rated_power_w=0.3),
        cylinder=CylinderParameters(pressure_rating_pa=7.3e4),
        load=KneeLoadParameters(),
    ),
    reference=SineReference(mean_deg=40.0, amplitude_deg=5.0, frequency_hz=2.0),
    simulation=SimulationParameters(duration_s=1.0),
)


@pytest.fixture(scope="module")
def brisk():
    return track(BRISK)


def test_the_metrics_of_a_run_are_those_of_its_columns_limits_and_ratings(brisk):
    run, m = brisk.run, brisk.metrics
    assert brisk.scenario == BRISK
    assert run.settings == BRISK.simulation
    assert run.time_s == pytest.approx(0.002 * np.arange(501))
    limit, late = 5000.0, slice(250, None)  # from one period on
    error = np.degrees(run["knee_reference_rad"] - run["knee_angle_rad"])
    assert brisk.error_deg == pytest.approx(error)
    command = run["motor_speed_command_rad_s"] * 30.0 / math.pi
    pressure, shaft = run["load_pressure_pa"], run["shaft_power_w"]
    assert dataclasses.asdict(m) == pytest.approx(
        {
            "max_error_deg": np.abs(error[late]).max(),
            "rms_error_deg": math.sqrt(np.mean(error[late] ** 2)),
            "max_error_overall_deg": np.abs(error).max(),
            "rms_error_overall_deg": math.sqrt(np.mean(error**2)),
            "mean_command_change_rpm": np.abs(np.diff(command[late])).mean(),
            "saturated_share": np.mean(np.abs(command) > 0.999999 * limit),
            "peak_command_rpm": np.abs(command).max(),
            "peak_pressure_mpa": 1e-6 * np.abs(pressure).max(),
            "pressure_over_rating_share": np.mean(np.abs(pressure) > 7.3e4),
            "peak_shaft_power_w": np.abs(shaft).max(),
            "power_over_rating_share": np.mean(np.abs(shaft) > 0.3),
            "shaft_energy_j": np.trapezoid(shaft, run.time_s),
            "shaft_energy_delivered_j": np.trapezoid(shaft.clip(0.0), run.time_s),
            "hydraulic_energy_j": np.trapezoid(run["hydraulic_power_w"], run.time_s),
        }
    )
    for name in ("saturated", "power_over_rating", "pressure_over_rating"):
        assert 0.1 < getattr(m, f"{name}_share") < 0.95
    assert m.shaft_energy_j != pytest.approx(m.hydraulic_energy_j, rel=1e-3)


def test_a_plot_shows_angle_error_and_command(brisk, curves):
    run, time = brisk.run, brisk.run.time_s
    angle, error, command, pressure = brisk.plot()
    lines = curves(angle)
    for label, name in (("knee angle", "knee_angle_rad"), ("reference", "knee_reference_rad")):
        assert lines[label][0] == pytest.approx(time)
        assert lines[label][1] == pytest.approx(np.degrees(run[name]))
    line, zero = error.lines
    assert line.get_xdata() == pytest.approx(time)
    assert line.get_ydata() == pytest.approx(brisk.error_deg)
    line, below, above = command.lines
    assert line.get_xdata() == pytest.approx(time)
    assert line.get_ydata() == pytest.approx(run["motor_speed_command_rad_s"] * 30.0 / math.pi)
    levels = [list(line.get_ydata()) for line in (zero, below, above)]
    assert levels == [pytest.approx(2 * [level]) for level in (0.0, -5000.0, 5000.0)]
    lines = curves(pressure)
    assert lines["|load pressure|"][1] == pytest.approx(1e-6 * np.abs(run["load_pressure_pa"]))
    assert list(lines["rating 0.073 MPa"][1]) == [0.073, 0.073]
    assert [text.get_text() for text in command.get_legend().get_texts()] == ["limit ±5000 rpm"]
    # Room for the legends above what is drawn.
    assert command.get_ylim()[1] > 1.25 * 5000.0
    assert angle.get_ylim()[1] > np.degrees(run["knee_reference_rad"]).max() + 2.0
    axes = angle, error, command, pressure
    assert [ax.get_xlabel() for ax in axes] == ["", "", "", "time (s)"]
    assert all(angle.get_shared_x_axes().joined(angle, ax) for ax in axes)
    assert [ax.get_ylabel() for ax in axes] == [
        "knee angle (deg)",
        "tracking error (deg)",
        "motor speed command (rpm)",
        "pressure (MPa)",
    ]
    for ax in (brisk.plot_angle(), brisk.plot_error()):
        assert ax.get_xlabel() == "time (s)"


def test_a_plot_of_a_run_with_a_wearer_shows_leg_and_torques(curves):
    worn = {
        "plant.load": {"kind": "knee"},
        "wearer": {"kind": "leg", "moment": {"times_s": (0, 1), "moments_n_m": (1, 5)}},
        "simulation.duration_s": 0.1,
    }
    free = track(changed(BRISK, worn | {"controller": {"kind": "torque", "mode": "assist"}}))
    angle, torque, command, _ = free.plot()
    assert curves(angle)["leg"][1] == pytest.approx(np.degrees(free["wearer_angle_rad"]))
    lines = curves(torque)
    assert lines["wearer"][1] == pytest.approx(free["interaction_torque_n_m"])
    assert lines["actuator, desired"][1] == pytest.approx(free["desired_torque_n_m"])
    assert lines["actuator"][1] == pytest.approx(-free["moment_arm_m"] * free["rod_force_n"])
    assert [ax.get_ylabel() for ax in (torque, command)] == [
        "torque (N·m)",
        "motor speed command (rpm)",
    ]
    assert torque.figure.get_label() == (
        "Knee angle with its reference, torques on the exoskeleton (positive flexes), motor speed "
        "command, and pressures in the cylinder over time."
    )
    # With position control the same signals have an error too.
    _, error, torque, *_ = dataclasses.replace(free, scenario=changed(BRISK, worn)).plot()
    assert (error.get_ylabel(), torque.get_ylabel()) == ("tracking error (deg)", "torque (N·m)")


def test_a_plot_shades_push_and_faults_and_shows_the_chambers(curves):
    """A fault of one sample has an area without width, whose edge is drawn."""
    fault = {"place": "command", "kind": "scale", "size": 0.0, "start_s": 0.1, "duration_s": 0.002}
    push = {"torque_n_m": 5.0, "start_s": 0.2, "duration_s": 0.1}
    values = {"plant.full_order": True, "faults": (fault,), "push": push}
    result = track(changed(BRISK, values | {"simulation.duration_s": 0.4}))
    for ax in result.plot():
        shaded = {drawn.get_label(): drawn for drawn in (*ax.patches, *ax.collections)}
        (area,) = shaded["fault"].get_paths()
        assert area.vertices[:, 0] == pytest.approx(0.1, abs=0.0021)
        assert shaded["fault"].get_linewidth()[0] > 0.5
        box = shaded["push"].get_extents().transformed(ax.transData.inverted())
        assert list(box.intervalx) == pytest.approx([0.2, 0.3])
    lines = curves(ax)
    for label, name in (("cap", "cap_pressure_pa"), ("rod side", "rod_side_pressure_pa")):
        assert lines[label][1] == pytest.approx(1e-6 * result[name])
    assert list(lines["relief valves 3.5 MPa"][1]) == [3.5, 3.5]


def test_a_command_without_limit_is_drawn_without_one(brisk):
    ideal = {"plant.ideal_motor": True, "controller.command_limit_rad_s": 1e12}
    boundless = changed(BRISK, ideal)
    ax = dataclasses.replace(brisk, scenario=boundless).plot()[2]
    assert len(ax.lines) == 1
    assert ax.get_legend() is None


@pytest.fixture(scope="module")
def settled():
    return track(
        Scenario(
            reference=StepReference(start_deg=30.0, end_deg=40.0, time_s=0.2),
            simulation=SimulationParameters(duration_s=1.5),
        )
    )


def test_the_step_metrics_of_a_run_are_those_of_python_control(settled):
    control = pytest.importorskip("control")
    run = settled.run
    response = (np.degrees(run["knee_angle_rad"][100:]) - 30.0) / 10.0
    info = control.step_info(response, run.time_s[100:] - 0.2, yfinal=1.0)
    step = settled.step
    assert step.step_deg == 10.0
    assert step.rise_time_s == pytest.approx(info["RiseTime"], rel=1e-9)
    assert step.settling_time_s == pytest.approx(info["SettlingTime"], rel=1e-9)
    assert step.overshoot_percent == pytest.approx(info["Overshoot"], rel=1e-9)
    assert step.settles
    # At the speed limit, 40.4 mm/s over a moment arm of 96 mm, 80 % of the step take 0.33 s.
    assert step.rise_time_s == pytest.approx(8.0 / math.degrees(40.4 / 96.0), rel=0.1)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_step_metrics_of_a_second_order_response_are_those_of_the_textbook(sign):
    damping, omega, time = 0.5, 10.0, np.arange(0.0, 3.0, 1e-4)
    damped = omega * math.sqrt(1.0 - damping**2)
    decay = np.exp(-damping * omega * time) / math.sqrt(1.0 - damping**2)
    response = 1.0 - decay * np.sin(damped * time + math.acos(damping))
    angle = np.concatenate([[30.0], 30.0 + sign * 8.0 * response])
    step = step_metrics(
        np.concatenate([[0.0], 0.5 + time]),
        angle,
        start_deg=30.0,
        end_deg=30.0 + sign * 8.0,
        step_s=0.5,
    )
    assert step.step_deg == sign * 8.0
    overshoot = 100.0 * math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2))
    assert step.overshoot_percent == pytest.approx(overshoot, rel=1e-4)
    assert step.settling_time_s == pytest.approx(0.8076, abs=2e-4)  # last |y − 1| = 0.02, by hand
    assert step.rise_time_s == pytest.approx(0.1638, abs=2e-4)  # from y = 0.1 to y = 0.9
    assert "within 2 % of the step of 8° from 0.808 s" in step.line


def test_a_response_that_does_not_settle_says_so():
    time = np.arange(0.0, 1.0, 0.01)
    slow = step_metrics(time, 10.0 * time, start_deg=0.0, end_deg=20.0, step_s=0.0)
    assert not slow.settles
    assert math.isnan(slow.rise_time_s)
    assert slow.overshoot_percent == 0.0
    assert slow.line == (
        "Does not track: not within 2 % of the step of 20° at the end; does not reach 90 %, "
        "overshoot 0 %, final error 10.1°."
    )


@pytest.mark.parametrize(("end_deg", "step_s"), [(5.0, 0.0), (20.0, 1.5)])
def test_a_run_without_its_step_has_no_step_metrics(end_deg, step_s):
    time = np.arange(0.0, 1.0, 0.01)
    steps = {"start_deg": 5.0, "end_deg": end_deg, "step_s": step_s}
    assert step_metrics(time, 5.0 + 0.0 * time, **steps) is None


def test_an_explicit_integrator_at_the_control_period_diverges_with_one_line():
    scenario = Scenario(
        reference=SineReference(frequency_hz=1.0, amplitude_deg=5.0),
        simulation=SimulationParameters(duration_s=2.0, integrator="runge_kutta3", step_s=0.002),
    )
    with pytest.raises(SimulationError, match=r"^t = .* s: ") as caught:
        track(scenario)
    assert "\n" not in str(caught.value)


def test_leaving_the_range_of_motion_says_time_and_signal():
    scenario = Scenario(
        plant=PlantParameters(pump=BldcPumpParameters(lag_s=0.5)),
        reference=StepReference(start_deg=20.0, end_deg=2.0, time_s=0.0),
        simulation=SimulationParameters(duration_s=3.0),
    )
    with pytest.raises(SimulationError, match=r"t = .* knee_angle = -.* deg left the range"):
        track(scenario)


PUSHED_S = np.arange(8) * 0.5


@pytest.mark.parametrize(
    ("deviation", "largest", "recovery_s"),
    [
        ([0, 0, 2, 3, 0, -4, 0.05, 0], 4.0, 2.0),
        ([0, 0, 0.05, 0, 0, 0, 0, 0], 0.05, 0.0),
        ([0, 0, 1, 0, 0, 0, 0, -0.2], 1.0, math.nan),
    ],
)
def test_recovery_counts_from_the_start_to_the_last_sample_outside(deviation, largest, recovery_s):
    free = np.sin(PUSHED_S)
    response = push_response(PUSHED_S, free + deviation, free, start_s=1.0)
    assert response.largest_deviation_deg == pytest.approx(largest)
    assert response.recovery_time_s == pytest.approx(recovery_s, nan_ok=True)
    assert ("is not back" in response.line) == math.isnan(recovery_s)
    assert ("The knee stays within 0.1°" in response.line) == (recovery_s == 0.0)


@pytest.mark.slow
def test_the_response_of_a_run_is_measured_from_the_run_without_the_push():
    push = {"torque_n_m": 100.0, "start_s": 2.0}
    scenario = Scenario.preset("leg").changed({"push": push, "simulation.duration_s": 4.0})
    result, free = track(scenario), track(scenario.changed({"push": None}))
    deviation = np.degrees(np.abs(result["knee_angle_rad"] - free["knee_angle_rad"]))
    assert result.push.largest_deviation_deg == pytest.approx(deviation.max(), rel=1e-12)
    after = result.run.time_s >= 2.0 + result.push.recovery_time_s - 1e-9
    assert deviation[after].max() <= RECOVERY_BAND_DEG < deviation[np.argmax(after) - 1]
    assert free.push is None
    assert result.verdict.stability == free.verdict.stability
