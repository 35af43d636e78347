"""Response of a run to a push: how far the knee moves, and how long it needs to return."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kneexo.common.result import Array, Result
from kneexo.parameters.criteria import RECOVERY_BAND_DEG


@dataclass(frozen=True, repr=False)
class PushResponse(Result):
    """How a push moves the knee, measured from the same run without the push."""

    largest_deviation_deg: float
    """Largest difference of the knee angles with and without the push."""
    recovery_time_s: float
    """Time from the start of the push to the first sample after which the knee stays in the band.

    The band is `RECOVERY_BAND_DEG`. The value is nan if the knee is outside at the end of the run.
    """

    @property
    def line(self) -> str:
        """One line with both numbers."""
        back = "is not back"
        if self.largest_deviation_deg <= RECOVERY_BAND_DEG:
            back = "stays"
        elif math.isfinite(self.recovery_time_s):
            back = f"is back {self.recovery_time_s:.3g} s after its start,"
        return (
            f"The push moves the knee by {self.largest_deviation_deg:.3g}°. The knee {back} within "
            f"{RECOVERY_BAND_DEG:g}° of the run without it."
        )


def push_response(
    time_s: Array, angle_deg: Array, free_deg: Array, *, start_s: float
) -> PushResponse:
    """Return the `PushResponse` of a run.

    Parameters
    ----------
    time_s
        Times of the samples in s, (n,).
    angle_deg, free_deg
        Knee angle in deg with and without the push at these times, (n,) each.
    start_s
        Start of the push in s.
    """
    deviation = np.abs(angle_deg - free_deg)
    outside = np.flatnonzero(deviation > RECOVERY_BAND_DEG)
    back = int(outside[-1]) + 1 if outside.size else 0
    recovery = max(float(time_s[back]) - start_s, 0.0) if back < time_s.size else math.nan
    return PushResponse(float(np.max(deviation)), recovery)
