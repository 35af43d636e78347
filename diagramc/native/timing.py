"""The time grid of a run: all events and records are at whole numbers of ticks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import chain
from typing import Any

import numpy as np

from ..errors import CompilationError
from ..run_data import Array, Integers

MANY_TICKS = 1_000_000
"""Number of ticks of a run from which `Timing.offset_note` names the offset that makes them."""

_FINE = 1000  # least part of the ticks that is due to offsets


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

    def offset_note(self, last: int) -> str:
        """Return one line if the offset of an update makes a run of ``last`` ticks long, else "".

        The ticks divide the offsets, so the time that a run takes grows with 1/offset.
        """
        pairs = list(zip(self.periods.tolist(), self.offsets.tolist(), strict=True))
        without_offsets = math.gcd(self.record_every, *(period for period, _ in pairs))
        if last < MANY_TICKS or without_offsets < _FINE * self.split:
            return ""
        period, offset = min(pairs, key=lambda pair: math.gcd(*pair))
        return (
            f"an update every {self.times(period):g} s with an offset of {self.times(offset):g} s "
            f"makes {last} ticks of {self.tick:g} s; an offset of 0 s, or of a larger share of the "
            f"period, takes less time"
        )

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
    times_s = [record_period_s, *chain.from_iterable(periods)]
    shortest_s = min(time for time in times_s if time > 0.0)
    # With far larger denominators nearly any two times would have a common divisor, with ticks too
    # short to run. The quotient of two decimal times is rounded, so 1e-9 is still equal.
    ratios = [Fraction(time / shortest_s).limit_denominator(1000) for time in times_s]
    errors = [abs(t / shortest_s - ratio) for t, ratio in zip(times_s, ratios, strict=True)]
    if max(errors) > 1e-9:
        raise CompilationError(
            f"sample times {', '.join(f'{time:g}' for time in times_s)} s have no common divisor"
        )
    # The unit is the greatest common divisor of fractions of the shortest time.
    denominator = math.lcm(*(ratio.denominator for ratio in ratios))
    numerators = [int(ratio * denominator) for ratio in ratios]
    divisor = math.gcd(*numerators)
    unit_s = shortest_s * divisor / denominator
    # A unit that exceeds the longest tick by rounding alone is not divided.
    split = max(1, math.ceil(unit_s / longest_s * (1.0 - 1e-9)))
    record_ticks, *update_ticks = [count // divisor * split for count in numerators]
    return Timing(
        tick=unit_s / split,
        periods=np.array(update_ticks[::2], dtype=np.int64),
        offsets=np.array(update_ticks[1::2], dtype=np.int64),
        record_every=record_ticks,
        unit=unit_s,
        split=split,
    )
