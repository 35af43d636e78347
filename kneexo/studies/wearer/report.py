"""Markdown report on a `kneexo.studies.wearer.study.WearerResult`."""

from __future__ import annotations

import math
from statistics import median_low

from kneexo.analysis.margins import soundness
from kneexo.parameters import BODIES
from kneexo.studies.markdown import number
from kneexo.studies.template import filled
from kneexo.studies.wearer.study import (
    DEVICES,
    GAINS,
    HELPING,
    HIGHER,
    LARGER,
    PAPER,
    SIZED,
    UNLIMITED,
    WearerResult,
    WearerRow,
)


def report(result: WearerResult) -> str:
    """Return the Markdown report on the torque that a wearer feels and the help that it gets."""
    settings = result.settings
    cadence = median_low(settings.cadences_hz)
    follow = {row.design: row for row in result.transparency if row.cadence_hz == cadence}
    rising = median_low(settings.rise_times_s)
    paper_rising = next(
        row for row in result.transparency if (row.design, row.rise_time_s) == (PAPER, rising)
    )
    by_design: dict[str, list[WearerRow]] = {}
    for row in result.transparency:
        by_design.setdefault(row.design, []).append(row)
    weak_cadence = median_low(settings.help_cadences_hz)
    weak = {
        (row.design, row.mode): row
        for row in result.help
        if (row.wearer, row.cadence_hz) == ("average", weak_cadence)
    }
    return filled(
        "wearer/report.md",
        result=result,
        settings=settings,
        cadence=cadence,
        paper=follow[PAPER],
        paper_higher=follow[PAPER + HIGHER],
        unlimited=follow[UNLIMITED],
        larger=follow[LARGER + HIGHER],
        sized=follow[SIZED + HIGHER],
        paper_rising=paper_rising,
        disk_margins=[
            min(row.disk_margin for row in result.margins if row.design == name) for name in GAINS
        ],
        helping=HELPING,
        weak=weak,
        weak_cadence=weak_cadence,
        motions=[row.motion for row in by_design[PAPER]],
        torques=[[name, *map(_torque, rows)] for name, rows in by_design.items()],
        devices=DEVICES,
        bodies=BODIES,
        failures=[row for row in (*result.transparency, *result.help) if row.failure],
        verdict=lambda row: soundness(row.disk_margin),
        share=lambda row: number(100.0 * row.saturated_share, ".0f"),
    )


def _torque(row: WearerRow) -> str:
    """Return rms, mean and peak torque of a row as text, or a dash if the run failed."""
    if math.isnan(row.rms_torque_n_m):
        return "–"
    mean, peak = number(row.mean_torque_n_m), number(row.peak_torque_n_m)
    return f"{number(row.rms_torque_n_m)} ({mean}, {peak})"
