"""One integrator of a compiled model at work, from tick to tick, in one lane or several."""

from __future__ import annotations

import ctypes
import math
import weakref
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache, cached_property, lru_cache
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import CompilationError, SimulationError
from . import exact_hold
from .printer import MEMO_LINES
from .time_loop import BETWEEN, DOUBLES, INPUT, INTEGRATORS, OK, RUN

if TYPE_CHECKING:
    from ..model import CompiledModel

Array = NDArray[np.float64]
"""An array of doubles."""
Integers = NDArray[np.int64]
"""An array of 64-bit integers."""

STEP_S = 2e-4
"""Default step of the Runge-Kutta integrators."""

ROUGH_STEP_S = 2e-5
"""Step of RK4 for records between two events, and where the exact hold gives up."""

LONGEST_TICK_S = 2e-3
"""Longest tick of the exact hold; a forcing that repeats within half of it can look constant."""

TOLERANCE = 1e-8
"""Default of the exact hold: local error of each state, relative to one plus the state."""


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
            values = np.array(getattr(self, name), dtype=float, order="C")
            if not np.isfinite(values).all():
                raise ValueError(f"{name}: must be finite")
            object.__setattr__(self, name, values)
        if not (np.diff(self.breaks) > 0.0).all():
            raise ValueError("breaks: must ascend")

    def value(self, time_s: float) -> Array:
        """The inputs at a time, (inputs,).

        The first segment ends and the last one starts at a break, where a value belongs to the
        segment on its right; at the last of several breaks, the end of a spline, to that on its
        left.
        """
        segment = int(np.searchsorted(self.breaks, time_s, side="right"))
        if 1 < segment == self.breaks.size and time_s == self.breaks[-1]:
            segment -= 1
        s = time_s - (self.breaks[segment - 1] if segment else 0.0)
        value = np.zeros(self.coefficients.shape[1])
        for factors in self.coefficients[segment].T[::-1]:
            value = value * s + factors
        return value

    @cached_property
    def address(self) -> tuple[int, ...]:
        """What machine code gets: ``time_loop.INPUT``."""
        breaks, coefficients = self.breaks, self.coefficients
        addresses = {"breaks": address(breaks), "coefficients": address(coefficients)}
        sizes = {"break_count": breaks.size, "powers": coefficients.shape[2]}
        return tuple((addresses | sizes)[name] for name in INPUT)


def require_shape(name: str, values: Array, expected: tuple[int, ...]) -> None:
    """Raise `ValueError` for another shape: machine code would not notice."""
    if values.shape != expected:
        raise ValueError(f"{name} has the shape {values.shape}: must be {expected}")


def element_name(port: str, element: int, size: int) -> str:
    """Return ``port``, or ``port[element]`` for a port with more than one element."""
    return f"{port}[{element}]" if size > 1 else port


def not_finite(time_s: float, name: str) -> SimulationError:
    """Return the error for a state or an output that is not finite."""
    return SimulationError(
        f"t = {time_s:.6g} s: {name} is not finite; reduce the step or check the parameters"
    )


def address(array: NDArray[Any]) -> int:
    """Address of the first element of an array without gaps."""
    return int(array.__array_interface__["data"][0])


class BufferPool:
    """Memory for records, used again once no array refers to it.

    Fresh memory of the size of a record costs as much time as the run that fills it.
    """

    def __init__(self, most: int) -> None:
        """``most``: unused elements that are kept."""
        self._most = most
        self._unused: deque[Array] = deque()

    def array(self, shape: tuple[int, ...]) -> Array:
        """An array, not initialized."""
        size = math.prod(shape)
        memory = self._taken(size)
        # All views of it have this array as their base, which is not an array itself.
        root = np.frombuffer(memory.data, dtype=float, count=size)
        weakref.finalize(root, self._give_back, memory).atexit = False
        return root.reshape(shape)

    def _taken(self, size: int) -> Array:
        for _ in range(len(self._unused)):
            with suppress(IndexError):  # another thread was faster
                memory = self._unused.popleft()
                if size <= memory.size <= 2 * size + 1024:
                    return memory
                self._unused.append(memory)
        return np.empty(max(size, 1))

    def _give_back(self, memory: Array) -> None:
        self._unused.append(memory)
        with suppress(IndexError):
            while sum(kept.size for kept in list(self._unused)) > self._most:
                self._unused.popleft()


_NO_TICKS = np.empty(0, dtype=np.int64)

PIECE_S = 0.2
"""What a piece of a run should take, between two chances for Ctrl-C."""

_FIRST_PIECE = 160_000  # steps; 30 s at the usual step are a single piece

RECORDS = BufferPool(8_000_000)
"""Memory of the records of all models: at most 64 MB that nobody uses."""


class Runner:
    """One integrator of a model; it remembers step and linear part of each lane.

    Raises what `CompiledModel.simulate` says of its arguments.
    """

    def __init__(
        self,
        model: CompiledModel,
        *,
        lanes: int = 1,
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
        self.model, self.lanes = model, lanes
        layout = model.layout
        longest = LONGEST_TICK_S if integrator == "exact_hold" else math.inf
        self.timing = timing(layout.periods, record_period_s, longest)
        first, columns = 0, {}
        for name, size in layout.outputs:
            columns[name] = range(first, first + size)
            first += size
        self.columns = np.array([c for n in self.names for c in columns[n]], dtype=np.int64)
        self._wanted = np.array([name in self.names for name, _ in layout.outputs], dtype=np.uint8)
        steps = 10.0 if integrator == "exact_hold" else max(1.0, self.timing.tick / step_s)
        self.piece = max(1, int(_FIRST_PIECE / steps))
        self._run = model.code.run(integrator, lanes)
        self._constants = model.code.start("constants")
        self._own_c = np.empty((lanes, layout.constants))
        self._c = np.empty((layout.constants, lanes))
        memory = exact_hold.Memory(len(layout.states))
        self._head = memory.head
        self._memory = np.empty((lanes, memory.size))
        self._shared = np.empty(memory.shared(lanes))
        self._tags = np.empty(len(layout.memos) * MEMO_LINES * lanes)
        self._values = np.empty(sum(layout.memos) * MEMO_LINES * lanes)
        self._status = np.zeros((lanes, 3), dtype=np.int64)
        self._inputs = np.zeros((lanes, len(INPUT)), dtype=np.int64)
        self._arguments = _arguments(
            RUN,
            c=self._c,
            own_c=self._own_c,
            inputs=self._inputs,
            tick=self.timing.tick,
            unit=self.timing.unit,
            split=self.timing.split,
            periods=self.timing.periods,
            offsets=self.timing.offsets,
            wanted=self._wanted,
            columns=self.columns,
            column_count=self.columns.size,
            memory=self._memory,
            shared=self._shared,
            tags=self._tags,
            values=self._values,
            status=self._status,
            step=step_s,
            tolerance=tolerance,
        )
        self._address = ctypes.addressof(self._arguments)

    def restart(self, parameters: Array) -> Runner:
        """Take parameters (lanes, parameters) and forget all that was before."""
        for lane, row in enumerate(np.ascontiguousarray(parameters, dtype=float)):
            self._constants(address(row), address(self._own_c[lane]))
        self._c[:] = self._own_c.T
        self._memory[:, : self._head] = 0.0
        self._shared[: self.lanes] = 0.0
        self._tags.fill(np.nan)
        return self

    def run(
        self,
        x: Array,
        d: Array,
        first: int,
        last: Integers,
        inputs: Sequence[InputTable],
        record: Array | None = None,
        kept: tuple[Integers, Array, Array] | None = None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> Integers:
        """Advance ``x`` (states, lanes) and ``d`` (held, lanes) from tick ``first`` to ``last``.

        ``record`` (lanes, columns, rows) is filled; a run without a step records at its only tick.
        ``kept``: ticks, and the states after their events, to be filled in. Returns the status of
        each lane, (lanes, 3): outcome, tick, and which limit.

        A long run is made in pieces of some tenths of a second, so that Ctrl-C ends it; each goes
        on with the bits of the one before. Raises `KeyboardInterrupt` once ``cancelled()``.
        """
        start, longest, ends = first, int(last.max()), np.empty_like(last)
        every = self.timing.record_every
        rows = 0 if record is None else record.shape[2]
        status = np.zeros_like(self._status)
        piece = self.piece
        while True:
            until = min(first + piece, longest)
            np.minimum(last, until, out=ends)
            ends[status[:, 0] != OK] = -1
            self.bind(x, d, ends, record, kept and _kept_from(first, kept))
            begin = perf_counter()
            row = -(-first // every) + start // -every
            outcome = self.go(first, until, rows, inputs, row)
            failed = outcome[:, 0] != OK
            status[failed] = outcome[failed]
            if not (last[status[:, 0] == OK] > until).any():
                return status
            if cancelled():
                raise KeyboardInterrupt
            took = perf_counter() - begin
            piece = 2 * piece if took < 0.5 * PIECE_S else max(1, int(piece * PIECE_S / took))
            first = until

    def bind(
        self,
        x: Array,
        d: Array,
        last: Integers,
        record: Array | None,
        kept: tuple[Integers, Array, Array] | None = None,
    ) -> None:
        """Take the arrays of `run`, for one call of `go` or more."""
        ticks, kept_x, kept_d = kept or (_NO_TICKS, x, d)
        _set(self._arguments, x=x, d=d, last=last, kept=ticks, kept_x=kept_x, kept_d=kept_d)
        self._arguments.kept_count = ticks.size
        self._bound = (x, d, last, ticks, kept_x, kept_d)  # alive as long as their addresses
        if record is not None:
            _set(self._arguments, record=record)

    def go(
        self, first: int, longest: int, rows: int, inputs: Sequence[InputTable], row: int = 0
    ) -> Integers:
        """Run with the bound arrays; returns the status, until the next run.

        The record has ``rows``; the first one written is ``row``.
        """
        if self.model.inputs:
            self._inputs[:] = [table.address for table in inputs]
        self._status.fill(0)
        arguments = self._arguments
        arguments.first, arguments.longest, arguments.rows = first, longest, rows
        arguments.record_every = self.timing.record_every if first < longest else 1
        arguments.row = row
        self._run(self._address)
        return self._status

    def output_not_finite(self, values: Array) -> str:
        """Return the name of the first recorded output that is not finite in a row (columns,)."""
        column = int(np.argmin(np.isfinite(values)))
        for name in self.names:
            size = self.model.outputs[name]
            if column < size:
                break
            column -= size
        return element_name(name, column, size)

    def records_between(
        self,
        kept: tuple[Integers, Array, Array],
        inputs: InputTable,
        times: Array,
        places: Integers,
    ) -> Array:
        """Records at ``times`` (rows,), each by RK4 from the kept state at its place; one lane."""
        record = np.empty((1, self.columns.size, times.size))
        table = np.array([inputs.address], dtype=np.int64)
        arguments = _arguments(
            BETWEEN,
            c=self._c,
            inputs=table,
            tick=self.timing.tick,
            unit=self.timing.unit,
            split=self.timing.split,
            wanted=self._wanted,
            columns=self.columns,
            column_count=self.columns.size,
            record=record,
            rows=times.size,
            step=ROUGH_STEP_S,
            kept=kept[0],
            kept_x=kept[1],
            kept_d=kept[2],
            times=times,
            places=places,
        )
        self.model.code.between()(ctypes.addressof(arguments))
        return record


def _kept_from(first: int, kept: tuple[Integers, Array, Array]) -> tuple[Integers, Array, Array]:
    """What is kept from the tick ``first`` on; at ``first`` - 1, only before the first tick."""
    start = int(np.searchsorted(kept[0], first)) if first else 0
    ticks, x, d = kept
    return ticks[start:], x[start:], d[start:]


@cache
def _structure(names: tuple[str, ...]) -> type[ctypes.Structure]:
    """Arguments of a function of `time_loop`, eight bytes each."""
    fields = [(n, ctypes.c_double if n in DOUBLES else ctypes.c_int64) for n in names]
    return type("Arguments", (ctypes.Structure,), {"_fields_": fields})


def _arguments(names: tuple[str, ...], **values: Any) -> Any:
    arguments = _structure(names)()
    _set(arguments, **values)
    return arguments


def _set(arguments: Any, **values: Any) -> None:
    """Numbers, or arrays, whose addresses are taken: the caller keeps them alive."""
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            assert value.flags.c_contiguous, name
            value = address(value)
        setattr(arguments, name, value)


@dataclass(frozen=True)
class Timing:
    """Whole numbers of ticks between events, and between records."""

    tick: float
    periods: Integers
    offsets: Integers
    record_every: int
    unit: float
    """Longest time in s that divides periods, offsets and the records', without an upper limit."""
    split: int
    """Ticks in a unit."""

    def times(self, ticks: Any) -> Any:
        """Times in s of ticks: multiples of the unit are not rounded twice."""
        if self.split == 1:
            return ticks * self.unit
        whole, part = np.divmod(ticks, self.split)
        return whole * self.unit + part * self.tick


@lru_cache
def timing(
    periods: tuple[tuple[float, float], ...],
    record_period_s: float | None,
    longest_s: float = math.inf,
) -> Timing:
    """The longest tick up to ``longest_s`` that divides all periods, offsets and the records'.

    Raises `CompilationError` when there is none, `ValueError` for a wrong ``record_period_s``.
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
    # The exact hold looks at three points of a tick, so a long one could miss what happens between.
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
