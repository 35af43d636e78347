"""Sliders: their ranges lie within those of the fields, and contain the present value."""

import math

import pytest

from kneexo.page.sliders import MAIN, SLIDERS, sliders_of
from kneexo.parameters import PlantParameters, Scenario
from kneexo.parameters.fields.fields import limits_of
from kneexo.parameters.paths import value_at
from kneexo.parameters.presets import PRESETS


@pytest.mark.parametrize("kind", SLIDERS, ids=lambda kind: kind.__name__)
def test_a_slider_belongs_to_a_field_and_lies_within_its_range(kind):
    for name, slider in SLIDERS[kind].items():
        field = kind.model_fields[name]
        low, high = limits_of(field)
        assert low <= slider.low < slider.high <= high, name
        assert field.default is None or slider.low <= field.default <= slider.high, name
        assert slider.low > 0.0 or slider.scale == "linear", name
    assert set(MAIN.get(kind, ())) <= set(SLIDERS[kind])


@pytest.mark.parametrize("preset", PRESETS)
def test_the_ends_of_a_slider_are_accepted(preset):
    scenario = Scenario.model_validate(PRESETS[preset].values)
    for path, slider in sliders_of(scenario):
        for end in (slider.low, slider.high):
            assert value_at(scenario.changed({path: end}), path) == end


def test_a_slider_is_extended_to_the_present_value():
    scenario = Scenario().changed({"plant.pump.gear_ratio": 50.0})
    sliders = dict(sliders_of(scenario))
    assert (sliders["plant.pump.gear_ratio"].low, sliders["plant.pump.gear_ratio"].high) == (1, 50)
    scenario = Scenario().changed({"encoder.mounting_error_rad": -0.1})
    assert dict(sliders_of(scenario))["encoder.mounting_error_rad"].low == -0.1


def test_a_number_that_is_left_out_has_no_slider():
    path = "plant.load.inertia_kg_m2"
    scenario = Scenario().changed({"plant.load": "knee"})
    assert path not in dict(sliders_of(scenario))
    assert dict(sliders_of(scenario.changed({path: 0.064})))[path].high == 0.3


def test_the_nominal_plant_has_no_sliders():
    both = Scenario(nominal=PlantParameters())
    assert [path for path, _ in sliders_of(both)] == [path for path, _ in sliders_of(Scenario())]


def test_a_mode_and_a_motion_have_the_sliders_that_act_in_them():
    def ends(mode, motion):
        fields = {"controller": {"kind": "torque", "mode": mode}, "wearer": {"motion": motion}}
        fields["wearer"]["kind"] = "leg"
        worn = Scenario.model_validate({"plant": {"load": "knee"}} | fields)
        return {path.removeprefix("controller.") for path, _ in sliders_of(worn)}

    virtual = {"stiffness_n_m_per_rad", "damping_n_m_s_per_rad", "band_rad", "assistance"}
    assert not ends("zero_torque", "prescribed") & virtual
    assert ends("impedance", "prescribed") & virtual == {
        "stiffness_n_m_per_rad",
        "damping_n_m_s_per_rad",
    }
    assert ends("assist_as_needed", "active") & virtual == {"stiffness_n_m_per_rad", "band_rad"}
    assert "wearer.inertia_kg_m2" in ends("zero_torque", "passive")
    assert "wearer.inertia_kg_m2" not in ends("zero_torque", "prescribed")


def test_units_for_people():
    sliders = dict(sliders_of(Scenario()))
    unit, factor = sliders["plant.pump.speed_limit_rad_s"].shown
    assert (unit, 2.0 * math.pi * factor) == ("rpm", pytest.approx(60.0))
    unit, factor = sliders["plant.pump.displacement_m3_per_rad"].shown
    value = Scenario().plant.pump.displacement_m3_per_rad
    assert (unit, factor * value) == ("cc/rev", pytest.approx(0.8))  # Table 2
    unit, factor = sliders["plant.cylinder.bulk_modulus_pa"].shown
    assert (unit, factor * 17_200e5) == ("bar", pytest.approx(17_200.0))
    unit, factor = sliders["encoder.mounting_error_rad"].shown
    assert (unit, factor * math.pi) == ("deg", pytest.approx(180.0))
