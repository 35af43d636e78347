"""Measured flexion of the knee over the gait cycle of walking.

The data are the mean of 56 strides of one healthy adult. They are derived from NONAN GaitPrint
(Wiles et al., Scientific Data), CC BY 4.0; the first lines of
``kneexo/data/gait_knee_flexion.csv`` say more.
"""

from __future__ import annotations

from importlib.resources import files

import numpy as np

from kneexo.result import Array

GAIT_STRIDE_S = 0.890
"""Median duration of the measured strides in s, from ``data/gait_knee_flexion.csv``."""


def gait_knee_flexion() -> tuple[Array, Array, Array]:
    """Return gait cycle in %, mean knee flexion in deg and its standard deviation in deg.

    Each array has the shape (101,). The cycle begins at heel contact (0 %) and ends at the next
    heel contact of the same leg (100 %). The measured flexions at both ends differ by 0.03°.
    """
    text = files("kneexo").joinpath("data", "gait_knee_flexion.csv").read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line[:1].isdigit()]
    percent, mean, deviation = np.array([row.split(",") for row in rows], dtype=float).T
    return percent, mean, deviation


def gait_start_percent() -> float:
    """Return the time of least flexion in % after heel contact. `gait_reference` starts there."""
    percent, mean, _ = gait_knee_flexion()
    return float(percent[np.argmin(mean)])
