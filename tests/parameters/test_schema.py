"""The JSON schema accepts what kneexo loads and refuses what it refuses."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from jsonschema import Draft7Validator

from kneexo.errors import ScenarioError
from kneexo.parameters import LINKAGES, Scenario
from kneexo.parameters.scenario_file import dump_scenario, load_scenario
from kneexo.parameters.schema import json_schema

README = Path(__file__).parents[2] / "README.md"


class EditorLoader(yaml.SafeLoader):
    """Reads 5e7 as a number, as YAML 1.2 and editors do; PyYAML takes it for text."""


EditorLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+"), list("-+0123456789")
)


@pytest.fixture(scope="module")
def schema():
    return json_schema()


def errors(schema, text):
    """Faults of a scenario file, as an editor shows them."""
    data = yaml.load(text, EditorLoader)
    return [error.message for error in Draft7Validator(schema).iter_errors(data)]


def test_schema_is_valid_and_names_its_draft(schema):
    Draft7Validator.check_schema(schema)
    assert schema["$schema"] == "http://json-schema.org/draft-07/schema#"


def test_schema_has_units_and_ranges(schema):
    mass = schema["$defs"]["CylinderParameters"]["properties"]["mass_kg"]
    assert mass["unit"] == "kg"
    assert mass["minimum"] == 0.01
    assert mass["maximum"] == 1000
    assert mass["description"].startswith("kg; >= 0.01 and <= 1000; Table 2: mass m of Eq. 16")


def test_every_value_has_a_description(schema):
    for name, model in schema["$defs"].items():
        for field, value in model["properties"].items():
            nested = {"$ref", "oneOf", "anyOf"} & set(value)
            assert nested or field == "kind" or value["description"], f"{name}.{field}"


VALID = [
    "{preset: leg, plant: {linkage: G3}, controller: {kind: pid, proportional_per_s: 10}}",
    dump_scenario(Scenario()),
    *(f"plant: {{linkage: {name}}}" for name in LINKAGES),
    "plant: {linkage: {a_2_m: 0.033}}",
    "plant: {full_order: {entrained_air: 0.01}}",
    "reference: {frequency_hz: 0.2}",
    "reference: gait",
    "reference: gait.csv",
    "reference: {kind: csv, file: gait.csv, cycles: 2, flexion: positive}",
    "reference: gait.mot",
    "parts: {cylinder: own.py:make}",
    "reference: {kind: gait, cycles: 3}",
    "reference: {kind: samples, times_s: [0, 1, 2], angles_deg: [3, 4, 5], interpolation: pchip}",
    *(f"controller: {word}" for word in ("smc", "pid")),
    *(f"estimator: {word}" for word in ("observer", "difference", "exact")),
    *(f"bus: {word}" for word in ("none", "cia402", "can")),
    *(f"reference: {word}" for word in ("sine", "step", "ramp")),
    *(f"plant: {{load: {word}}}" for word in ("none", "knee")),
    "plant: {full_order: true}",
    "plant: {full_order: false}",
    "plant: {load: knee}\nwearer: {kind: leg, moment: gait}",
    "plant: {load: knee}\nwearer: {kind: leg, moment: {kind: gait, body_mass_kg: 60}}",
    "plant: {load: knee}\nwearer: {kind: leg, moment: moment.csv}",
    "plant: {load: knee}\nwearer: {kind: leg, moment: {file: moment.csv, flexion: negative}}",
    "estimator: {}",
    "bus: {latency_samples: 2}",
    "bus: {kind: cia402, velocity_unit_rpm: 1, latency_samples: 1}",
    "bus: {kind: cia402, velocity_unit_rpm: 0.1}",
]


@pytest.mark.parametrize("text", VALID)
def test_schema_accepts_what_loads(schema, text, tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(text, encoding="utf-8")
    (tmp_path / "gait.csv").write_text("time_s,knee_angle_deg\n0,1\n1,2\n2,3\n")
    (tmp_path / "gait.mot").write_text(
        "inDegrees=yes\nendheader\ntime knee_angle_deg\n0 1\n1 2\n3 2"
    )
    (tmp_path / "own.py").touch()
    (tmp_path / "moment.csv").write_text("time_s,knee_moment_nm\n0,1\n30,2\n")
    load_scenario(path)
    assert errors(schema, text) == []


@pytest.mark.parametrize(
    "text",
    [
        "plant: {linkage: G9}",
        "plant: {linkage: {a_2_m: 0}}",
        "plant: {cylinder: {mass: 1}}",
        "polynomial: {p_mm_deg: [1, 2]}",
        "polynomial: {p_mm_deg: [1, 2, 3, 4, 5, many]}",
        "polynomial: {p_mm_deg: [1, 2, 3, 4, 5, 1e9]}",
        "controller: {proportional_per_s: 10}",
        "controller: {kind: pid, lambda_per_s: 10}",
        "reference: walk",
        "reference: samples",
        "reference: csv",
        "controller: law",
        "controller: lqr",
        "bus: CAN",
        "plant: {full_order: 1}",
        "reference: {kind: csv}",
        "reference: {kind: csv, file: gait.csv, period_s: 0}",
        "reference: {kind: csv, file: gait.csv, flexion: up}",
        "reference: {kind: samples, times_s: [0, 1], angles_deg: [3, 4]}",
        "plant: {load: knee}\nwearer: {kind: leg, moment: walk}",
        "plant: {load: knee}\nwearer: {kind: leg, moment: {kind: gait, body_mass_kg: 0}}",
        "plant: {load: knee}\nwearer: {kind: leg, moment: {body_mass_kg: 60}}",
        "bus: {latency_samples: 11}",
        "bus: {velocity_unit_rpm: 1}",
        "bus: {kind: cia402, velocity_unit_rpm: 0.5}",
    ],
)
def test_schema_refuses_what_does_not_load(schema, text, tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError):
        load_scenario(path)
    assert errors(schema, text)
