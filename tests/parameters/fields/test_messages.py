"""Each report of pydantic becomes one line without pydantic's words."""

from __future__ import annotations

import re

import numpy as np
import pytest
from pydantic import ValidationError

from kneexo.errors import ParameterError
from kneexo.parameters import Scenario
from kneexo.parameters.fields.messages import one_line

PYDANTIC = re.compile(
    r"Input|instance of|dictionary|discriminator|Unable|extract|\btag|pydantic|valid |Extra|\[type"
)
"""Words that only pydantic uses."""


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
