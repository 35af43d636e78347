"""References by name and from files, and one line for each fault of a file."""

from pathlib import Path

import pytest

from kneexo.errors import ParameterError
from kneexo.parameters import (
    CsvReference,
    GaitReference,
    SampledReference,
    Scenario,
    SineReference,
    gait_reference,
)
from kneexo.parameters.scenario_file import load_scenario


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
        ("t,knee\n0,1\n1,2\n", "gait.csv: times_s has 2 values: must have at least 3"),
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


def test_a_missing_csv_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"none\.csv: cannot be read: No such file"):
        CsvReference(file="none.csv").samples(tmp_path)


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


def test_the_default_sine_is_that_of_section_5() -> None:
    reference = SineReference()
    assert reference.mean_deg - reference.amplitude_deg == 10.0
    assert reference.mean_deg + reference.amplitude_deg == 70.0
    assert reference.frequency_hz == 0.1
