from collections import Counter
from decimal import Decimal
from functools import reduce

import pytest
from reproduce_cases import (
    METRICS,
    PAPER,
)

from kneexo.parameters import RodPolynomialParameters
from kneexo.studies.paper import EQ_27_DIFFERENCES, EQ_27_EXACT_STATES, FIG_12
from kneexo.studies.reproduce.report import report
from kneexo.studies.reproduce.study import (
    speed_demand,
)

NOT = "does not hold"
WORDS = {
    "smc": "sliding-mode control",
    "pid": "PID as in the paper (P, 5 1/s)",
    "pid_tuned": "PID, tuned",
    "pid_feedforward": "PID, tuned, with reference velocity",
}


def test_the_report_has_each_number_of_the_paper_beside_ours(known, tables):
    numbers = known.results()
    comparison, more, *_ = tables(report(known))
    heads = ["quantity", "unit", "paper", "kneexo", "difference"]
    assert comparison[0] == [*heads, "holds within", "verdict", "how obtained"]
    assert more[0] == ["quantity", "unit", "kneexo", "how obtained"]
    judged, others = iter(comparison[1:]), iter(more[1:])
    for path, paper in PAPER.items():
        ours = reduce(dict.__getitem__, path, numbers)
        if paper is None:
            row = next(others)
            unit, shown = row[1:3]
        else:
            row = next(judged)
            unit, printed, shown, difference, criterion, verdict = row[1:7]
        suffix = {
            "rpm": "_rpm",
            "mm": "_mm",
            "mm²": "_mm2",
            "deg": "_deg",
            "deg²": "_deg2",
            "Hz": "_hz",
        }
        assert path[-1].endswith(suffix.get(unit, "ratio")), row
        last_digit = 10.0 ** Decimal(shown).as_tuple().exponent
        assert float(shown) == pytest.approx(ours, abs=0.51 * last_digit)
        if paper is not None:
            assert float(printed) == paper
            assert difference[0] in "+-"
            assert float(difference) == pytest.approx(ours - paper, rel=6e-3, abs=1e-12)
            bound = float(criterion.split()[-1])
            if criterion.startswith("below"):
                assert bound == paper
                assert (ours < bound) == (verdict == "holds")
            else:
                assert criterion.startswith("± ")
                assert bound == 0.5 * 10.0 ** Decimal(printed).as_tuple().exponent
                within = abs(ours - paper) <= bound * (1.0 + 1e-9)
                assert verdict == ("holds" if within else NOT)
    assert [*judged, *others] == []
    judgements = [row["judgement"] for row in numbers["comparison"]]
    kinds = [j.removesuffix(" within what the paper prints") for j in judgements]
    assert [row[6] for row in comparison[1:]] == [k for k in kinds if k != "not printed"]


def test_the_screen_has_the_judgements(known, check_screen):
    rows = known.results()["comparison"]
    count = Counter(row["judgement"] for row in rows)
    within, holding = count["holds within what the paper prints"], count["holds"]
    text = report(known)
    failing = count["does not hold"]
    assert (
        f"Of {within + holding + failing} comparisons with the paper {within + holding} hold, "
        f"{within} of them to all digits that the paper prints, and {failing} do not, "
        "for these reasons:"
    ) in text
    lines = check_screen(text, most=21)  # more of these numbers fail than of the paper's
    assert lines[2].startswith("Of ")
    head, _, _ = text.partition("\n## ")
    for row in rows:
        named = f"{row['quantity']} " in head
        assert named == (row["judgement"] == "does not hold"), row["quantity"]
        assert row["because"] in head


def test_the_other_tables_of_the_report_are_those_of_the_results(known, tables):
    _, _, quintics, controllers, exact, differences = tables(report(known))
    p, q = RodPolynomialParameters().p_mm_deg, RodPolynomialParameters().q_deg_mm
    for n, row in enumerate(quintics[1:]):
        assert (row[0], row[3]) == (f"p_{n + 1}", f"q_{n + 1}")
        shown = [float(row[column]) for column in (1, 2, 4, 5)]
        expected = [p[n], 1e-9 * (n + 1), q[n], 1e-8 * (n + 1)]
        assert shown == pytest.approx(expected, rel=6e-4)
    columns = ("max_error_deg", "rms_error_deg", "mean_command_change_rpm", "saturated_share")
    for n, (name, row) in enumerate(zip(FIG_12, controllers[1:], strict=True)):
        assert row[0] == WORDS[name]
        expected = [(n + 1) * METRICS[column] for column in (*columns, "peak_command_rpm")]
        expected[3] = round(100.0 * expected[3])  # in whole percent
        assert [float(cell.rstrip(" %")) for cell in row[1:]] == pytest.approx(expected, abs=5e-4)
    assert [float(row[1]) for row in exact[1:]] == pytest.approx([-0.5, 0.5], abs=0.025)
    assert [row[0] for row in exact[1:]] == list(EQ_27_EXACT_STATES)
    for name, factor, row in zip(EQ_27_DIFFERENCES, (10, 20), differences[1:], strict=True):
        assert row[0] == name
        expected = [factor * value for value in (0.11, 0.12, 15.0)]
        assert [float(cell) for cell in row[1:]] == pytest.approx(expected, abs=5e-3)


def test_the_words_about_the_speed_limit_have_its_numbers(known):
    text = report(known)
    peak_rpm, saturation_hz = speed_demand()
    for said in (f"{peak_rpm:.0f} rpm", f"{saturation_hz:.3f} Hz", "1700 rpm", "16.0 %"):
        assert said in text
