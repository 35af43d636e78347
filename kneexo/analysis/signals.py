"""Period, root mean square, shares and unit of signals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from kneexo.parameters import Scenario
from kneexo.result import Array


def period_s(scenario: Scenario) -> float:
    """Return the period in s of a sinusoidal reference, or zero for another reference."""
    reference = scenario.reference
    return 1.0 / reference.frequency_hz if reference.kind == "sine" else 0.0


def rms(values: Array) -> float:
    """Return the root mean square of ``values`` (n,)."""
    return float(np.sqrt(np.mean(np.square(values))))


def to_rpm(speed: Any) -> Any:
    """Convert a speed from rad/s to rpm."""
    return speed * 30.0 / math.pi


def saturation(limit: float) -> float:
    """Return the magnitude from which a command with this limit counts as saturated."""
    return limit * (1.0 - 1e-6)


def saturated_share(command: Array, limit: float) -> float:
    """Return the share of ``command`` (n,) whose magnitude is at least `saturation`."""
    return int(np.count_nonzero(np.abs(command) >= saturation(limit))) / command.size


def share_above(values: Array, bound: float) -> float:
    """Return the share of ``values`` (n,) whose absolute value exceeds ``bound``."""
    return int(np.count_nonzero(np.abs(values) > bound)) / values.size
