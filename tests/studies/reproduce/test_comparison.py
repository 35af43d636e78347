"""Judgements of the paper's numbers, against rounding in decimal numbers."""

from decimal import ROUND_HALF_EVEN, Decimal

import pytest
from reproduce_cases import PAPER

from kneexo.studies.reproduce.comparison import (
    DOES_NOT_HOLD,
    HOLDS,
    HOLDS_AS_PRINTED,
    NOT_PRINTED,
    PAPER_NUMBERS,
    Comparison,
    PaperNumber,
    compared,
)


def judged(computed, printed, kind="value"):
    number = PaperNumber("x", "mm", ("x",), ".2f", "", printed, kind, "of a reason")
    return Comparison(number, computed)


@pytest.mark.parametrize(
    ("computed", "printed", "kind", "judgement"),
    [
        (139.0549, "139.05", "value", HOLDS_AS_PRINTED),
        (139.0551, "139.05", "value", DOES_NOT_HOLD),
        (139.0449, "139.05", "value", DOES_NOT_HOLD),
        (3.51, "4", "value", HOLDS_AS_PRINTED),
        (3.49, "4", "value", DOES_NOT_HOLD),
        (-0.004, "0.00", "value", HOLDS_AS_PRINTED),
        (0.006, "0.00", "value", DOES_NOT_HOLD),
        (1.99, "2", "upper bound", HOLDS),
        (2.01, "2", "upper bound", DOES_NOT_HOLD),
        (float("nan"), "2", "upper bound", DOES_NOT_HOLD),
        (float("nan"), "2", "value", DOES_NOT_HOLD),
        (1.0, "", "value", NOT_PRINTED),
    ],
)
def test_a_number_is_judged_to_the_digits_that_the_paper_prints(computed, printed, kind, judgement):
    comparison = judged(computed, printed, kind)
    assert comparison.judgement == judgement
    assert comparison.because == ("of a reason" if judgement == DOES_NOT_HOLD else "")


def test_the_judgements_of_the_paper_are_those_of_decimal_rounding(by_hand):
    results = by_hand.results()
    for comparison in compared(results):
        number = comparison.number
        if comparison.judgement == NOT_PRINTED or number.kind == "upper bound":
            continue
        digit = Decimal(number.printed).as_tuple().exponent
        rounded = Decimal(comparison.computed).quantize(Decimal(1).scaleb(digit), ROUND_HALF_EVEN)
        holds = rounded == Decimal(number.printed)
        assert comparison.judgement == (HOLDS_AS_PRINTED if holds else DOES_NOT_HOLD), number


def test_the_printed_numbers_are_those_of_the_paper():
    assert {n.key: float(n.printed) if n.printed else None for n in PAPER_NUMBERS} == PAPER
    (bound,) = (n for n in PAPER_NUMBERS if n.kind == "upper bound")
    assert bound.key == ("fig12", "smc", "max_error_deg")  # "less than 2°"


def test_the_results_have_each_judgement(by_hand):
    results = by_hand.results()
    assert results["comparison"][0] == {
        "quantity": "x at 10° (Section 5)",
        "unit": "mm",
        "paper": 139.05,
        "kneexo": results["table1"]["x_at_10deg_mm"],
        "difference": results["table1"]["x_at_10deg_mm"] - 139.05,
        "judgement": "holds within what the paper prints",
        "because": "",
        "method": "Eq. 10 with Table 1",
    }
    misprint = results["comparison"][1]
    assert misprint["judgement"] == "does not hold"
    assert "misprint" in misprint["because"]
    assert len(results["comparison"]) == len(PAPER_NUMBERS)
