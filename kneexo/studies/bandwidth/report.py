"""Markdown of `kneexo.studies.bandwidth.study`."""

from __future__ import annotations

import math

import numpy as np

from kneexo.analysis.bandwidth import rod_limits
from kneexo.analysis.frequency_response import require_sine
from kneexo.studies.bandwidth.study import BandwidthResult
from kneexo.studies.markdown import document, markdown_table, number

_DRIFT_DEG = 1.0
"""Distance of the knee's mean from the reference's that is reported."""


def report(study: BandwidthResult) -> str:
    """The story in Markdown."""
    unsettled = int(np.sum(~study.cells["settled"] & np.isfinite(study.gain_db)))
    worst = 100.0 * np.nanmax(study.relative_uncertainty, initial=0.0)
    columns = {
        "measured_hz": "−3 dB, measured (Hz)",
        "linear_loop_hz": "linear loop",
        "acceleration_bound_hz": "acceleration bound",
        "follower_hz": "speed limit, follower",
        "rate_limit_hz": "speed limit, closed form",
    }
    rows = []
    for i, amplitude in enumerate(study.amplitudes_deg):
        name, expected = study.decided_by(i)
        values = [study.bandwidths[column][i] for column in columns]
        shown = [number(value, ".4g") for value in [*values, values[0] / expected]]
        rows.append([f"{amplitude:g}", *shown[:-1], name, shown[-1]])
    return document(
        "# Frequency response from small to large amplitudes",
        f"Sinestream about {require_sine(study.scenario).mean_deg:g}°, {study.response.size} "
        f"sines. Bandwidth is where the gain of the fundamental first falls below 1/√2. "
        f"{unsettled} sines had not settled after {study.settings.estimate.largest_cycles} "
        f"cycles: their scatter is in the uncertainty, which is at most {worst:.2g} % of the "
        f"gain.",
        markdown_table(("amplitude (deg)", *columns.values(), "lowest", "measured / lowest"), rows),
        _limits_in_words(study),
        _linear_in_words(study),
        _drift_in_words(study),
        "Runs that failed:" if study.failures else "",
        [f"- {line}" for line in study.failures],
    )


def _limits_in_words(study: BandwidthResult) -> str:
    at: dict[str, list[str]] = {}
    for i, amplitude in enumerate(study.amplitudes_deg):
        at.setdefault(study.decided_by(i)[0], []).append(f"{amplitude:g}°")
    parts = [f"the {name} at {', '.join(amplitudes)}" for name, amplitudes in at.items()]
    speed, acceleration = rod_limits(study.scenario)
    text = f"What sets the bandwidth: {'; '.join(parts)}."
    if math.isfinite(acceleration):
        text += (
            f" The motor gives the rod at most {1e3 * speed:.3g} mm/s and "
            f"{acceleration:.3g} m/s²: below {1e3 * speed**2 / acceleration:.2g} mm of rod "
            f"amplitude a sine meets the acceleration limit first, above it the speed limit."
        )
    return text


def _linear_in_words(study: BandwidthResult) -> str:
    if study.linear_failure:
        return f"There is no linear loop to compare with: {study.linear_failure}."
    free, counted = (study.linear_deviation(quantized=quantized) for quantized in (False, True))
    if math.isnan(free):
        return (
            f"At {study.amplitudes_deg[0]:g}° the motor reaches its limits, or the run fails, "
            f"at every frequency: there is nothing to compare with the linear loop."
        )
    text = (
        f"Where the motor stays off its limits, the response at {study.amplitudes_deg[0]:g}° "
        f"differs from that of the linear loop by at most {100 * free:.2g} % without "
        f"quantizers"
    )
    if study.scenario.quantized and not math.isnan(counted):
        text += f", {100 * counted:.2g} % with them"
    return text + "."


def _drift_in_words(study: BandwidthResult) -> str:
    away = np.abs(study.cells["mean_deg"] - require_sine(study.scenario).mean_deg)
    count = int(np.sum(away > _DRIFT_DEG))
    if not count:
        return ""
    i, j = np.unravel_index(np.nanargmax(away), away.shape)
    return (
        f"At {count} sines the mean of the knee leaves the reference's by more than "
        f"{_DRIFT_DEG:g}°, most ({away[i, j]:.3g}°) at {study.amplitudes_deg[i]:g}° and "
        f"{study.frequencies_hz[j]:g} Hz: a motor that a fast sine keeps at its limits has "
        f"little authority left to hold the mean."
    )
