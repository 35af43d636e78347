"""One scenario in numbers: how it tracks, and how far its sampled loop is from instability."""

from __future__ import annotations

import math
from typing import Any

from kneexo.analysis.bandwidth import large_signal_bandwidth_hz
from kneexo.analysis.sampled_loop import linearize_loop
from kneexo.analysis.tracking import TRACKING_FIGURES, track_figures
from kneexo.errors import KneexoError
from kneexo.parameters import Scenario
from kneexo.simulation import awaitable, needs_runs

MARGIN_FIGURES = ("phase_margin_deg", "delay_margin_s", "gain_margin", "disk_margin")
"""Figures of `kneexo.analysis.Margins` that an assessment quotes."""


@needs_runs
async def assess(
    scenario: Scenario, *, tracking: bool = True, margins: bool = True, bandwidth: bool = False
) -> dict[str, Any]:
    """Plain numbers by name: `TRACKING_FIGURES`, ``stable``, `MARGIN_FIGURES`, ``bandwidth_hz``.

    The margins are those at the middle of the reference's range, the bandwidth is that of the
    reference's own sine (`large_signal_bandwidth_hz`). What fails is nan (``stable``: None) and
    ``tracking_failure``, ``margins_failure`` or ``bandwidth_failure`` says why in one line, so that
    a sweep over many scenarios shows where a run diverges in place of ending there. An unstable
    loop has no margins: they are nan.
    """
    figures: dict[str, Any] = {}
    if tracking:
        figures |= dict.fromkeys(TRACKING_FIGURES, math.nan) | {"tracking_failure": ""}
        try:
            figures |= await awaitable(track_figures, scenario)
        except KneexoError as error:
            figures["tracking_failure"] = str(error)
    if margins:
        figures |= dict.fromkeys(MARGIN_FIGURES, math.nan)
        figures |= {"stable": None, "margins_failure": ""}
        try:
            loop = linearize_loop(scenario, scenario.reference.middle_deg)
            figures["stable"] = loop.stable
            if loop.stable:
                values = loop.margins()
                figures |= {name: getattr(values, name) for name in MARGIN_FIGURES}
        except KneexoError as error:
            figures["margins_failure"] = str(error)
    if bandwidth:
        figures |= {"bandwidth_hz": math.nan, "bandwidth_failure": ""}
        try:
            figures["bandwidth_hz"] = await awaitable(large_signal_bandwidth_hz, scenario)
            if math.isnan(figures["bandwidth_hz"]):
                figures["bandwidth_failure"] = "no bandwidth: the gain does not cross 1/√2"
        except KneexoError as error:
            figures["bandwidth_failure"] = str(error)
    return figures
