"""The exact hold: an exponential integrator with error control, for one lane or several.

The exact hold advances the states x by a tick, in one step or in several. A tick is the unit of the
time grid of a run. The method splits dx/dt = A x + g(t, x), where A is the Jacobian at some earlier
state. A step h solves the linear part exactly, by the functions of z = A h

    phi_1 = (e^z - 1)/z,  phi_2 = (phi_1 - 1)/z,  phi_3 = (phi_2 - 1/2)/z,

and takes g as a parabola through the start, the middle and the end (Cox and Matthews 2002,
J. Comput. Phys. 176). Let g_a be g at the middle minus g at the start, and g_b be g at the end
minus g at the start. The states are

    middle          x + h/2 phi_1(z/2) dx/dt,
    predicted end   x + h phi_1 dx/dt + 2 h (phi_2 + phi_2(z/2)) g_a,
    end             x + h phi_1 dx/dt + 2 h phi_2 g_a + h (phi_2 - 4 phi_3) (2 g_a - g_b).

The order is three with any A. Near the start of the step, g changes by g' t to first order in the
time t since the start. The middle lacks the term (h/2)^2 phi_2(z/2) g'. The predicted end lacks the
term h^2 (phi_2 - a/2) g', where h a is the factor of g_a in the formula above. The end has g_a with
the factor h (4 phi_2 - 8 phi_3), about 2/3 h, and g_b with the factor h (4 phi_3 - phi_2), about
h/6. So the two errors cancel if a = 2 (phi_2 + phi_2(z/2)). This is the weak form of a condition
of Hochbruck and Ostermann (2005, SIAM J. Numer. Anal. 43). If A is the Jacobian at the start and g
does not depend on time, g' is zero and the order is four.

A straight line for g in place of the parabola gives a method of order two. The last term above is
the difference between the two ends, and is the error estimate. A step that misses the tolerance is
repeated with the Jacobian at its start. If this does not help, the steps become driven where dx/dt
depends on the time, as explained below. Otherwise, and if a driven step fails, the step is halved.
Short steps get past corners of the derivatives (a clip, a valve).
If a tick requires eight steps or more, each step must meet a tenth of the tolerance, because the
errors add up. Every sixteenth such step tries the Jacobian at its start even if the step meets the
tolerance. An old Jacobian can be good enough for small steps only, and the steps would then stay
small.

A step that fails with the Jacobian at its start fails because of g. If the norm of A h is at most 2
after three halvings or more, the further steps of the tick are explicit: steps of `DormandPrince`,
of order five, which evaluate dx/dt alone. Such steps are the rule where valves flutter and where
friction changes its sign. They neither choose Jacobians nor fill tables. Their error estimate is
close to their error where a derivative has a corner, so they must be ten times as accurate.

Where dx/dt depends on the time itself, as through a reference or an input table, g is curved even
with the Jacobian at the start. A straight line for g is then poor. So the error estimate is much
larger than the error, and the step fails. From there on the steps are driven. A driven step also
uses the slope of g at its start,

    g' = d²x/dt² - A dx/dt,  d²x/dt² = ∂f/∂t + J f,

where f is dx/dt and J is its Jacobian by x. The compiler derives d²x/dt² from the equations. So g'
contains the slope of the functions of time, and it corrects an old A. In driven steps g_a and g_b
have another meaning. Let g_a be g at the middle minus g at the start minus h/2 g', and g_b be g at
the end minus g at the start minus h g'. The states are

    middle          x + h/2 phi_1(z/2) dx/dt + (h/2)^2 phi_2(z/2) g',
    predicted end   x + h phi_1 dx/dt + h^2 phi_2 g' + 12 h phi_3 g_a,
    end             x + h phi_1 dx/dt + h^2 phi_2 g' + 8 h phi_3 g_a + e,
    e               h (2.8 phi_3 - 0.6 phi_2) (g_b - 4 g_a).

If e had the factor 12 phi_4 - 2 phi_3, g would be the cubic through its three values and its slope.
That factor is 1/6 + z/60 with an error of the order z^3. The factor 2.8 phi_3 - 0.6 phi_2 is
1/6 + z/60 - z^2/600 with an error of this order, and needs no phi_4.

The order of driven steps is four with any A. Let g'' be the second derivative of g. The middle
lacks the term (h/2)^3 phi_3(z/2) g'', about h^3/48 g''. The predicted end has about h^3/12 g'' too
much, because it contains 12 h phi_3 g_a in the place of 8 h phi_3 g_a. The end has g_a with the
factor 4/6 h and g_b with the factor h/6 at z = 0, so the two errors cancel. The term e is about
h^4/72 times the third derivative of g, and is the error estimate. In a step of a whole tick, an
oscillation with a period of about a tick can vanish from e. So a driven step lasts half a tick or
less. Driven steps end when the estimate of a step without g' would be at most 5 % of what it may
be.

A lane is one of the runs that the code makes side by side. Each lane has its own step, Jacobians
and tables, so a run has the same bits in a lane and alone. A lane that has reached the end of the
tick waits for the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from .dormand_prince import DormandPrince
from .integrators import Tick, before_end
from .ir import Array, Function, Module, Operand, Value, Variable
from .jacobian_slots import Memory
from .phi_functions import FINEST, Tables, define_store_matrix, fill_tables, step_of
from .types import BOOL, DOUBLE, INT, POINTER, Type

ChooseSlot = Callable[[Tick, Value, Array, Value], None]
"""``choose(tick, lane, memory, time)`` emits code that chooses the Jacobian of one lane.

The code computes the Jacobian at the lane's state and then calls ``choose_slot``: see
`jacobian_slots`.
"""

_MANY = 3  # least number of halvings with which a tick has "many" steps
# Where valves flutter, explicit steps save most of 70 Jacobians and 400 steps in a tick.
_EXPLICIT = 3  # least number of halvings of an explicit step
# With driven steps 30 s of a prescribed leg on a stiff cuff take a ninth of the time.
_DRIVEN = 1  # least number of halvings of a driven step
_SHORT = 2.0  # largest norm of A h of an explicit step
_SHARE = 0.1  # share of the tolerance that each of many steps may use
# Without this check, the Jacobian from before a reversal stays as long as small steps pass with it.
# Runs at 1 Hz and with a signum controller then took 1.5 to 1.8 times as long.
_CHECK = 16  # of many steps, one in this number tries the Jacobian at its start
_EASY = 0.05  # share of the tolerance below which a step may double
_STRICT = 10.0  # factor of the error estimate of explicit and driven steps, if there are many
_NEGLIGIBLE = 0.01  # share of the tolerance below which a correction is left out
# In units of 1 + |x|: beyond an error of 1 % in all, the run ends with a `StiffnessError`.
_MOST_EXCESS = 1e-2  # largest sum of the errors of finest steps that miss the tolerance
FASTEST_PER_S = 1e13
"""Largest norm of A in 1/s. Chains of lags with poles of 1e-3 … 1e14 1/s are right to 1e-12."""
_WHOLE = 1 << FINEST  # number of finest steps in a tick
# The next four are for records within a step. Of 1 + |x|, what a parabola for g may change at most
# where it is left out: a rounding error.
_STRAIGHT = 1e-14
_PIECE = 8.0  # largest norm of A t in a piece of a series, whose terms then cost 4 digits at most
_LAST = 1e-13  # bound of the last term of a series, in parts of the first
_MOST_SERIES = 64.0  # largest norm of A t of a series; beyond, tables of phi functions cost less


class Shared:
    """Layout of the memory that all lanes share, in elements of eight bytes for each lane.

    Each element has one value for each lane: ``level``, the number of halvings of the step;
    ``driven``, 1 if the steps are driven; the ``norm`` of the current ``jacobian``; and the five
    matrices of ``_take_step`` at ``tables``. The elements of ``head`` must be zero when a run
    starts.
    """

    def __init__(self, size: int) -> None:
        self.level, self.driven, self.norm, self.jacobian = 0, 1, 2, 3
        self.head = 2
        self.square = size * size
        self.tables = self.jacobian + self.square
        self.size = self.tables + 5 * self.square


def multiplied(f: Function, size: int, matrix: Array, vector: Array, out: Array) -> None:
    """Emit ``out`` = matrix · vector. The matrix is stored column by column.

    The code for a single lane works on four rows at once.
    """
    type_ = matrix.type
    rows: list[tuple[int, Type]] = []  # first row of a block, and type of its elements
    if type_.lanes == 1:
        rows = [(row, type_.of(4)) for row in range(0, size - 3, 4)]
    rows += [(row, type_) for row in range(4 * len(rows), size)]
    totals = [f.variable(f.constant(0.0, block)) for _, block in rows]
    for k in f.each(size):
        factor, column = vector[k], matrix.shifted(f.coerce(k, INT) * size)
        for (row, block), total in zip(rows, totals, strict=True):
            elements = column.shifted(row).cast(block)[0]
            total.set(f.fma(elements, f.coerce(factor, block), total.get()))
    for (row, block), total in zip(rows, totals, strict=True):
        out.shifted(row).cast(block)[0] = total.get()


class _Step:
    """Local memory of the emitted code for the result of a step until the step is accepted."""

    def __init__(self, tick: Tick) -> None:
        f = tick.function
        self.end = tick.vector()
        """State at the end of the step."""
        self.worst = f.variable(f.constant(0.0, tick.type))
        """Sum over all states of error estimate / tolerance.

        The step meets the tolerance if this sum is at most 1.
        """
        self.slope = tick.vector()
        """dx/dt at the end of an explicit step."""
        self.middle = tick.vector()
        """State at the middle of a step that is not explicit."""
        self.rest = tick.vector()
        """Change of dx/dt from start to middle, minus the change that the step predicts."""
        self.undriven = f.variable(f.constant(0.0, tick.type))
        """What ``worst`` of a driven step would be without g'. A small value ends driven steps."""

    def replace(self, tick: Tick, lanes: Value, other: _Step) -> None:
        """Emit code that replaces the result in ``lanes`` by the result of another step.

        The other step is not explicit.
        """
        f = tick.function
        for i in f.each(tick.size):
            self.end[i] = f.select(lanes, other.end[i], self.end[i])
            self.middle[i] = f.select(lanes, other.middle[i], self.middle[i])
            self.rest[i] = f.select(lanes, other.rest[i], self.rest[i])
        self.worst.set(f.select(lanes, other.worst.get(), self.worst.get()))
        self.undriven.set(f.select(lanes, other.undriven.get(), self.undriven.get()))


def _take_step(
    tick: Tick,
    time: Value,
    h: Value,
    slope: Array,
    weight: Array,
    tables: Array,
    jacobian: Array,
    step: _Step,
) -> None:
    """Emit one step from the states ``tick.x`` at ``time``, by the equations of this module.

    ``h``: duration of the step in s; ``slope``: dx/dt at the start; ``weight``: inverse of the
    tolerance of each state; ``tables``: phi functions of ``jacobian`` for the steps h and h/2. The
    code writes the result to ``step``.
    """
    f, size, square = tick.function, tick.size, tick.size**2
    predicted, f_a, f_b, g_b, part, move = (tick.vector() for _ in range(6))
    middle, end, g_a, worst = step.middle, step.end, step.rest, step.worst
    multiplied(f, size, tables.shifted(3 * square), slope, middle)
    multiplied(f, size, tables, slope, end)
    for i in f.each(size):
        middle[i] = tick.x[i] + middle[i]
        end[i] = tick.x[i] + end[i]
    remainders = f.variable(f.constant(0.0, tick.type))

    def remainder(t: Value, y: Array, rate: Array, rest: Array) -> None:
        tick.rate(t, y, rate)
        for i in f.each(size):
            move[i] = y[i] - tick.x[i]
        multiplied(f, size, jacobian, move, part)
        for i in f.each(size):
            rest[i] = (rate[i] - slope[i]) - part[i]
            remainders.set(f.fma(f.absolute(rest[i]), weight[i], remainders.get()))

    remainder(f.fma(h, 0.5, time), middle, f_a, g_a)
    large = ~(h * remainders.get() < _NEGLIGIBLE)
    for i in f.each(size):
        predicted[i] = end[i]
    with f.when(f.any_lane(large)):
        multiplied(f, size, tables.shifted(square), g_a, part)
        multiplied(f, size, tables.shifted(4 * square), g_a, move)
        for i in f.each(size):
            end[i] = f.select(large, f.fma(part[i], 2.0, end[i]), end[i])
            predicted[i] = f.select(large, f.fma(move[i], 4.0, end[i]), end[i])
    remainder(before_end(tick, time + h), predicted, f_b, g_b)
    worst.set(0.0)
    large = ~(h * remainders.get() < _NEGLIGIBLE)
    with f.when(f.any_lane(large)):
        for i in f.each(size):
            g_b[i] = f.fma(g_a[i], 2.0, -g_b[i])
        multiplied(f, size, tables.shifted(2 * square), g_b, part)
        for i in f.each(size):
            end[i] = f.select(large, end[i] + part[i], end[i])
            total = f.fma(f.absolute(part[i]), weight[i], worst.get())
            worst.set(f.select(large, total, worst.get()))


def _take_driven_step(
    tick: Tick,
    time: Value,
    h: Value,
    weight: Array,
    tables: Array,
    jacobian: Array,
    step: _Step,
) -> None:
    """Emit one driven step, by the equations of this module; arguments as in `_take_step`.

    The tables contain p = h phi_2 and q = h (phi_2 - 4 phi_3). So h phi_3 is (p - q)/4, and the
    factor of e is p/10 - 7/10 q. Without g' the error estimate would be q (2 g_a - g_b), or
    -q (2 g_a + (g_b - 4 g_a)).
    """
    assert tick.second_rate is not None
    f, size, square = tick.function, tick.size, tick.size**2
    rates, slope, growth = f.array(2 * size, tick.type), tick.vector(), tick.vector()
    predicted, rate, move, g_b = (tick.vector() for _ in range(4))
    p_a, q_a, p_b, q_b = (tick.vector() for _ in range(4))
    middle, end, g_a = step.middle, step.end, step.rest
    phi_1, p, q, half_1, half_2 = (tables.shifted(n * square) for n in range(5))
    tick.second_rate(time, tick.x, rates)
    for i in f.each(size):
        slope[i] = rates[i]
    multiplied(f, size, jacobian, slope, rate)
    for i in f.each(size):
        # At a root at zero d²x/dt² is not finite. Any g' works, with smaller steps.
        change = h * (rates[f.coerce(i, INT) + size] - rate[i])
        growth[i] = f.select((change - change).equals(0.0), change, 0.0)
    multiplied(f, size, half_1, slope, middle)
    multiplied(f, size, half_2, growth, move)
    for i in f.each(size):
        middle[i] = f.fma(move[i], 0.5, tick.x[i] + middle[i])

    def remainder(t: Value, y: Array, share: float, rest: Array) -> None:
        tick.rate(t, y, rate)
        for i in f.each(size):
            move[i] = y[i] - tick.x[i]
        multiplied(f, size, jacobian, move, rest)
        for i in f.each(size):
            rest[i] = f.fma(growth[i], -share, (rate[i] - slope[i]) - rest[i])

    remainder(f.fma(h, 0.5, time), middle, 0.5, g_a)
    multiplied(f, size, phi_1, slope, end)
    multiplied(f, size, p, growth, move)
    multiplied(f, size, p, g_a, p_a)
    multiplied(f, size, q, g_a, q_a)
    for i in f.each(size):
        end[i] = f.fma(p_a[i] - q_a[i], 2.0, tick.x[i] + end[i] + move[i])
        predicted[i] = end[i] + (p_a[i] - q_a[i])
    remainder(before_end(tick, time + h), predicted, 1.0, g_b)
    for i in f.each(size):
        move[i] = f.fma(g_a[i], -4.0, g_b[i])
    multiplied(f, size, p, move, p_b)
    multiplied(f, size, q, move, q_b)
    step.worst.set(0.0)
    step.undriven.set(0.0)
    for i in f.each(size):
        correction = f.fma(p_b[i], 0.1, q_b[i] * -0.7)
        end[i] = end[i] + correction
        step.worst.set(f.fma(f.absolute(correction), weight[i], step.worst.get()))
        undriven = f.fma(q_a[i], 2.0, q_b[i])
        step.undriven.set(f.fma(f.absolute(undriven), weight[i], step.undriven.get()))


def _define_copy_slot(module: Module, size: int, lanes: int) -> Function:
    """Define the emitted function ``copy_slot(slot, out, tick, level)``.

    The function copies the Jacobian and the tables of a slot to the place of its lane in the shared
    memory, and first fills tables that are missing.
    """
    to, tables_at = Shared(size), Tables(size)
    arguments = {"slot": POINTER, "out": POINTER, "tick": DOUBLE, "level": INT}
    f = module.function("copy_slot", arguments, attributes="noinline")
    jacobian, out = (Array(f.arguments[name], DOUBLE) for name in ("slot", "out"))
    tick, level = f.arguments["tick"], f.arguments["level"]
    tables = jacobian.shifted(Memory(size).square)
    f.call(fill_tables(module, size), tick, tables.pointer, level)
    h = step_of(f, tick, level)
    table = tables.shifted(level * tables_at.level + tables_at.first)
    half = table.shifted(tables_at.level)
    for i in f.loop(to.square):
        out[(f.coerce(i, INT) + to.jacobian) * lanes] = jacobian[i]
    for j in f.loop(size):
        for i in f.each(size):
            place = f.coerce(j, INT) * tables_at.rows + i
            phi_1, phi_2, phi_3 = (table[place + n * tables_at.matrix] for n in range(3))
            half_1, half_2 = (half[place + n * tables_at.matrix] for n in range(2))
            values = [h * phi_1, h * phi_2, h * f.fma(phi_3, -4.0, phi_2)]
            values += [0.5 * h * half_1, 0.5 * h * half_2]
            for n, value in enumerate(values):
                element = f.coerce(j, INT) * size + i
                out[(element + (to.tables + n * to.square)) * lanes] = value
    return f


class ExactHold:
    """Emits the exact hold.

    `prepare` emits code that runs before the first tick, and `advance` emits the steps of one tick.
    """

    def __init__(
        self, tick_s: Value, tolerance: Value, memory: Array, shared: Array, choose: ChooseSlot
    ) -> None:
        """Store values of the emitted code for `prepare` and `advance`.

        ``tick_s``: duration of a tick in s; ``memory``: the memories of all lanes (`Memory`), one
        after the other; ``shared``: the memory that all lanes share (`Shared`).
        """
        self.tick_s, self.tolerance = tick_s, tolerance
        self.memory, self.shared = memory, shared
        self.choose = choose
        self.dormand_prince = DormandPrince(tick_s.function)

    def _lanes(self, tick: Tick) -> Iterator[tuple[Value, Array]]:
        """Emit a loop over all lanes. Yield the lane's number and memory once, to emit the body."""
        at = Memory(tick.size)
        for lane in tick.function.loop(tick.type.lanes):
            number = tick.function.coerce(lane, INT)
            yield number, self.memory.shifted(number * at.size)

    def _explicit(self, f: Function, level: Value, norm: Value, bent: Value) -> Value:
        """Emit the condition that a step after ``level`` halvings is explicit.

        ``bent``: whether a step with the Jacobian at its start has failed in this tick.
        """
        short = norm * step_of(f, self.tick_s, level) <= _SHORT
        return bent & short & (level >= _EXPLICIT)

    def _refresh(self, tick: Tick, lane: Value, memory: Array, level: Value, bent: Value) -> None:
        """Emit code that copies a lane's current Jacobian and tables to the shared memory.

        ``level``: the copied tables belong to the step after this number of halvings. An explicit
        step requires no tables.
        """
        f, size, lanes = tick.function, tick.size, tick.type.lanes
        at, to, tables_at = Memory(size), Shared(size), Tables(size)
        jacobian = memory.shifted(memory.cast(INT)[at.slot] * at.slot_size + at.slots)
        tables = jacobian.shifted(at.square)
        norm = tables[tables_at.NORM]
        self.shared[lane + to.norm * lanes] = norm
        with f.when(~self._explicit(f, level, norm, bent)):
            # A function, not a copy at each use: that halves LLVM's time for 50 states.
            copy = f.module.shared("copy_slot", lambda: _define_copy_slot(f.module, size, lanes))
            out = self.shared.address(lane)
            f.call(copy, jacobian.pointer, out, self.tick_s, level)

    def prepare(self, tick: Tick) -> None:
        """Emit code that chooses a first Jacobian in each lane that has no Jacobian yet.

        The code then copies every lane's current Jacobian and tables to the shared memory.
        """
        levels = self.shared.cast(INT)
        for lane, memory in self._lanes(tick):
            with tick.function.when(memory.cast(INT)[Memory(tick.size).filled].equals(0)):
                self.choose(tick, lane, memory, tick.start)
            self._refresh(tick, lane, memory, levels[lane], tick.function.constant(0, BOOL))

    def advance(self, tick: Tick) -> tuple[Value, Value]:
        """Emit the steps of a tick; return two conditions.

        The first is true in lanes where even the shortest steps miss the tolerance by too much, or
        where the second is true. The second is true in lanes whose norm of A at the start of the
        tick exceeds `FASTEST_PER_S`; they take no step.
        """
        f, type_ = tick.function, tick.type
        ints = INT.of(type_.lanes)
        at, rows = Shared(tick.size), Array(self.shared.pointer, ints)
        # Number of halvings of the step, and 1 if the steps are driven.
        level = f.variable(rows[at.level])
        driven = f.variable(f.constant(0, ints) if tick.second_rate is None else rows[at.driven])
        # Position in the tick, and 1 if this step has tried another Jacobian.
        position, tried = (f.variable(f.constant(0, ints)) for _ in range(2))
        # The tolerance is missed by too much, and a step with the Jacobian at its start has failed.
        stiff = (self._norm(tick) > FASTEST_PER_S) & tick.running
        rough, bent = (f.variable(value) for value in (stiff, f.constant(0, BOOL.of(type_.lanes))))
        # In any lane a step has moved x without its slope, and a step has changed x.
        moved, changed = (f.variable(f.constant(1, BOOL)) for _ in range(2))
        slope, weight, step = tick.vector(), tick.vector(), _Step(tick)
        with f.forever() as loop:
            active = (position.get() < _WHOLE) & ~rough.get()
            if type_.lanes > 1:
                active = active & tick.running
            loop.stop_if(~f.any_lane(active))
            time = self._time(tick, position.get())
            explicit = self._explicit(f, level.get(), self._norm(tick), bent.get())
            is_driven = driven.get().differs(0) & ~explicit
            with f.when(moved.get() & f.any_lane(active & ~is_driven)):
                tick.rate(time, tick.x, slope)
            with f.when(changed.get()):
                for i in f.each(tick.size):
                    weight[i] = 1.0 / (self.tolerance * (1.0 + f.absolute(tick.x[i])))
            span = f.coerce(f.constant(_WHOLE, ints), ints) >> level.get()
            lanes = (active & ~explicit & ~is_driven, active & is_driven, active & explicit)
            self._try_step(tick, position.get(), span, level.get(), lanes, slope, weight, step)
            many = level.get() >= _MANY
            worst = step.worst.get() * f.select(many, f.constant(1.0 / _SHARE, type_), 1.0)
            worst = worst * f.select(many & (explicit | is_driven), f.constant(_STRICT, type_), 1.0)
            good = f.variable(worst <= 1.0)
            limit = f.select(many & ~explicit, f.constant(_EASY, type_), 1.0)
            doubted = active & ~(worst <= limit)
            with f.when(f.any_lane(doubted), rare=True):
                due = (position.get() & (span * _CHECK - 1)).equals(0) & tried.get().equals(0)
                doubted = doubted & (due | ~good.get())
                tried.set(f.select(explicit, 1, tried.get()))  # without another Jacobian
                with f.when(f.any_lane(doubted)):
                    self._refine(tick, step, time, doubted, level, driven, tried, good, rough, bent)
            taken = active & good.get()
            moved.set(f.any_lane((taken | is_driven) & ~explicit))
            changed.set(f.any_lane(taken))
            tick.keep(time, step_of(f, self.tick_s, level.get()), step.end, taken)
            for i in f.each(tick.size):
                tick.x[i] = f.select(taken, step.end[i], tick.x[i])
                slope[i] = f.select(taken & explicit, step.slope[i], slope[i])
            position.set(f.select(taken, position.get() + span, position.get()))
            tried.set(f.select(taken, 0, tried.get()))
            # A driven step may end the driven steps: its estimate is then that of the next step.
            undriven = step.undriven.get() * f.select(many, f.constant(1.0 / _SHARE, type_), 1.0)
            back = taken & is_driven & (undriven <= _EASY)
            driven.set(f.select(back, 0, driven.get()))
            worst = f.select(back, undriven, worst)
            easy = taken & (level.get() > 0) & (worst <= _EASY)
            with f.when(f.any_lane(easy)):
                self._coarsen(tick, worst, easy, position.get(), level, driven.get(), bent.get())
        rows[at.level], rows[at.driven] = level.get(), driven.get()
        with f.when(f.any_lane(bent.get()), rare=True):  # the next tick begins with a Jacobian
            flags, levels = _spilled(f, f.flags(bent.get())), self.shared.cast(INT)
            for lane, memory in self._lanes(tick):
                with f.when(flags[lane].differs(0)):
                    self._refresh(tick, lane, memory, levels[lane], f.constant(0, BOOL))
        return rough.get(), stiff

    def _try_step(
        self,
        tick: Tick,
        position: Value,
        span: Value,
        level: Value,
        lanes: tuple[Value, Value, Value],
        slope: Array,
        weight: Array,
        step: _Step,
    ) -> None:
        """Emit one step of each lane.

        ``lanes``: conditions for steps that are neither driven nor explicit, driven, and explicit.
        ``position`` and ``span``: start and length of the step, see `_time`.
        """
        f, count, at = tick.function, tick.type.lanes, Shared(tick.size)
        plain, driven, explicit = lanes
        jacobian, tables = (
            self.shared.shifted(place * count).cast(tick.type) for place in (at.jacobian, at.tables)
        )
        time, h = self._time(tick, position), step_of(f, self.tick_s, level)
        with f.when(f.any_lane(plain)):
            _take_step(tick, time, h, slope, weight, tables, jacobian, step)
        if tick.second_rate is not None:
            with f.when(f.any_lane(driven)):
                other = _Step(tick)
                _take_driven_step(tick, time, h, weight, tables, jacobian, other)
                step.replace(tick, driven, other)
        with f.when(f.any_lane(explicit)):
            after = self._time(tick, position + span)
            end, end_slope, error = self.dormand_prince.step(tick, time, h, after, slope)
            worst = f.variable(f.constant(0.0, tick.type))
            for i in f.each(tick.size):
                step.slope[i] = end_slope[i]
                step.end[i] = f.select(explicit, end[i], step.end[i])
                worst.set(f.fma(f.absolute(error[i]), weight[i], worst.get()))
            step.worst.set(f.select(explicit, worst.get(), step.worst.get()))

    def inside(self, tick: Tick, step: Array, time: Value, out: Array) -> None:
        """Emit code that writes the states at a ``time`` within a step of this tick to ``out``.

        ``step``: begin of the step, its length h, and the states at its start and at its end. The
        code solves dx/dt = A x + g, where A is the current Jacobian, and g is a parabola through
        the start, the middle and the end of the step. The middle comes from a straight line for g.
        If g hardly bends the solution, g stays this line.
        """
        f, size, type_, lanes = tick.function, tick.size, tick.type, tick.type.lanes
        slope, end_slope, rest, bend, curve, move, rate, base = (tick.vector() for _ in range(8))
        begin, h, start, end = step[0], step[1], step.shifted(2), step.shifted(2 + size)
        jacobian = self.shared.shifted(Shared(size).jacobian * lanes).cast(type_)

        def remainder(now: Value, x: Array) -> None:
            tick.rate(now, x, rate)
            for i in f.each(size):
                move[i] = x[i] - start[i]
            multiplied(f, size, jacobian, move, rest)
            for i in f.each(size):
                rest[i] = (rate[i] - slope[i]) - rest[i]

        tick.rate(begin, start, slope)
        remainder(before_end(tick, begin + h), end)
        per_h, straight = 1.0 / h, f.variable(f.constant(1, BOOL.of(lanes)))
        for i in f.each(size):
            bend[i], curve[i], end_slope[i] = rest[i] * per_h, 0.0, rate[i]
            most = f.fma(f.absolute(start[i]), _STRAIGHT, _STRAIGHT)
            straight.set(straight.get() & (h * f.absolute(rest[i]) < most))
        for number in f.loop(2):
            last, bent = f.coerce(number, INT).equals(1), ~straight.get()
            with f.when(last | f.any_lane(bent)):
                span = f.select(last, f.coerce(time, type_) - begin, h * 0.5)
                span = f.select(f.coerce(tick.running, BOOL.of(lanes)), span, 0.0)
                # From the end the series is shorter. A faster A would multiply the errors there.
                back = last & (span > h * 0.5) & (self._norm(tick) * h <= _PIECE)
                for i in f.each(size):
                    base[i] = f.select(back, end[i], start[i])
                    slope[i] = f.select(back, end_slope[i], slope[i])
                    bend[i] = f.select(back, f.fma(curve[i], h, bend[i]), bend[i])
                self._solve(tick, f.select(back, span - h, span), jacobian, slope, bend, curve, out)
                for i in f.each(size):
                    out[i] = base[i] + out[i]
            with f.when(~last & f.any_lane(bent)):
                remainder(f.fma(h, 0.5, begin), out)
                for i in f.each(size):
                    line, at_end = bend[i], bend[i] * h
                    bend[i] = f.select(bent, f.fma(rest[i], 4.0, -at_end) * per_h, line)
                    curve[i] = f.select(
                        bent, f.fma(rest[i], -8.0, 4.0 * at_end) * per_h * per_h, 0.0
                    )

    def _solve(
        self, tick: Tick, span: Value, a: Array, slope: Array, bend: Array, curve: Array, out: Array
    ) -> None:
        """Emit code that writes the solution of a linear equation at the time ``span`` to ``out``.

        The equation is dy/dt = A y + ``slope`` + ``bend`` t + ``curve`` t²/2 with y(0) = 0. The
        solution is a Taylor series in pieces, with a norm of A t of at most ``_PIECE`` in each.
        A lane with a fast A makes tables for this time.
        """
        f, size, type_, norm = tick.function, tick.size, tick.type, self._norm(tick)
        rate, line, term, force, later, change, product = (tick.vector() for _ in range(7))
        scaled = f.array(size * size, type_)
        fast = norm * span > _MOST_SERIES
        left = f.variable(f.select(fast, f.constant(0.0, type_), span))
        for i in f.each(size):
            out[i], rate[i], line[i] = 0.0, slope[i], bend[i]
        with f.forever() as pieces:
            h = left.get()
            pieces.stop_if(~f.any_lane(f.absolute(h) > 0.0))
            long = ~(norm * f.absolute(h) <= _PIECE)
            h = f.select(long, f.minimum(h, _PIECE / norm), h)
            left.set(left.get() - h)
            for e in f.each(size * size):
                scaled[e] = h * a[e]
            for i in f.each(size):
                term[i] = h * rate[i]
                force[i], later[i], change[i] = h * h * line[i], h * h * h * curve[i], term[i]
            # The terms are y' h, y'' h², … at the start of the piece, without 1, 1/2!, …
            ratio, share = norm * f.absolute(h), f.variable(f.constant(1.0))
            bound, order = f.variable(ratio), f.variable(f.constant(2.0))
            with f.forever() as series:
                number = order.get()
                more = f.coerce(number < 4.0, BOOL.of(type_.lanes)) | (bound.get() > _LAST)
                series.stop_if(~f.any_lane(more))
                part = 1.0 / number
                share.set(share.get() * part)
                bound.set(bound.get() * (ratio * f.coerce(part, type_)))
                order.set(number + 1.0)
                multiplied(f, size, scaled, term, product)
                for i in f.each(size):
                    term[i], force[i], later[i] = product[i] + force[i], later[i], 0.0
                    longer = f.fma(term[i], f.coerce(share.get(), type_), change[i])
                    change[i] = f.select(more, longer, change[i])
            multiplied(f, size, a, change, product)
            for i in f.each(size):
                out[i] = out[i] + change[i]
                rate[i] = rate[i] + product[i] + h * f.fma(h * 0.5, curve[i], line[i])
                line[i] = f.fma(h, curve[i], line[i])
        with f.when(f.any_lane(fast), rare=True):
            flags, spans = _spilled(f, f.flags(fast)), _spilled(f, span)
            fill = fill_tables(f.module, size)
            store = f.module.shared("store_matrix", partial(define_store_matrix, f.module, size))
            for lane, memory in self._lanes(tick):
                with f.when(flags[lane].differs(0)):
                    at, phi_at, t = Memory(size), Tables(size), spans[lane]
                    current = memory.cast(INT)[at.slot] * at.slot_size + at.slots
                    tables = memory.shifted(at.tables)
                    f.call(store, memory.address(current), tables.pointer)
                    f.call(fill, t, tables.pointer, f.constant(0, INT))
                    for i in f.loop(size):
                        total = f.variable(f.constant(0.0))
                        for j in f.loop(size):
                            column, power = f.coerce(j, INT), t
                            phi = tables.shifted(column * phi_at.rows + i + phi_at.first)
                            for n, vector in enumerate((slope, bend, curve)):
                                value = vector.cast(DOUBLE)[column * type_.lanes + lane] * power
                                total.set(f.fma(phi[n * phi_at.matrix], value, total.get()))
                                power = power * t
                        out.cast(DOUBLE)[f.coerce(i, INT) * type_.lanes + lane] = total.get()

    def _norm(self, tick: Tick) -> Value:
        """Emit code that loads the norm of each lane's current Jacobian."""
        place = Shared(tick.size).norm * tick.type.lanes
        return self.shared.shifted(place).cast(tick.type)[0]

    def _time(self, tick: Tick, position: Value) -> Value:
        """Emit the time in s of a position within the tick, which has `_WHOLE` parts."""
        f, type_ = tick.function, tick.type
        share = f.to_double(position) * (1.0 / _WHOLE)
        time = f.fma(f.coerce(self.tick_s, type_), share, f.coerce(tick.start, type_))
        return before_end(tick, time)

    def _refine(
        self,
        tick: Tick,
        step: _Step,
        time: Value,
        doubted: Value,
        level: Variable,
        driven: Variable,
        tried: Variable,
        good: Variable,
        rough: Variable,
        bent: Variable,
    ) -> None:
        """Emit code that tries another Jacobian in each lane of ``doubted``, or halves the step.

        The shortest step cannot be halved, so the code accepts this step even if the step misses
        the tolerance. If the errors of such steps add up to too much, the code does not accept the
        step, and ``rough`` becomes true in the lane.
        """
        f, size, lanes, at = tick.function, tick.size, tick.type.lanes, Memory(tick.size)
        times, worsts = _spilled(f, time), _spilled(f, step.worst.get())
        levels, tries = _spilled(f, level.get()), _spilled(f, tried.get())
        drivens = _spilled(f, driven.get())
        doubts, goods = (_spilled(f, f.flags(value)) for value in (doubted, good.get()))
        roughs, bents = (_spilled(f, f.flags(value.get())) for value in (rough, bent))
        change, rest = f.array(size * lanes), f.array(size * lanes)
        for i in f.each(size):
            _spill(change, i, step.middle[i] - tick.x[i])
            _spill(rest, i, step.rest[i])
        for lane, memory in self._lanes(tick):
            with f.when(doubts[lane].differs(0)):
                whole = memory.cast(INT)
                slot, again = whole[at.slot], f.variable(f.constant(0, BOOL))
                with f.when(tries[lane].equals(0)):
                    tries[lane] = 1
                    for i in f.loop(size):
                        place = f.coerce(i, INT)
                        memory[place + at.change] = change[place * lanes + lane]
                        memory[place + at.rest] = rest[place * lanes + lane]
                    self.choose(tick, lane, memory, times[lane])
                    again.set(whole[at.slot].differs(slot))
                failed = goods[lane].equals(0)
                with f.when(again.get()):
                    goods[lane] = 0
                failed = failed & ~again.get()
                if tick.second_rate is not None:  # the steps become driven before they are halved
                    undriven = failed & drivens[lane].equals(0)
                    with f.when(undriven):
                        drivens[lane] = 1
                        levels[lane] = f.select(levels[lane] < _DRIVEN, _DRIVEN, levels[lane])
                    failed = failed & ~undriven
                with f.when(failed):
                    bents[lane] = 1
                    finest = levels[lane].equals(FINEST)
                    with f.when(finest):
                        worst = worsts[lane]
                        memory[at.excess] = f.fma(worst, self.tolerance, memory[at.excess])
                        goods[lane] = 1
                        # Accept an error estimate that is not finite. The state is not finite
                        # either, and a later check of the state reports this.
                        finite = (worst - worst).equals(0.0)
                        with f.when(finite & (memory[at.excess] > _MOST_EXCESS)):
                            goods[lane] = 0
                            roughs[lane] = 1
                    with f.when(~finest):
                        levels[lane] = levels[lane] + 1
                self._refresh(tick, lane, memory, levels[lane], bents[lane].differs(0))
        ints = INT.of(lanes)
        level.set(levels.cast(ints)[0])
        driven.set(drivens.cast(ints)[0])
        tried.set(tries.cast(ints)[0])
        good.set(goods.cast(ints)[0].differs(0))
        rough.set(roughs.cast(ints)[0].differs(0))
        bent.set(bents.cast(ints)[0].differs(0))

    def _coarsen(
        self,
        tick: Tick,
        worst: Value,
        easy: Value,
        position: Value,
        level: Variable,
        driven: Value,
        bent: Value,
    ) -> None:
        """Emit code that lengthens the next step in each lane of ``easy``, whose error is small.

        The code doubles the step as long as the predicted error is small and the doubled step
        begins at a multiple of its own length.
        """
        f = tick.function
        flags, positions = _spilled(f, f.flags(easy)), _spilled(f, position)
        levels, worsts = _spilled(f, level.get()), _spilled(f, worst)
        bents = _spilled(f, f.flags(bent))
        coarsest = _spilled(f, driven * _DRIVEN)
        for lane, memory in self._lanes(tick):
            with f.when(flags[lane].differs(0)):
                before = levels[lane]
                with f.forever() as loop:
                    more = levels[lane] > coarsest[lane]
                    loop.stop_if(~(more & (worsts[lane] <= _EASY)))
                    # On this grid steps end exactly with the tick, and each level has one table.
                    twice = f.constant(2 * _WHOLE, INT) >> levels[lane]
                    loop.stop_if((positions[lane] % twice).differs(0))
                    levels[lane] = levels[lane] - 1
                    # The estimate is of fourth order in a step, or of fifth in explicit ones.
                    worsts[lane] = worsts[lane] * 32.0
                with f.when(levels[lane].differs(before)):
                    self._refresh(tick, lane, memory, levels[lane], bents[lane].differs(0))
        level.set(levels.cast(INT.of(tick.type.lanes))[0])


def _spilled(f: Function, value: Value) -> Array:
    """Emit code that copies the lanes of ``value`` to new local memory; return this memory."""
    memory = f.array(value.type.lanes, value.type.of(1))
    _spill(memory, 0, value)
    return memory


def _spill(memory: Array, index: Operand, value: Value) -> None:
    memory.cast(value.type)[index] = value
