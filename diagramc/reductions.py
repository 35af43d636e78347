"""Numbers that a batch of runs computes from the samples of its outputs, without storing them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .run_data import Array

REDUCTIONS = (
    *("maximum", "minimum", "mean", "rms", "variation", "integral"),
    *("count", "first_time", "last_time"),
)
"""Kinds of reductions; `Reduction` explains each kind."""


@dataclass(frozen=True)
class Reduction:
    """A number that `CompiledModel.simulate_batch` computes from the samples of an output.

    The samples v_0 … v_m are the values that a record would have from ``after_s`` to the end of the
    run, at the times t_0 … t_m. The machine code adds them up one after the other.

    ==============  ================================================================
    kind            number
    ==============  ================================================================
    ``maximum``     largest v_k
    ``minimum``     smallest v_k
    ``mean``        Σ v_k / (m + 1)
    ``rms``         (Σ v_k² / (m + 1))^½, the root mean square
    ``variation``   Σ \\|v_k − v_(k−1)\\|, from k = 1
    ``integral``    Σ (v_k + v_(k−1))/2 · record period, the trapezoidal rule in s
    ``count``       number of samples v_k ≥ ``bound``
    ``first_time``  first t_k in s with v_k ≥ ``bound``
    ``last_time``   last t_k in s with v_k ≥ ``bound``
    ==============  ================================================================

    Without samples a ``variation``, ``integral`` or ``count`` is zero, and any other number is nan.
    A time is also nan if no sample reaches ``bound``.
    """

    kind: str
    """One of `REDUCTIONS`."""
    output: str
    """Element of an output: ``name[index]``, or ``name`` of a port with a single element."""
    minus: str | None = None
    """Element that is subtracted from ``output`` in each sample; None: nothing is subtracted."""
    magnitude: bool = False
    """Whether each sample is the absolute value of the output or of the difference."""
    after_s: float | Array = 0.0
    """Time of the first sample in s, with a tolerance of 1 ns: one value, or one for each run."""
    bound: float | Array = 0.0
    """Bound in the unit of the output: one value, or one for each run."""

    def __post_init__(self) -> None:
        """Raise `ValueError` for an unknown kind, or for a number that is not finite."""
        if self.kind not in REDUCTIONS:
            raise ValueError(f"kind = {self.kind!r}: must be one of {', '.join(REDUCTIONS)}")
        for name in ("after_s", "bound"):
            value = getattr(self, name)
            if not (np.issubdtype(np.asarray(value).dtype, np.number) and np.isfinite(value).all()):
                raise ValueError(f"{name}: must be finite")
