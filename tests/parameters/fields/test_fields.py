"""Words of fields."""

import pytest

from kneexo.errors import ParameterError
from kneexo.parameters import (
    G3,
    Cia402Parameters,
    ExactParameters,
    FullCylinderParameters,
    KneeLoadParameters,
    PidParameters,
    Scenario,
    StepReference,
    gait_reference,
)
from kneexo.parameters.fields.fields import words_of
from kneexo.parameters.scenario_file import load_scenario

WORDS = [
    ("controller", "pid", PidParameters()),
    ("plant.load", "knee", KneeLoadParameters()),
    ("bus", "cia402", Cia402Parameters()),
    ("bus", "can", Cia402Parameters()),
    ("estimator", "exact", ExactParameters()),
    ("reference", "step", StepReference()),
    ("reference", "gait", gait_reference(1.0, 30)),
    ("plant.linkage", "G3", G3),
    ("plant.full_order", True, FullCylinderParameters()),
    ("plant.full_order", False, None),
]


@pytest.mark.parametrize(("path", "word", "value"), WORDS)
def test_a_word_stands_for_its_value_in_files_and_in_python(path, word, value, tmp_path):
    top, _, name = path.partition(".")
    file = tmp_path / "scenario.yaml"
    text = str(word).lower() if isinstance(word, bool) else word
    file.write_text(f"{top}: {{{name}: {text}}}" if name else f"{top}: {text}")
    made = Scenario(**{top: {name: word} if name else word})
    for scenario in (load_scenario(file), made, Scenario().changed({path: word})):
        part = getattr(scenario, top)
        assert (getattr(part, name) if name else part) == value


def test_a_path_reaches_into_a_word_that_is_given_too():
    values = {"controller.integral_per_s2": 3.0, "controller": "pid", "plant.linkage.branch": 1}
    scenario = Scenario().changed(values | {"plant.linkage": "G3", "plant.full_order": True})
    assert scenario.controller == PidParameters(integral_per_s2=3.0)
    assert scenario.plant.linkage == G3
    assert scenario.plant.full_order == FullCylinderParameters()


def test_words_are_the_kinds_and_the_other_names():
    assert list(words_of(Scenario.model_fields["bus"])) == ["none", "cia402", "can"]
    assert words_of(Scenario.model_fields["encoder"]) == {}
    assert words_of(None) == {}


def test_one_is_not_the_word_true():
    with pytest.raises(ParameterError, match=r"full_order = 1: must be true, false or a mapping$"):
        Scenario(plant={"full_order": 1})
