"""The time grid of a run: all events and records are at whole numbers of ticks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np

from ..errors import CompilationError
from ..run_data import Array, Integers


@dataclass(frozen=True)
class Timing:
    """The time grid of a run: the tick, and the numbers of ticks between events and records."""

    tick: float
    """Duration of a tick in s."""
    periods: Integers
    """Sample period of each discrete update in ticks."""
    offsets: Integers
    """Tick of the first execution of each discrete update."""
    record_every: int
    """Number of ticks from one record to the next."""
    unit: float
    """Longest time in s that divides all sample periods, their offsets and the record period."""
    split: int
    """Number of ticks in a unit; above 1 if a unit is longer than the longest tick allowed."""

    def times(self, ticks: Any) -> Any:
        """Return the times in s of the tick numbers ``ticks``, an integer or an array.

        The time of a tick at a multiple of `unit` is a single product, which is rounded only once.
        """
        if self.split == 1:
            return ticks * self.unit
        whole, part = np.divmod(ticks, self.split)
        return whole * self.unit + part * self.tick

    def record_times(self, last: int) -> Array:
        """Return the times in s of the records from tick 0 to the tick ``last``."""
        times: Array = self.times(np.arange(0, last + 1, self.record_every))
        return times

    def record_after(self, time_s: Any) -> Any:
        """Return the index of the first record at or after ``time_s``, a number or an array."""
        row = np.maximum(np.floor(time_s / (self.record_every * self.tick)).astype(np.int64), 0)
        for _ in range(2):  # the quotient is rounded, so the record can be the next one
            row += self.times(row * self.record_every) < time_s
        return row


@lru_cache
def timing(
    periods: tuple[tuple[float, float], ...],
    record_period_s: float | None,
    longest_s: float = math.inf,
) -> Timing:
    """Return the time grid with the longest tick that divides all sample periods and offsets.

    Parameters
    ----------
    periods
        Sample period and offset in s of each discrete update.
    record_period_s
        Time between two records in s; the tick divides this time too. None stands for the shortest
        sample period.
    longest_s
        Upper limit of the tick in s.

    Raises
    ------
    CompilationError
        The times have no common divisor.
    ValueError
        ``record_period_s`` is not finite and positive, or is None without a sample period.
    """
    if record_period_s is None:
        if not periods:
            raise ValueError("record_period_s is needed: the model has no sample time")
        record_period_s = min(period for period, _ in periods)
    if not 0.0 < record_period_s < math.inf:
        raise ValueError(f"record_period_s = {record_period_s} s: must be finite and > 0")
    spans = [record_period_s, *(span for pair in periods for span in pair)]
    base = min(span for span in spans if span > 0.0)
    ratios = [Fraction(span / base).limit_denominator(1000) for span in spans]
    if any(abs(span / base - ratio) > 1e-9 for span, ratio in zip(spans, ratios, strict=True)):
        raise CompilationError(
            f"sample times {', '.join(f'{span:g}' for span in spans)} s have no common divisor"
        )
    parts = math.lcm(*(ratio.denominator for ratio in ratios))
    counts = [int(ratio * parts) for ratio in ratios]
    shared = math.gcd(*counts)
    split = max(1, math.ceil(base * shared / parts / longest_s * (1.0 - 1e-9)))
    counts = [count // shared * split for count in counts]
    unit = base * shared / parts
    return Timing(
        unit / split,
        np.array(counts[1::2], dtype=np.int64),
        np.array(counts[2::2], dtype=np.int64),
        counts[0],
        unit,
        split,
    )
