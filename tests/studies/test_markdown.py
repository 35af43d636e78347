import math

import pytest

from kneexo.studies.markdown import markdown_table, number


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.12345, "0.123"), (math.nan, "–"), (math.inf, "∞"), (-math.inf, "−∞")],
)
def test_numbers_that_are_none_have_a_sign_of_their_own(value, shown):
    assert number(value) == shown


def test_a_number_has_the_form_asked_for():
    assert number(-1.25, "+.1f") == "-1.2"
    assert number(math.nan, "+.1f") == "–"


def test_a_table_has_a_head_a_rule_and_its_rows():
    assert markdown_table(("", "max (deg)"), [("SMC", "0.2"), ("PID", "∞")]) == [
        "|  | max (deg) |",
        "| --- | --- |",
        "| SMC | 0.2 |",
        "| PID | ∞ |",
    ]
