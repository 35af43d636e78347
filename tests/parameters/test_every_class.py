"""The contract of every class of parameters and settings, field by field.

A number has a unit, which ends its name, a range and a provenance. What no field takes is refused
in one line that names the field, its value, its unit and its range.
"""

from __future__ import annotations

import math
import re
import typing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from kneexo.errors import ParameterError
from kneexo.parameters import (
    CsvReference,
    GaitReference,
    LawParameters,
    MomentTable,
    NoLoad,
    PidParameters,
    SampledReference,
    Scenario,
    Uncertainty,
    UncertaintySet,
)
from kneexo.parameters.device.parts import PartParameters
from kneexo.parameters.fields.fields import allowed_range, limits_of, models_of, source_of, unit_of
from kneexo.parameters.fields.quantity import Parameters
from kneexo.studies.catalogue import STUDIES
from kneexo.studies.contest import Contestant

OWN_LAW = Path(__file__).parents[2] / "examples" / "own_law.py"
NEEDED: dict[typing.Any, dict[str, typing.Any]] = {
    Contestant: {"controller": "smc", "gains": {"lambda_per_s": {"low": 1.0, "high": 2.0}}},
    CsvReference: {"file": "x.csv"},
    LawParameters: {"function": f"{OWN_LAW}:law"},
    PartParameters: {"make": f"{OWN_LAW}:law"},
    MomentTable: {"times_s": (0.0, 1.0), "moments_n_m": (0.0, 1.0)},
    SampledReference: {"times_s": (0.0, 1.0, 2.0), "angles_deg": (1.0, 2.0, 3.0)},
    Uncertainty: {"low": 1.0, "high": 2.0},
    UncertaintySet: {"values": {"bus": {"low": 1.0, "high": 2.0}}},
}
"""What has no default."""


def parts_of(*models: typing.Any) -> list[type[Parameters]]:
    """Return the classes and those of their fields."""
    found = [*models]
    for model in found:  # grows meanwhile
        for field in model.model_fields.values():
            found += [part for part in models_of(field) if part not in found]
    return found


def is_number(annotation: typing.Any) -> bool:
    parts = typing.get_args(annotation) if typing.get_origin(annotation) is tuple else [annotation]
    return any(part in (int, float) for part in parts)


OF_SCENARIOS = parts_of(Scenario)
CLASSES = parts_of(
    Scenario,
    CsvReference,
    GaitReference,
    UncertaintySet,
    *(study.computation().settings for study in STUDIES.values()),
)
FIELDS = {
    f"{model.__name__}.{name}": (model, name, field)
    for model in CLASSES
    for name, field in model.model_fields.items()
}
NUMBERS = {key: entry for key, entry in FIELDS.items() if is_number(entry[2].annotation)}
for key in ("LawParameters.initial_state", "FaultParameters.size"):
    del NUMBERS[key]  # their units are those of the user's law and of the place
BOUNDED = {key: entry for key, entry in NUMBERS.items() if entry[2].annotation in (int, float)}
every_class = pytest.mark.parametrize("model", CLASSES)
each_number = pytest.mark.parametrize("key", BOUNDED)


def made(model: typing.Any, **values: typing.Any) -> typing.Any:
    return model(**(NEEDED.get(model, {}) | values))


def test_introspection_sees_every_class() -> None:
    assert len(CLASSES) >= 55
    assert len(BOUNDED) >= 150


SOURCE = re.compile(
    r"Tables? |Sections? |Eq\. |Fig\. |assumption|given by the user|standard gravity|Winter 2009|"
    r"arXiv |result: |three periods|the control period|accuracy of|rod position minus reference|"
    r"OpenSim model |the file once|stroke of |least margin of |kneexo size: "
)
SUFFIXES = {
    "1": "", "mm/deg^n": "_mm_deg", "deg/mm^n": "_deg_mm", "°C": "_degc", "Ω": "_ohm",
    "(rad/s)/N": "_rad_s_per_n", "(rad/s²)/N": "_rad_s2_per_n", "N/(m/s)": "_n_s_per_m",
    "m³/(s·Pa)": "_m3_per_s_pa", "m³/rad": "_m3_per_rad", "rad/s": "_rad_s", "deg/s": "_deg_s",
    "m/s": "_m_s", "m/s²": "_m_s2", "m/s³": "_m_s3", "rad/s²": "_rad_s2",
}  # fmt: skip
"""Ends of names that are not those of `suffix`."""


def suffix(unit: str) -> str:
    """The end of a name for a unit: ``N·m/rad`` is ``_n_m_per_rad``."""
    plain = unit.lower().translate(str.maketrans("²³·", "23_")).replace("/", "_per_")
    return SUFFIXES.get(unit, "_" + plain.removeprefix("1_"))


ALL_SUFFIXES = {suffix(unit_of(field)) for _, _, field in NUMBERS.values()}


@pytest.mark.parametrize("key", NUMBERS)
def test_a_number_has_unit_range_and_provenance(key: str) -> None:
    model, name, field = NUMBERS[key]
    listed = typing.get_origin(field.annotation) is tuple
    assert listed or re.fullmatch(r">=? \S+( and <= \S+)?", allowed_range(field))
    assert listed or "<=" in allowed_range(field) or name.endswith("seed")
    assert SOURCE.match(source_of(field))
    assert unit_of(field)
    longest = max((end for end in ALL_SUFFIXES if name.endswith(end)), key=len)
    counts_samples = longest == "_samples" and model not in OF_SCENARIOS  # of a distribution
    assert longest == suffix(unit_of(field)) or counts_samples


@every_class
def test_a_class_is_documented_frozen_and_its_own_plain_data(model: typing.Any) -> None:
    assert model.__doc__
    instance = made(model)
    for name, field in model.model_fields.items():
        told = source_of(field) or models_of(field) or name == "kind"
        assert told or model in (Contestant, Uncertainty)
        with pytest.raises(ParameterError, match=f"{model.__name__} is frozen; .*{name}"):
            setattr(instance, name, getattr(instance, name))
    assert made(model, **instance.model_dump()) == instance
    assert model.model_validate_json(instance.model_dump_json()) == instance


@pytest.mark.parametrize("model", OF_SCENARIOS)
def test_a_part_of_a_scenario_can_be_hashed_and_changed_number_by_number(model: typing.Any) -> None:
    instance = made(model)
    assert hash(instance) == hash(instance.model_copy())
    # A validator that changes values would need the whole validation of a copy.
    validators = model.__pydantic_decorators__.model_validators
    modes = {v.info.mode for name, v in validators.items() if name != "_completed"}
    assert modes <= {"after"}


# ------------------------------------------------------------------------------- faults


def fault(model: typing.Any, **values: typing.Any) -> str:
    with pytest.raises(ParameterError) as caught:
        made(model, **values)
    line = str(caught.value)
    assert line.isprintable()
    assert line.startswith(f"{model.__name__}: ")
    return line


@each_number
def test_a_number_must_be_finite_and_in_its_range_whose_ends_are_exact(key: str) -> None:
    model, name, field = BOUNDED[key]
    low, high = limits_of(field)
    unit = "" if unit_of(field) == "1" else f" {unit_of(field)}"
    if field.annotation is int:
        ends = ((low, -1), (high, 1))  # a seed has no upper end
        outside: list[float] = [int(end) + step for end, step in ends if math.isfinite(end)]
    else:
        outside = [math.nextafter(low, -math.inf), math.nextafter(high, math.inf)]
        assert field.is_required() or field.default is None or low <= field.default <= high
    for value in (*outside, math.nan, math.inf, -math.inf):
        line = fault(model, **{name: value})
        shown = f"{value:g}" if math.isnan(value) or value == float(f"{value:g}") else repr(value)
        assert f": {name} = {shown}{unit}" in line
        assert line.endswith(f"{allowed_range(field)}{unit}")
        assert field.annotation is int or "is out of range: must be finite and " in line
    for value in ("1", True, (1.0,), {}):
        line = fault(model, **{name: value})
        assert f": {name} = {value!r}: must be" in line
        assert line.endswith(f"{allowed_range(field)}{unit}")


COUPLED = (
    *("must be below", "must not exceed", "must be at least", "must be less than"),
    *("must be 0 or >=", "must be at most", "must be <", "must be more than", "seed must be given"),
)


@given(data=st.data(), key=st.sampled_from(sorted(BOUNDED)))
def test_a_value_inside_the_range_is_accepted_and_kept(data: st.DataObject, key: str) -> None:
    model, name, field = BOUNDED[key]
    low, high = limits_of(field)
    whole = field.annotation is int
    most = int(high) if math.isfinite(high) else None
    value = data.draw(st.integers(int(low), most) if whole else st.floats(low, high))
    try:
        assert getattr(made(model, **{name: value}), name) == value
    except ParameterError as error:  # a neighbour's default does not fit
        assert any(reason in str(error) for reason in COUPLED)  # noqa: PT017 (only some draws raise)


PYDANTIC = re.compile(
    r"Input|instance of|dictionary|discriminator|Unable|extract|\btag|pydantic|valid |Extra|\[type"
)
"""Words that only pydantic uses."""
endless: dict[str, typing.Any] = {}
endless["plant"] = endless
WRONG: list[typing.Any] = [
    *(None, True, 0, -1, 10**5000, 0.5, float("nan"), float("inf"), 1j, "", "x", "1,6", b"x"),
    *((), (1,), ("x",), ((),), [None], {}, {"kind": "x"}, {"x": 1}, {1: 2}, {"kind": None}, set()),
    *(np.array([1.0, 2.0]), np.array(["x"]), object(), PidParameters, NoLoad(), len, endless),
]


@every_class
def test_every_field_refuses_every_wrong_value_in_one_line_of_ours(model: typing.Any) -> None:
    refused = 0
    for name in (*model.model_fields, "nonsense"):
        for value in WRONG:
            try:
                made(model, **{name: value})
            except ParameterError as error:
                line = str(error)
                refused += 1
                assert line.isprintable()
                assert len(line) <= 400
                assert not PYDANTIC.search(line), line
                assert line.startswith(f"{model.__name__}: "), line
                assert re.search("must |unknown name|cannot be|has no argument", line), line
    assert refused >= len(WRONG)
