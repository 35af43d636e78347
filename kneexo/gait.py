"""A measured knee in walking: flexion over the gait cycle, as data and as a reference.

The data are the mean of 56 strides of one healthy adult, derived from NONAN GaitPrint (Wiles et
al., Scientific Data), CC BY 4.0: see the head of ``kneexo/data/gait_knee_flexion.csv``.
"""

from __future__ import annotations

from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from kneexo.errors import ParameterError
from kneexo.parameters import SampledReference

Array = NDArray[np.float64]


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


def gait_reference(frequency_hz: float = 1.0, cycles: int = 3) -> SampledReference:
    """The measured knee flexion as a periodic reference, ``cycles`` strides long.

    It starts and ends at the least flexion, where the knee is at rest (`gait_start_percent`), at
    t = 0. A straight line is taken from the curve that closes it: it moves no sample by more than
    0.03°, a twentieth of the standard deviation. The loop settles during the first stride.

    Parameters
    ----------
    frequency_hz
        Strides per second, > 0 and at most 10 Hz (beyond, a sample lasts less than a millisecond);
        the measured one is `kneexo.parameters.GAIT_STRIDE_S`.
    cycles
        Number of strides, 1 … 1000.

    Raises
    ------
    ParameterError
        A value is out of range.
    """
    if not 0.0 < frequency_hz <= 10.0:
        raise ParameterError(f"frequency_hz = {frequency_hz:g} Hz: must be > 0 and <= 10 Hz")
    if not 1 <= cycles <= 1000:
        raise ParameterError(f"cycles = {cycles}: must be >= 1 and <= 1000")
    percent, mean, _ = gait_knee_flexion()
    closed = mean - (mean[-1] - mean[0]) * percent / percent[-1]
    stride = np.roll(closed[:-1], -int(np.argmin(mean)))
    angles = np.append(np.tile(stride, cycles), stride[0])
    times = np.arange(angles.size) / (stride.size * frequency_hz)
    return SampledReference(times_s=tuple(times.tolist()), angles_deg=tuple(angles.tolist()))
