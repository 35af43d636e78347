"""Parameters of the knee references: sine, step, ramp, samples, CSV files and the gait curve."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from kneexo.common.files.reading import file_error
from kneexo.common.files.table import SUFFIXES, read_table
from kneexo.common.result import Array
from kneexo.errors import ParameterError
from kneexo.parameters.fields.fields import Words, kind_of
from kneexo.parameters.fields.quantity import Parameters, choice, quantity
from kneexo.parameters.task.gait import gait_knee_flexion

_LEAST_FLEXION_DEG = -2.0


def _flexion(default: float, source: str) -> Any:
    return quantity(default, "deg", source, ge=_LEAST_FLEXION_DEG, le=91)


_SHORTEST_RAMP_S = 1e-3  # the jerk of the reference is divided by the third power of ``ramp_s``
_SHORTEST_SAMPLE_S = 1e-6
_FEWEST_SAMPLES = 3
_LARGEST_GAP_DEG = 2.0  # assumption: a measured stride that closes less well is no cycle
_MOTION_SAMPLES = 60  # of one rise; the spline between them is within 1e-4 deg of minimum jerk
SHORTEST_RUN_S = 1e-3
"""Duration of the shortest run in s."""
LONGEST_TIME_S = 1e5
"""Largest absolute value of a sample's time in s. Times can be negative."""
TIMES_IN_MS = "; divide all times by 1000 if they are in ms"
"""Remedy for a time out of range."""


class _KneeReference(Parameters):
    @property
    def range_deg(self) -> tuple[float, float]:
        """Smallest and largest knee angle of the reference in deg."""
        raise NotImplementedError


class SineReference(_KneeReference):
    """Knee angle mean − amplitude·cos(2πft). The knee starts at rest, at the smallest angle.

    With ``ramp_s`` > 0 the angle starts at the mean, and the amplitude grows smoothly from zero
    during ``ramp_s``.
    """

    kind: Literal["sine"] = "sine"
    mean_deg: float = _flexion(40.0, "Section 5: 10…70°")
    amplitude_deg: float = quantity(30.0, "deg", "Section 5: 10…70°", ge=0, le=46)
    frequency_hz: float = quantity(0.1, "Hz", "Section 5: 0.1 Hz", ge=1e-5, le=250)
    ramp_s: float = quantity(
        0.0, "s", "assumption: none; time over which the amplitude grows", ge=0, le=1e5
    )

    @property
    def range_deg(self) -> tuple[float, float]:
        """Smallest and largest knee angle of the reference in deg."""
        return self.mean_deg - self.amplitude_deg, self.mean_deg + self.amplitude_deg

    @model_validator(mode="after")
    def _ramp_is_smooth(self) -> SineReference:
        if 0.0 < self.ramp_s < _SHORTEST_RAMP_S:
            raise ValueError(
                f"ramp_s = {self.ramp_s:g} s is out of range: must be 0 or >= {_SHORTEST_RAMP_S:g} "
                f"s and <= 100000 s"
            )
        return self


class StepReference(_KneeReference):
    """Knee angle that jumps from ``start_deg`` to ``end_deg`` at ``time_s``."""

    kind: Literal["step"] = "step"
    start_deg: float = _flexion(30.0, "assumption: an example")
    end_deg: float = _flexion(50.0, "assumption: an example")
    time_s: float = quantity(1.0, "s", "assumption: an example", ge=0, le=1e6)

    @property
    def range_deg(self) -> tuple[float, float]:
        """Smallest and largest knee angle of the reference in deg."""
        return min(self.start_deg, self.end_deg), max(self.start_deg, self.end_deg)


class RampReference(_KneeReference):
    """Knee angle that moves from ``start_deg`` to ``end_deg`` at a constant rate.

    The motion starts at ``time_s``.
    """

    kind: Literal["ramp"] = "ramp"
    start_deg: float = _flexion(20.0, "assumption: an example")
    end_deg: float = _flexion(60.0, "assumption: an example")
    time_s: float = quantity(1.0, "s", "assumption: an example", ge=0, le=1e6)
    rate_deg_s: float = quantity(
        15.0, "deg/s", "assumption: below the 23 deg/s that the speed limit allows", ge=1e-3, le=1e4
    )

    @property
    def range_deg(self) -> tuple[float, float]:
        """Smallest and largest knee angle of the reference in deg."""
        return min(self.start_deg, self.end_deg), max(self.start_deg, self.end_deg)


def require_samples(
    times_s: Sequence[float], name: str, values: Sequence[float], fewest: int
) -> None:
    """Raise `ValueError` unless times increase and there are as many values.

    Parameters
    ----------
    times_s
        The times in s.
    name, values
        The values at these times.
    fewest
        Smallest number of values.
    """
    if not len(times_s) == len(values) >= fewest:
        raise ValueError(
            f"times_s has {len(times_s)} values and {name} has {len(values)}: must be as many, at "
            f"least {fewest}"
        )
    if any(b - a < _SHORTEST_SAMPLE_S for a, b in pairwise(times_s)):
        raise ValueError("times_s must increase by at least 1e-6 s from sample to sample")


Interpolation = Literal["cubic", "pchip", "linear"]
"""Name of the curve that connects the samples of a reference."""
_INTERPOLATION = (
    "cubic: spline with continuous acceleration, which may pass the samples' range; pchip: "
    "shape-preserving cubic, which stays within neighbouring samples; linear: straight lines"
)

_CLIP = "true: samples beyond the range of motion are set to its ends, as in hyperextension"


class SampledReference(_KneeReference):
    """Knee angle that passes through samples.

    The default curve is a cubic spline with continuous acceleration. ``interpolation`` chooses
    another curve. Times and angles can be tuples, lists, NumPy arrays or pandas columns.
    """

    kind: Literal["samples"] = "samples"
    times_s: tuple[float, ...] = Field(
        min_length=_FEWEST_SAMPLES,
        json_schema_extra={"unit": "s", "source": "given by the user; strictly increasing"},
    )
    angles_deg: tuple[float, ...] = Field(
        min_length=_FEWEST_SAMPLES, json_schema_extra={"unit": "deg", "source": "given by the user"}
    )
    interpolation: Interpolation = choice("cubic", _INTERPOLATION)
    clip: bool = choice(False, _CLIP)
    clipped_deg: float = quantity(0.0, "deg", "result: largest change by clip", ge=0, le=1e9)
    shift_s: float = quantity(0.0, "s", "result: time in the file at 0 s", ge=0, le=LONGEST_TIME_S)

    @model_validator(mode="after")
    def _consistent(self) -> SampledReference:
        require_samples(self.times_s, "angles_deg", self.angles_deg, _FEWEST_SAMPLES)
        if max(abs(self.times_s[0]), abs(self.times_s[-1])) > LONGEST_TIME_S:
            raise ValueError(f"times_s must lie within ±{LONGEST_TIME_S:g} s")
        if self.times_s[-1] < SHORTEST_RUN_S:
            raise ValueError(
                f"times_s ends at {self.times_s[-1]:g} s: must end at >= {SHORTEST_RUN_S:g} s, "
                f"because a run starts at 0 s; subtract the first time, {self.times_s[0]:g} s, "
                f"from all times"
            )
        return self

    @property
    def range_deg(self) -> tuple[float, float]:
        """Smallest and largest sample in deg. The spline between the samples can go beyond them."""
        return min(self.angles_deg), max(self.angles_deg)

    def clipped(self, low_deg: float, high_deg: float) -> SampledReference:
        """Return the reference with its samples clipped to a range, and how far they were off."""
        angles = np.clip(self.angles_deg, low_deg, high_deg)
        off = max(float(np.max(np.abs(angles - self.angles_deg))), self.clipped_deg)
        return self.model_copy(update={"angles_deg": tuple(angles.tolist()), "clipped_deg": off})


class CsvTable(Parameters):
    """A CSV file, or a .mot or .sto file of OpenSim, with a quantity of the knee over time."""

    kind: Literal["csv"] = "csv"
    file: str = Field(
        min_length=1,
        json_schema_extra={
            "unit": "",
            "source": "given by the user; relative to the scenario file, else to the working "
            "directory",
        },
    )
    time: str = choice("time_s", "name of the column of times in s; in OpenSim's files time")
    flexion: Literal["positive", "negative"] = choice(
        "positive", "sign of flexion in the file; negative in OpenSim's gait2392"
    )
    shift_s: float | None = quantity(
        None, "s", "left out: first time of the reference's file, if > 0", ge=0, le=LONGEST_TIME_S
    )
    """Is subtracted from the times, so that a trial within a recording begins at 0 s."""


def shifted(times_s: list[float], shift_s: float) -> list[float]:
    """Return times minus a shift, rounded to 1 ns, so that 14.3 s − 12.3 s is 2 s.

    Without a shift the times stay as they are.
    """
    return [round(time - shift_s, 9) for time in times_s] if shift_s else times_s


class CsvReference(CsvTable):
    """A file with the samples of a reference.

    `samples` reads the file. A scenario made with a file stores the samples, not the file name.
    """

    angle: str = choice(
        "knee_angle_deg", "name of the column of knee angles in deg; OpenSim's may be in rad"
    )
    period_s: float | None = quantity(
        None,
        "s",
        "left out: the column of times is in s; else it is in percent of a cycle of this duration",
        ge=0.1,
        le=1e3,
    )
    cycles: int = quantity(1, "1", "the file once; how often the samples are run", ge=1, le=1000)
    interpolation: Interpolation = choice("cubic", _INTERPOLATION)
    clip: bool = choice(False, _CLIP)

    def samples(self, directory: str | os.PathLike[str] = ".") -> SampledReference:
        """Read the samples from the file. A relative file path starts at ``directory``.

        `read_table` says which files can be read. Raises `ScenarioError`, a subclass of
        `ParameterError`, if the file cannot be read or lacks a column, or if an entry is missing,
        is not a number, or is out of range.
        """
        path = Path(directory, self.file)
        table = read_table(path, (self.time, self.angle), "; give its names as time: and angle:")
        table = table.without_repeats()
        times, angles = table.columns[self.time], table.degrees(self.angle)
        if len(times) < _FEWEST_SAMPLES:
            message = f"has {len(times)} rows; must have at least {_FEWEST_SAMPLES}"
            raise file_error(path, None, message)
        unit, scale = ("s", 1.0) if self.period_s is None else ("%", self.period_s / 100.0)
        table.require(self.time, -LONGEST_TIME_S, LONGEST_TIME_S, unit, TIMES_IN_MS)
        table.require_increase(self.time, _SHORTEST_SAMPLE_S, unit)
        if self.period_s is not None and (times[0], times[-1]) != (0.0, 100.0):
            message = (
                f"{self.time} = {times[0]:g} … {times[-1]:g} %: must run from 0 to 100 %; leave "
                f"period_s out if it is in s"
            )
            raise file_error(path, None, message)
        times = [scale * time for time in times]
        shift_s = max(times[0], 0.0) if self.shift_s is None else self.shift_s
        times = shifted(times, shift_s)
        if self.flexion == "negative":
            angles = [-angle for angle in angles]
        low, high = min(angles), max(angles)
        if 0.5 * (low + high) < _LEAST_FLEXION_DEG:
            other = "negative" if self.flexion == "positive" else "positive"
            message = (
                f"{self.angle} = {low:.4g} … {high:.4g} deg: flexion must be positive; set "
                f"flexion: {other}"
            )
            raise file_error(path, None, message)
        gap = abs(angles[-1] - angles[0])
        if self.cycles > 1 and gap > _LARGEST_GAP_DEG:
            message = (
                f"{self.angle} ends {gap:.3g} deg from its first row: must be <= "
                f"{_LARGEST_GAP_DEG:g} deg, or each cycle jumps; subtract a straight line"
            )
            raise file_error(path, None, message)
        # The first row of a further cycle is the last row of the cycle before.
        span, cycles = times[-1] - times[0], range(self.cycles)
        try:
            return SampledReference(
                times_s=tuple(time + n * span for n in cycles for time in times[n > 0 :]),
                angles_deg=tuple(angle for n in cycles for angle in angles[n > 0 :]),
                interpolation=self.interpolation,
                clip=self.clip,
                shift_s=shift_s,
            )
        except ParameterError as error:
            reason = str(error).removeprefix("SampledReference: ")
            raise file_error(path, None, reason) from None


class GaitReference(Parameters):
    """The built-in knee flexion of walking, for ``cycles`` strides; see `gait_reference`."""

    kind: Literal["gait"] = "gait"
    frequency_hz: float = quantity(1.0, "Hz", "assumption: strides per second", gt=0, le=10)
    cycles: int = quantity(30, "1", "assumption: 30 s at 1 Hz, a default run", ge=1, le=1000)


@cache
def gait_stride_deg() -> Array:
    """Return the knee flexion of a stride of `gait_reference` in deg, (n,), without its end."""
    percent, mean, _ = gait_knee_flexion()
    closed = mean - (mean[-1] - mean[0]) * percent / percent[-1]
    return np.roll(closed[:-1], -int(np.argmin(mean)))


def stride_frequency_hz(times_s: Sequence[float], values: Sequence[float], stride: Array) -> float:
    """Return the frequency in Hz with which ``values`` (m,) repeat ``stride`` (n,).

    The result is nan if ``values`` do not repeat ``stride`` or are shorter than one whole stride.
    A factor may scale all values.
    """
    if len(values) <= stride.size:
        return math.nan
    repeated, given = np.resize(stride, len(values)), np.array(values)
    factor = float(repeated @ given / (repeated @ repeated))
    error = np.max(np.abs(given - factor * repeated))
    if error >= 1e-9 * np.max(np.abs(given)):  # also if all values are zero
        return math.nan
    return 1.0 / (times_s[stride.size] - times_s[0])


def gait_reference(frequency_hz: float = 1.0, cycles: int = 3) -> SampledReference:
    """Return the measured knee flexion of a stride, repeated ``cycles`` times, as a reference.

    The first and the last sample are at the least flexion (`gait_start_percent`), where the knee is
    at rest. The first sample is at t = 0. The measured stride does not end at exactly the angle at
    which it starts, so a straight line is subtracted to close the gap. The subtraction changes no
    sample by more than 0.03°, a twentieth of the measurement's standard deviation. A closed loop
    settles during the first stride.

    Parameters
    ----------
    frequency_hz
        Strides per second, > 0 and <= 10 Hz. At 10 Hz the samples are a millisecond apart. The
        measured stride lasts `kneexo.parameters.task.gait.GAIT_STRIDE_S`.
    cycles
        Number of strides, 1 … 1000.

    Raises
    ------
    ParameterError
        A value is out of range.
    """
    GaitReference(frequency_hz=frequency_hz, cycles=cycles)  # raises the error
    stride = gait_stride_deg()
    angles = np.append(np.tile(stride, cycles), stride[0])
    times = np.arange(angles.size) / (stride.size * frequency_hz)
    return SampledReference(times_s=tuple(times.tolist()), angles_deg=tuple(angles.tolist()))


def sit_to_stand_reference(
    rise_time_s: float = 2.0,
    cycles: int = 3,
    *,
    seated_deg: float = 85.0,
    standing_deg: float = 5.0,
) -> SampledReference:
    """Return the knee flexion of standing up and sitting down.

    The knee extends in ``rise_time_s``, rests for half this time, flexes in ``rise_time_s``, and
    rests again. Each motion has minimum jerk, θ = θ_0 + (θ_1 − θ_0)(10u³ − 15u⁴ + 6u⁵) with the
    time u from 0 to 1. Source: Flash and Hogan, J. Neurosci. 5(7), 1985, for movements of the arm.
    That the knee moves in the same way is an assumption.

    Parameters
    ----------
    rise_time_s
        Time in s of standing up, and of sitting down.
    cycles
        How often the person stands up and sits down.
    seated_deg, standing_deg
        Knee angles in deg of sitting and of standing.

    Raises
    ------
    ParameterError
        A value is out of range.
    """
    if not 0.1 <= rise_time_s <= 100.0:
        raise ParameterError(f"rise_time_s = {rise_time_s:g} s: must be >= 0.1 and <= 100 s")
    if not 1 <= cycles <= 1000:
        raise ParameterError(f"cycles = {cycles}: must be >= 1 and <= 1000")
    u = np.arange(_MOTION_SAMPLES) / _MOTION_SAMPLES
    rise = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])(u)
    rest = np.ones(_MOTION_SAMPLES // 2)
    cycle = np.concatenate([rise, rest, 1.0 - rise, 0.0 * rest])
    angles = seated_deg + (standing_deg - seated_deg) * np.append(np.tile(cycle, cycles), 0.0)
    times = np.arange(angles.size) * rise_time_s / _MOTION_SAMPLES
    return SampledReference(times_s=tuple(times.tolist()), angles_deg=tuple(angles.tolist()))


def table_mapping(value: Any) -> Any:
    """Return the path of a file, or a mapping with ``file``, as the mapping of a `CsvTable`.

    Any other value is returned unchanged.
    """
    if isinstance(value, str) and value.endswith(SUFFIXES):
        value = {"file": value}
    is_file = isinstance(value, dict) and "file" in value
    return {"kind": "csv"} | value if is_file else value


def object_of_kind(value: Any, *classes: type[Parameters]) -> Any:
    """Return a mapping whose ``kind`` is that of a class as an object of this class.

    Any other value is returned unchanged. Raises `ParameterError` for a faulty value.
    """
    for cls in classes:
        if isinstance(value, dict) and value.get("kind") == kind_of(cls):
            try:
                return cls(**value)
            except ParameterError as error:
                raise ParameterError(str(error).removeprefix(f"{cls.__name__}: ")) from None
    return value


def read_reference(value: Any, directory: Any) -> Any:
    """Return a gait or CSV reference as a `SampledReference`, any other reference unchanged.

    ``value`` is a scenario's reference: an object, a mapping, or the path of a file of
    `CsvReference`. A relative path starts at ``directory``. Raises `ParameterError` for a faulty
    file or value.
    """
    value = object_of_kind(table_mapping(value), CsvReference, GaitReference)
    if isinstance(value, CsvReference):
        return value.samples(directory)
    if isinstance(value, GaitReference):
        return gait_reference(value.frequency_hz, value.cycles)
    return value


Reference = Annotated[
    SineReference | StepReference | RampReference | SampledReference,
    Field(discriminator="kind"),
    Words(models=(GaitReference, CsvReference)),
]
"""Type of a scenario's reference. The field ``kind`` selects the class."""
