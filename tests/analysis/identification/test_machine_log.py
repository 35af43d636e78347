"""Logs that are read by name and unit, and what of them is refused."""

import os

import numpy as np
import pytest

from kneexo.analysis.identification.machine_log import check, check_range, phase_rad, read_log
from kneexo.errors import ParameterError, ScenarioError
from kneexo.geometry.linkage import encoder_angle
from kneexo.parameters import Scenario

BASE = Scenario()
COMMAND, SPEED, ENCODER = "motor_speed_command_rad_s", "motor_speed_rad_s", "encoder_reading_rad"
HEAD = f"time_s,{COMMAND},{SPEED},knee_angle_rad,speed_rpm\n"


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(HEAD + "0,1,2,3,60\n0.002,2,3,4,120\n")
    return path


def test_columns_are_read_by_name_and_in_another_unit(written):
    log = read_log(written, [f"{SPEED}=speed_rpm*0.1047198"], [SPEED])
    assert sorted(log) == sorted(["time_s", COMMAND, SPEED])
    np.testing.assert_allclose(log[SPEED], [6.283188, 12.566376])
    np.testing.assert_allclose(log["time_s"], [0.0, 0.002])
    assert sorted(read_log(written, [], [])) == sorted(["time_s", COMMAND, SPEED])
    arrays = read_log({"time_s": [0.0, 1.0], COMMAND: [1.0, 2.0], "x": [3, 4]}, [f"{SPEED}=x"], [])
    np.testing.assert_allclose(arrays[SPEED], [3.0, 4.0])


@pytest.mark.parametrize(
    ("columns", "measured", "message"),
    [
        (["time_s=t"], [], r"log\.csv: has no column 't'; it has .*--columns NAME=COLUMN says"),
        ([], [ENCODER], rf"log\.csv: has no column '{ENCODER}'"),
        ([], ["sped_rad_s"], "sped_rad_s: is no column of a run; did you mean"),
        (["time_s"], [], "columns: time_s: must be NAME=COLUMN or"),
        (["time_s=time_s*1e"], [], r"time_s=time_s\*1e: must be"),
    ],
)
def test_a_missing_or_unknown_column_is_named(written, columns, measured, message):
    with pytest.raises(ParameterError, match=message):
        read_log(written, columns, measured)


def test_special_files_are_refused(tmp_path):
    os.mkfifo(tmp_path / "log.csv")
    with pytest.raises(ScenarioError, match=r"log\.csv: cannot be read: is not a regular file"):
        read_log(tmp_path / "log.csv", [], [])


def log_of(**changes):
    k = np.arange(60)
    log = {"time_s": 0.002 * k, COMMAND: 100.0 * np.sin(0.1 * k), SPEED: 100.0 * np.sin(0.1 * k)}
    return log | {name: change(log[name], k) for name, change in changes.items()}


LIMIT = 5000.0 * np.pi / 30.0
WRONG = {
    r"time_s = 0\.01 s in row 31 follows 0\.058 s: must be later, by at most 10 sam": {
        "time_s": lambda t, k: np.where(k == 30, 0.01, t)
    },
    r"time_s = 0\.09 s in row 31 follows 0\.058 s: must be later, by at most 10 sam": {
        "time_s": lambda t, k: np.where(k >= 30, t + 0.03, t)
    },
    r"the median step is 2 s: must be controller\.sample_time_s = 0\.002 s.*1000\?.*\*0\.001$": {
        "time_s": lambda t, k: 1000.0 * t
    },
    r"the median step is 0\.004 s: must be controller\.sample_time_s = 0\.002 s, a row for each": {
        "time_s": lambda t, k: 2.0 * t
    },
    r"_command_rad_s = -?954\.\d rad/s in row \d+: must be within ±523\.6 .*9\.549\?.*0\.1047198": {
        COMMAND: lambda u, k: 9.5493 * u
    },
    rf"{COMMAND}: is at its limit of 523\.6 rad/s in more than 90% of the rows": {
        COMMAND: lambda u, k: np.where(k % 20, LIMIT, u)
    },
}


@pytest.mark.parametrize("message", WRONG)
def test_times_and_commands_that_contradict_the_scenario_are_refused(message):
    check(log_of(), BASE)
    with pytest.raises(ParameterError, match=f"{message}") as caught:
        check(log_of(**WRONG[message]), BASE)
    assert "\n" not in str(caught.value)


def test_a_command_that_is_often_at_its_limit_is_taken():
    check(log_of(**{COMMAND: lambda u, k: np.where(k % 8, LIMIT, u)}), BASE)


def test_readings_beyond_the_range_of_motion_are_refused():
    scenario = BASE.changed({"encoder.phase_rad": 0.2, "encoder.mounting_error_rad": 0.1})
    assert phase_rad(scenario) == pytest.approx(0.2 + np.pi / 4096)
    angles = encoder_angle(scenario.plant.linkage, np.radians([0.0, 90.0]))
    check_range({ENCODER: angles - phase_rad(scenario)}, scenario)
    check_range({}, scenario)
    for angle, row in zip(angles, (1, 2), strict=True):
        far = np.where(angles == angle, 2.0 * angle - angles.mean(), angles) - phase_rad(scenario)
        with pytest.raises(
            ParameterError, match=rf"rad in row {row}: must be within .*set encoder"
        ):
            check_range({ENCODER: far}, scenario)
