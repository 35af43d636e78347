"""Markdown report on a `kneexo.studies.sliding.study.SlidingResult`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from kneexo.parameters import Scenario
from kneexo.studies.markdown import Cell, number
from kneexo.studies.sliding.study import (
    LAWS,
    SlidingCase,
    SlidingResult,
    effective_masses_kg,
    full_order,
)
from kneexo.studies.template import filled


def report(result: SlidingResult) -> str:
    """Return the report on the sliding condition in Markdown."""
    law = result.law
    derived = [case for case in result.cases if case.part != "sampled" and case.plant != "full"]
    return filled(
        "sliding/report.md",
        result=result,
        law=law,
        law_label=lambda case: LAWS[case.law],
        measured=_measured,
        outcome=lambda case: "left the range of motion" if case.measured.failure else "complete",
        promise_kept=sum(map(_keeps_its_promise, derived)),
        promise_cases=len(derived),
        loads=[
            {
                "load_n": load,
                "paper_eta_m_s3": result.smallest_eta("paper", load),
                "area_eta_m_s3": result.smallest_eta("area", load),
            }
            for load in result.settings.loads_n
        ],
        infinity=math.inf,
        masses_kg=effective_masses_kg(full_order(result.scenario)),
        shares=list(_shares(result)),
        layers_per_sample=law.eta_m_s3 * Scenario().controller.sample_time_s / law.phi_m_s2,
    )


def _measured(name: str, factor: float = 1.0) -> Cell:
    """Return a function that prints a case's measured number ``name`` times ``factor``."""

    def text(case: SlidingCase) -> str:
        return number(factor * getattr(case.measured, name))

    return text


def _keeps_its_promise(case: SlidingCase) -> bool:
    """Return True if s stays in the boundary layer and all samples outside meet the condition."""
    outside, holding = case.measured.outside_share, case.measured.holding_share
    return case.stays and (not outside or holding == 1.0)


def _shares(result: SlidingResult) -> Iterator[dict[str, Any]]:
    """Yield for each law the range, over its runs, of the share of samples that meet the condition.

    The share, in %, refers to the samples outside the boundary layer. Only runs of the full-order
    plant with a continuous law and with such samples count.
    """
    for name, label in LAWS.items():
        shares = [
            case.measured.holding_share
            for case in result.cases
            if case.plant == "full" and case.law == name and case.measured.outside_share > 0.0
        ]
        if shares:
            yield {"law": label, "low": 100.0 * min(shares), "high": 100.0 * max(shares)}
