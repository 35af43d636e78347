"""Each report of pydantic becomes one line without pydantic's words."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from kneexo.errors import ParameterError
from kneexo.parameters import (
    CsvReference,
    CylinderParameters,
    GaitReference,
    NoLoad,
    PidParameters,
    SampledReference,
    Scenario,
    Uncertainty,
    UncertaintySet,
)
from kneexo.parameters.fields.fields import models_of
from kneexo.parameters.fields.messages import one_line
from kneexo.parameters.fields.quantity import Parameters
from kneexo.studies.catalogue import STUDIES

PYDANTIC = re.compile(
    r"Input|instance of|dictionary|discriminator|Unable|extract|\btag|pydantic|valid |Extra|\[type"
)
"""Words that only pydantic uses."""


def parts_of(*models: Any) -> list[type[Parameters]]:
    found = [*models]
    for model in found:  # grows meanwhile
        for field in model.model_fields.values():
            found += [part for part in models_of(field) if part not in found]
    return found


CLASSES = parts_of(
    Scenario,
    CsvReference,
    GaitReference,
    UncertaintySet,
    *(study.computation().settings for study in STUDIES.values()),
)
endless: dict[str, Any] = {}
endless["plant"] = endless
WRONG: list[Any] = [
    *(None, True, 0, -1, 10**5000, 0.5, float("nan"), float("inf"), 1j, "", "x", "1,6", b"x"),
    *((), (1,), ("x",), ((),), [None], {}, {"kind": "x"}, {"x": 1}, {1: 2}, {"kind": None}, set()),
    *(np.array([1.0, 2.0]), np.array(["x"]), object(), PidParameters, NoLoad(), len, endless),
]


def test_the_classes_are_many():
    assert len(CLASSES) > 30
    assert {Uncertainty, CylinderParameters, CsvReference} <= {*CLASSES}


@pytest.mark.parametrize("model", CLASSES)
def test_every_field_refuses_every_wrong_value_in_one_line_of_ours(model: type[Parameters]) -> None:
    needed: dict[Any, Any] = {
        SampledReference: {"times_s": (0.0, 1.0, 2.0), "angles_deg": (1.0, 2.0, 3.0)},
        CsvReference: {"file": "x.csv"},
        Uncertainty: {"low": 1.0, "high": 2.0},
        UncertaintySet: {"values": {"bus": {"low": 1.0, "high": 2.0}}},
    }
    refused = 0
    for name in (*model.model_fields, "nonsense"):
        for value in WRONG:
            try:
                model(**(needed.get(model, {}) | {name: value}))
            except ParameterError as error:
                line = str(error)
                refused += 1
                assert line.isprintable()
                assert len(line) <= 400
                assert not PYDANTIC.search(line), line
                assert line.startswith(f"{model.__name__}: "), line
                assert "must " in line or "unknown name" in line or "cannot be" in line, line
    assert refused >= len(WRONG)


REPORTS = [
    ("union_tag_not_found", ("controller",), {"discriminator": "'kind'"}, "torque, law or a"),
    ("model_type", ("plant",), {"class_name": "PlantParameters"}, "a mapping of names to values"),
    ("recursion_loop", ("plant",), {}, "another value (recursion loop)"),
    ("frozen_instance", ("plant",), {}, "a mapping of names to values"),
    ("invalid_key", ("plant",), {}, "a mapping of names to values"),
    ("string_type", ("controller", "law", "function"), {}, "text"),
    ("is_instance_of", ("encoder",), {"class": "X"}, "a mapping of names to values"),
]


@pytest.mark.parametrize(("kind", "location", "context", "expected"), REPORTS)
def test_a_report_that_values_rarely_cause_is_a_line_too(kind, location, context, expected):
    fault = {"type": kind, "loc": location, "input": 3, "ctx": context}
    report = ValidationError.from_exception_data("Scenario", [fault])
    keys, line = one_line(Scenario, report)
    assert keys == tuple(key for key in location if key != "law")
    assert line.startswith(f"{'.'.join(keys)} = 3: must be ")
    if kind != "recursion_loop":  # no field has this fault alone
        assert expected in line
    assert not PYDANTIC.search(line)


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (lambda: Scenario.model_validate({"plant": 3}), "Scenario: plant = 3: must be a mapping"),
        (lambda: Scenario.model_validate_json("{"), "Scenario: is not JSON: EOF while parsing"),
        (lambda: Scenario.model_validate_json('{"mass_kg": 2}'), "mean plant.cylinder.mass_kg?"),
    ],
)
def test_every_way_to_make_parameters_refuses_in_one_line(make, line):
    with pytest.raises(ParameterError, match=line) as caught:
        make()
    assert str(caught.value).isprintable()


def test_numbers_of_numpy_are_numbers():
    scenario = Scenario().changed(
        {"bus.latency_samples": np.int64(2), "encoder.quantized": np.False_}
    )
    assert type(scenario.bus.latency_samples) is int
    assert scenario.encoder.quantized is False
