import json
from pathlib import Path

from kneexo.analysis import track
from kneexo.command_line.main import main
from kneexo.geometry.rod_polynomial import completed
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.scenario_file import load_scenario
from kneexo.studies.contest.contest import ContestSettings

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_values_of_the_scenario_win_over_the_file(capsys, short, tmp_path, undrawn):
    path, out = short, tmp_path / "out"
    texts = ["plant.cylinder.mass_kg=1.7", "reference.frequency_hz=2", "plant.linkage=G3"]
    command = ["simulate", path, *(word for text in texts for word in ("--set", text))]
    assert main([*command, "--out", str(out), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    values = {"plant.cylinder.mass_kg": 1.7, "reference.frequency_hz": 2, "plant.linkage": "G3"}
    expected = changed(load_scenario(path), values)
    assert changed(Scenario(), printed["scenario"]) == completed(expected)
    assert load_scenario(out / "scenario.yaml") == completed(expected)
    assert expected.reference.amplitude_deg == 2.0  # of the file
    metrics = track(expected).metrics
    assert printed["max_error_deg"] == metrics.max_error_deg
    assert printed["max_error_deg"] != track(load_scenario(path)).metrics.max_error_deg


def test_changed_leaves_nested_mappings_of_settings_alone():
    settings = ContestSettings()
    path = "contestants.SMC.controller.lambda_per_s"
    assert changed(settings, {path: 5.0}).contestants["SMC"].controller.lambda_per_s == 5.0
    assert settings == ContestSettings()
    assert ContestSettings().contestants["SMC"].controller.lambda_per_s == 20.0


def test_a_relative_out_belongs_to_the_directory_of_the_call(
    capsys, short, tmp_path, undrawn, monkeypatch
):
    (tmp_path / "elsewhere").mkdir()
    file = tmp_path / "my.py"
    file.write_text(
        f"import os\nos.chdir({str(tmp_path / 'elsewhere')!r})\n"
        "def law(rod_extension, rod_reference):\n"
        "    return 1.3e5 * (rod_reference[0] - rod_extension)\n"
    )
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", short, "--law", f"{file}:law", "--out", "results"]) == 0
    assert (tmp_path / "results" / "signals.csv").is_file()


def test_a_law_of_the_user_replaces_that_of_the_file(capsys, short, tmp_path, undrawn):
    out, law = tmp_path / "out", f"{EXAMPLES / 'own_law.py'}:law"
    command = ["simulate", short, "--law", law, "--out", str(out), "--json"]
    assert main([*command, "--set", "controller.values.gain=9e4"]) == 0
    printed = json.loads(capsys.readouterr().out)
    expected = track(load_scenario(short).with_law(law, values={"gain": 9e4})).metrics
    assert printed["max_error_deg"] == expected.max_error_deg
    assert expected.max_error_deg > 2.0 * track(load_scenario(short)).metrics.max_error_deg
    assert load_scenario(out / "scenario.yaml").controller.values == {"gain": 9e4}
