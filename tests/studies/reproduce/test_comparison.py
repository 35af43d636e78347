"""Judgements of the paper's numbers, against rounding in decimal numbers."""

from decimal import ROUND_HALF_EVEN, Decimal

import pytest

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

PAPER = {
    ("table1", "x_at_10deg_mm"): 139.05,
    ("table1", "x_at_70deg_mm"): 38.98,
    ("table1", "strokes_per_period_mm"): 200.14,
    ("table1", "linkage_max_mm"): None,
    ("table1", "refit_p_sse_mm2"): 0.1781,
    ("table1", "refit_q_sse_deg2"): 1.241,
    ("table1", "linkage_rmse_mm"): 0.03,
    ("table1", "refit_q_rmse_deg"): 0.0792,
    ("table1_g4", "refit_p_sse_mm2"): 0.1781,
    ("table1_g4", "refit_q_sse_deg2"): 1.241,
    ("table1_g4", "refit_p_rmse_mm"): 0.03,
    ("table1_g4", "refit_q_rmse_deg"): 0.0792,
    ("fig9", "error_after_1s_mm"): None,
    ("fig9", "final_error_mm"): 0.0,
    ("fig12", "smc", "max_error_deg"): 2.0,
    ("fig12", "pid", "max_error_deg"): 4.0,
    ("fig12", "pid_tuned", "max_error_deg"): None,
    ("fig12", "pid_feedforward", "max_error_deg"): None,
    ("speed_limit", "peak_speed_demand_at_0.1hz_rpm"): 5000.0,
    ("fig13", "bandwidth_hz"): 0.21,
    ("fig13", "phase_at_bandwidth_deg"): None,
    ("scaling", "gear_3", "ratio"): None,
    ("scaling", "half_amplitude", "ratio"): None,
}
"""Where the results have a number, and what Lee et al. 2020 print in its place."""


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
