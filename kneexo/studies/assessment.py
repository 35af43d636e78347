"""Tracking metrics, stability margins and bandwidth of one scenario as plain numbers."""

from __future__ import annotations

import math
from typing import Any

from kneexo.analysis.frequency.bandwidth import large_signal_bandwidth_hz
from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.analysis.tracking.interaction import INTERACTION_METRICS
from kneexo.analysis.tracking.reduced_tracking import track_basic_metrics
from kneexo.analysis.tracking.reductions import TRACKING_METRICS
from kneexo.errors import failure_noted
from kneexo.parameters import Scenario
from kneexo.simulation import needs_runs
from kneexo.systems.knee_reference import run_middle_deg

MARGIN_METRICS = ("phase_margin_deg", "delay_margin_s", "gain_margin", "disk_margin")
"""Names of the fields of `kneexo.analysis.Margins` that `assess` returns."""


@needs_runs
def assess(
    scenario: Scenario, *, tracking: bool = True, margins: bool = True, bandwidth: bool = False
) -> dict[str, Any]:
    """Return a dictionary from the name of a metric of a scenario to its value.

    Each argument that is True adds a group of metrics:

    - ``tracking``: the `TRACKING_METRICS` of a simulated run, and ``tracking_failure``. A scenario
      with a wearer adds the `INTERACTION_METRICS` of the samples that count for the error.
    - ``margins``: ``stable``, `MARGIN_METRICS` and ``margins_failure``. The loop is linearized in
      the middle of the reference's range. The margins of an unstable loop are nan.
    - ``bandwidth``: ``bandwidth_hz`` (`large_signal_bandwidth_hz`) and ``bandwidth_failure``.

    The function raises no `KneexoError`, so that a sweep continues after a scenario fails. If the
    analysis of a group fails, the numbers of the group are nan, ``stable`` is None, and the
    group's ``…_failure`` is the error message. Otherwise ``…_failure`` is an empty text.
    """
    metrics: dict[str, Any] = {}
    loop = None
    if tracking:
        names = TRACKING_METRICS + INTERACTION_METRICS * (scenario.wearer.kind != "none")
        metrics |= dict.fromkeys(names, math.nan)
        with failure_noted(metrics, "tracking_failure"):
            metrics |= track_basic_metrics(scenario)
    if margins:
        metrics |= dict.fromkeys(MARGIN_METRICS, math.nan)
        metrics["stable"] = None
        with failure_noted(metrics, "margins_failure"):
            loop = linearize_loop(scenario, knee_angle_deg=run_middle_deg(scenario))
            metrics["stable"] = loop.stable
            if loop.stable:
                values = loop.margins()
                metrics |= {name: getattr(values, name) for name in MARGIN_METRICS}
    if bandwidth:
        metrics["bandwidth_hz"] = math.nan
        with failure_noted(metrics, "bandwidth_failure"):
            metrics["bandwidth_hz"] = large_signal_bandwidth_hz(scenario, loop=loop)
            if math.isnan(metrics["bandwidth_hz"]):
                metrics["bandwidth_failure"] = "no bandwidth: the gain does not cross 1/√2"
    return metrics
