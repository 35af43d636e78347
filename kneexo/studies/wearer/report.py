"""Markdown report on a `kneexo.studies.wearer.wearer.WearerResult`."""

from __future__ import annotations

import math
from statistics import median_low

from kneexo.analysis.linear.margins import soundness
from kneexo.parameters import BODIES, SEAL_FRICTION_N
from kneexo.parameters.device.plant import LOWEST_PRESSURE_PA
from kneexo.studies.markdown import number
from kneexo.studies.template import filled
from kneexo.studies.wearer.wearer import (
    DEVICES,
    HELPING,
    HIGHER,
    INERTIA,
    LARGER,
    PAPER,
    SIZED,
    UNLIMITED,
    WearerResult,
    WearerRow,
)


def report(result: WearerResult) -> str:
    """Return the Markdown report on the torque that a wearer feels, and on the assistance."""
    settings = result.settings
    cadence, rise = median_low(settings.cadences_hz), median_low(settings.rise_times_s)
    weak_cadence = median_low(settings.help_cadences_hz)
    by_design: dict[str, list[WearerRow]] = {}
    for row in result.transparency:
        by_design.setdefault(row.design, []).append(row)
    walks = {row.design: row for row in result.transparency if row.cadence_hz == cadence}
    rows = (*result.transparency, *result.help)
    return filled(
        "wearer/report.md",
        result=result,
        scenario=result.scenario,
        settings=settings,
        seal_friction_n=SEAL_FRICTION_N,
        paper=walks[PAPER],
        paper_higher=walks[PAPER + HIGHER],
        unlimited=walks[UNLIMITED],
        larger=walks[LARGER + HIGHER],
        sized=walks[SIZED + HIGHER],
        inertia=walks[INERTIA],
        rising=next(row for row in by_design[PAPER] if row.rise_time_s == rise),
        weak=[
            [
                row
                for row in result.help
                if (row.design, row.wearer, row.cadence_hz) == (name, "average", weak_cadence)
            ]
            for name in HELPING
        ],
        motions=[row.motion for row in by_design[PAPER]],
        torques=[[name, *map(_torque, rows)] for name, rows in by_design.items()],
        below_vacuum=any(map(_below_vacuum, result.transparency)),
        vacuum_mpa=1e-6 * LOWEST_PRESSURE_PA,
        devices=DEVICES,
        bodies=BODIES,
        failures=[row for row in rows if row.failure],
        verdict=lambda row: soundness(row.disk_margin),
        interval=lambda row: f"{number(row.low_n_m_per_rad)}…{number(row.high_n_m_per_rad)}",
        share=lambda row: number(100.0 * row.saturated_share, ".0f"),
    )


def _torque(row: WearerRow) -> str:
    """Return rms, mean and peak torque of a row as text, or a dash if the run failed.

    A dagger marks a run in which the pressure of a chamber falls below vacuum.
    """
    if math.isnan(row.rms_torque_n_m):
        return "–"
    mean, peak = number(row.mean_torque_n_m), number(row.peak_torque_n_m)
    mark = " †" if _below_vacuum(row) else ""
    return f"{number(row.rms_torque_n_m)} ({mean}, {peak}){mark}"


def _below_vacuum(row: WearerRow) -> bool:
    return row.lowest_pressure_pa < LOWEST_PRESSURE_PA
