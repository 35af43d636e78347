"""The flat list of the names of a class, and the remedies for wrong paths."""

import pytest

from kneexo.parameters import (
    CylinderParameters,
    KneeLoadParameters,
    NoLoad,
    PidParameters,
    PlantParameters,
    Scenario,
    SlidingModeParameters,
)
from kneexo.parameters.fields.names import Place, advice, names_of
from kneexo.parameters.paths import has_path
from kneexo.studies.contest import ContestSettings


def test_names_are_those_of_some_scenario():
    names = {".".join(name.path): name for name in names_of(Scenario)}
    for path in ("plant.cylinder.mass_kg", "nominal", "simulation"):
        assert names[path].setting == ()
        assert has_path(Scenario(), path)
    needed = {
        "controller.integral_per_s2": ("controller.kind = pid", {"controller": "pid"}),
        "plant.load.segment_mass_kg": ("plant.load.kind = knee", {"plant.load": "knee"}),
        "plant.full_order.entrained_air": ("plant.full_order = true", {"plant.full_order": True}),
        "nominal.cylinder.mass_kg": ("nominal = {}", {"nominal": {}}),
    }
    for path, (setting, values) in needed.items():
        assert f"{'.'.join(names[path].setting)} = {names[path].choice}" == setting
        assert not has_path(Scenario(), path)
        assert has_path(Scenario().changed(values), path)
    kind = names["controller.kind = pid"]
    assert (kind.word, kind.owner) == ("pid", PidParameters)


def test_keys_of_mappings_are_those_of_the_path():
    path = ("contestants", "NAME", "controller", "lambda_per_s")
    assert path in {name.path for name in names_of(ContestSettings)}
    path = ("contestants", "SMC", "controller", "lambda_per_s")
    assert path in {name.path for name in names_of(ContestSettings, path)}


FULL = "plant.full_order"
SMC, LOAD, SETTINGS = (SlidingModeParameters,), (KneeLoadParameters,), ContestSettings
CUFF = "wearer.cuff.stiffness_n_m_per_rad (needs wearer.kind = leg)?"
REMEDIES = [
    # a name at the wrong place, and a misspelt one
    (Scenario, "mass_kg", (), "; did you mean plant.cylinder.mass_kg?"),
    (Scenario, "cylinder.mass_kg", (), "; did you mean plant.cylinder.mass_kg?"),
    (Scenario, "cuff.stiffness_n_m_per_rad", (), "; did you mean " + CUFF),
    (Scenario, "mas_kg", (), "; did you mean plant.cylinder.mass_kg?"),
    (Scenario, "plant.cylindr.mass_kg", (), "; did you mean plant.cylinder.mass_kg?"),
    (Scenario, "nominal.knee.mass_kg", (), "; did you mean nominal.cylinder.mass_kg?"),
    (
        Scenario,
        "duration",
        (Scenario,),
        "; did you mean simulation.duration_s or push.duration_s (needs push = {})?",
    ),
    (PlantParameters, "mass_kg", (), "; did you mean cylinder.mass_kg?"),
    (CylinderParameters, "lag_s", (), "; Scenario has plant.pump.lag_s"),
    (Scenario, "qqq", (NoLoad,), "; known here: kind"),
    (Scenario, "qqq", (), ""),
    # another choice of the parts
    (Scenario, "controller.integral_per_s2", SMC, "; needs controller.kind = pid"),
    (Scenario, "controller.lambda_per_s", (PidParameters,), "; needs controller.kind = smc"),
    (Scenario, "controller.values.gain", (), "; needs controller.kind = law"),
    (Scenario, f"{FULL}.entrained_air", (), f"; needs {FULL} = true"),
    (Scenario, "controller.integral_rad", (PidParameters,), "controller.integral_per_s2?"),
    (Scenario, "plant.load.segment_mass", (NoLoad,), "mass_kg (needs plant.load.kind = knee)?"),
    (Scenario, "controller.pid", SMC, "; did you mean controller.kind = pid?"),
    (
        Scenario,
        "plant.stribeck",
        (),
        f"; did you mean {FULL}.stribeck_friction_n (needs {FULL} = true) or "
        f"{FULL}.stribeck_speed_m_s (needs {FULL} = true)?",
    ),
    # names of another structure
    (Scenario, "plant.cylinder.mass_kg", (), "; nest the names: plant: {cylinder: {mass_kg: …}}"),
    (Scenario, "plant.cylinder.mass_kg.x", (), "; plant.cylinder.mass_kg is a single value"),
    (SETTINGS, "contestants.A.controller.lambda", SMC, "contestants.A.controller.lambda_per_s?"),
    (SETTINGS, "contestants.A.mass_kg", (), "; Scenario has plant.cylinder.mass_kg"),
]


@pytest.mark.parametrize(("model", "path", "here", "text"), REMEDIES)
def test_a_wrong_path_has_a_remedy(model, path, here, text):
    remedy = advice(model, tuple(path.split(".")), here)
    assert remedy.endswith(text)
    assert remedy == text or not text.startswith(";")


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
    assert below.field is PidParameters.model_fields["derivative"]
    assert below.holders == (PidParameters,)
