"""Markdown report on a `kneexo.analysis.TrackingResult`."""

from __future__ import annotations

import math

import numpy as np

from kneexo.analysis import TrackingResult
from kneexo.analysis.signals import settled_s, to_rpm
from kneexo.parameters.criteria import SETTLING_BAND
from kneexo.studies.markdown import number
from kneexo.studies.template import filled


def report(result: TrackingResult) -> str:
    """Return the report on a run in Markdown: findings, values with limits, other values."""
    scenario, run = result.scenario, result.run
    chamber_mpa = None
    if scenario.plant.full_order is not None and "cap_pressure_pa" in run.data:
        chambers = np.maximum(run["cap_pressure_pa"], run["rod_side_pressure_pa"])
        chamber_mpa = 1e-6 * float(np.max(chambers))
    return filled(
        "simulate/report.md",
        plant=scenario.plant,
        lines=[*result.verdict.lines, *result.verdict.model_lines],
        verdict=result.verdict,
        metrics=result.metrics,
        step=result.step,
        settling_band=SETTLING_BAND,
        command_limit_rpm=to_rpm(scenario.command_limit_rad_s),
        chamber_mpa=chamber_mpa,
        first=" after the first period" if settled_s(scenario) > 0.0 else "",
        isnan=math.isnan,
        over=_over,
        unit=_with_unit,
    )


def _over(share: float, where: str = "above") -> str:
    """Return the verdict on a limit that a run reaches for a ``share`` of its time."""
    return f"{where} the limit for {number(100.0 * share)} %" if share > 0.0 else "below the limit"


def _with_unit(value: float, unit: str) -> str:
    """Return a number of three digits with its unit; a dash for nan."""
    return "–" if math.isnan(value) else f"{number(value)}{'' if unit == '°' else ' '}{unit}"
