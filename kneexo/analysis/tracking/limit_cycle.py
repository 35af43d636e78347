"""Limit cycle of a knee whose reference rests: its amplitude, period and load pressure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kneexo.analysis.tracking.clauses import said
from kneexo.common.result import Result
from kneexo.simulation import Run

SMALLEST_CYCLE_DEG = 1e-3
"""Smallest amplitude of a limit cycle in deg. Assumption: 1/80 of a count of the encoder.

The rounding of a drive's speed command alone moves the knee of ``bench`` by 0.0003°.
"""

REST_RAD = 1e-6
"""Largest change of a reference that rests, in rad. The compiled and Drake's references round."""

SUSTAINED = 0.9
"""Smallest ratio of the swings in the last and the third quarter of a rest that does not decay."""


@dataclass(frozen=True, repr=False)
class LimitCycle(Result):
    """Oscillation of the knee that does not decay while the reference rests."""

    start_s: float
    """Time from which on the reference is constant."""
    amplitude_deg: float
    """Half the swing of the knee angle from peak to peak."""
    period_s: float
    """Mean time between two crossings of the middle angle in the same direction."""
    lowest_pressure_mpa: float
    highest_pressure_mpa: float
    """Range of the load pressure in the limit cycle."""

    @property
    def line(self) -> str:
        """One line with the numbers of the limit cycle."""
        return (
            f"{said('hunts', **vars(self))}, the load pressure from "
            f"{self.lowest_pressure_mpa:.2g} to {self.highest_pressure_mpa:.2g} MPa."
        )


def limit_cycle(run: Run) -> LimitCycle | None:
    """Return the limit cycle at the end of a run, or None if there is none.

    The reference rests after its last change. The first half of this rest is for transients. The
    knee has a limit cycle if its swing in the last quarter of the rest is at least 0.9 of the swing
    in the quarter before, if the amplitude is at least `SMALLEST_CYCLE_DEG`, and if the knee angle
    crosses the middle of the swing at least three times in these two quarters.
    """
    reference = run["knee_reference_rad"]
    moving = np.flatnonzero(np.abs(reference - reference[-1]) > REST_RAD)
    start = int(moving[-1]) + 1 if moving.size else 0
    half = (start + reference.size) // 2
    angle = np.degrees(run["knee_angle_rad"][half:])
    if angle.size < 4:
        return None
    before, after = np.array_split(angle, 2)
    amplitude, middle = 0.5 * float(np.ptp(after)), 0.5 * float(np.max(angle) + np.min(angle))
    if amplitude < max(SMALLEST_CYCLE_DEG, 0.5 * SUSTAINED * float(np.ptp(before))):
        return None
    # Ripples about the middle do not count, because the knee must leave half of the swing.
    side = np.where(np.abs(angle - middle) > 0.5 * amplitude, np.sign(angle - middle), 0.0)
    outside = np.flatnonzero(side)
    crossings = outside[1:][np.diff(side[outside]) != 0.0]
    if (periods := (crossings.size - 1) // 2) < 1:
        return None
    time, pressure = run.time_s[half:], 1e-6 * run["load_pressure_pa"][half:]
    return LimitCycle(
        start_s=float(run.time_s[start]),
        amplitude_deg=amplitude,
        period_s=float(time[crossings[2 * periods]] - time[crossings[0]]) / periods,
        lowest_pressure_mpa=float(np.min(pressure)),
        highest_pressure_mpa=float(np.max(pressure)),
    )
