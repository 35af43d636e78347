"""Emits the substeps of the Rosenbrock method in a tick, for one lane or several.

`diagramc.rosenbrock` has the equations. Each lane has substeps of its own, so a run has the
same bits in a lane and alone. A lane that has reached the end of the tick waits for the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..rosenbrock import CONTROL, MOST_SUBSTEPS, RODAS, Elimination, Operation
from .integrators import Tick, before_end
from .ir import Array, Function, Module, Operand, Value
from .types import BOOL, INT, POINTER, Type

Linear = Callable[[Operand, Array, Array], None]
"""``linear(t, x, out)`` emits a call of the function of `printer.define_linear` for all lanes."""


@dataclass(frozen=True)
class Stuck:
    """Values of the emitted code about lanes that do not reach the end of the tick."""

    lanes: Value
    """Condition that holds in these lanes."""
    errors: Array
    """Largest error estimate of each state in the tick, divided by the tolerance of the state.

    Repeated substeps do not count: when a substep fails, the next ones from the same point become
    so short that their estimates are not finite, and these would hide the state that failed.
    """


class Rosenbrock:
    """Emits the substeps of one tick."""

    def __init__(
        self,
        type_: Type,
        elimination: Elimination,
        linear: Linear,
        has_time_derivative: bool,
        tick_s: Value,
        tolerance: Value,
        substeps: Array,
    ) -> None:
        """Define the functions that factorize and solve, and store values of the emitted code.

        Parameters
        ----------
        type_
            Type of a state: a double in each lane.
        elimination, linear, has_time_derivative
            The elimination with the Jacobian of the model. The call of the function that writes
            dx/dt, then ∂f/∂t if ``has_time_derivative``, and the elements of the Jacobian.
        tick_s, tolerance
            Duration of a tick in s, and largest error estimate of a substep.
        substeps
            Memory for the length of the next substep of each lane in s; zero stands for a tick.
        """
        self.elimination, self.linear = elimination, linear
        self.has_time_derivative = has_time_derivative
        self.tick_s, self.tolerance, self.substeps = tick_s, tolerance, substeps
        module = tick_s.function.module
        self._factorize = _define_factorize(module, elimination, type_)
        self._solve = _define_solve(module, elimination, type_)

    def advance(self, tick: Tick) -> Stuck:
        """Emit the substeps of a tick; return the lanes that do not reach its end."""
        f, size, type_ = tick.function, tick.size, tick.type
        parts = 1 + self.has_time_derivative
        slope = f.array(parts * size + len(self.elimination.entries), type_)
        by_time, jacobian = slope.shifted(size), slope.shifted(parts * size)
        factors = f.array(self.elimination.size, type_)
        end, shares, errors = (tick.vector() for _ in range(3))
        stages = [tick.vector() for _ in RODAS.nodes]
        known = self.substeps[0]
        substep = f.variable(f.select(known > 0.0, known, f.coerce(self.tick_s, type_)))
        done = f.variable(f.constant(0.0, type_))  # time since the start of the tick in s
        count = f.variable(f.constant(0, INT))
        moved = f.variable(f.constant(1, BOOL.of(type_.lanes)))  # the last substep was good
        changed = f.variable(f.constant(1, BOOL))  # the last substep was good in any lane
        left = f.variable(tick.running if type_.lanes > 1 else f.constant(1, BOOL))
        for i in f.each(size):
            errors[i] = 0.0
        with f.forever() as loop:
            loop.stop_if(~(f.any_lane(left.get()) & (count.get() < MOST_SUBSTEPS)))
            count.set(count.get() + 1)
            with f.when(changed.get()):
                self.linear(self._time(tick, done.get()), tick.x, slope)
            rest = f.coerce(self.tick_s, type_) - done.get()
            last = substep.get() >= rest * CONTROL.whole
            h = f.select(last, rest, f.minimum(substep.get(), rest * CONTROL.share))
            per_h = 1.0 / h
            diagonal = per_h * (1.0 / RODAS.gamma)
            f.call(self._factorize, jacobian.pointer, diagonal, factors.pointer)
            for stage, node in enumerate(RODAS.nodes):
                u = stages[stage]
                if stage:
                    before = stages[:stage]
                    for i in f.each(size):
                        end[i] = tick.x[i] + _sum(f, RODAS.state_factors[stage], before, i)
                    now = self._time(tick, f.fma(h, node, done.get()))
                    tick.rate(now, end, u)
                    for i in f.each(size):
                        change = _sum(f, RODAS.rate_factors[stage], before, i)
                        u[i] = f.fma(per_h, change, u[i])
                else:
                    for i in f.each(size):
                        u[i] = slope[i]
                if self.has_time_derivative and RODAS.time_factors[stage]:
                    for i in f.each(size):
                        u[i] = f.fma(h * RODAS.time_factors[stage], by_time[i], u[i])
                f.call(self._solve, factors.pointer, u.pointer)
            error = f.variable(f.constant(0.0, type_))
            not_finite = f.variable(f.constant(0.0, type_))
            for i in f.each(size):
                end[i] = tick.x[i] + _sum(f, RODAS.weights, stages, i)
                scale = self.tolerance * (1.0 + f.absolute(tick.x[i]))
                estimate = f.absolute(_sum(f, RODAS.error_weights, stages, i))
                shares[i] = estimate / scale
                error.set(error.get() + shares[i])
                not_finite.set(f.fma(end[i], 0.0, not_finite.get()))
            good = (error.get() <= 1.0) & not_finite.get().equals(0.0)
            for i in f.each(size):
                larger = (shares[i] > errors[i]) | shares[i].differs(shares[i])
                errors[i] = f.select(moved.get() & larger, shares[i], errors[i])
            # No comparison holds with nan, so an error of nan makes the substep shorter.
            factor = f.maximum(CONTROL.least, CONTROL.safety / f.sqrt(f.sqrt(error.get())))
            factor = f.select(error.get() <= CONTROL.easy, CONTROL.most, factor)
            # A substep from here has failed, so the next substep is not longer.
            factor = f.select(moved.get(), factor, f.minimum(factor, 1.0))
            following = factor * h
            near_end = good & (h < substep.get())
            following = f.select(near_end, f.maximum(substep.get(), following), following)
            following = f.minimum(following, f.coerce(self.tick_s, type_))
            substep.set(f.select(left.get(), following, substep.get()))
            moved.set(good)
            taken = left.get() & good
            changed.set(f.any_lane(taken))
            tick.keep(self._time(tick, done.get()), h, end, taken)
            for i in f.each(size):
                tick.x[i] = f.select(taken, end[i], tick.x[i])
            done.set(f.select(taken, done.get() + h, done.get()))
            left.set(left.get() & ~(taken & last))
        self.substeps[0] = substep.get()
        return Stuck(left.get(), errors)

    def _time(self, tick: Tick, done: Value) -> Value:
        """Emit the time in s that is ``done`` s after the start of the tick."""
        return before_end(tick, tick.function.coerce(tick.start, tick.type) + done)


def _sum(f: Function, factors: Sequence[float], vectors: Sequence[Array], i: Operand) -> Value:
    """Emit Σ factor · vector[i] of the vectors whose factor is not zero."""
    total: Value | None = None
    for factor, vector in zip(factors, vectors, strict=True):
        if factor:
            total = vector[i] * factor if total is None else f.fma(vector[i], factor, total)
    assert total is not None
    return total


def _define_factorize(module: Module, elimination: Elimination, type_: Type) -> Function:
    """Define the emitted function ``factorize(jacobian, diagonal, out)``.

    The function writes the factors of the matrix diagonal · I - ``jacobian`` to ``out``.
    ``jacobian`` has the elements `Elimination.entries`.
    """
    arguments = {"jacobian": POINTER, "diagonal": type_, "out": POINTER}
    f = module.function("factorize", arguments, attributes="noinline")
    jacobian, out = (Array(f.arguments[name], type_) for name in ("jacobian", "out"))
    a = [f.constant(0.0, type_)] * elimination.size
    for place, (row, column) in enumerate(elimination.entries):
        element = jacobian[place]
        a[place] = f.arguments["diagonal"] - element if row == column else -element
    for operation in elimination.factorization:
        _execute(f, operation, a, a)
    for place, value in enumerate(a):
        out[place] = value
    return f


def _define_solve(module: Module, elimination: Elimination, type_: Type) -> Function:
    """Define the emitted function ``solve(factors, b)``, which replaces ``b`` by the solution."""
    f = module.function("solve", dict.fromkeys(("factors", "b"), POINTER), attributes="noinline")
    factors, right = (Array(f.arguments[name], type_) for name in ("factors", "b"))
    a = [factors[place] for place in range(elimination.size)]
    b = [right[row] for row in range(1 + max(row for row, _ in elimination.entries))]
    for operation in elimination.substitution:
        _execute(f, operation, b, a)
    for row, value in enumerate(b):
        right[row] = value
    return f


def _execute(f: Function, operation: Operation, numbers: list[Value], factors: list[Value]) -> None:
    """Emit an operation on ``numbers``, with a factor of ``factors``."""
    target, factor, other = operation
    if factor is None:
        numbers[target] = 1.0 / numbers[target]
    elif other is None:
        numbers[target] = numbers[target] * factors[factor]
    else:
        numbers[target] = f.fma(-factors[factor], numbers[other], numbers[target])
