import html
import json
import re
import shlex

import pytest

import kneexo
from kneexo.analysis.frequency.frequency_response import SinestreamSettings
from kneexo.command_line.main import main
from kneexo.geometry.rod_polynomial import completed
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.scenario_file import load_scenario
from kneexo.studies.bandwidth import bandwidth
from kneexo.studies.catalogue import STUDIES
from kneexo.studies.markdown import repeating_commands


def test_an_interrupted_study_goes_on_with_identical_results(
    capsys, tmp_path, monkeypatch, undrawn
):
    whole, torn = tmp_path / "whole", tmp_path / "torn"
    few = ["--set=amplitudes_deg=[1.0]", "--set=frequencies_hz=[2, 3, 5]"]
    command = ["study", "bandwidth", *few, "--workers", "1", "--out"]
    assert main([*command, str(whole)]) == 0
    measure, calls = bandwidth._measure, []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return measure(*arguments)

    interrupted.__module__, interrupted.__qualname__ = measure.__module__, measure.__qualname__
    monkeypatch.setattr(bandwidth, "_measure", interrupted)
    *findings, empty, files = capsys.readouterr().out.splitlines()
    assert findings[0] == "Frequency response from small to large amplitudes"
    assert findings[2].startswith("Bandwidth (−3 dB): ")
    assert max(map(len, findings)) <= 100
    assert (empty, files) == ("", f"In {whole}: bandwidth.json, bandwidth.md")
    assert main([*command, str(torn)]) == 130
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("kneexo: interrupted; 3 finished pieces are kept in ")
    assert [file.name for file in torn.iterdir()] == ["bandwidth.checkpoint.jsonl"]
    assert main([*command, str(torn)]) == 0
    pieces = len(calls) - 4
    assert pieces > 0
    for name in ("bandwidth.json", "bandwidth.md"):
        assert (torn / name).read_bytes() == (whole / name).read_bytes()
    assert not (torn / "bandwidth.checkpoint.jsonl").exists()


@pytest.mark.parametrize("interrupted", [False, True])
def test_a_long_study_tells_its_cost_and_answers_from_a_tenth_of_its_plants(
    capsys, tmp_path, replace_study, interrupted
):
    asked = []

    def compute(scenario=Scenario(), *, settings, checkpoint, **_):
        asked.append((settings.samples, settings.corners_max, settings.seed, len(checkpoint)))
        if interrupted and len(asked) == 2:
            raise KeyboardInterrupt
        if "piece" not in checkpoint:
            checkpoint.keep("piece", 1.0)
        assert checkpoint["piece"] == 1.0

    replace_study("robustness", compute)
    command = ["study", "robustness", "--set=samples=230", "--set=seed=3", "--restart"]
    assert main([*command, "--out", str(tmp_path)]) == (130 if interrupted else 0)
    assert asked == [(23, 100, 3, 0), (230, 1000, 3, 1)]
    cost, first, *_, last = capsys.readouterr().err.splitlines()
    told = r"kneexo: with default settings about \d+ min on two cores; this machine has \d+"
    assert re.fullmatch(told, cost)
    assert first == "kneexo: first answer, samples=23, corners_max=100:"
    report = json.loads((tmp_path / "robustness.json").read_text())
    assert report["settings"]["samples"] == (23 if interrupted else 230)
    pieces = tmp_path / "robustness.checkpoint.jsonl"
    assert pieces.exists() == interrupted
    if interrupted:
        assert last == (
            f"kneexo: interrupted; the first answer (samples=23, corners_max=100) is in {tmp_path}"
            f"; 1 finished pieces are kept in {pieces}; the same command goes on from them"
        )


def test_few_plants_need_no_first_answer(capsys, tmp_path, replace_study):
    asked = []
    replace_study(
        "robustness", lambda scenario=Scenario(), *, settings, **_: asked.append(settings.samples)
    )
    assert main(["study", "robustness", "--set=samples=99", "--out", str(tmp_path)]) == 0
    assert asked == [99]
    assert "first answer" not in capsys.readouterr().err


@pytest.mark.parametrize("study", STUDIES.values(), ids=lambda study: study.name)
def test_each_study_is_wired(capsys, tmp_path, study, replace_study):
    options = {}

    def compute(scenario=Scenario(), *, settings, workers, executor, progress, checkpoint=None):
        assert executor is None
        assert (checkpoint is not None) == study.resumable
        options["workers"] = workers

    replace_study(study.name, compute)
    command = study.command.split()
    out = tmp_path / "out"
    assert main([*command, "--workers", "2", "--out", str(out), "--json"]) == 0
    assert options["workers"] == 2
    printed = json.loads(capsys.readouterr().out)
    assert (printed["kneexo"], printed["results"]) == (kneexo.__version__, "of the study")
    assert changed(Scenario(), printed["scenario"]) == completed(Scenario())
    settings = study.computation().settings()
    assert printed["settings"] == settings.model_dump(mode="json")
    names = ("results", "report") if study.name == "reproduce" else (study.name, study.name)
    assert {file.name for file in out.iterdir()} == {f"{names[0]}.json", f"{names[1]}.md"}
    assert json.loads((out / f"{names[0]}.json").read_text()) == printed
    assert (out / f"{names[1]}.md").read_text() == "# report\n"
    assert main([*command, "--out", str(out), "--html"]) == 0
    page = (out / f"{study.name}.html").read_text()
    assert f"<title>kneexo {study.command}</title>" in page


def test_reproduce_takes_settings_of_fig_13(capsys, tmp_path, replace_study):
    passed = []

    def compute(scenario=Scenario(), *, settings, **_):
        passed.append(settings)

    replace_study("reproduce", compute)
    settings = ["--set=trials=2", "--set=frequencies_hz=[0.2, 0.21, 0.3]"]
    assert main(["reproduce", *settings, "--out", str(tmp_path), "--html"]) == 0
    assert passed == [SinestreamSettings(trials=2, frequencies_hz=(0.2, 0.21, 0.3))]
    command = shlex.join(["kneexo", "reproduce", *settings])
    assert f"<code>{html.escape(command)}</code>" in (tmp_path / "reproduce.html").read_text()


def test_failed_runs_become_scenarios_beside_the_report(
    tmp_path, capsys, monkeypatch, replace_study
):
    (tmp_path / "my.py").write_text("def law(rod_extension):\n    return rod_extension\n")
    failing = changed(Scenario(), {"initial_offset_m": 0.15})
    runs = {"first": failing, "second": failing.with_law(f"{tmp_path / 'my.py'}:law")}
    shows = {"failed_runs": lambda result: runs}
    replace_study("robustness", lambda scenario=Scenario(), **_: None, **shows)
    out = tmp_path / "out"
    assert main(["study", "robustness", "--out", str(out)]) == 0
    assert "failure_1.yaml, failure_2.yaml" in capsys.readouterr().out
    assert len(list(out.glob("failure*"))) == 2
    monkeypatch.chdir(out)
    for command, scenario in zip(repeating_commands(runs).values(), runs.values(), strict=True):
        program, *words = command.strip("`").split()
        assert (program, words[0], load_scenario(words[1])) == ("kneexo", "simulate", scenario)
        assert main(words) == 2
        *_, last = capsys.readouterr().err.splitlines()  # a law says before that it runs
        assert last.startswith(f"kneexo: {words[1]}: the rod starts at 0.2890")
