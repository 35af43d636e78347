import json

import pytest

import kneexo
from kneexo.analysis import track
from kneexo.command_line.main import main
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.scenario_file import load_scenario
from kneexo.studies.contest.study import ContestSettings


@pytest.mark.parametrize("number", ["1_0", "٣", "nan", "inf", "1e999", "0x1", ""])
@pytest.mark.parametrize("option", ["--knee-angle", "--workers"])
def test_numbers_of_options_have_the_digits_0_to_9(capsys, option, number):
    command = "linearize" if option == "--knee-angle" else "bandwidth"
    with pytest.raises(SystemExit) as caught:
        main([command, option, number, "--out", "o"])
    assert caught.value.code == 2
    assert f"argument {option}: {number!r} must be a" in capsys.readouterr().err


@pytest.mark.parametrize(
    "command", [["simulate"], ["linearize", "--knee-angle", "20"], ["diagram"], ["params"]]
)
def test_json_says_version_and_scenario(capsys, short, tmp_path, undrawn, command):
    name, *options = command
    out = [] if name == "params" else ["--out", str(tmp_path / "out")]
    assert main([name, short, *options, *out, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["kneexo"] == kneexo.__version__
    assert changed(Scenario(), printed["scenario"]) == load_scenario(short)
    if name == "linearize":
        assert printed["settings"] == {"knee_angle_deg": 20.0}


def test_values_of_the_scenario_win_over_the_file(capsys, short, tmp_path, undrawn):
    path, out = short, tmp_path / "out"
    texts = ["plant.cylinder.mass_kg=1.7", "reference.frequency_hz=2", "plant.linkage=G3"]
    command = ["simulate", path, *(word for text in texts for word in ("--set", text))]
    assert main([*command, "--out", str(out), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    values = {"plant.cylinder.mass_kg": 1.7, "reference.frequency_hz": 2, "plant.linkage": "G3"}
    expected = changed(load_scenario(path), values)
    assert changed(Scenario(), printed["scenario"]) == expected
    assert load_scenario(out / "scenario.yaml") == expected
    assert expected.reference.amplitude_deg == 2.0  # of the file
    metrics = track(expected).metrics
    assert printed["max_error_deg"] == metrics.max_error_deg
    assert printed["max_error_deg"] != track(load_scenario(path)).metrics.max_error_deg


def test_the_engine_wins_over_the_values(capsys, short, tmp_path, undrawn):
    command = ["simulate", short, "--set", "simulation.integrator=radau1"]
    arguments = [*command, "--set", "simulation.duration_s=1.1", "--engine", "compiled"]
    assert main([*arguments, "--out", str(tmp_path / "out"), "--json"]) == 0
    simulation = json.loads(capsys.readouterr().out)["scenario"]["simulation"]
    assert (simulation["integrator"], simulation["duration_s"]) == ("exact_hold", 1.1)


@pytest.mark.parametrize("command", ["simulate", "linearize"])
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("plant.cylinder.mass_kg", "--set plant.cylinder.mass_kg: must be NAME=VALUE"),
        ("plant.cylinder.mass_kg=-1", "plant.cylinder.mass_kg = -1 kg is out of range"),
        ("plant.cylinder.mas_kg=1", "plant.cylinder.mas_kg: unknown name"),
        ("plant.cylindr.mass_kg=1", "this scenario has no plant.cylindr"),
        ("plant.full_order.entrained_air=0", "this scenario has no plant.full_order"),
        ("plant.linkage=G9", "'G9' must be one of G1"),
        ("plant.linkage=[", "--set plant.linkage:1: YAML syntax"),
        ("controller.mass_min_kg=2", "must not exceed mass_max_kg"),
    ],
)
def test_bad_values_of_the_scenario_are_one_line(capsys, tmp_path, command, text, message):
    out = tmp_path / "out"
    assert main([command, "--set", text, "--out", str(out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("kneexo: ")
    assert message in line
    assert not out.exists()


def test_changed_leaves_nested_mappings_of_settings_alone():
    settings = ContestSettings()
    path = "contestants.SMC.controller.lambda_per_s"
    assert changed(settings, {path: 5.0}).contestants["SMC"].controller.lambda_per_s == 5.0
    assert settings == ContestSettings()
    assert ContestSettings().contestants["SMC"].controller.lambda_per_s == 20.0
