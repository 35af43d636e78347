"""Web models as data; tests/page/web/test_worker.py runs them beside the compiled engine."""

import json
import math
from functools import cache

import numpy as np
import pytest

from kneexo.geometry import linkage
from kneexo.page.maps import map_value
from kneexo.page.model import web_model, web_modules, with_structure
from kneexo.page.modules import SHIPPED
from kneexo.parameters import PlantParameters, Scenario

LEG = Scenario.model_validate(SHIPPED["leg"])
model_of = cache(web_model)  # takes a second


@pytest.mark.slow
def test_a_model_is_json_and_says_what_a_number_is():
    model = json.loads(json.dumps(model_of(LEG), allow_nan=False))
    gear = model["quantities"][0]
    assert gear["name"] == "plant.pump.gear_ratio"
    assert (gear["value"], gear["unit"], gear["scale"]) == (6.0, "1", "log")
    assert gear["low"] < 6.0 < gear["high"]
    assert "Section 5: 6:1" in gear["source"]
    for quantity in model["quantities"]:
        assert quantity["low"] <= quantity["value"] <= quantity["high"]
    assert (model["controller"], model["load"]) == ("smc", "knee")


@pytest.mark.slow
def test_the_inertia_of_the_load_stands_in_place_of_the_mass():
    pytest.importorskip("ziglang", reason="needs Zig: pip install ziglang")
    inertia, mass = "plant.load.inertia_kg_m2", "plant.cylinder.mass_kg"
    scenario = Scenario().changed({"plant.load": {"kind": "knee", "inertia_kg_m2": 0.064}})
    names = {quantity["name"] for quantity in model_of(scenario)["quantities"]}
    assert {inertia, mass} & names == {inertia}


@pytest.mark.slow
def test_the_limits_follow_the_sliders():
    limits = model_of(LEG)["limits"]
    rpm = 2.0 * math.pi / 60.0
    speed = {"plant.pump.speed_limit_rad_s": 2000.7 * rpm}
    # The bus of the leg rounds to whole revolutions per minute.
    command = map_value(limits["command_limit_rad_s"], speed)
    assert command == pytest.approx(2000.0 * rpm, rel=1e-14)
    assert map_value(limits["motor_speed_limit_rad_s"], speed) == pytest.approx(2000 * rpm)
    assert limits["pressure_rating_pa"] == 3.5e6
    assert limits["knee_high_rad"] == math.radians(90.0)
    relief = {"plant.full_order.relief_pressure_pa": 2.2e6}
    assert map_value(limits["relief_pressure_pa"], relief) == 2.2e6


def test_the_limits_of_the_reduced_order():
    limits = model_of(Scenario())["limits"]
    assert limits["relief_pressure_pa"] is None
    assert map_value(limits["command_limit_rad_s"], {"plant.pump.speed_limit_rad_s": 100.0}) == 100
    # The counts over the range of motion add up to the range of θ_4.
    count = limits["encoder_count_knee_deg"]
    assert (count["low_deg"], count["high_deg"], len(count["values"])) == (0.0, 90.0, 91)
    counts = np.trapezoid(1.0 / np.array(count["values"]), np.linspace(0.0, 90.0, 91))
    first, last = linkage.encoder_angle(Scenario().plant.linkage, np.radians([0.0, 90.0]))
    assert counts == pytest.approx(abs(last - first) / (2.0 * math.pi / 4096.0), rel=1e-3)


def test_the_other_structure_has_its_defaults_and_the_rest_stays():
    scenario = Scenario().changed({"plant.pump.gear_ratio": 4.0, "controller.lambda_per_s": 9.0})
    other = with_structure(scenario, "pid", "knee")
    assert (other.controller.kind, other.plant.load.kind) == ("pid", "knee")
    assert other.plant.pump.gear_ratio == 4.0
    assert with_structure(scenario, "smc", "none") == scenario
    back = with_structure(other, "smc", "none")
    assert back == scenario.changed({"controller.lambda_per_s": 20.0})


def test_the_loop_without_quantizers_adds_no_half_count():
    model = model_of(Scenario())
    modules = web_modules([model])
    offsets = {}
    for name in ("loop", "smooth"):
        place = modules[model[name]["module"]]["table"]["params"].index("coordinates.offset_rad")
        offsets[name] = model[name]["base"][place]
        (formula,) = (m for m in model[name]["maps"] if m["index"] == place)
        turned = map_value(formula, {"encoder.mounting_error_rad": 0.01})
        assert turned == pytest.approx(offsets[name] - 0.01, abs=1e-15)
    assert offsets == {"loop": pytest.approx(math.pi / 4096.0), "smooth": 0.0}


@pytest.mark.slow
def test_a_controller_of_another_plant_keeps_its_limit():
    limits = web_model(Scenario(nominal=PlantParameters()))["limits"]
    slow = {"plant.pump.speed_limit_rad_s": 100.0}
    assert limits["command_limit_rad_s"] == pytest.approx(5000.0 * math.pi / 30.0)
    assert map_value(limits["motor_speed_limit_rad_s"], slow) == 100.0
