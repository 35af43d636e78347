"""Fits to the log of an own program: motor, pump and oil as linear equations, solved exactly."""

import numpy as np
import pytest
from scipy.linalg import expm

from kneexo.analysis.faults.thresholds import MARGIN, detector_thresholds
from kneexo.analysis.identification.fit import fit
from kneexo.analysis.tracking.tracking import track
from kneexo.errors import ParameterError, ScenarioError
from kneexo.geometry.linkage import encoder_angle, knee_angle_from_rod, rod_extension
from kneexo.parameters import SampledReference, Scenario
from kneexo.parameters.paths import value_at

LAG, PUMP = "plant.pump.lag_s", "plant.pump.displacement_m3_per_rad"
TRUE = {LAG: 0.0135, PUMP: 1.4e-7}
T, COUNT, PHASE, START_DEG = 0.002, 2.0 * np.pi / 4096, 0.3, 45.0
BASE = Scenario(encoder={"phase_rad": PHASE})


def machine(rows, seed=0, noise=1.0):
    """The log of an own program. Each command is held from its row on."""
    plant, random = BASE.plant, np.random.default_rng(seed)
    oil, lag = plant.cylinder, TRUE[LAG]
    area, pumped = oil.mean_area_m2, TRUE[PUMP] / plant.pump.gear_ratio
    stiff = 4.0 * oil.bulk_modulus_pa / oil.total_volume_m3
    leak = plant.pump.internal_leakage_m3_per_s_pa
    a = np.zeros((5, 5))  # speed, extension, velocity, pressure, command
    a[0, [0, 4]] = -1.0 / lag, 1.0 / lag
    a[1, 2] = 1.0
    a[2, 2:4] = -oil.damping_n_s_per_m / oil.mass_kg, area / oil.mass_kg
    a[3, [0, 2, 3]] = stiff * pumped, -stiff * area, -stiff * leak
    k = np.arange(rows)
    command = 200.0 * np.sin(2.0 * np.pi * 0.8 * k * T) + 60.0 * np.sin(2.0 * np.pi * 6.0 * k * T)
    late = random.uniform(-0.1, 0.1, rows) * T
    late[0] = 0.4 * T
    y = before = np.zeros(5)
    y[1] = rod_extension(plant.linkage, np.radians(START_DEG))
    seen, step, after = [], expm(a * T), expm(a * (late % T)[:, None, None])
    for row in k:
        y[4] = command[row]
        seen.append(after[row] @ (y if late[row] >= 0.0 else before))
        y, before = step @ y, y
    speed, x = np.array(seen).T[:2]
    angle = encoder_angle(plant.linkage, knee_angle_from_rod(plant.linkage, x))
    return {
        "time_s": 12.5 + k * T + late,
        "motor_speed_command_rad_s": command,
        "encoder_reading_rad": np.floor((angle - PHASE) / COUNT) * COUNT,
        "motor_speed_rad_s": speed + noise * random.standard_normal(rows),
    }


def require_inside(result, true, most):
    for name, value in true.items():
        low, high = result.open_loop.interval[name]
        assert abs(result.open_loop.values[name] - value) < high - low, name
        assert high - low < most * abs(value or 1.0), name


def test_the_numbers_of_an_own_program_are_found_within_their_intervals():
    log = machine(500)
    limit = float(np.abs(log["motor_speed_command_rad_s"]).max())
    scenario = BASE.changed({"controller.command_limit_rad_s": limit})
    result = fit(scenario, log, [LAG, PUMP], command_holds="from")
    require_inside(result, TRUE, 0.03)
    assert result.time_s[:2] == pytest.approx([0.4 * T, T], abs=0.11 * T)
    start = encoder_angle(BASE.plant.linkage, np.radians(START_DEG))
    assert result.predicted["encoder_reading_rad"][0] == pytest.approx(start, abs=0.1 * COUNT)
    assert set(result.open_loop.words.values()) == {"bounded"}
    assert min(result.open_loop.validation.values()) > 90.0
    assert result.whole_loop is None
    for path, value in TRUE.items():
        assert value_at(result.scenario, path) == pytest.approx(value, rel=0.01)
        assert value_at(result.scenario.nominal, path.partition(".")[2]) == value_at(BASE, path)
    assert result.trained.mean() == pytest.approx(0.75, abs=2e-3)
    assert result.trained.argmin() == result.trained.sum()  # the last rows are held out
    residual = result.predicted["motor_speed_rad_s"] - result.measured["motor_speed_rad_s"]
    assert np.std(residual) == pytest.approx(1.0, rel=0.1)
    assert result.open_loop.noise["motor_speed"] == pytest.approx(1.0, rel=0.1)
    limited, note = result.notes
    assert limited == "motor_speed_command_rad_s: is at its limit in 0.4 % of the rows"
    assert note.startswith("encoder_reading: its residuals are mostly rounding")


def test_a_log_may_begin_in_motion():
    log = {name: column[130:] for name, column in machine(500).items()}
    require_inside(fit(BASE, log, [LAG, PUMP], command_holds="from"), TRUE, 0.03)


def test_sensors_and_the_command_of_the_row_before():
    log = machine(400)
    held = log["motor_speed_command_rad_s"]
    log["motor_speed_command_rad_s"] = np.append(0.0, held[:-1])
    log["speed_rpm"] = 1.05 * log.pop("motor_speed_rad_s") * 30.0 / np.pi
    result = fit(
        BASE,
        log,
        [LAG, PUMP, "motor_speed.gain", "encoder_reading.delay_s=0:0.01"],
        columns=["motor_speed_rad_s=speed_rpm*0.10471975511965977"],
    )
    require_inside(result, TRUE | {"motor_speed.gain": 1.05}, 0.03)
    assert result.open_loop.values["encoder_reading.delay_s"] < 0.3 * T
    assert result.time_s[0] == pytest.approx(5.0 * T, abs=0.6 * T)  # what came before is not shown


def test_the_knee_starts_where_the_encoder_says_and_not_where_the_reference_begins():
    log = machine(300)
    log["knee_reference_rad"] = np.full(300, np.radians(START_DEG - 15.0))
    found = fit(BASE, log, [LAG, PUMP], command_holds="from", whole_loop=False)
    require_inside(found, TRUE, 0.1)


@pytest.mark.slow
def test_both_estimates_agree_if_the_controller_is_that_of_the_machine():
    slow = {"reference.frequency_hz": 0.7, "reference.amplitude_deg": 4.0}
    base = Scenario().changed({**slow, "reference.mean_deg": 40.0})
    true = base.model_copy(update={"nominal": base.plant}).changed(TRUE)
    run = track(
        true.with_engine("drake").changed({"simulation.duration_s": 2.0}), all_signals=True
    ).run
    log = dict(run.columns)
    noise = np.random.default_rng(3).standard_normal(run.time_s.size)
    log["motor_speed_rad_s"] = log["motor_speed_rad_s"] + noise
    result = fit(base, log, [LAG, PUMP])
    require_inside(result, TRUE, 0.02)
    rows = result.results()["unknowns"]
    for name, value in TRUE.items():
        assert rows[name]["whole_loop"] == pytest.approx(value, rel=0.05)
        assert abs(rows[name]["difference"]) < 4.0


def motion_that_does_not_repeat(seed):
    """A believed scenario, its machine with the true numbers, and the log of a run."""
    random, t = np.random.default_rng(seed), np.arange(0.0, 6.001, 0.02)
    hz = np.array([0.23, 0.61, 1.37, 2.9]) * random.uniform(0.9, 1.1, 4)
    waves = np.sin(2.0 * np.pi * hz * t[:, None] + random.uniform(0.0, 6.28, 4))
    angles = 40.0 + waves @ [4.0, 2.5, 1.2, 0.4]
    base = Scenario(reference=SampledReference(times_s=t, angles_deg=angles))
    true = base.model_copy(update={"nominal": base.plant}).changed(TRUE)
    log = dict(track(true, all_signals=True).run.columns)
    noise = 1.5 * random.standard_normal(log["time_s"].size)
    log["motor_speed_rad_s"] = log["motor_speed_rad_s"] + noise
    return base, true, log


@pytest.mark.slow
def test_intervals_are_right_for_a_motion_that_does_not_repeat():
    errors = []
    for seed in range(6):
        base, _, log = motion_that_does_not_repeat(seed)
        found = fit(base, log, [LAG, PUMP], whole_loop=False).open_loop
        deviation = np.sqrt(np.diag(found.covariance))
        errors.append(
            [(found.values[n] - TRUE[n]) / d for n, d in zip(TRUE, deviation, strict=False)]
        )
    assert 0.4 < np.sqrt(np.mean(np.square(errors))) < 1.6
    assert np.abs(errors).max() < 4.0


@pytest.mark.slow
def test_thresholds_of_a_fitted_machine_see_a_drift_that_the_default_ones_miss():
    base, true, log = motion_that_does_not_repeat(0)
    fitted = fit(base, log, [LAG, PUMP], whole_loop=False)
    task = {"reference": "sine", "protection": {}, "simulation.duration_s": 22.0}
    own = fitted.scenario.changed({"nominal": None, **task})
    level_mm = detector_thresholds(own, fitted.uncertainty(), 10).largest("flow")
    narrow = {"protection": {"flow_mm": MARGIN * level_mm}}
    healthy = detector_thresholds(own.changed(narrow), fitted.uncertainty(), 50, seed=2)
    assert not healthy.alarms
    drift = {"place": "encoder", "kind": "drift", "size": 0.5, "start_s": 12.0}
    unit = {"nominal": own.plant.model_dump(), **task, **narrow}
    seen = [
        np.any(
            track(true.changed(change | {"faults": (drift,)}), all_signals=True).run[
                "safety_reason"
            ]
        )
        for change in (task, unit)
    ]
    assert seen == [False, True]


LOG = machine(120)
WRONG = {
    "speed sign": ({"motor_speed_rad_s": -1.0}, r"motor_speed_rad_s: falls where .*-1\.00"),
    "speed in rpm": ({"motor_speed_rad_s": 9.5493}, r"moves 9\.\d+ times .* by 9\.549\?"),
    "speed in turns": ({"motor_speed_rad_s": 0.159155}, r"by 6\.283\? .*\*6\.283185"),
    "angle in deg": ({"encoder_reading_rad": 57.29578}, r"encoder_reading_rad.*by 57\.3\?"),
    "angle in mrad": ({"encoder_reading_rad": 1e3}, r"encoder_reading_rad.*by 1000\?"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_sign_or_unit_is_named(case):
    factors, message = WRONG[case]
    log = LOG | {name: factor * LOG[name] for name, factor in factors.items()}
    log["knee_reference_rad"] = np.full(120, np.radians(START_DEG))
    with pytest.raises(ScenarioError, match=rf"^log: .*{message}"):
        fit(BASE, log, [LAG], command_holds="from")


def test_swapped_columns_are_named():
    command, speed = "motor_speed_command_rad_s", "motor_speed_rad_s"
    log = LOG | {command: LOG[speed], speed: LOG[command]}
    with pytest.raises(ScenarioError, match=r"speed_rad_s: leads .*: are the columns swapp"):
        fit(BASE, log, [LAG], command_holds="from")


PARAMETERS = {
    "plant.pump.lag": r"plant\.pump\.lag: unknown name; did you mean plant\.pump\.lag_s\?",
    "plant.full_order.dead_volume_m3": r"unknown name; needs plant\.full_order = true",
    "bus.latency_samples": "= 0: must be a real number with a range",
    "simulation.tolerance": "= None: must be a real number with a range",
    "controller.lambda_per_s": "controller.lambda_per_s: has no effect on a measured output",
    f"{LAG}=0.1:b": "must be NAME or NAME=LOW:HIGH",
    "": "^parameters = '': must be NAME or NAME=LOW:HIGH",
    f"{LAG}=0.1:2": r"lag_s = 0\.01 s: the range 0\.1 … 2 must .* >= 0\.0001 and <= 1; give one",
    "plant.cylinder.stiffness_n_per_m": r"0 … 0 must have low < high.*_m=LOW:HIGH$",
    "encoder_reading.delay_s": r"delay_s = 0 s: the range 0 … 0 must have low < high, and be fin",
}


@pytest.mark.parametrize("name", PARAMETERS)
def test_a_parameter_that_cannot_be_fitted_is_refused(name):
    with pytest.raises(ParameterError, match=PARAMETERS[name]) as caught:
        fit(BASE, LOG, [name], command_holds="from")
    assert "\n" not in str(caught.value)


def test_a_log_shorter_than_a_time_constant_is_refused():
    slow = BASE.changed({LAG: 0.5})
    with pytest.raises(ParameterError, match=r"lag_s = 0\.5 s: is longer than the log of 0\.23"):
        fit(slow, LOG, [LAG], command_holds="from")
