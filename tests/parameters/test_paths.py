"""Values of parameters by dotted paths."""

import re

import pytest

from kneexo.errors import ParameterError
from kneexo.parameters import (
    G2,
    CylinderParameters,
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
    ("path", "value", "message"),
    [
        (
            "plant.pomp.lag_s",
            0.01,
            "plant.pomp.lag_s: unknown name plant.pomp; did you mean plant.pump.lag_s?",
        ),
        ("plant.full_order.dead_volume_m3", 1e-6, "set plant.full_order = true too"),
        ("plant.pump.lg_s", 0.01, "plant.pump.lg_s: unknown name"),
        ("plant.pump.lag_s", -1.0, "plant.pump.lag_s = -1 s is out of range"),
        ("bus.latency_samples", 1.5, "bus.latency_samples = 1.5 samples: must be a whole number"),
        ("reference.mean_deg", 80.0, "leaves the range of motion"),
    ],
)
def test_a_change_that_the_scenario_does_not_have_is_refused(
    path: str, value: object, message: str
) -> None:
    with pytest.raises(ParameterError, match=re.escape(message)):
        changed(Scenario(), {path: value})


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
