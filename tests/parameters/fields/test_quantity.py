"""Limits, faults, arrays and frozen values of parameters; each field: `test_every_class.py`."""

from __future__ import annotations

import copy
import math
import pickle
import typing

import numpy as np
import pytest

from kneexo.errors import ParameterError
from kneexo.parameters import (
    CylinderParameters,
    FullCylinderParameters,
    PlantParameters,
    RodPolynomialParameters,
    SampledReference,
    Scenario,
    SlidingModeParameters,
)
from kneexo.parameters.fields.fields import limits_of
from kneexo.parameters.fields.quantity import Parameters
from kneexo.studies.bandwidth import BandwidthSettings


def fault(model: type[Parameters], **values: typing.Any) -> str:
    with pytest.raises(ParameterError) as caught:
        model(**values)
    line = str(caught.value)
    assert line.isprintable()
    assert line.startswith(f"{model.__name__}: ")
    return line


# ------------------------------------------------------------------------ introspection


def test_limits_are_numbers_that_the_field_takes() -> None:
    """An open end is the next number beyond it."""
    fields = FullCylinderParameters.model_fields
    low, high = limits_of(fields["relief_pressure_pa"])
    assert (low, high) == (math.nextafter(1e6, math.inf), 1e9)
    assert FullCylinderParameters(relief_pressure_pa=low).relief_pressure_pa == low
    assert limits_of(fields["dead_volume_m3"])[0] > 0.0
    assert limits_of(PlantParameters.model_fields["rod_map"]) == (-math.inf, math.inf)


# ------------------------------------------------------------------------------- faults


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf], ids=str)
def test_samples_and_coefficients_must_be_finite(value: float) -> None:
    angles = {"angles_deg": (1.0, 2.0, 3.0)}
    line = fault(SampledReference, times_s=(0.0, 1.0, value), **angles)
    assert line.startswith(
        f"SampledReference: times_s.2 = {value:g} s is out of range: must be fin"
    )
    line = fault(RodPolynomialParameters, p_mm_deg=(1.0, value, 3.0, 4.0, 5.0, 6.0))
    assert line.startswith(f"RodPolynomialParameters: p_mm_deg.1 = {value:g} mm/deg^n is out of")


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
            {"times_s": None, "angles_deg": (1.0,) * 3},
            "times_s has no value: must be a list of numbers",
        ),
    ],
)
def test_fault_is_one_line(
    model: type[Parameters], values: dict[str, typing.Any], line: str
) -> None:
    assert fault(model, **values) == f"{model.__name__}: {line}"


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
