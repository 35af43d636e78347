"""A measured knee in walking: flexion over the gait cycle.

The data are the mean of 56 strides of one healthy adult, derived from NONAN GaitPrint (Wiles et
al., Scientific Data), CC BY 4.0: see the head of ``kneexo/data/gait_knee_flexion.csv``.
"""

from __future__ import annotations

from importlib.resources import files

import numpy as np

from kneexo.result import Array

GAIT_STRIDE_S = 0.890
"""Median stride time of the measured gait, as the head of ``data/gait_knee_flexion.csv`` says."""


def gait_knee_flexion() -> tuple[Array, Array, Array]:
    """Gait cycle in %, mean knee flexion in deg and its standard deviation in deg, each (101,).

    From heel contact (0 %) to heel contact (100 %) of the same leg, as measured: the two ends
    differ by 0.03°.
    """
    text = files("kneexo").joinpath("data", "gait_knee_flexion.csv").read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line[:1].isdigit()]
    percent, mean, deviation = np.array([row.split(",") for row in rows], dtype=float).T
    return percent, mean, deviation


def gait_start_percent() -> float:
    """Where `gait_reference` starts: least flexion (mid-stance), in % after heel contact."""
    percent, mean, _ = gait_knee_flexion()
    return float(percent[np.argmin(mean)])
