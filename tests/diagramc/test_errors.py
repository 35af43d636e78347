"""Errors of the compiler: one line, and the built-in class that a caller expects."""

import pytest

from diagramc import errors


def test_a_message_is_a_single_printable_line():
    error = errors.CompilationError("a\nb\x1b[31m é \u2028")
    assert str(error) == r"a\nb\x1b[31m é \u2028"
    assert str(errors.Error()) == ""


@pytest.mark.parametrize(
    ("kind", "built_in"),
    [
        (errors.ParameterError, ValueError),
        (errors.SimulationError, RuntimeError),
        (errors.StiffnessError, errors.SimulationError),
        (errors.OutputError, OSError),
        (errors.ResultError, KeyError),
        (errors.CompilationError, TypeError),
    ],
)
def test_errors_are_caught_as_built_in_ones(kind, built_in):
    with pytest.raises(built_in, match=r"^a b$"):
        raise kind("a b")
    assert issubclass(kind, errors.Error)


@pytest.mark.parametrize("most", [10, 11, 120])
def test_a_long_text_loses_its_middle(most):
    text = "".join(chr(ord("a") + i % 26) for i in range(most + 1))
    assert errors.shortened(text[:-1], most) == text[:-1]
    start, end = errors.shortened(text, most).split(" … ")
    assert text.startswith(start)
    assert text.endswith(end)
    assert most - 1 <= len(start) + 3 + len(end) <= most


def test_a_name_is_shown_on_one_line_of_at_most_300_characters():
    assert errors.shown("a\tb") == r"a\tb"
    assert len(errors.shown("\n" * 1000)) == 300
