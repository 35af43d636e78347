"""Emits the code of the Runge-Kutta integrators for one tick, for one lane or several."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .ir import Array, Function, Operand, Value, Variable
from .types import BOOL, INT, Type

Rate = Callable[[Operand, Array, Array], None]
"""``rate(t, x, out)`` emits code that writes dx/dt at time t in s and states x to ``out``.

The open inputs have their values at the time t.
"""


Report = Callable[[Value, Sequence[Array]], None]
"""``report(lanes, (ratio, start, end, h, x))`` emits code that logs a tick with an unstable step.

``lanes`` is the condition that holds in the lanes with such a step, and ``ratio`` is the ratio by
which the ticks of a lane are compared. The tick begins at the time ``start`` in s with the states
x, and has steps of the length h. The emitted arrays have one element, or one for each state.
"""

Keep = Callable[[Value, Value, Array, Value], None]
"""``keep(begin, h, end, lanes)`` emits code that keeps a step for the records at times in the step.

The step has begun at the time ``begin`` in s with the current states and has the length ``h``. It
ends with the states ``end``. ``lanes`` is the condition that holds in the lanes that take the step.
"""

Differences = Callable[[Operand], tuple[Value, Value]]
"""``differences(i)`` emits the slower and the faster difference of the rates of state i."""

RATIO = 1.4**4
"""Square of the ratio (h |λ|)² of two differences of the rates from which a step is suspected.

RK4 is unstable from h |λ| = 2.6 … 2.83 on, depending on the argument of λ, and the third order from
1.73 … 2.51 on. Where the rates have a corner, such as at a valve that opens, an unstable mode
oscillates about the corner and makes a smaller ratio, but at least 2. So 1.4², just below 2, is
the ratio here.
"""

CLEAR = 2.0**4
"""Ratio that counts as infinite, so that no later tick replaces the tick in the log.

A run that diverges soon has states that no correct run has.
"""

STEPS_PER_CHECK = 100
"""Ratio of steps to checked steps. The tick of a 2 ms controller has 100 steps of 20 µs."""

_SMALLEST_CHANGE = 1e-9
"""Change of a scaled state in a step below which differences of rates are rounding errors."""


@dataclass(frozen=True)
class Tick:
    """The values that an integrator requires to emit one tick.

    The emitted code advances the states ``x`` from the time ``start`` to the time ``end``.
    """

    function: Function
    size: int
    """Number of continuous states."""
    type: Type
    """Type of one state: a double in each lane."""
    start: Value
    end: Value
    """Start and end of the tick in s, the same in all lanes."""
    x: Array
    running: Value
    """Condition that is true in the lanes that advance. Code with a single lane ignores it."""
    rate: Rate
    step: Value
    """Largest step of the Runge-Kutta integrators in s."""
    report: Report = lambda lanes, step: None
    second_rate: Rate | None = None
    """Like ``rate``, but writes dx/dt and then d²x/dt² along a solution, twice ``size`` elements.

    None if dx/dt follows from the states alone until the end of the tick.
    """
    number: Value | None = None
    """Number of the tick, which decides which step is checked.

    Without a number each step is checked, which takes 15 % of a run.
    """
    keep: Keep = lambda begin, h, end, lanes: None

    def vector(self) -> Array:
        """Return new local memory of the emitted code, with one element for each state."""
        return self.function.array(self.size, self.type)

    def along(self, out: Array, *terms: tuple[Operand, Array]) -> None:
        """Emit ``out`` = x + Σ factor · vector, where ``terms`` are the pairs (factor, vector)."""
        f = self.function
        for i in f.each(self.size):
            total = self.x[i]
            for factor, vector in terms:
                total = f.fma(f.coerce(factor, self.type), vector[i], total)
            out[i] = total

    def accept(self, new: Array) -> None:
        """Emit code that copies ``new`` to the states ``x`` in the lanes that advance."""
        for i in self.function.each(self.size):
            if self.type.lanes == 1:
                self.x[i] = new[i]
            else:
                self.x[i] = self.function.select(self.running, new[i], self.x[i])


class _Watch:
    """Emits the search of a tick for steps that are too long for a mode λ.

    The stages of a step of length h are a short power iteration with the Jacobian J of the rates at
    the start of the step. Of two differences of the rates, the faster difference contains two
    powers of h J more. So the ratio of the norms of both differences grows with the largest
    (h |λ|)² among the modes that move. A single power would not do, because states of different
    size would make the ratio too large. One of `STEPS_PER_CHECK` steps is checked. A tick is
    reported if the square of the ratio exceeds `RATIO` in such a step, or if the scaled states
    change in the tick by more than 1 for each `STEPS_PER_CHECK` steps. Explicit time and corners of
    the rates change the ratio too, so a report is a suspicion only.
    """

    def __init__(self, tick: Tick, steps: Value) -> None:
        """Emit code that copies the states at the start of the tick.

        The tick has ``steps`` steps or more.
        """
        f = tick.function
        self.tick, self._start = tick, tick.vector()
        self._rank = self._sum()
        for i in f.each(tick.size):
            self._start[i] = tick.x[i]
        # A tick of 1 s may have thousands of steps, in which correct states change by more than 1.
        # With a limit of 1 for all ticks, each tick of Van der Pol's orbit was judged in Python:
        # 11 s in place of 0.4 s for the run.
        self._most_moved = f.maximum(steps * (1.0 / STEPS_PER_CHECK), 1.0)
        # The checked step changes from tick to tick, or it could keep step with an oscillation.
        candidates = f.to_int(f.minimum(steps, float(STEPS_PER_CHECK)))
        first = f.constant(0, INT) if tick.number is None else tick.number % candidates
        self._next = f.variable(first)
        """Number of the next step that is checked, among the steps of the tick."""
        self._stride = 1 if tick.number is None else STEPS_PER_CHECK

    def stop(self, count: Value) -> Value:
        """Emit the number of the step after the next checked step, but at most ``count``."""
        after = self._next.get() + 1
        return self.tick.function.select(after < count, after, count)

    def check(self, done: Value, h: Value, differences: Differences) -> None:
        """Emit code that compares the differences of the rates of a step, if this step is checked.

        ``done``: number of the tick's steps up to this one.
        """
        tick, f = self.tick, self.tick.function
        with f.when(done > self._next.get()):
            self._next.set(self._next.get() + self._stride)
            slow, fast = self._sum(), self._sum()
            for i in f.each(tick.size):
                for total, difference in zip((slow, fast), differences(i), strict=True):
                    self._add_square(total, i, difference)
            noise = _SMALLEST_CHANGE / h
            bound = f.fma(slow.get(), RATIO, f.coerce(noise * noise, tick.type))
            # No comparison holds with nan.
            rank = f.select(fast.get() <= bound, 0.0, self._ranked(fast.get() / slow.get()))
            self._rank.set(f.maximum(self._rank.get(), rank))

    def end(self, h: Value) -> None:
        """Emit the report of the tick, which logs it if one of its steps is suspected.

        The steps of the tick have the length h in s.
        """
        tick, f = self.tick, self.tick.function
        moved, limit = self._sum(), self._most_moved
        for i in f.each(tick.size):
            self._add_square(moved, i, tick.x[i] - self._start[i])
        # A valve that was too fast in another step leaves a jump.
        stays = moved.get() <= f.coerce(limit * limit, tick.type)
        lanes = ~(stays & (self._rank.get() <= 0.0)) & tick.running
        with f.when(f.any_lane(lanes), rare=True):
            rank = f.maximum(self._rank.get(), self._ranked(moved.get()))
            arrays = [f.array(1, tick.type) for _ in range(4)]
            for array, value in zip(arrays, (rank, tick.start, tick.end, h), strict=True):
                array[0] = f.coerce(value, tick.type)
            tick.report(lanes, [*arrays, self._start])

    def _sum(self) -> Variable:
        """Return a new variable of the emitted code, which is zero."""
        f = self.tick.function
        return f.variable(f.constant(0.0, self.tick.type))

    def _add_square(self, total: Variable, i: Operand, value: Value) -> None:
        """Emit ``total`` += (value / scale)². The scale is that of state i at the start."""
        f = self.tick.function
        scaled = value * (1.0 / (f.absolute(self._start[i]) + 1.0))
        total.set(f.fma(scaled, scaled, total.get()))

    def _ranked(self, ratio: Value) -> Value:
        """Emit the ratio, or infinity from `CLEAR` on and for nan."""
        return self.tick.function.select(ratio < CLEAR, ratio, math.inf)


def before_end(tick: Tick, time: Value) -> Value:
    """Emit the earlier of ``time`` and the last double before the end of the tick.

    An input that jumps at the end of the tick has its value before the jump at this time.
    """
    f = tick.function
    latest = f.from_bits(f.bits(tick.end) - 1)
    return f.minimum(time, f.coerce(latest, tick.type))


def advance_rk4(tick: Tick) -> None:
    """Emit one tick of the classical fourth-order Runge-Kutta method.

    The steps are equal, and at most as long as ``tick.step``.
    """
    f = tick.function
    span = tick.end - tick.start
    # A quotient just above a whole number, by rounding, makes no further step.
    steps = f.maximum(f.ceil(span / tick.step - 1e-9), 1.0)
    h = span / steps
    z, k1, k2, k3, k4 = (tick.vector() for _ in range(5))
    watch = _Watch(tick, steps)

    def differences(i: Operand) -> tuple[Value, Value]:
        # |k₁ + k₄ - 2 k₃| = (h |λ|)²/2 |k₂ - k₁| for a single mode
        return (k2[i] - k1[i]) * 0.5, f.fma(k3[i], -2.0, k1[i] + k4[i])

    done, count = f.variable(f.constant(0, INT)), f.to_int(steps)
    with f.forever() as loop:
        loop.stop_if(done.get() >= count)
        # The check is outside of the loop over steps, which then needs fewer registers. This
        # saves 4 % of a run.
        first, stop = done.get(), watch.stop(count)
        for number in f.loop(stop - first):
            t = f.fma(f.to_double(first + number), h, tick.start)
            tick.rate(t, tick.x, k1)
            tick.along(z, (0.5 * h, k1))
            tick.rate(t + 0.5 * h, z, k2)
            tick.along(z, (0.5 * h, k2))
            tick.rate(t + 0.5 * h, z, k3)
            tick.along(z, (h, k3))
            tick.rate(t + h, z, k4)
            sixth = f.coerce(h * (1.0 / 6.0), tick.type)
            for i in f.each(tick.size):
                middle = f.fma(k2[i] + k3[i], 2.0, k1[i] + k4[i])
                z[i] = f.fma(sixth, middle, tick.x[i])
            tick.keep(t, h, z, f.constant(1, BOOL))
            tick.accept(z)
        done.set(stop)
        watch.check(stop, h, differences)
    watch.end(h)


def advance_runge_kutta3(tick: Tick) -> None:
    """Emit one tick of a third-order method, in the steps of Drake's RungeKutta3Integrator.

    The last step ends exactly at the end of the tick. The last step is shorter than ``tick.step``,
    or at most 1 % longer.
    """
    f = tick.function
    z, k1, k2, k3 = (tick.vector() for _ in range(4))
    watch = _Watch(tick, f.maximum(f.floor((tick.end - tick.start) / tick.step), 1.0))
    time, count = f.variable(tick.start), f.variable(f.constant(0, INT))
    with f.forever() as loop:
        t = time.get()
        loop.stop_if(t >= tick.end)
        # 1.01 is the factor by which Drake stretches the last step, so that no tiny one follows.
        last = f.fma(tick.step, 1.01, t) >= tick.end
        h = f.select(last, tick.end - t, tick.step)
        tick.rate(t, tick.x, k1)
        tick.along(z, (0.5 * h, k1))
        tick.rate(t + 0.5 * h, z, k2)
        tick.along(z, (-h, k1), (2.0 * h, k2))
        tick.rate(t + h, z, k3)
        sixth = f.coerce(h * (1.0 / 6.0), tick.type)
        for i in f.each(tick.size):
            z[i] = f.fma(sixth, f.fma(k2[i], 4.0, k1[i] + k3[i]), tick.x[i])
        tick.keep(t, h, z, f.constant(1, BOOL))
        tick.accept(z)
        number = count.get()
        # |k₁ + k₃ - 2 k₂| = (h |λ|)² |k₁| for a single mode
        watch.check(number + 1, h, lambda i: (k1[i], f.fma(k2[i], -2.0, k1[i] + k3[i])))
        count.set(number + 1)
        time.set(f.select(last, tick.end, t + h))
    watch.end(tick.step)
