"""The modules that come with the package are those of the present code."""

import base64
import json
import math
import re
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import kneexo
from diagramc.c import cross
from kneexo.errors import CompilationError, ParameterError
from kneexo.page import modules as web_code
from kneexo.page.modules import (
    loop_source,
    module_key,
    module_of,
    modules,
    reference_source,
    require_slow_modes,
    shipped_sources,
    write_shipped,
)
from kneexo.parameters import Scenario

FOLDER = Path(kneexo.__file__).parent / "data" / "web"


def listed():
    return json.loads((FOLDER / "modules.json").read_text())


def test_the_shipped_modules_are_small_and_those_of_the_list():
    files = {file.stem: file.stat().st_size for file in FOLDER.glob("*.wasm")}
    assert set(files) == set(listed()["modules"])
    assert sum(files.values()) < 1_100_000


def test_the_key_of_the_default_loop_is_shipped_whatever_its_numbers():
    changed = Scenario().changed(
        {
            "plant.pump.gear_ratio": 3.5,
            "plant.linkage": "G3",
            "plant.cylinder.bulk_modulus_pa": 3e9,
            "reference.kind": "ramp",
            "controller.phi_m_s2": 1.0,
        }
    )
    key = module_key(loop_source(Scenario()))
    assert listed()["modules"][key] == "paper, smc, with quantizers"
    assert module_key(loop_source(changed)) == key


@pytest.mark.slow
def test_a_loop_with_another_constant_in_its_code_has_a_key_of_its_own():
    coarse = Scenario().changed({"encoder.counts_per_revolution": 512})
    assert module_key(loop_source(coarse)) not in listed()["modules"]


@pytest.mark.slow
def test_every_shipped_module_has_the_key_of_its_source():
    assert {module_key(source): name for name, source in shipped_sources()} == listed()["modules"]


@pytest.mark.slow
def test_the_shipped_modules_are_those_that_zig_makes(tmp_path, monkeypatch):
    if find_spec("ziglang") is None or version("ziglang") != listed()["zig"]:
        pytest.skip(f"needs Zig: pip install ziglang=={listed()['zig']}")
    monkeypatch.setenv("DIAGRAMC_CACHE_DIR", str(tmp_path / "cache"))
    made = tmp_path / "made"
    write_shipped(made)
    for file in FOLDER.iterdir():
        assert (made / file.name).read_bytes() == file.read_bytes(), file.name
    assert {file.name for file in made.iterdir()} == {file.name for file in FOLDER.iterdir()}


def test_a_structure_that_is_not_shipped_needs_zig(monkeypatch):
    monkeypatch.setattr(cross, "find_spec", lambda name: None)
    monkeypatch.setattr(web_code, "modules", {})
    with pytest.raises(CompilationError, match=r"Zig is not installed; pip install ziglang$"):
        module_of(reference_source("sine", 0.003))
    key = module_of(reference_source("sine", 0.002))
    assert "defaults" not in web_code.modules[key]["table"]


def test_a_law_in_python_has_no_module():
    scenario = Scenario().with_law(lambda knee_angle, knee_reference: str(knee_angle))
    with pytest.raises(ParameterError, match="has no web module, because it is called as Python"):
        loop_source(scenario)


def test_a_reference_module_follows_its_formula(web_run):
    key = module_of(reference_source("sine", 0.002))
    table = modules[key]["table"]
    assert table["params"] == [
        f"sine.{n}" for n in ("mean_rad", "amplitude_rad", "frequency_hz", "ramp_s")
    ]
    run = web_run(base64.b64decode(modules[key]["code"]))
    columns = run.run(table, ticks=500, params=[0.7, 0.2, 1.5, 0.0])
    w, t = 2.0 * math.pi * 1.5, 0.002 * np.arange(501)
    expected = [
        0.7 - 0.2 * np.cos(w * t),
        0.2 * w * np.sin(w * t),
        0.2 * w**2 * np.cos(w * t),
        -0.2 * w**3 * np.sin(w * t),
    ]
    np.testing.assert_allclose(columns.T, expected, rtol=0, atol=1e-12 * w**3)


MOMENT = {"times_s": [0.0, 1.0], "moments_n_m": [0.0, 5.0]}
SHORT_GAP = {"kind": "samples", "times_s": [0.0, 0.001, 1.0], "angles_deg": [10.0, 11.0, 12.0]}


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"reference": "ramp"},
            r"^reference\.kind = 'ramp': must be 'sine' or 'samples' on a page",
        ),
        (
            {"reference": SHORT_GAP},
            r"^reference\.times_s: rises by 0\.001 s; must rise by at least .* 0\.002 s on a page",
        ),
        (
            {"wearer": {"kind": "leg", "motion": "active", "moment": MOMENT}},
            r"^wearer\.motion = 'active': .* must be 'prescribed' or 'passive' with wearer\.moment",
        ),
    ],
)
def test_a_motion_of_a_wearer_that_a_page_cannot_follow_is_refused(fields, message):
    worn = {"plant": {"load": "knee"}, "wearer": "leg", "simulation": {"duration_s": 1.0}}
    with pytest.raises(ParameterError, match=message):
        loop_source(Scenario.model_validate(worn | fields))


def test_a_cuff_too_stiff_for_the_page_is_refused_with_the_most_it_follows():
    """2.7/(0.002 s/15) = 20250 1/s against b/(m r²), with m = 1.6 kg and r = 36.8 mm."""
    worn = Scenario.model_validate({"plant": {"load": "knee"}, "wearer": "leg"})
    most = 20250 * 1.6 * 0.0368**2
    name = "wearer.cuff.damping_n_m_s_per_rad"
    require_slow_modes(worn.changed({name: 0.98 * most}))
    with pytest.raises(ParameterError, match=f"^{name} = .* must be at most") as caught:
        require_slow_modes(worn.changed({name: 1.5 * most}))
    named = float(re.search(r"at most (\S+) ", str(caught.value))[1])
    assert named == pytest.approx(most, rel=0.01)


@pytest.mark.parametrize(
    ("preset", "changes", "place", "least"),
    [
        # λ = 2807 1/s at 1.6 kg, Table 2; 0.56/(0.002 s/15) = 4200 1/s; λ² is as 1/m
        (
            "paper",
            {"plant.cylinder.mass_kg": 0.3},
            "plant.cylinder.mass_kg",
            1.6 * (2807 / 4200) ** 2,
        ),
        (
            "paper",
            {"plant.motor": {"inertia_kg_m2": 2e-7}, "protection": {"safe_state": "dynamic_brake"}},
            "plant.motor.inertia_kg_m2",
            0.04**2 / (0.15 * 2.7 * 15 / 0.002),
        ),
        # m = I/r² with the largest arm, 107.09 mm
        (
            "leg",
            {"plant.full_order": None, "plant.load.inertia_kg_m2": 0.005},
            "plant.load.inertia_kg_m2",
            1.6 * (2807 / 4200) ** 2 * 0.10709**2,
        ),
    ],
)
def test_a_mode_too_fast_for_the_page_is_refused_with_the_least_value(
    preset, changes, place, least
):
    scenario = Scenario.preset(preset).changed(changes)
    with pytest.raises(ParameterError) as caught:
        require_slow_modes(scenario)
    text = str(caught.value)
    assert text.startswith(f"{place} = ")
    named = float(re.search(r"at least (\S+) ", text)[1])
    assert named == pytest.approx(least, rel=2e-3)
    require_slow_modes(scenario.changed({place: 1.01 * named}))
    with pytest.raises(ParameterError):
        require_slow_modes(scenario.changed({place: 0.99 * named}))


def test_valves_and_friction_of_the_full_order_limit_no_step():
    """RK4 with 60 steps in a sample would need a dead volume of 4.2 ml for its valve."""
    fast = {"plant.full_order.dead_volume_m3": 3e-6, "plant.full_order.friction_band_m_s": 1e-4}
    scenario = Scenario.preset("leg").changed(fast)
    require_slow_modes(scenario)
    tolerances = [loop_source(scenario, smooth=s).rosenbrock_tolerance for s in (False, True)]
    assert tolerances == [1e-6, 1e-12]
    assert loop_source(Scenario()).rosenbrock_tolerance is None
