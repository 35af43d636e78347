"""The campaign of random scenario files and runs, in small; `benchmarks/campaign.py`."""

import importlib.util
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed

PATH = Path(__file__).parents[1] / "benchmarks" / "campaign_scenarios.py"
spec = importlib.util.spec_from_file_location("campaign_scenarios", PATH)
campaign = importlib.util.module_from_spec(spec)
spec.loader.exec_module(campaign)

HERE = SimpleNamespace(outcomes=campaign.run_outcomes)
TEMPLATES = (Scenario(), changed(Scenario(), {"controller": {"kind": "pid"}}))


def bad(outcomes):
    return [outcome for outcome in outcomes if outcome[0] in campaign.BAD]


@pytest.mark.slow
def test_damaged_files_are_scenarios_or_one_line():
    outcomes = list(campaign.files(200, seed=1))
    assert not bad(outcomes)
    kinds = [kind for kind, *_ in outcomes]
    assert min(kinds.count("valid"), kinds.count("refused")) >= 10


def test_random_runs_are_finite_or_one_line():
    outcomes = list(campaign.run_all(campaign.randoms(TEMPLATES, 50, seed=1), HERE))
    assert not bad(outcomes)
    kinds = [kind for kind, *_ in outcomes]
    assert kinds.count("valid") >= 10


def test_every_number_is_tried_at_both_ends_of_its_range():
    subjects = [text for text, _ in campaign.corners(TEMPLATES[:1], seed=1)]
    for text in ("bore_m = 0.001", "bore_m = 1", "ramp_s = 1e-300", "tolerance = 1e-14"):
        assert any(line.endswith(text) for line in subjects)


def test_a_traceback_names_its_run_alone(monkeypatch):
    def dividing(requests):
        for index, request in requests.items():
            if request.scenario.initial_offset_m:
                raise ZeroDivisionError
            yield index, SimpleNamespace(data={"a": np.array([np.nan])})

    monkeypatch.setattr(campaign, "serve_runs", dividing)
    scenarios = [Scenario(), Scenario(initial_offset_m=0.01)]
    kinds = [kind for kind, _ in campaign.run_outcomes(scenarios)]
    assert kinds == ["nan", "traceback"]


def test_a_hang_ends():
    with pytest.raises(TimeoutError), campaign.time_limit(0.05):
        time.sleep(5.0)
    assert campaign.outcome_of(TimeoutError()) == ("hang", "")
    assert campaign.outcome_of(KeyError("a"))[0] == "traceback"
