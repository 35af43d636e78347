"""Study `fit`: the arguments of its command, its files, and the uncertain values of its result."""

import json
from dataclasses import replace

import numpy as np
import pytest
from fit_cases import DELAY, LAG, LOAD, made_up

from kneexo.command_line.main import main
from kneexo.errors import ParameterError
from kneexo.parameters.scenario_file import load_scenario
from kneexo.studies.fit import FitSettings, fit as study


@pytest.fixture
def passed(monkeypatch):
    """What the study fits. The fit itself returns the result that is made up."""
    passed = {}

    def fitted(scenario, log, **options):
        passed.update(scenario=scenario, log=log, **options)
        return made_up()

    monkeypatch.setattr("kneexo.analysis.identification.fit.fit", fitted)
    return passed


def test_the_command_takes_the_log_and_writes_the_fitted_scenario(
    tmp_path, passed, capsys, monkeypatch
):
    monkeypatch.setattr("kneexo.command_line.output.save_figure", lambda *_: None)
    mine = tmp_path / "mine.yaml"
    mine.write_text("plant: {load: knee}\n")
    names = f"{LAG}=0.001:0.1,{LOAD}"
    words = ["fit", "my log.csv", str(mine), "--parameters", names, "--columns", "time_s=t*0.001"]
    out = tmp_path / "out"
    assert main([*words, "--set", "loss=huber", "--out", str(out), "--json"]) == 0
    assert passed["log"] == "my log.csv"
    assert passed["parameters"] == (f"{LAG}=0.001:0.1", LOAD)
    assert passed["columns"] == ("time_s=t*0.001",)
    assert (passed["loss"], passed["command_holds"]) == ("huber", "until")
    assert passed["scenario"] == load_scenario(mine)
    printed = json.loads(capsys.readouterr().out)
    assert printed["settings"]["log"] == "my log.csv"
    assert printed["unknowns"][LAG]["difference"] == pytest.approx(4.0)
    assert {file.name for file in out.iterdir()} == {"fit.json", "fit.md", "fitted.yaml"}
    assert load_scenario(out / "fitted.yaml") == made_up().scenario
    assert (out / "fitted.yaml").read_text().splitlines()[:2] == [
        f"# {LAG}: fitted to bench.csv, ± 0.0005 (95 %, bounded)",
        f"# {LOAD}: fitted to bench.csv, ± 7.6 (95 %, one-sided)",
    ]


def test_settings_name_no_log():
    with pytest.raises(ParameterError, match="log: must be the path"):
        study.fit_study(settings=FitSettings())


def test_the_intervals_are_uncertain_values():
    values = made_up().uncertainty().values
    assert list(values) == [LAG, LOAD]
    assert (values[LAG].low, values[LAG].high, values[LAG].scale) == (0.012, 0.013, "log")
    assert values[LOAD].source == "fitted to bench.csv, ± 7.6 (95 %, one-sided)"
    interval = made_up().open_loop.interval | {LAG: (0.0, 0.013)}
    zero = replace(made_up(), open_loop=replace(made_up().open_loop, interval=interval))
    assert zero.uncertainty().values[LAG].scale == "linear"
    with pytest.raises(ParameterError, match="values"):
        replace(made_up(), paths=()).uncertainty()


def test_the_text_has_both_estimates_and_the_notes():
    text = str(made_up())
    assert f"{LAG}: 0.0145 in the whole loop, +4.0 combined standard deviations" in text
    assert text.splitlines()[-1] == made_up().notes[0]
    alone = replace(made_up(), whole_loop=None)
    assert "whole loop" not in str(alone)
    assert np.isnan(alone.results()["unknowns"][DELAY]["whole_loop"])
