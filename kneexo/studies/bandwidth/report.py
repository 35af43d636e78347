"""Markdown report on a `kneexo.studies.bandwidth.bandwidth.BandwidthResult`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np

from kneexo.analysis.frequency.bandwidth import rod_limits
from kneexo.analysis.frequency.frequency_response import require_sine
from kneexo.studies.bandwidth.bandwidth import BandwidthResult
from kneexo.studies.markdown import number
from kneexo.studies.template import filled

_DRIFT_DEG = 1.0
"""Limit in deg. The report mentions a larger difference between the means of knee and reference."""


def report(result: BandwidthResult) -> str:
    """Return the Markdown report on the frequency response at all amplitudes."""
    rows = []
    for i, amplitude in enumerate(result.amplitudes_deg):
        lowest, expected_hz = result.decided_by(i)
        bandwidths = {name: values[i] for name, values in result.bandwidths.items()}
        ratio = bandwidths["measured_hz"] / expected_hz
        rows.append({"amplitude_deg": amplitude, "lowest": lowest, "ratio": ratio} | bandwidths)
    speed, acceleration = rod_limits(result.scenario)
    free, counted = (result.linear_deviation(quantized=counts) for counts in (False, True))
    return filled(
        "bandwidth/report.md",
        result=result,
        rows=rows,
        limits=[_limit(name, list(group)) for name, group in groupby(rows, itemgetter("lowest"))],
        mean_deg=require_sine(result.scenario).mean_deg,
        smallest_deg=result.amplitudes_deg[0],
        unsettled=int(np.sum(~result.cells["settled"] & np.isfinite(result.gain_db))),
        uncertainty_percent=100.0 * np.nanmax(result.relative_uncertainty, initial=0.0),
        speed_m_s=speed,
        acceleration_m_s2=acceleration,
        infinity=math.inf,
        deviation=None if math.isnan(free) else free,
        deviation_with_counts=(
            None if math.isnan(counted) or not result.scenario.quantized else counted
        ),
        drift=_drift(result),
    )


def _limit(name: str, rows: Sequence[dict[str, Any]]) -> dict[str, str]:
    """Return texts with the ranges of neighbouring amplitudes that the same limit decides.

    Each range goes from the smallest to the largest amplitude.
    """

    def ends(key: str, form: str) -> str:
        texts = [number(rows[n][key], form) for n in (0, -1)]
        return "…".join(dict.fromkeys(texts))

    return {
        "name": name,
        "range_deg": ends("amplitude_deg", "g"),
        "measured_hz": ends("measured_hz", ".4g"),
        "ratio": ends("ratio", ".3g"),
    }


def _drift(result: BandwidthResult) -> dict[str, Any]:
    """Return the largest difference between the mean angles of knee and reference.

    The dictionary also has the amplitude and frequency at which this difference occurs, and the
    number of map cells above ``_DRIFT_DEG``. Without such a cell the dictionary is empty.
    """
    distance = np.abs(result.cells["mean_deg"] - require_sine(result.scenario).mean_deg)
    count = int(np.sum(distance > _DRIFT_DEG))
    if not count:
        return {}
    i, j = np.unravel_index(np.nanargmax(distance), distance.shape)
    return {
        "count": count,
        "limit_deg": _DRIFT_DEG,
        "largest_deg": distance[i, j],
        "amplitude_deg": result.amplitudes_deg[i],
        "frequency_hz": result.frequencies_hz[j],
    }
