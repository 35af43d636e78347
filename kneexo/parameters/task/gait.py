"""Measured walking: flexion of the knee over the gait cycle, and the net moment of a stride.

The flexion is the mean of 56 strides of one healthy adult. It is derived from NONAN GaitPrint
(Wiles et al., Scientific Data), CC BY 4.0. The moment belongs to another adult. It is derived from
an example of opensim-core, Apache-2.0. The first lines of the files in ``kneexo/data`` say more.
"""

from __future__ import annotations

from importlib.resources import files

import numpy as np

from kneexo.common.result import Array

GAIT_STRIDE_S = 0.890
"""Median duration of the measured strides in s, from ``data/gait_knee_flexion.csv``."""

MOMENT_STRIDE_S = 1.147
"""Duration in s after which angle and moment of `gait_knee_moment` repeat best."""


def gait_knee_flexion() -> tuple[Array, Array, Array]:
    """Return gait cycle in %, mean knee flexion in deg and its standard deviation in deg.

    Each array has the shape (101,). The cycle begins at heel contact (0 %) and ends at the next
    heel contact of the same leg (100 %). The measured flexions at both ends differ by 0.03°.
    """
    percent, mean, deviation = _columns("gait_knee_flexion.csv")
    return percent, mean, deviation


def gait_start_percent() -> float:
    """Return the time of least flexion in % after heel contact. `gait_reference` starts there."""
    percent, mean, _ = gait_knee_flexion()
    return float(percent[np.argmin(mean)])


def gait_knee_moment() -> tuple[Array, Array, Array]:
    """Return time in s, knee flexion in deg and net knee moment in N·m of measured walking.

    Each array has the shape (1350,). The samples are 1 ms apart, from 0.450 s to 1.799 s, which is
    1.2 strides of one adult. A positive moment flexes the knee. The moment includes the reaction
    of the ground.
    """
    time, flexion, moment = _columns("knee_angle_moment_walk.csv")
    return time, flexion, moment


def gait_moment_cycle() -> Array:
    """Return the net knee moment in N·m over the gait cycle of `gait_knee_flexion`, (101,).

    The moment comes from the last stride of `gait_knee_moment`, measured on another adult. The
    phase of the moment is shifted so that the flexions of both adults have the largest correlation.
    A subtracted straight line makes both ends equal, and changes no sample by more than 1.2 N·m. A
    positive moment flexes the knee.
    """
    time, flexion, moment = gait_knee_moment()
    percent, mean, _ = gait_knee_flexion()
    times = time[-1] + MOMENT_STRIDE_S * (0.01 * percent - 1.0)
    angle = np.interp(times, time, flexion)[:-1]
    cycle = np.interp(times, time, moment)
    cycle -= (cycle[-1] - cycle[0]) * percent / percent[-1]
    correlations = [mean[:-1] @ np.roll(angle, shift) for shift in range(angle.size)]
    aligned = np.roll(cycle[:-1], int(np.argmax(correlations)))
    return np.append(aligned, aligned[0])


def _columns(name: str) -> Array:
    """Read a CSV file of ``kneexo/data``; row i of the result is column i of the file."""
    text = files("kneexo").joinpath("data", name).read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line[:1].isdigit()]
    return np.array([row.split(",") for row in rows], dtype=float).T
