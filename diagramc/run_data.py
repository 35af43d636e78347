"""Initial states and open inputs of a run of a compiled model, as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""An array of doubles."""
Integers: TypeAlias = NDArray[np.int64]
"""An array of 64-bit integers."""


def slices(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return the place of each named vector in an array that has these vectors one after another.

    ``sizes`` has the size of each vector, in their order.
    """
    places, first = {}, 0
    for name, size in sizes.items():
        places[name] = slice(first, first := first + size)
    return places


@dataclass(frozen=True)
class State:
    """Continuous states (n,) and discrete states (m,) of a compiled model."""

    continuous: Array
    discrete: Array


@dataclass(frozen=True)
class ResumableState(State):
    """State at the end of a run, with all that a later run needs to go on from there.

    `CompiledModel.simulate` makes it with ``resumable=True``, and takes it as ``state``.
    """

    tick: int
    """Number of the last tick of the run."""
    settings: tuple[Any, ...]
    """Settings of the run that the later run must have too."""
    memory: Array
    """Jacobians of the exact hold, and the tables of their phi functions."""
    shared: Array
    """Length of the next step."""
    reduced: Array
    """Accumulated value and last sample of each reduction, (reductions, 2)."""
    record: Array
    """Records of the run (columns, rows), with which the records of the later run begin."""


@dataclass(frozen=True)
class InputTable:
    """Values of a model's open inputs: piecewise polynomials of time.

    ``breaks`` (n,) are times in s that separate n + 1 segments. The first segment lies before the
    first break, and the last segment lies after the last break. The ``coefficients[segment, input,
    power]`` multiply powers of the time since the segment began. In the first segment the
    coefficients multiply powers of t. Without arguments the table has a single input, which is
    zero.
    """

    breaks: Array = field(default_factory=lambda: np.empty(0))
    coefficients: Array = field(default_factory=lambda: np.zeros((1, 1, 1)))

    def __post_init__(self) -> None:
        """Raise `ValueError` if the breaks do not ascend, or if a number is not finite."""
        for name in ("breaks", "coefficients"):  # machine code reads doubles in C order
            values = np.array(getattr(self, name), dtype=float, order="C")
            if not np.isfinite(values).all():
                raise ValueError(f"{name}: must be finite")
            object.__setattr__(self, name, values)
        if not (np.diff(self.breaks) > 0.0).all():
            raise ValueError("breaks: must ascend")

    def value(self, time_s: float) -> Array:
        """Return the values of the inputs at a time, (inputs,).

        At a break, the segment that begins there gives the values. At the last break of a table
        with several breaks, the segment that ends there gives the values.
        """
        segment = int(np.searchsorted(self.breaks, time_s, side="right"))
        if 1 < segment == self.breaks.size and time_s == self.breaks[-1]:
            segment -= 1
        s = time_s - (self.breaks[segment - 1] if segment else 0.0)
        value = np.zeros(self.coefficients.shape[1])
        for factors in self.coefficients[segment].T[::-1]:
            value = value * s + factors
        return value
