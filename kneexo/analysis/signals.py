"""Period, root mean square, shares and unit of signals, and the phase of a response."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from kneexo.common.result import Array
from kneexo.parameters import Scenario


def period_s(scenario: Scenario) -> float:
    """Return the period in s of a sinusoidal reference, or zero for another reference."""
    reference = scenario.reference
    return 1.0 / reference.frequency_hz if reference.kind == "sine" else 0.0


def settled_s(scenario: Scenario) -> float:
    """Return the time in s at which the metrics begin that leave out the start of a run.

    The first period of a sine is left out if the run has at least two periods. Of a shorter run
    nothing is left out, because the rest would hide a part of the motion. As in
    `kneexo.analysis.tracking.interaction.whole_periods`, the last period may lack its last sample.
    """
    period, sample_s = period_s(scenario), scenario.controller.sample_time_s
    samples = math.floor(scenario.duration_s / sample_s + 1e-6) + 1
    return period if periods_in(samples * sample_s, period) >= 2 else 0.0


def periods_in(span_s: float, period_s: float) -> int:
    """Return the number of whole periods in a time, or zero if the period is zero."""
    return math.floor(span_s / period_s + 1e-9) if period_s > 0.0 else 0


def rms(values: Array) -> float:
    """Return the root mean square of ``values`` (n,)."""
    return float(np.sqrt(np.mean(np.square(values))))


def unwrapped_deg(response: Any) -> Array:
    """Return the phase in deg of ``response`` (…, n), unwrapped along n over its finite values."""
    phase = np.angle(response)
    for row in np.atleast_2d(phase):
        finite = np.isfinite(row)
        row[finite] = np.unwrap(row[finite])
    return np.degrees(phase)


def to_rpm(speed: Any) -> Any:
    """Convert a speed from rad/s to rpm."""
    return speed * 30.0 / math.pi


def saturation(limit: float) -> float:
    """Return the magnitude from which a command with this limit counts as saturated."""
    # Below the limit, because the drive's whole number times its unit is rounded.
    return limit * (1.0 - 1e-6)


def saturated_share(command: Array, limit: float) -> float:
    """Return the share of ``command`` (n,) whose magnitude is at least `saturation`."""
    return int(np.count_nonzero(np.abs(command) >= saturation(limit))) / command.size


def share_above(values: Array, bound: float) -> float:
    """Return the share of ``values`` (n,) whose absolute value exceeds ``bound``."""
    return int(np.count_nonzero(np.abs(values) > bound)) / values.size
