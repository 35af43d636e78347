"""The report of ``kneexo reproduce``: the paper's numbers beside the numbers from kneexo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kneexo.parameters import RodPolynomialParameters
from kneexo.studies.paper import PAPER_BANDWIDTH_HZ
from kneexo.studies.reproduce.study import ReproduceResult
from kneexo.studies.template import filled


def report(result: ReproduceResult) -> str:
    """Return the report in Markdown, with each number of the paper beside the computed number."""
    numbers, table = result.results(), RodPolynomialParameters()
    table1 = numbers["table1"]
    return filled(
        "reproduce/report.md",
        **numbers,
        compared=_compared,
        named=_named,
        paper_bandwidth_hz=PAPER_BANDWIDTH_HZ,
        quintics=zip(
            *(table.p_mm_deg, table1["refit_p_mm_deg"]),
            *(table.q_deg_mm, table1["refit_q_deg_mm"]),
            strict=True,
        ),
    )


def _compared(printed: float | None, computed: float, form: str) -> str:
    """Return table cells with the paper's number, the computed number, and their difference.

    ``printed`` is None if the paper does not print the number.
    """
    paper = "not printed" if printed is None else f"{printed:g}"
    difference = "" if printed is None else f"{computed - printed:+.3g}"
    return f"{paper} | {computed:{form}} | {difference}"


def _named(cases: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a list of table rows. Each value of ``cases`` is a row, with its key as ``name``."""
    return [{"name": name} | case for name, case in cases.items()]
