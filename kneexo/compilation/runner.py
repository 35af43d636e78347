"""One integrator of a compiled model at work, from tick to tick."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kneexo.compilation.cache import make_ready
from kneexo.compilation.codegen import INTEGRATORS
from kneexo.errors import CompilationError

if TYPE_CHECKING:
    from kneexo.compilation.model import CompiledModel

Array = NDArray[np.float64]

STEP_S = 2e-4
"""Default step of the Runge-Kutta integrators: 11 a period of the 447 Hz mode of the oil."""

ROUGH_STEP_S = 2e-5
"""Step of RK4 for records between two events, also where the exact hold gives up: a third of the
make-up valve's time constant."""

LONGEST_TICK_S = 2e-3
"""Longest tick, that of the paper's controller; a forcing that repeats within half of it can look
constant to the exact hold."""

TOLERANCE = 1e-8
"""Default of the exact hold: local error of each state, relative to one plus the state."""


_NO_RECORD = np.empty((0, 0))
_NOTHING_KEPT = (np.empty(0, dtype=np.int64), np.empty((0, 0)), np.empty((0, 0)))


@dataclass(frozen=True)
class State:
    """Continuous states (n,) and discrete states (m,) of a compiled model."""

    continuous: Array
    held: Array


@dataclass(frozen=True)
class InputTable:
    """Inputs as piecewise polynomials of time.

    ``coefficients[segment, input, power]``, in powers of the time since the last of ``breaks``
    (n,); there are n + 1 segments, one before the first break and one after the last. Without
    arguments a single input that is zero.
    """

    breaks: Array = field(default_factory=lambda: np.empty(0))
    coefficients: Array = field(default_factory=lambda: np.zeros((1, 1, 1)))

    def __post_init__(self) -> None:
        """Raise `ValueError` for breaks that do not ascend, and for numbers that are not finite."""
        for name in ("breaks", "coefficients"):  # as machine code wants them
            values = np.array(getattr(self, name), dtype=float)
            if not np.isfinite(values).all():
                raise ValueError(f"{name}: must be finite")
            object.__setattr__(self, name, values)
        if not (np.diff(self.breaks) > 0.0).all():
            raise ValueError("breaks: must ascend")


def require_shape(name: str, values: Array, expected: tuple[int, ...]) -> None:
    """Raise `ValueError` for another shape: machine code would not notice."""
    if values.shape != expected:
        raise ValueError(f"{name} has the shape {values.shape}: must be {expected}")


class Runner:
    """One integrator of a model with one parameter vector; it remembers step and linear part.

    Raises what `CompiledModel.simulate` says of its arguments.
    """

    def __init__(
        self,
        model: CompiledModel,
        parameters: Array,
        *,
        outputs: Sequence[str] | None = None,
        record_period_s: float | None = None,
        integrator: str = "exact_hold",
        step_s: float = STEP_S,
        tolerance: float = TOLERANCE,
    ) -> None:
        if integrator not in INTEGRATORS:
            raise ValueError(
                f"integrator = {integrator!r}: must be one of {', '.join(INTEGRATORS)}"
            )
        for name, value in (("step_s", step_s), ("tolerance", tolerance)):
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} = {value}: must be finite and > 0")
        for name in outputs or ():
            if name not in model.outputs:
                raise ValueError(f"output {name!r} is unknown; known: {', '.join(model.outputs)}")
        self.names = tuple(model.outputs) if outputs is None else tuple(outputs)
        module, names = model.module, self.names
        self._options: dict[str, Any] = {
            "outputs": outputs,
            "record_period_s": record_period_s,
            "integrator": integrator,
            "step_s": step_s,
            "tolerance": tolerance,
        }
        self.model = model
        self.parameters = np.asarray(parameters, dtype=float)
        self.constants = model.constants(parameters)
        longest = LONGEST_TICK_S if integrator == "exact_hold" else math.inf
        self.timing = _timing(module.PERIODS, record_period_s, longest)
        self.wanted = np.array([name in names for name in model.outputs], dtype=np.bool_)
        columns = [module.OUTPUTS[n][0] + i for n in names for i in range(model.outputs[n])]
        self.columns = np.array(columns, dtype=np.int64)
        self._run = getattr(module, f"run_{integrator}")
        self._ready = False
        self._tolerance = tolerance
        self._hold = self._work(step_s)

    def __deepcopy__(self, memo: Any) -> Runner:
        """A new one, with the memory empty: Drake copies cache entries with a Context."""
        return Runner(self.model, self.parameters, **self._options)

    def _work(self, step_s: float) -> tuple[Any, ...]:
        """Settings, work vectors and memory of an integrator: see `loops`."""
        module, n = self.model.module, len(self.model.state_names)
        return (
            np.array([self.timing.tick, step_s, self._tolerance, 0.0]),
            np.empty((2, n)),
            np.zeros(4, dtype=np.int64),
            np.zeros((module.SLOTS + 1) * n * n),
            np.empty(module.SLOTS * (module.FINEST + 2) * 3 * n * n),
            np.empty(module.SLOTS),
        )

    def run(
        self,
        x: Array,
        d: Array,
        first: int,
        last: int,
        inputs: InputTable,
        record: Array = _NO_RECORD,
        kept: tuple[NDArray[np.int64], Array, Array] = _NOTHING_KEPT,
    ) -> None:
        """Advance ``x`` and ``d`` from tick ``first`` to ``last``, filling ``record``.

        A run without a step records at its only tick.
        ``kept``: ticks, and the states after their events, to be filled in.
        """
        arguments = (
            self.constants,
            x,
            d,
            inputs.breaks,
            inputs.coefficients,
            self.timing.tick,
            first,
            last,
            self.timing.periods,
            self.timing.offsets,
            self.timing.record_every if first < last else 1,
            self.wanted,
            self.columns,
            *self._hold,
            record,
            *kept,
        )
        if not self._ready:
            slot = (x.copy(), *self._work(STEP_S), 0)
            make_ready(self.model.module.choose_slot, slot)
            without_a_step = (*arguments[:1], x.copy(), d.copy(), *arguments[3:6], 0, 0)
            make_ready(self._run, (*without_a_step, *arguments[8:19], _NO_RECORD, *_NOTHING_KEPT))
            self._ready = True
        status, tick, which = self._run(*arguments)
        if status != self.model.module.OK:
            raise self.model.fault(
                status, tick * self.timing.tick, which, self.parameters, State(x, d)
            )

    def run_with_records(
        self, x: Array, d: Array, last: int, inputs: InputTable, times: Array
    ) -> Array:
        """Advance from 0 to ``last``, or as far as ``times`` need; returns the records there."""
        tick = self.timing.tick
        # Each comes from the last tick before it, so that it sees the state before the updates.
        ticks, places = np.unique(
            np.ceil(times / tick - 1e-9).astype(np.int64) - 1, return_inverse=True
        )
        kept = (ticks, np.empty((ticks.size, x.size)), np.empty((ticks.size, d.size)))
        self.run(x, d, 0, max(last, *(ticks[-1:] + 1)) if ticks.size else last, inputs, kept=kept)
        record = np.empty((times.size, self.columns.size))
        arguments = (
            self.constants,
            inputs.breaks,
            inputs.coefficients,
            tick,
            self.timing.periods,
            self.wanted,
            self.columns,
            *self._work(ROUGH_STEP_S),
            *kept,
            times,
            places,
            record,
        )
        make_ready(self.model.module.outputs_between, arguments)
        self.model.module.outputs_between(*arguments)
        return record


@dataclass(frozen=True)
class _Timing:
    """Whole numbers of ticks between events, and between records."""

    tick: float
    periods: NDArray[np.int64]
    offsets: NDArray[np.int64]
    record_every: int


@lru_cache
def _timing(
    periods: tuple[tuple[float, float], ...],
    record_period_s: float | None,
    longest_s: float = math.inf,
) -> _Timing:
    """The longest tick up to ``longest_s`` that divides all periods, offsets and the records'."""
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
    # The exact hold looks at three points of a tick, so a long one could miss what happens between.
    split = max(1, math.ceil(base * shared / parts / longest_s * (1.0 - 1e-9)))
    counts = [count // shared * split for count in counts]
    return _Timing(
        base * shared / parts / split,
        np.array(counts[1::2], dtype=np.int64),
        np.array(counts[2::2], dtype=np.int64),
        counts[0],
    )
