"""The data of the page to play with, with models that need no compiler."""

import json
import re

import pytest
import yaml

from kneexo.errors import ParameterError
from kneexo.page import playground
from kneexo.page.model import controller_of
from kneexo.page.playground import missing_models, playground_data, playground_page
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.presets import PRESETS
from kneexo.parameters.scenario_file import load_scenario
from kneexo.studies.paper import FIG_12, IDEAL_SMC


@pytest.fixture(autouse=True)
def _models_without_maps(monkeypatch):
    """Models with the two kinds of a scenario, and no modules."""

    def web_model(scenario):
        if scenario.controller.kind == "pid" and scenario.plant.full_order is not None:
            raise ParameterError("no compiler for this structure")
        return {
            "controller": controller_of(scenario),
            "load": scenario.plant.load.kind,
            "quantities": [],
            "wearer": scenario.wearer.kind != "none",
            "moment": None,
            "references": {"sine": {"quantities": []}} | _samples(scenario),
            "limits": {"knee_low_rad": 0.0, "knee_high_rad": 1.5},
        }

    monkeypatch.setattr(playground, "web_model", web_model)
    monkeypatch.setattr(playground, "web_modules", lambda models: {})


def _samples(scenario):
    if scenario.reference.kind != "samples":
        return {}
    return {"samples": {"ticks": round(scenario.duration_s / scenario.controller.sample_time_s)}}


SCENARIOS = {
    **{f"preset {name}": Scenario.preset(name) for name in PRESETS},
    **{f"Fig. 12, {name}": scenario for name, scenario in FIG_12.items()},
    "Fig. 9": IDEAL_SMC,
    "another design": changed(
        Scenario(),
        {
            "plant.linkage": "G3",
            "nominal": {"cylinder": {"mass_kg": 1.5}},
            "estimator": "difference",
            "reference": {"kind": "samples", "times_s": [0, 1, 2], "angles_deg": [10, 20, 15]},
            "simulation.duration_s": 1.5,
        },
    ),
}


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_values_of_a_model_are_a_scenario_file_of_the_same_scenario(name, tmp_path):
    entry = playground_data([SCENARIOS[name]], ["x"])["scenarios"][0]
    plain = json.loads(json.dumps(entry["models"][0]["scenario"]))
    file = tmp_path / "scenario.yaml"
    file.write_text(yaml.safe_dump(plain))
    assert load_scenario(file) == SCENARIOS[name].with_duration()


def test_a_scenario_has_models_of_both_controllers_and_loads_its_own_first():
    pid = changed(Scenario.preset("bench"), {"controller": "pid"})
    models = playground_data([pid], ["x"])["scenarios"][0]["models"]
    kinds = [(model["controller"], model["load"]) for model in models]
    assert kinds == [("pid", "knee"), ("pid", "none"), ("smc", "knee"), ("smc", "none")]
    assert models[1]["scenario"]["bus"] == {"kind": "cia402"}
    assert "load" not in models[1]["scenario"].get("plant", {})


def test_models_that_cannot_be_made_are_left_out_with_the_reason():
    entry = playground_data([Scenario.preset("leg")], ["x"])["scenarios"][0]
    assert [model["controller"] for model in entry["models"]] == ["smc", "smc"]
    assert entry["missing"] == {
        "no compiler for this structure": [("pid", "knee"), ("pid", "none")]
    }
    assert missing_models({"scenarios": [entry]}) == [
        "x: the page has no pid with load knee, no pid with load none. "
        "no compiler for this structure"
    ]


def test_a_wearer_has_models_of_the_modes_that_need_no_biological_moment():
    data = playground_data([Scenario.preset("wearer")], ["x"])
    modes = ["zero_torque", "impedance", "assist_as_needed"]
    assert [model["controller"] for model in data["scenarios"][0]["models"]] == modes
    assert {model["load"] for model in data["scenarios"][0]["models"]} == {"knee"}
    assert [setup["controller"] for setup in data["setups"]] == modes[:2]
    assert data["scenarios"][0]["missing"] == {}


def test_set_up_b_is_the_other_controller_or_the_second_scenario():
    alone = playground_data([Scenario()], ["x"])
    assert [setup["controller"] for setup in alone["setups"]] == ["smc", "pid"]
    assert alone["compare"] is False
    both = playground_data([Scenario(), Scenario.preset("leg")], ["x", "y"])
    assert [setup["scenario"] for setup in both["setups"]] == [0, 1]
    assert [setup["load"] for setup in both["setups"]] == ["none", "knee"]
    assert both["compare"] is True


def test_a_page_shows_a_run_of_half_a_second_to_a_minute():
    for duration, shown in ((0.1, 0.5), (20.0, 20.0), (1000.0, 60.0)):
        scenario = changed(Scenario(), {"simulation.duration_s": duration})
        assert playground_data([scenario], ["x"])["scenarios"][0]["duration_s"] == shown


def test_a_run_ends_where_the_biological_moment_ends():
    moment = {"times_s": [0.0, 7.0], "moments_n_m": [0.0, 5.0]}
    worn = {"plant": {"load": "knee"}, "wearer": {"kind": "leg", "moment": moment}}
    scenario = Scenario.model_validate(worn | {"simulation": {"duration_s": 2.0}})
    data = playground_data([scenario], ["x"])
    assert (data["duration"]["high"], data["scenarios"][0]["duration_s"]) == (7.0, 2.0)
    assert playground_data([Scenario()], ["x"])["duration"]["high"] == 60.0


def test_models_share_the_samples_of_a_minute_at_most():
    gait = {"kind": "gait", "frequency_hz": 0.1, "cycles": 10}
    models = playground_data([changed(Scenario(), {"reference": gait})], ["x"])["scenarios"][0][
        "models"
    ]
    assert models[0]["references"]["samples"] == {"ticks": 30_000}
    assert [list(model["references"]) for model in models[1:]] == [["sine"]] * 3


def test_a_page_escapes_names_and_is_marked():
    name = "</script><script>alert(1)</script><b>&"
    page = playground_page([Scenario()], [name])
    assert "the whole control loop runs again in your browser" in page  # CI looks for these words
    assert "alert(1)</script>" not in page
    assert "<title>kneexo: &lt;/script&gt;" in page
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)[1]
    assert "default-src 'none'" in policy
    assert "'wasm-unsafe-eval'" in policy
    assert "unsafe-inline" not in policy
    assert "'unsafe-eval'" not in policy


def test_a_page_has_one_to_eight_scenarios():
    for count in (0, 9):
        with pytest.raises(ParameterError, match=f"{count} scenarios: .* at least 1 and at most 8"):
            playground_page([Scenario()] * count, ["x"] * count)
