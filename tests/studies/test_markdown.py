import math

import pytest

from kneexo.studies.markdown import (
    column_table,
    number,
    percent,
    row_table,
)


@pytest.mark.parametrize(
    ("value", "form", "shown"),
    [
        (0.12345, "", "0.123"),
        (4150.45, "", "4150"),  # three digits need no exponent
        (0.00202651, "", "0.00203"),
        (-16.701, "", "-16.7"),
        (-0.0, "", "0"),
        (123456.0, "", "123000"),
        (math.nan, "", "–"),
        (math.inf, "", "∞"),
        (-math.inf, "", "−∞"),
        (-1.25, "+.1f", "-1.2"),
        (-0.003, ".1f", "0.0"),
        (math.nan, "+.1f", "–"),
        (0.255, "%", "26 %"),
        (math.nan, "%", "–"),
    ],
)
def test_a_number_has_its_form(value, form, shown):
    text = percent(value) if form == "%" else number(value, *filter(None, [form]))
    assert text == shown


CELLS = {"who": "name", "error": ("error_deg", ".1f"), "fails": lambda row: row["failure"] or "no"}
ROWS = [
    {"name": "SMC", "error_deg": 0.25, "failure": ""},
    {"name": "PID", "error_deg": math.nan, "failure": "yes"},
]


def test_rows_are_shown_by_key_by_form_or_by_function():
    assert row_table(ROWS, CELLS)[2:] == ["| SMC | 0.2 | no |", "| PID | – | yes |"]
    assert row_table(ROWS, CELLS)[0] == "| who | error | fails |"


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
