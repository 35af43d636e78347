"""The report of ``kneexo reproduce``: the paper's numbers beside the numbers from kneexo."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from kneexo.parameters import RodPolynomialParameters
from kneexo.studies.reproduce.comparison import (
    DOES_NOT_HOLD,
    HOLDS,
    HOLDS_AS_PRINTED,
    NOT_PRINTED,
    Comparison,
    compared,
)
from kneexo.studies.reproduce.reproduce import FIG_12_TITLES, ReproduceResult
from kneexo.studies.template import filled

_CONTROLLERS = FIG_12_TITLES | {"pid_feedforward": "PID, tuned, with reference velocity"}
"""The controllers of Fig. 12 in words, by name."""


def report(result: ReproduceResult) -> str:
    """Return the report in Markdown, with each number of the paper beside the computed number."""
    numbers, table = result.results(), RodPolynomialParameters()
    table1 = numbers["table1"]
    comparison = list(compared(numbers))
    failing: dict[str, list[Comparison]] = {}
    for row in comparison:
        if row.judgement == DOES_NOT_HOLD:
            failing.setdefault(row.because, []).append(row)
    counts = Counter(row.judgement for row in comparison if row.judgement != NOT_PRINTED)
    return filled(
        "reproduce/report.md",
        **numbers,
        linkage=result.fig12["smc"].scenario.plant.linkage,
        judged=[row for row in comparison if row.paper is not None],
        more=[row for row in comparison if row.paper is None],
        failing=failing,
        counts=counts,
        HOLDS=HOLDS,
        HOLDS_AS_PRINTED=HOLDS_AS_PRINTED,
        DOES_NOT_HOLD=DOES_NOT_HOLD,
        computed=lambda row: f"{row.computed:{row.number.form}}",
        difference=lambda row: f"{row.difference:+.3g}",
        # The column "holds within" already tells a bound from a number with printed digits.
        verdict=lambda row: DOES_NOT_HOLD if row.judgement == DOES_NOT_HOLD else HOLDS,
        named=_named,
        controller=lambda row: _CONTROLLERS[row["name"]],
        quintics=zip(
            *(table.p_mm_deg, table1["refit_p_mm_deg"]),
            *(table.q_deg_mm, table1["refit_q_deg_mm"]),
            strict=True,
        ),
    )


def _named(cases: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a list of table rows. Each value of ``cases`` is a row, with its key as ``name``."""
    return [{"name": name} | case for name, case in cases.items()]
