"""Emits the code of the Runge-Kutta integrators for one tick, for one lane or several."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .ir import Array, Function, Operand, Value
from .types import INT, Type

Rate = Callable[[Operand, Array, Array], None]
"""``rate(t, x, out)`` emits code that writes dx/dt at time t in s and states x to ``out``.

The open inputs have their values at the time t.
"""


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
    steps = f.maximum(f.ceil(span / tick.step - 1e-9), 1.0)
    h = span / steps
    z, k1, k2, k3, k4 = (tick.vector() for _ in range(5))
    for number in f.loop(f.to_int(steps)):
        t = f.fma(f.to_double(f.coerce(number, INT)), h, tick.start)
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
        tick.accept(z)


def advance_runge_kutta3(tick: Tick) -> None:
    """Emit one tick of a third-order method, in the steps of Drake's RungeKutta3Integrator.

    The last step ends exactly at the end of the tick: it is shorter than ``tick.step``, or at most
    1 % longer.
    """
    f = tick.function
    z, k1, k2, k3 = (tick.vector() for _ in range(4))
    time = f.variable(tick.start)
    with f.forever() as loop:
        t = time.get()
        loop.stop_if(t >= tick.end)
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
        tick.accept(z)
        time.set(f.select(last, tick.end, t + h))
