"""Values of parameters by dotted paths."""

import math
import re
import typing

import numpy as np
import pytest

from kneexo.errors import ParameterError
from kneexo.parameters import (
    G2,
    CylinderParameters,
    FullCylinderParameters,
    KneeLoadParameters,
    PidParameters,
    PlantParameters,
    Scenario,
)
from kneexo.parameters.paths import changed, has_path, known_path, value_at


def test_changed_gives_a_validated_copy() -> None:
    base = Scenario(plant=PlantParameters(load=KneeLoadParameters()))
    copy = changed(
        base,
        {
            "plant.cylinder.mass_kg": 1.8,
            "plant.linkage": "G2",
            "plant.full_order": {"coulomb_friction_n": 40.0},
            "plant.load.knee_torque_n_m": 3.0,
            "bus.latency_samples": 2,
        },
    )
    assert copy.plant.cylinder == CylinderParameters(mass_kg=1.8)
    assert copy.plant.linkage == G2
    assert copy.plant.full_order is not None
    assert copy.plant.full_order.coulomb_friction_n == 40.0
    assert copy.plant.load == KneeLoadParameters(knee_torque_n_m=3.0)
    assert copy.bus.latency_samples == 2
    assert base == Scenario(plant=PlantParameters(load=KneeLoadParameters()))
    assert changed(base, {}) == base


def test_changed_validates_only_what_it_changes() -> None:
    base = Scenario()
    copy = changed(base, {"plant.cylinder.mass_kg": 1.9})
    assert copy.plant.pump is base.plant.pump
    assert copy.controller is base.controller
    assert copy.plant.cylinder == CylinderParameters(mass_kg=1.9)
    # Conditions between values hold for all of them.
    with pytest.raises(ParameterError, match="leaves the range of motion"):
        changed(base, {"plant.knee.flexion_max_deg": 60.0})


def test_changed_reaches_into_a_part_that_it_was_given() -> None:
    base = Scenario()
    copy = changed(base, {"nominal": base.plant, "nominal.cylinder.mass_kg": 1.9})
    assert copy.nominal is not None
    assert (copy.nominal.cylinder.mass_kg, copy.plant.cylinder.mass_kg) == (1.9, 1.6)
    assert base.plant.cylinder.mass_kg == 1.6


def test_changed_leaves_its_argument_alone() -> None:
    values: dict[str, object] = {
        "plant.full_order": {"coulomb_friction_n": 40.0},
        "plant.full_order.coulomb_friction_n": 30.0,
    }
    copy = changed(Scenario(), values)
    assert copy.plant.full_order is not None
    assert copy.plant.full_order.coulomb_friction_n == 30.0
    assert values["plant.full_order"] == {"coulomb_friction_n": 40.0}


@pytest.mark.parametrize(
    ("path", "remedy"),
    [
        ("plant.pomp.lag_s", "did you mean plant.pump.lag_s?"),
        ("plant.pomp.x", "did you mean plant.pump?"),
        ("x.y", "known here: bus, controller, "),
    ],
)
def test_a_path_that_the_scenario_does_not_have_is_refused(path: str, remedy: str) -> None:
    with pytest.raises(ParameterError, match=re.escape(f"{path}: unknown name; {remedy}")):
        changed(Scenario(), {path: 0.01})


def test_a_value_is_read_where_the_attributes_lead() -> None:
    scenario = Scenario()
    assert value_at(scenario, "plant.cylinder.mass_kg") == scenario.plant.cylinder.mass_kg
    assert value_at(scenario.plant, "cylinder") is scenario.plant.cylinder
    assert value_at(scenario, "plant.wheel.mass_kg") is None


@pytest.mark.parametrize(
    ("path", "exists", "is_known"),
    [
        ("plant.cylinder.mass_kg", True, True),
        ("plant.cylinder", True, True),
        ("controller.integral_per_s2", False, True),  # of another control law
        ("bus.velocity_unit_rpm", False, True),
        ("plant.cylinder.colour", False, False),
        ("plant.cylinder.mass_kg.value", False, False),
        ("command_limit_rad_s", False, False),  # a property is no parameter
        ("", False, False),
    ],
)
def test_a_path_of_another_structure_is_known_but_absent(
    path: str, exists: bool, is_known: bool
) -> None:
    assert has_path(Scenario(), path) is exists
    assert known_path(path) is is_known


def test_the_order_of_the_paths_does_not_matter() -> None:
    values = {"controller.proportional_per_s": 3.0, "controller.kind": "pid"}
    for items in (values.items(), reversed(values.items())):
        assert changed(Scenario(), dict(items)).controller == PidParameters(proportional_per_s=3.0)
    whole = {"plant.cylinder.mass_kg": 2.0, "plant": PlantParameters(ideal_motor=True)}
    plant = changed(Scenario(), whole).plant
    assert (plant.cylinder.mass_kg, plant.ideal_motor) == (2.0, True)


def test_the_same_kind_keeps_the_values_of_a_part() -> None:
    base = Scenario(controller=PidParameters(integral_per_s2=7.0))
    assert changed(base, {"controller.kind": "pid"}) == base
    assert changed(base, {"controller.kind": "smc"}).controller == Scenario().controller


@pytest.mark.parametrize("values", [3, {3: 2}, "plant"])
def test_values_that_are_no_mapping_are_refused(values) -> None:
    with pytest.raises(ParameterError, match="must have a mapping from paths to values"):
        changed(Scenario(), values)


# ------------------------------------------------------------- numbers without whole validation


def validated(scenario: Scenario, values: dict[str, typing.Any]) -> Scenario | str:
    """The scenario with changed values by pydantic alone, or the text of its error."""
    data = scenario.model_dump()
    for path, value in values.items():
        *parents, name = path.split(".")
        holder = data
        for parent in parents:
            holder = holder[parent]
        holder[name] = value
    try:
        return Scenario(**data)
    except ParameterError as error:
        return str(error)


@pytest.mark.parametrize(
    "values",
    [
        {"plant.cylinder.mass_kg": 1.7},
        {"plant.cylinder.mass_kg": 1.7, "initial_offset_m": 0.01, "plant.pump.lag_s": 0.02},
        {"plant.cylinder.bore_m": 0.011, "plant.cylinder.rod_diameter_m": 0.0107},
        {"simulation.duration_s": 3.0, "encoder.mounting_error_rad": -0.001},
        {"plant.knee.flexion_min_deg": 5.0, "plant.knee.flexion_max_deg": 80.0},
        # faults: a range, a rule of one class, a rule across classes, a wrong type
        {"plant.cylinder.mass_kg": 1e9},
        {"plant.cylinder.mass_kg": -1.0, "plant.pump.lag_s": 9.0},
        {"plant.cylinder.mass_kg": math.nan},
        {"plant.cylinder.bore_m": 0.0101},
        {"plant.knee.flexion_max_deg": 1.0},
        {"plant.cylinder.mass_kg": "heavy"},
        {"plant.full_order.relief_pressure_pa": 1e6},
    ],
)
def test_changed_numbers_are_those_of_a_whole_validation(values: dict[str, typing.Any]) -> None:
    scenario = Scenario(plant=PlantParameters(full_order=FullCylinderParameters()))
    expected = validated(scenario, values)
    if isinstance(expected, str):
        with pytest.raises(ParameterError) as caught:
            changed(scenario, values)
        assert str(caught.value) == expected
        assert scenario._with_numbers(values) is None
    else:
        ours = scenario._with_numbers(values)
        assert ours == changed(scenario, values) == expected
        assert ours.model_dump_json() == expected.model_dump_json()


def test_other_values_than_floats_need_the_whole_validation() -> None:
    for values in (
        {"plant.cylinder.mass_kg": 2},
        {"plant.cylinder.mass_kg": np.float64(2.0)},
        {"plant.linkage": "G2"},
        {"plant.full_order.entrained_air": 0.01},
        {"simulation": 1.0},
        {"plant.mass_kg": 1.0},
    ):
        assert Scenario()._with_numbers(values) is None
