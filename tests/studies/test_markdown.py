import math

import pytest

from kneexo.studies.markdown import (
    column_table,
    markdown_table,
    number,
    percent,
    row_table,
)


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.12345, "0.123"), (math.nan, "–"), (math.inf, "∞"), (-math.inf, "−∞")],
)
def test_numbers_that_are_none_have_a_sign_of_their_own(value, shown):
    assert number(value) == shown


def test_a_number_has_the_form_asked_for():
    assert number(-1.25, "+.1f") == "-1.2"
    assert number(-0.003, ".1f") == "0.0"
    assert number(math.nan, "+.1f") == "–"


def test_a_table_has_a_head_a_rule_and_its_rows():
    assert markdown_table(("", "max (deg)"), [("SMC", "0.2"), ("PID", "∞")]) == [
        "|  | max (deg) |",
        "| --- | --- |",
        "| SMC | 0.2 |",
        "| PID | ∞ |",
    ]


CELLS = {"who": "name", "error": ("error_deg", ".1f"), "fails": lambda row: row["failure"] or "no"}
ROWS = [
    {"name": "SMC", "error_deg": 0.25, "failure": ""},
    {"name": "PID", "error_deg": math.nan, "failure": "yes"},
]


def test_rows_are_shown_by_key_by_form_or_by_function():
    assert row_table(ROWS, CELLS)[2:] == ["| SMC | 0.2 | no |", "| PID | – | yes |"]
    assert row_table(ROWS, CELLS)[0] == "| who | error | fails |"


def test_a_row_may_be_an_object():
    assert row_table([3 + 4j], {"x": ("real", "g"), "y": "imag"})[2:] == ["| 3 | 4.0 |"]


def test_a_name_may_lead_inside_and_a_share_be_in_percent():
    rows = [{"z": 3 + 4j, "share": 0.255}]
    assert row_table(rows, {"x": "z.real", "s": ("share", "%")})[2:] == ["| 3.0 | 26 % |"]


def test_columns_are_the_same_the_other_way_round():
    assert column_table(["a", "b"], ROWS, CELLS) == [
        "|  | a | b |",
        "| --- | --- | --- |",
        "| who | SMC | PID |",
        "| error | 0.2 | – |",
        "| fails | no | yes |",
    ]


def test_a_share_is_in_whole_percent():
    assert percent(0.255) == "26 %"
    assert percent(1.0) == "100 %"
    assert percent(math.nan) == "–"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (4150.45, "4150"),
        (0.00202651, "0.00203"),
        (-16.701, "-16.7"),
        (-0.0, "0"),
        (123456.0, "123000"),
        (math.nan, "–"),
        (-math.inf, "−∞"),
    ],
)
def test_three_digits_need_no_exponent(value, text):
    assert number(value) == text
