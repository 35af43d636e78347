"""References by name and from files, and one line for each fault of a file."""

import math
from pathlib import Path

import numpy as np
import pytest

from kneexo.errors import ParameterError
from kneexo.parameters import (
    CsvReference,
    GaitReference,
    SampledReference,
    Scenario,
    gait_reference,
    sit_to_stand_reference,
)
from kneexo.parameters.scenario_file import load_scenario
from kneexo.parameters.task.reference import stride_frequency_hz
from kneexo.systems.knee_reference import make_knee_reference


def csv_file(directory: Path, text: str) -> CsvReference:
    (directory / "gait.csv").write_text(text, encoding="utf-8")
    return CsvReference(file="gait.csv", time="t", angle="knee")


def test_csv_reference_reads_two_columns(tmp_path: Path) -> None:
    text = "# measured\n\nt, hip ,knee\n0,1,10\n0.5,2,20\n\n1,3,12.5\n"
    reference = csv_file(tmp_path, text).model_copy(update={"interpolation": "pchip"})
    assert reference.samples(tmp_path) == SampledReference(
        times_s=(0.0, 0.5, 1.0), angles_deg=(10.0, 20.0, 12.5), interpolation="pchip"
    )


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "gait.csv: is empty"),
        (
            "t,hip\n0,1\n",
            "gait.csv: has no column 'knee'; it has t, hip; give its names as time: and angle:",
        ),
        ("t,knee\n0,1\n1,two\n", "gait.csv:3: knee: 'two'; must be a finite number"),
        ("t,knee\n0,1\n1\n", "gait.csv:3: knee: no value; must be a finite number"),
        ("t,knee\n0,1\n1,2\n", "gait.csv: has 2 rows; must have at least 3"),
        (
            "t,knee\n0,1\n0,2\n1,2\n",
            "gait.csv:3: t = 0 s after 0 s: must increase by at least 1e-06 s",
        ),
        (
            "t,knee\n0,1\n1,2\n2e5,2\n",
            "gait.csv:4: t = 200000 s is out of range: must be >= -100000",
        ),
    ],
)
def test_faults_of_a_csv_reference_name_file_and_line(tmp_path: Path, text: str, line: str) -> None:
    with pytest.raises(ParameterError) as caught:
        csv_file(tmp_path, text).samples(tmp_path)
    assert str(caught.value).startswith(f"{tmp_path}/{line}")


def test_the_path_of_a_csv_file_is_a_reference(tmp_path, monkeypatch) -> None:
    (tmp_path / "gait.csv").write_text("time_s,knee_angle_deg\n0,10\n1,20\n2,15\n")
    samples = SampledReference(times_s=(0.0, 1.0, 2.0), angles_deg=(10.0, 20.0, 15.0))
    monkeypatch.chdir(tmp_path)
    assert Scenario(reference="gait.csv").reference == samples
    with pytest.raises(ParameterError, match=r"none\.csv: cannot be read: No such file"):
        Scenario(reference="none.csv")
    file = tmp_path / "folder" / "knee.yaml"
    file.parent.mkdir()
    file.write_text("reference: ../gait.csv")
    assert load_scenario(file).reference == samples


def test_the_path_of_a_file_of_opensim_is_a_reference(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("ik.mot", "ik.sto"):
        text = "inDegrees=yes\nendheader\ntime\tknee_angle_deg\n0\t10\n1\t20\n2\t15\n"
        Path(name).write_text(text)
        assert Scenario(reference=name).reference.angles_deg == (10.0, 20.0, 15.0)


def test_samples_must_end_after_the_start_of_a_run() -> None:
    angles = (10.0, 20.0, 15.0)
    assert SampledReference(times_s=(-2.0, 0.0, 1e-3), angles_deg=angles).times_s[0] == -2.0
    line = (
        r"times_s ends at -2 s: must end at >= 0\.001 s, because a run starts at 0 s; subtract the "
        r"first time, -6 s, from all times$"
    )
    with pytest.raises(ParameterError, match=line):
        SampledReference(times_s=(-6.0, -4.0, -2.0), angles_deg=angles)
    with pytest.raises(ParameterError, match="times_s ends at 0 s: must end at"):
        SampledReference(times_s=(-6.0, -4.0, 0.0), angles_deg=angles)


def test_the_gait_curve_has_a_name() -> None:
    named = Scenario(reference={"kind": "gait", "frequency_hz": 0.5, "cycles": 2})
    assert named.reference == gait_reference(0.5, 2)
    assert Scenario(reference="gait").reference == gait_reference(1.0, 30)
    assert Scenario(reference=GaitReference(cycles=4)).reference == gait_reference(1.0, 4)
    with pytest.raises(
        ParameterError, match=r"reference = 'walk': must be sine, .*, gait, csv or a mapping"
    ):
        Scenario(reference="walk")
    with pytest.raises(ParameterError, match="reference: cycles = 0 is out of range"):
        Scenario(reference={"kind": "gait", "cycles": 0})


def motion(reference: SampledReference, times: np.ndarray) -> np.ndarray:
    """Angle and rate in deg and deg/s, (n, 2)."""
    source = make_knee_reference(reference)
    context = source.CreateDefaultContext()
    rows = []
    for time in times:
        context.SetTime(time)
        rows.append(source.get_output_port().Eval(context)[:2].copy())
    return np.degrees(rows)


def test_standing_up_has_minimum_jerk() -> None:
    reference = sit_to_stand_reference(2.0, 2, seated_deg=80.0, standing_deg=10.0)
    assert reference.range_deg == (10.0, 80.0)
    assert reference.times_s[-1] == pytest.approx(2 * (2.0 + 1.0 + 2.0 + 1.0))
    u = np.linspace(0.0, 1.0, 41)
    minimum_jerk = 80.0 - 70.0 * (10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5)
    angles = np.concatenate([minimum_jerk, [10.0, 10.0], minimum_jerk[::-1], [80.0, 80.0]])
    times = np.concatenate([2.0 * u, [2.1, 2.9], 3.0 + 2.0 * u, [5.1, 5.9]])
    for start in (0.0, 6.0):
        degrees = motion(reference, start + times)[:, 0]
        # The third derivative jumps at both ends. There the spline is 1/192 of jump·h³ off.
        assert degrees == pytest.approx(angles, abs=1e-3)
    # The largest rate of minimum jerk is 15/8 of the mean rate.
    rate = motion(reference, np.array([1.0]))[0, 1]
    assert rate == pytest.approx(-1.875 * 70.0 / 2.0, rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, 1), r"rise_time_s = 0 s: must be >= 0\.1 and <= 100 s"),
        ((2.0, 0), r"cycles = 0: must be >= 1 and <= 1000"),
    ],
)
def test_standing_up_needs_time_and_cycles(arguments: tuple[float, int], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        sit_to_stand_reference(*arguments)


def test_the_frequency_of_a_stride_is_known_from_its_samples():
    stride = np.array([1.0, 4.0, 2.0, 0.5])
    times = 0.25 * np.arange(9)
    assert stride_frequency_hz(times, np.resize(3.0 * stride, 9), stride) == 1.0
    for other in (np.zeros(9), np.resize(stride, 9) + 1e-6, np.resize(stride[:3], 9), stride):
        assert math.isnan(stride_frequency_hz(times[: other.size], other, stride))
