from decimal import Decimal
from functools import reduce

import pytest
from reproduce_cases import (
    PAPER,
)

from kneexo.studies.reproduce.report import report

NOT = "does not hold"


def test_the_report_has_each_number_of_the_paper_beside_ours(by_hand, tables):
    numbers = by_hand.results()
    comparison, more, *_ = tables(report(by_hand))
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
