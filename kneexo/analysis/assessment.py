"""One scenario in numbers: how it tracks, and how far its sampled loop is from instability."""

from __future__ import annotations

import math
from typing import Any

from kneexo.analysis.bandwidth import large_signal_bandwidth_hz
from kneexo.analysis.sampled_loop import linearize_loop
from kneexo.analysis.tracking import TRACKING_METRICS, track_basic_metrics
from kneexo.errors import KneexoError
from kneexo.parameters import Scenario
from kneexo.simulation import awaitable, needs_runs

MARGIN_METRICS = ("phase_margin_deg", "delay_margin_s", "gain_margin", "disk_margin")
"""Fields of `kneexo.analysis.Margins` that `assess` returns."""


@needs_runs
async def assess(
    scenario: Scenario, *, tracking: bool = True, margins: bool = True, bandwidth: bool = False
) -> dict[str, Any]:
    """Plain numbers by name: `TRACKING_METRICS`, ``stable``, `MARGIN_METRICS`, ``bandwidth_hz``.

    The margins are those at the middle of the reference's range, the bandwidth is that of the
    reference's own sine (`large_signal_bandwidth_hz`). What fails is nan (``stable``: None) and
    ``tracking_failure``, ``margins_failure`` or ``bandwidth_failure`` says why in one line, so that
    a sweep over many scenarios shows where a run diverges in place of ending there. An unstable
    loop has no margins: they are nan.
    """
    metrics: dict[str, Any] = {}
    if tracking:
        metrics |= dict.fromkeys(TRACKING_METRICS, math.nan) | {"tracking_failure": ""}
        try:
            metrics |= await awaitable(track_basic_metrics, scenario)
        except KneexoError as error:
            metrics["tracking_failure"] = str(error)
    if margins:
        metrics |= dict.fromkeys(MARGIN_METRICS, math.nan)
        metrics |= {"stable": None, "margins_failure": ""}
        try:
            loop = linearize_loop(scenario, scenario.reference.middle_deg)
            metrics["stable"] = loop.stable
            if loop.stable:
                values = loop.margins()
                metrics |= {name: getattr(values, name) for name in MARGIN_METRICS}
        except KneexoError as error:
            metrics["margins_failure"] = str(error)
    if bandwidth:
        metrics |= {"bandwidth_hz": math.nan, "bandwidth_failure": ""}
        try:
            metrics["bandwidth_hz"] = await awaitable(large_signal_bandwidth_hz, scenario)
            if math.isnan(metrics["bandwidth_hz"]):
                metrics["bandwidth_failure"] = "no bandwidth: the gain does not cross 1/√2"
        except KneexoError as error:
            metrics["bandwidth_failure"] = str(error)
    return metrics
