"""Messages: one line each, whatever they name."""

import pickle

import pytest

from kneexo import errors
from kneexo.errors import KneexoError, close_names, escaped, question, shortened, shown

ERRORS = {e for e in vars(errors).values() if isinstance(e, type) and issubclass(e, KneexoError)}


@pytest.mark.parametrize("error", sorted(ERRORS, key=str))
def test_every_error_is_one_line_here_and_in_another_process(error):
    raised = error("a\nb\x1b λ\u2028")
    for copy in (raised, pickle.loads(pickle.dumps(raised))):
        assert type(copy) is error
        assert str(copy) == "a\\nb\\x1b λ\\u2028"


def test_a_failure_is_noted_and_what_was_computed_before_it_stays():
    row = {"first": 0.0, "second": 0.0}
    with errors.failure_noted(row, "why"):
        row["first"] = 1.0
        raise errors.SimulationError("t = 1 s: out of range")
    assert row == {"first": 1.0, "second": 0.0, "why": "t = 1 s: out of range"}
    with errors.failure_noted(row, "why"):
        row["second"] = 2.0
    assert row == {"first": 1.0, "second": 2.0, "why": ""}


def test_only_errors_of_the_kind_are_noted():
    with pytest.raises(errors.ParameterError), errors.failure_noted({}, kind=errors.ResultError):
        raise errors.ParameterError("mass_kg = -1: must be > 0")
    with pytest.raises(ZeroDivisionError), errors.failure_noted({}):
        raise ZeroDivisionError


def test_text_for_a_message():
    assert escaped("λ …") == "λ …"
    assert shortened("x" * 120) == "x" * 120
    assert shortened("a" * 100 + "b" * 100) == "a" * 60 + " … " + "b" * 57
    assert len(shown("\n" * 5000)) == 300


@pytest.mark.parametrize(
    ("name", "names", "close"),
    [
        ("mas_kg", ["bore_m", "mass_kg"], ["mass_kg"]),
        ("MASS_KG", ["bore_m", "mass_kg"], ["mass_kg"]),
        ("mass", ["segment_mass_kg", "mass_kg"], ["mass_kg", "segment_mass_kg"]),
        ("g1", ["G1", "G2"], ["G1"]),
        ("leakage", ["leakage_m3_per_s_pa"], ["leakage_m3_per_s_pa"]),  # most of it is the unit
        ("colour", ["bore_m", "mass_kg"], []),
        ("a", ["b_a_c"], []),
    ],
)
def test_close_names_differ_by_letters_case_or_words(name, names, close):
    assert close_names(name, names)[: len(close) or 1] == close


def test_a_question_lists_names():
    assert question([]) == ""
    assert question(["a"]) == "; did you mean a?"
    assert question(["a", "b", "c"]) == "; did you mean a, b or c?"
