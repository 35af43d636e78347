"""Names that are suggested for an unknown name."""

import pytest

from kneexo.errors import ParameterError
from kneexo.parameters import (
    CylinderParameters,
    FullCylinderParameters,
    PidParameters,
    PlantParameters,
    Scenario,
)
from kneexo.parameters.names import Place, path_of_part, paths_of, suggestion
from kneexo.parameters.paths import has_path
from kneexo.studies.contest import ContestSettings


def test_paths_are_those_of_some_scenario():
    paths = paths_of(Scenario)
    for path in ("plant.cylinder.mass_kg", "nominal", "simulation"):
        assert paths[path] == ""
        assert has_path(Scenario(), path)
    needed = {
        "controller.integral_per_s2": ("controller.kind = pid", {"controller": "pid"}),
        "plant.load.segment_mass_kg": ("plant.load.kind = knee", {"plant.load": "knee"}),
        "plant.full_order.entrained_air": ("plant.full_order = true", {"plant.full_order": True}),
    }
    for path, (setting, values) in needed.items():
        assert paths[path] == setting
        assert not has_path(Scenario(), path)
        assert has_path(Scenario().changed(values), path)
    assert not any(path.startswith("nominal.") for path in paths)
    assert "contestants.NAME.controller.lambda_per_s" in paths_of(ContestSettings)


@pytest.mark.parametrize(
    ("model", "path"),
    [
        (CylinderParameters, "plant.cylinder"),
        (PidParameters, "controller"),
        (FullCylinderParameters, "plant.full_order"),
    ],
)
def test_a_part_has_a_path(model, path):
    assert path_of_part(model) == (Scenario, path)


def test_a_class_of_settings_is_no_part_of_a_scenario():
    assert path_of_part(ContestSettings) is None


@pytest.mark.parametrize(
    ("model", "name", "prefix", "text"),
    [
        (Scenario, "mass_kg", "", "; did you mean plant.cylinder.mass_kg?"),
        (Scenario, "cylinder.mass_kg", "", "; did you mean plant.cylinder.mass_kg?"),
        (Scenario, "mas_kg", "", "; did you mean plant.cylinder.mass_kg?"),
        (
            Scenario,
            "entrained_air",
            "plant.cylinder.",
            "; did you mean plant.full_order.entrained_air (needs plant.full_order = true)?",
        ),
        (PlantParameters, "mass_kg", "", "; did you mean cylinder.mass_kg?"),
        (CylinderParameters, "lag_s", "", "; Scenario has plant.pump.lag_s"),
        (Scenario, "duration", "", "; did you mean simulation.duration_s?"),  # no section
        (
            Scenario,
            "stribeck",
            "plant.",
            "; did you mean plant.full_order.stribeck_friction_n or "
            "plant.full_order.stribeck_speed_m_s (each needs plant.full_order = true)?",
        ),
        (Scenario, "qqq", "", "; known here: a, b"),
    ],
)
def test_a_suggestion_is_a_path(model, name, prefix, text):
    assert suggestion(model, name, ["a", "b"], prefix) == text


def test_a_place_follows_kinds_and_keys_of_mappings():
    place = Place((ContestSettings,))
    for key in ("contestants", "SMC", "controller"):
        place = place.below(key)
    chosen = place.of_kind("pid")
    assert chosen is not None
    assert chosen.models == (PidParameters,)
    assert place.of_kind("lambda_per_s") is None
    below = chosen.below("derivative")
    assert below.keys == ("contestants", "SMC", "controller", "derivative")
    assert below.prefix == "contestants.SMC.controller."
    assert below.field is PidParameters.model_fields["derivative"]
    assert set(place.models) == set(below.members) > set(below.holders) == {PidParameters}


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"controller": {"integral_per_s2": 1}}, "; needs controller.kind = pid"),
        ({"controller": {"integral": 1}}, "; did you mean controller.integral_per_s2 (needs "),
        ({"controller": {"pid": {}}}, "; did you mean controller.kind = pid?"),
        (
            {"nominal": {"load": {"mass_kg": 1}}},
            "mean nominal.load.segment_mass_kg (needs nominal.",
        ),
        ({"controller": {"mass_min": 1}}, "; did you mean controller.mass_min_kg"),
        ({"controller": {"kind": "pid", "lambda_per_s": 1}}, "; needs controller.kind = smc"),
    ],
)
def test_a_name_of_another_kind_says_so(values, text):
    with pytest.raises(ParameterError) as caught:
        Scenario(**values)
    assert text in str(caught.value)


def test_a_path_into_another_kind_says_so():
    with pytest.raises(ParameterError, match=r"controller.values; needs controller.kind = law"):
        Scenario().changed({"controller.values.gain": 1.0})
