"""Every field has unit, range and provenance, and each fault of a value is one line."""

from __future__ import annotations

import copy
import math
import pickle
import re
import typing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from pydantic.fields import FieldInfo

from kneexo.errors import KneexoError, ParameterError
from kneexo.parameters import (
    CylinderParameters,
    ExactParameters,
    FullCylinderParameters,
    KneeLoadParameters,
    KneeParameters,
    LawParameters,
    LinkageParameters,
    MomentTable,
    PidParameters,
    PlantParameters,
    RodPolynomialParameters,
    SampledReference,
    Scenario,
    SlidingModeParameters,
)
from kneexo.parameters.fields.fields import allowed_range, limits_of, source_of, unit_of
from kneexo.parameters.fields.quantity import Parameters
from kneexo.studies.bandwidth import BandwidthSettings


def classes_of(annotation: typing.Any) -> list[type[Parameters]]:
    """The parameter classes that an annotation names, with those of their fields."""
    if isinstance(annotation, type) and issubclass(annotation, Parameters):
        nested = [classes_of(field.annotation) for field in annotation.model_fields.values()]
        return [annotation, *(model for models in nested for model in models)]
    return [model for part in typing.get_args(annotation) for model in classes_of(part)]


def is_number(annotation: typing.Any) -> bool:
    parts = typing.get_args(annotation) if typing.get_origin(annotation) is tuple else [annotation]
    return any(part in (int, float) for part in parts)


OWN_LAW = Path(__file__).parents[3] / "examples" / "own_law.py"
NEEDED = {
    LawParameters: {"function": f"{OWN_LAW}:law"},
    MomentTable: {"times_s": (0.0, 1.0), "moments_n_m": (0.0, 1.0)},
    SampledReference: {"times_s": (0.0, 1.0, 2.0), "angles_deg": (1.0, 2.0, 3.0)},
}
"""What has no default, where numbers are tried."""
CLASSES = list(dict.fromkeys(classes_of(Scenario)))
FIELDS = {
    f"{model.__name__}.{name}": (model, name, field)
    for model in CLASSES
    for name, field in model.model_fields.items()
}
NUMBERS = {key: entry for key, entry in FIELDS.items() if is_number(entry[2].annotation)}
del NUMBERS["LawParameters.initial_state"]  # its units are those of the user's law
del NUMBERS["FaultParameters.size"]  # its unit is that of the place
BOUNDED = {key: entry for key, entry in NUMBERS.items() if entry[2].annotation in (int, float)}


def bounds_of(field: FieldInfo) -> tuple[float, float, bool]:
    """Lower and upper bound, and whether the lower one is excluded."""
    bounds = {
        key: getattr(bound, key)
        for bound in field.metadata
        for key in ("ge", "gt", "le")
        if getattr(bound, key, None) is not None
    }
    return bounds.get("gt", bounds.get("ge")), bounds["le"], "gt" in bounds


def fault(model: type[Parameters], **values: typing.Any) -> str:
    with pytest.raises(ParameterError) as caught:
        model(**(NEEDED.get(model, {}) | values))
    line = str(caught.value)
    assert line.isprintable()
    assert line.startswith(f"{model.__name__}: ")
    return line


# ------------------------------------------------------------------------ introspection


def test_introspection_sees_every_class() -> None:
    assert len(CLASSES) >= 20
    assert len(BOUNDED) >= 60
    assert {LinkageParameters, KneeLoadParameters, PidParameters, SampledReference} <= {*CLASSES}


def test_each_number_has_unit_range_and_provenance() -> None:
    kinds = "Tables? |Sections? |Eq\\. |Fig\\. |assumption|given by the user|standard gravity"
    kinds += "|Winter 2009|arXiv |result: "
    run = "three periods|the control period|accuracy of|rod position minus reference"
    for key, (_, _, field) in NUMBERS.items():
        assert unit_of(field), key
        listed = typing.get_origin(field.annotation) is tuple
        assert listed or re.fullmatch(r">=? \S+ and <= \S+", allowed_range(field)), key
        assert re.match(f"({kinds}|{run})", source_of(field)), key


def test_no_class_has_a_validator_that_changes_its_values() -> None:
    # Otherwise a copy with changed numbers would need the whole validation.
    for model in CLASSES:
        validators = model.__pydantic_decorators__.model_validators
        modes = {v.info.mode for name, v in validators.items() if name != "_completed"}
        assert modes <= {"after"}, model


def test_limits_are_numbers_that_the_field_takes() -> None:
    """An open end is the next number beyond it."""
    fields = FullCylinderParameters.model_fields
    low, high = limits_of(fields["relief_pressure_pa"])
    assert (low, high) == (math.nextafter(1e6, math.inf), 1e9)
    assert FullCylinderParameters(relief_pressure_pa=low).relief_pressure_pa == low
    assert limits_of(fields["dead_volume_m3"])[0] > 0.0
    assert limits_of(PlantParameters.model_fields["rod_map"]) == (-math.inf, math.inf)


def test_choices_have_a_provenance() -> None:
    for key, (_, name, field) in FIELDS.items():
        assert source_of(field) or classes_of(field.annotation) or name == "kind", key


SUFFIXES = {
    "(rad/s)/N": "_rad_s_per_n",
    "(rad/s²)/N": "_rad_s2_per_n",
    "N·m/rad": "_n_m_per_rad",
    "N·m·s/rad": "_n_m_s_per_rad",
    "kg·m²": "_kg_m2",
    "1": "",
    "deg": "_deg",
    "deg/s": "_deg_s",
    "deg/mm^n": "_deg_mm",
    "Hz": "_hz",
    "kg": "_kg",
    "m": "_m",
    "m/s": "_m_s",
    "m/s²": "_m_s2",
    "m/s³": "_m_s3",
    "m³": "_m3",
    "m³/(s·Pa)": "_m3_per_s_pa",
    "m³/rad": "_m3_per_rad",
    "mm": "_mm",
    "mm/deg^n": "_mm_deg",
    "N": "_n",
    "N/(m/s)": "_n_s_per_m",
    "N/m": "_n_per_m",
    "N/s": "_n_per_s",
    "N·m": "_n_m",
    "N·m/A": "_n_m_per_a",
    "A": "_a",
    "V": "_v",
    "Ω": "_ohm",
    "°C": "_degc",
    "J/K": "_j_per_k",
    "K/W": "_k_per_w",
    "1/K": "_per_k",
    "s/m": "_s_per_m",
    "Pa": "_pa",
    "rad": "_rad",
    "rpm": "_rpm",
    "rad/s": "_rad_s",
    "rad/s²": "_rad_s2",
    "s": "_s",
    "samples": "_samples",
    "W": "_w",
    "1/s": "_per_s",
    "1/s²": "_per_s2",
}


def test_each_name_ends_with_the_unit() -> None:
    for key, (_, name, field) in NUMBERS.items():
        longest = max((s for s in SUFFIXES.values() if name.endswith(s)), key=len)
        assert longest == SUFFIXES[unit_of(field)], key


def test_classes_are_documented_and_frozen() -> None:
    for model in CLASSES:
        assert model.__doc__, model
        instance = model(**NEEDED.get(model, {}))
        for name in model.model_fields:
            with pytest.raises(ParameterError, match=f"{model.__name__} is frozen; .*{name}"):
                setattr(instance, name, getattr(instance, name))
        assert hash(instance) == hash(instance.model_copy())


# ------------------------------------------------------------------------------- faults


def assert_tells(
    line: str, name: str, value: str, field: FieldInfo, *, is_number: bool = True
) -> None:
    """The line names the field, its value, its range and, unless it is a pure number, its unit."""
    unit = "" if unit_of(field) == "1" else f" {unit_of(field)}"
    assert f": {name} = {value}{unit if is_number else ''}" in line
    assert line.endswith(f"{allowed_range(field)}{unit}")


def test_each_number_must_be_a_finite_number() -> None:
    for model, name, field in BOUNDED.values():
        for value in (math.nan, math.inf, -math.inf):
            line = fault(model, **{name: value})
            assert_tells(line, name, f"{value:g}", field)
            assert field.annotation is int or "is out of range: must be finite and " in line
        for value in ("1", True, (1.0,), {}):
            line = fault(model, **{name: value})
            assert_tells(line, name, f"{value!r}: must be", field, is_number=False)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf], ids=str)
def test_samples_and_coefficients_must_be_finite(value: float) -> None:
    angles = {"angles_deg": (1.0, 2.0, 3.0)}
    line = fault(SampledReference, times_s=(0.0, 1.0, value), **angles)
    assert line.startswith(
        f"SampledReference: times_s.2 = {value:g} s is out of range: must be fin"
    )
    line = fault(RodPolynomialParameters, p_mm_deg=(1.0, value, 3.0, 4.0, 5.0, 6.0))
    assert line.startswith(f"RodPolynomialParameters: p_mm_deg.1 = {value:g} mm/deg^n is out of")


def test_bounds_are_exact() -> None:
    for model, name, field in BOUNDED.values():
        low, high, exclusive = bounds_of(field)
        if field.annotation is int:
            outside = (low - 1, high + 1)
        else:
            outside = (low if exclusive else math.nextafter(low, -1e9), math.nextafter(high, 1e99))
        for value in outside:
            line = fault(model, **{name: value})
            shown = "int" if field.annotation is int else f"{value:g}"
            assert_tells(line, name, repr(value) if f" = {value!r}" in line else shown, field)
            assert "is out of range" in line


COUPLED = (
    *("must be below", "must not exceed", "must be at least", "must be 0 or >="),
    *("must be at most", "seed must be given"),
)


@given(data=st.data(), key=st.sampled_from(sorted(BOUNDED)))
def test_value_inside_the_range_is_accepted_and_kept(data: st.DataObject, key: str) -> None:
    model, name, field = BOUNDED[key]
    low, high, exclusive = bounds_of(field)
    value = data.draw(
        st.integers(low, high)
        if field.annotation is int
        else st.floats(low, high, exclude_min=exclusive)
    )
    try:
        assert getattr(model(**(NEEDED.get(model, {}) | {name: value})), name) == value
    except ParameterError as error:  # a neighbour's default does not fit
        assert any(reason in str(error) for reason in COUPLED)  # noqa: PT017 (only some draws raise)


@pytest.mark.parametrize(
    ("model", "values", "line"),
    [
        (
            RodPolynomialParameters,
            {"p_mm_deg": (1.0, 2.0, 3.0, 4.0, 5.0, 1e5)},
            "p_mm_deg.5 = 100000 mm/deg^n is out of range: "
            "must be finite and >= -10000 and <= 10000 mm/deg^n",
        ),
        (
            BandwidthSettings,
            {"frequencies_hz": (0.1, 0.2)},
            "frequencies_hz has 2 values: must have at least 3",
        ),
        (
            KneeParameters,
            {"mass_kg": 3.0},
            "mass_kg: unknown name; Scenario has plant.cylinder.mass_kg",
        ),
        (
            CylinderParameters,
            {"rod_diameter_m": 0.02},
            "rod_diameter_m = 0.02 m must be below 0.98 times bore_m = 0.02 m",
        ),
        (
            SlidingModeParameters,
            {"mass_min_kg": 2.0},
            "mass_min_kg = 2 kg must not exceed mass_max_kg = 1.8 kg",
        ),
        (
            SampledReference,
            {"times_s": (0.0, 1.0, 2.0), "angles_deg": (1.0,) * 4},
            "times_s has 3 values and angles_deg has 4: must be as many, at least 3",
        ),
        (
            SampledReference,
            {"times_s": (0.0, 1.0, 1.0), "angles_deg": (1.0,) * 3},
            "times_s must increase by at least 1e-6 s from sample to sample",
        ),
        (
            SampledReference,
            {"times_s": None},
            "times_s has no value: must be a list of numbers",
        ),
        (
            Scenario,
            {
                "controller": SlidingModeParameters(continuous=True),
                "estimator": ExactParameters(),
                "bus": {"latency_samples": 1},
            },
            "bus.kind = none with latency_samples = 1 needs a discrete controller",
        ),
    ],
)
def test_fault_is_one_line(
    model: type[Parameters], values: dict[str, typing.Any], line: str
) -> None:
    assert fault(model, **values) == f"{model.__name__}: {line}"


def test_parameter_error_is_a_value_error() -> None:
    assert issubclass(ParameterError, ValueError)
    assert issubclass(ParameterError, KneexoError)


def test_integers_become_floats() -> None:
    mass = CylinderParameters(mass_kg=2).mass_kg
    assert isinstance(mass, float)


# ------------------------------------------------------------------------------- arrays


class Column:
    """What a pandas column offers."""

    def __init__(self, values: list[float]) -> None:
        self.values = values

    def tolist(self) -> list[float]:
        return self.values


@pytest.mark.parametrize("make", [list, np.array, Column], ids=["list", "array", "column"])
def test_arrays_are_accepted_where_tuples_are_asked_for(make: typing.Any) -> None:
    times, angles = [0.0, 1.0, 2.0], [10.0, 20.0, 15.0]
    made = SampledReference(times_s=make(times), angles_deg=make(angles))
    assert made == SampledReference(times_s=tuple(times), angles_deg=tuple(angles))
    assert {type(value) for value in made.times_s} == {float}
    assert hash(made)  # models are cached by their scenarios


def test_a_number_is_a_tuple_of_one_where_any_length_is_valid() -> None:
    assert BandwidthSettings(amplitudes_deg=1).amplitudes_deg == (1.0,)
    assert "must be a list of numbers" in fault(RodPolynomialParameters, p_mm_deg=1.0)
    assert "must be a list of numbers" in fault(BandwidthSettings, amplitudes_deg=True)


def test_arrays_of_wrong_shape_or_type_are_refused() -> None:
    two = fault(SampledReference, times_s=np.ones((2, 2)), angles_deg=(1.0, 2.0, 3.0))
    assert "times_s.0" in two
    assert "must be a number" in two
    text = fault(SampledReference, times_s="012", angles_deg=(1.0,) * 3)
    assert "must be a list of numbers" in text


# ------------------------------------------------------------------------------ frozen


def test_an_assignment_names_the_call_that_changes_the_value() -> None:
    scenario = Scenario()
    with pytest.raises(ParameterError) as caught:
        scenario.plant.cylinder.mass_kg = 2  # type: ignore[misc]
    call = 'scenario.changed({"plant.cylinder.mass_kg": 2})'
    assert str(caught.value) == f"CylinderParameters is frozen; make a changed copy: {call}"
    assert eval(call, {"scenario": scenario}).plant.cylinder.mass_kg == 2.0
    with pytest.raises(ParameterError, match=r'parameters\.changed\(\{"frequencies_hz": 3\}\)$'):
        BandwidthSettings().frequencies_hz = 3
    with pytest.raises(ParameterError, match=r"^CylinderParameters is frozen"):
        del scenario.plant.cylinder.mass_kg
    with pytest.raises(ParameterError, match=r"no attribute mass; did you mean mass_kg\?$"):
        scenario.plant.cylinder.mass = 2  # type: ignore[attr-defined]
    assert scenario == Scenario()


def test_an_unknown_attribute_has_a_suggestion() -> None:
    scenario = Scenario()
    with pytest.raises(AttributeError, match=r"^Scenario has .* plant\.cylinder\.mass_kg\?$"):
        scenario.mass_kg  # type: ignore[attr-defined]  # noqa: B018
    with pytest.raises(AttributeError, match=r"\(needs controller\.kind = pid\)$"):
        scenario.controller.integral_per_s2  # type: ignore[union-attr]  # noqa: B018
    assert not hasattr(scenario, "__array__")
    assert getattr(scenario.plant, "wheel", None) is None
    assert pickle.loads(pickle.dumps(scenario)) == copy.deepcopy(scenario) == scenario
