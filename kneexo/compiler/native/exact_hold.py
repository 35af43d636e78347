"""The exact hold: an exponential integrator with error control, for one lane or several.

It advances the states x by a tick, the unit of a run's time grid, in one step or in several. The
method splits dx/dt = A x + g(t, x), where A is the Jacobian at some earlier state. A step h solves
the linear part exactly, by the functions of z = A h

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
repeated with the Jacobian at its start. If this does not help, the step is halved. Short steps get
past corners of the derivatives (a clip, a valve). If a tick requires eight steps or more, each step
must meet a tenth of the tolerance, because the errors add up. Every sixteenth such step tries the
Jacobian at its start even if the step meets the tolerance. An old Jacobian can be good enough for
small steps only, and the steps would then stay small.

A lane is one of the runs that the code makes side by side. Each lane has its own step, Jacobians
and tables, so a run has the same bits in a lane and alone. A lane that has reached the end of the
tick waits for the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import accumulate

from .integrators import Tick
from .ir import UNROLLED, Array, Function, Module, Operand, Value, Variable
from .phi_functions import FINEST, define_fill_tables
from .types import BOOL, DOUBLE, INT, POINTER

ChooseSlot = Callable[[Tick, Value, Array, Value], None]
"""``choose(tick, lane, memory, time)`` emits code that chooses the Jacobian of one lane.

The code computes the Jacobian at the lane's state and then calls ``choose_slot``: see
`define_choose_slot`.
"""

SLOTS = 4
"""Number of slots of a lane. A slot stores one Jacobian and the tables of its phi functions."""

_MANY = 3  # least number of halvings with which a tick has "many" steps
_SHARE = 0.1  # share of the tolerance that each of many steps may use
_CHECK = 16  # of many steps, one in this number tries the Jacobian at its start
_EASY = 0.05  # share of the tolerance below which a step may double
_NEGLIGIBLE = 0.01  # share of the tolerance below which a correction is left out
_MOST_EXCESS = 1e-2  # largest sum of the errors of finest steps that miss the tolerance
_WHOLE = 1 << FINEST  # number of finest steps in a tick


class Memory:
    """Layout of the memory that the exact hold uses for one lane, in elements of eight bytes.

    ``Memory(size)`` serves ``size`` continuous states. The attribute ``size`` is the number of
    elements of the memory, and ``square`` is the number of elements of one matrix. The other
    attributes, such as ``jacobians``, are the indices at which the parts of the memory begin.
    """

    def __init__(self, size: int) -> None:
        square = size * size
        self.square = square
        self.table = 3 * square
        """Number of elements of a table: three phi functions of one Jacobian for one step size."""
        sizes = {
            "filled": 1,  # number of slots that hold a Jacobian
            "made": 1,  # number of Jacobians stored so far
            "slot": 1,  # slot of the current Jacobian
            "excess": 1,  # sum of the errors of finest steps that miss the tolerance
            "jacobians": SLOTS * square,
            "candidate": square,  # the Jacobian that is tried
            "change": size,  # state at the middle of a step minus that at its start
            "rest": size,  # remainder of dx/dt there that the linear part does not explain
            "tables": SLOTS * (FINEST + 2) * self.table,
        }
        places = dict(zip(sizes, accumulate(sizes.values(), initial=0), strict=False))
        self.filled, self.made, self.slot, self.excess = (places[k] for k in list(sizes)[:4])
        self.jacobians, self.candidate, self.change = (places[k] for k in list(sizes)[4:7])
        self.rest, self.tables = (places[k] for k in list(sizes)[7:])
        self.head = self.jacobians
        """Number of elements at the beginning of the memory that must be zero when a run starts."""
        self.size = -(-sum(sizes.values()) // 8) * 8

    def shared(self, lanes: int) -> int:
        """Return the number of elements of the memory that all lanes share.

        This memory holds three things for each lane: the number of halvings of the step, the
        current Jacobian, and the current tables.
        """
        return (1 + self.square + self.table + 2 * self.square) * lanes


def multiplied(f: Function, size: int, matrix: Array, vector: Array, out: Array) -> None:
    """Emit ``out`` = matrix · vector. The matrix is stored column by column."""
    if size <= UNROLLED:
        for row in range(size):
            total = matrix[row] * vector[0]
            for column in range(1, size):
                total = f.fma(matrix[column * size + row], vector[column], total)
            out[row] = total
        return
    for i in f.each(size):
        out[i] = 0.0
    for k in f.each(size):
        factor, elements = vector[k], matrix.shifted(k * size)
        for i in f.each(size):
            out[i] = f.fma(elements[i], factor, out[i])


def define_choose_slot(module: Module, size: int) -> Function:
    """Define the emitted function ``choose_slot(x, memory, tick)``, which chooses a Jacobian.

    ``x``: states of the lane; ``memory``: see `Memory`; ``tick``: duration of a tick in s. The
    memory has a candidate for the Jacobian, the vector ``change``, and the vector ``rest``. If
    (candidate - current Jacobian) · ``change`` is less than a tenth of ``rest``, the current
    Jacobian stays. Otherwise the candidate becomes the current Jacobian. If no slot holds the
    candidate yet, the candidate replaces the oldest Jacobian, and the code computes new tables.
    """
    fill_tables = define_fill_tables(module, size)
    at, square = Memory(size), size * size
    arguments = {"x": POINTER, "memory": POINTER, "tick": DOUBLE}
    f = module.function("choose_slot", arguments, attributes="noinline cold")
    x, memory = (Array(f.arguments[name], DOUBLE) for name in ("x", "memory"))
    whole = memory.cast(INT)
    filled, current = whole[at.filled], whole[at.slot]
    jacobians, candidate = memory.shifted(at.jacobians), memory.shifted(at.candidate)
    for e in f.loop(square):
        with f.when((candidate[e] - candidate[e]).differs(0.0)):
            candidate[e] = (
                0.0  # infinite slope of a root at zero; any matrix works, with smaller steps
            )
    with f.when(filled > 0):
        explained, total_rest = f.variable(f.constant(0.0)), f.variable(f.constant(0.0))
        for i in f.loop(size):
            total = f.variable(f.constant(0.0))
            for k in f.loop(size):
                place = f.coerce(k, INT) * size + i
                difference = candidate[place] - jacobians[current * square + place]
                change = memory[f.coerce(k, INT) + at.change]
                total.set(f.fma(difference, change, total.get()))
            scale = 1.0 + f.absolute(x[i])
            explained.set(explained.get() + f.absolute(total.get()) / scale)
            total_rest.set(
                total_rest.get() + f.absolute(memory[f.coerce(i, INT) + at.rest]) / scale
            )
        f.return_if(explained.get() < 0.1 * total_rest.get())
    for slot in f.loop(SLOTS):
        number = f.coerce(slot, INT)
        with f.when(number < filled):
            same = f.variable(f.constant(1, BOOL))
            for e in f.loop(square):
                equal = jacobians[number * square + e].equals(candidate[e])
                same.set(same.get() & equal)
            with f.when(same.get()):
                whole[at.slot] = number
                f.return_if(f.constant(1, BOOL))
    slot = whole[at.made] % SLOTS
    whole[at.made] = whole[at.made] + 1
    with f.when(filled < SLOTS):
        whole[at.filled] = filled + 1
    for e in f.loop(square):
        jacobians[slot * square + e] = candidate[e]
    tables = memory.shifted(slot * ((FINEST + 2) * at.table) + at.tables)
    f.call(fill_tables, jacobians.address(slot * square), f.arguments["tick"], tables.pointer)
    whole[at.slot] = slot
    return f


@dataclass(frozen=True)
class _Step:
    """The result of one step, which is not accepted yet, as values of the emitted code."""

    end: Array
    """State at the end of the step."""
    worst: Value
    """Sum over all states of error estimate / tolerance.

    The step meets the tolerance if this sum is at most 1.
    """
    middle: Array
    """State at the middle of the step."""
    rest: Array
    """Change of dx/dt from start to middle, minus the change that the Jacobian predicts."""


def _step(
    tick: Tick, time: Value, h: Value, slope: Array, weight: Array, tables: Array, jacobian: Array
) -> _Step:
    """Emit one step from the states ``tick.x`` at ``time``, by the equations of this module.

    ``h``: duration of the step in s; ``slope``: dx/dt at the start; ``weight``: inverse of the
    tolerance of each state; ``tables``: phi functions of ``jacobian`` for the steps h and h/2.
    """
    f, size, square = tick.function, tick.size, tick.size**2
    middle, predicted, end = (tick.vector() for _ in range(3))
    f_a, g_a, f_b, g_b, part, move = (tick.vector() for _ in range(6))
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
    remainder(time + h, predicted, f_b, g_b)
    worst = f.variable(f.constant(0.0, tick.type))
    large = ~(h * remainders.get() < _NEGLIGIBLE)
    with f.when(f.any_lane(large)):
        for i in f.each(size):
            g_b[i] = f.fma(g_a[i], 2.0, -g_b[i])
        multiplied(f, size, tables.shifted(2 * square), g_b, part)
        for i in f.each(size):
            end[i] = f.select(large, end[i] + part[i], end[i])
            total = f.fma(f.absolute(part[i]), weight[i], worst.get())
            worst.set(f.select(large, total, worst.get()))
    return _Step(end, worst.get(), middle, g_a)


class ExactHold:
    """Emits the exact hold.

    `prepare` emits code that runs before the first tick, and `advance` emits the steps of one tick.
    """

    def __init__(
        self, tick_s: Value, tolerance: Value, memory: Array, shared: Array, choose: ChooseSlot
    ) -> None:
        """Store values of the emitted code for `prepare` and `advance`.

        ``tick_s``: duration of a tick in s; ``memory``: the memories of all lanes (`Memory`), one
        after the other; ``shared``: the memory that all lanes share (`Memory.shared`).
        """
        self.tick_s, self.tolerance = tick_s, tolerance
        self.memory, self.shared = memory, shared
        self.choose = choose

    def _lanes(self, tick: Tick) -> Iterator[tuple[Value, Array]]:
        """Emit a loop over all lanes. Yield the lane's number and memory once, to emit the body."""
        at = Memory(tick.size)
        for lane in tick.function.loop(tick.type.lanes):
            number = tick.function.coerce(lane, INT)
            yield number, self.memory.shifted(number * at.size)

    def _refresh(self, tick: Tick, lane: Value, memory: Array, level: Value) -> None:
        """Emit code that copies a lane's current Jacobian and tables to the shared memory.

        ``level``: the copied tables belong to the step after this number of halvings.
        """
        f, at, lanes = tick.function, Memory(tick.size), tick.type.lanes
        slot = memory.cast(INT)[at.slot]
        jacobian = memory.shifted(slot * at.square + at.jacobians)
        tables = memory.shifted((slot * (FINEST + 2) + level) * at.table + at.tables)
        for i in f.loop(at.square):
            self.shared[(f.coerce(i, INT) + 1) * lanes + lane] = jacobian[i]
        for i in f.loop(at.table + 2 * at.square):  # with two functions of half the step
            self.shared[(f.coerce(i, INT) + (1 + at.square)) * lanes + lane] = tables[i]

    def prepare(self, tick: Tick) -> None:
        """Emit code that chooses a first Jacobian in each lane that has no Jacobian yet.

        The code then copies every lane's current Jacobian and tables to the shared memory.
        """
        levels = self.shared.cast(INT)
        for lane, memory in self._lanes(tick):
            with tick.function.when(memory.cast(INT)[Memory(tick.size).filled].equals(0)):
                self.choose(tick, lane, memory, tick.start)
            self._refresh(tick, lane, memory, levels[lane])

    def advance(self, tick: Tick) -> Value:
        """Emit the steps of a tick; return a condition.

        The condition is true in lanes where even the shortest steps miss the tolerance by too much.
        """
        f, size, type_ = tick.function, tick.size, tick.type
        lanes, at = type_.lanes, Memory(size)
        ints, mask = INT.of(lanes), BOOL.of(lanes)
        jacobian = Array(self.shared.address(lanes), type_)
        tables = Array(self.shared.address((1 + at.square) * lanes), type_)
        level = f.variable(Array(self.shared.pointer, ints)[0])
        position, tried = (f.variable(f.constant(0, ints)) for _ in range(2))
        rough = f.variable(f.constant(0, mask))
        moved = f.variable(f.constant(1, BOOL))
        slope, weight = tick.vector(), tick.vector()
        with f.forever() as loop:
            active = (position.get() < _WHOLE) & ~rough.get()
            if lanes > 1:
                active = active & tick.running
            loop.stop_if(~f.any_lane(active))
            share = f.to_double(position.get()) * (1.0 / _WHOLE)
            time = f.fma(f.coerce(self.tick_s, type_), share, f.coerce(tick.start, type_))
            with f.when(moved.get()):
                tick.rate(time, tick.x, slope)
                for i in f.each(size):
                    weight[i] = 1.0 / (self.tolerance * (1.0 + f.absolute(tick.x[i])))
            span = f.coerce(f.constant(_WHOLE, ints), ints) >> level.get()
            h = f.coerce(self.tick_s, type_) * (f.to_double(span) * (1.0 / _WHOLE))
            step = _step(tick, time, h, slope, weight, tables, jacobian)
            many = level.get() >= _MANY
            worst = step.worst * f.select(many, f.constant(1.0 / _SHARE, type_), 1.0)
            good = f.variable(worst <= 1.0)
            limit = f.select(many, f.constant(_EASY, type_), 1.0)
            doubted = active & ~(worst <= limit)
            with f.when(f.any_lane(doubted), rare=True):
                due = (position.get() & (span * _CHECK - 1)).equals(0) & tried.get().equals(0)
                doubted = doubted & (due | ~good.get())
                with f.when(f.any_lane(doubted)):
                    self._refine(tick, step, time, doubted, level, tried, good, rough)
            taken = active & good.get()
            moved.set(f.any_lane(taken))
            before = position.get()
            position.set(before + span)
            with f.when(f.any_lane(~taken), rare=True):
                for i in f.each(size):
                    step.end[i] = f.select(taken, step.end[i], tick.x[i])
                position.set(f.select(taken, before + span, before))
            for i in f.each(size):
                tick.x[i] = step.end[i]
            tried.set(f.select(taken, 0, tried.get()))
            easy = taken & (level.get() > 0) & (worst <= _EASY)
            with f.when(f.any_lane(easy)):
                self._coarsen(tick, worst, easy, position.get(), level)
        Array(self.shared.pointer, ints)[0] = level.get()
        return rough.get()

    def _refine(
        self,
        tick: Tick,
        step: _Step,
        time: Value,
        doubted: Value,
        level: Variable,
        tried: Variable,
        good: Variable,
        rough: Variable,
    ) -> None:
        """Emit code that tries another Jacobian in each lane of ``doubted``, or halves the step.

        The shortest step cannot be halved, so the code accepts this step even if the step misses
        the tolerance. If the errors of such steps add up to too much, the code does not accept the
        step, and ``rough`` becomes true in the lane.
        """
        f, size, lanes, at = tick.function, tick.size, tick.type.lanes, Memory(tick.size)
        times, worsts = _spilled(f, time), _spilled(f, step.worst)
        levels, tries = _spilled(f, level.get()), _spilled(f, tried.get())
        doubts, goods = (_spilled(f, f.flags(value)) for value in (doubted, good.get()))
        roughs = _spilled(f, f.flags(rough.get()))
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
                with f.when(failed & ~again.get()):
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
                self._refresh(tick, lane, memory, levels[lane])
        ints = INT.of(lanes)
        level.set(levels.cast(ints)[0])
        tried.set(tries.cast(ints)[0])
        good.set(goods.cast(ints)[0].differs(0))
        rough.set(roughs.cast(ints)[0].differs(0))

    def _coarsen(
        self, tick: Tick, worst: Value, easy: Value, position: Value, level: Variable
    ) -> None:
        """Emit code that lengthens the next step in each lane of ``easy``, whose error is small.

        The code doubles the step as long as the predicted error is small and the doubled step
        begins at a multiple of its own length.
        """
        f = tick.function
        flags, positions = _spilled(f, f.flags(easy)), _spilled(f, position)
        levels, worsts = _spilled(f, level.get()), _spilled(f, worst)
        for lane, memory in self._lanes(tick):
            with f.when(flags[lane].differs(0)):
                before = levels[lane]
                with f.forever() as loop:
                    loop.stop_if(~((levels[lane] > 0) & (worsts[lane] <= _EASY)))
                    twice = f.constant(2 * _WHOLE, INT) >> levels[lane]
                    loop.stop_if((positions[lane] % twice).differs(0))
                    levels[lane] = levels[lane] - 1
                    # The estimate is of third order, and one more in a step.
                    worsts[lane] = worsts[lane] * 16.0
                with f.when(levels[lane].differs(before)):
                    self._refresh(tick, lane, memory, levels[lane])
        level.set(levels.cast(INT.of(tick.type.lanes))[0])


def _spilled(f: Function, value: Value) -> Array:
    """Emit code that copies the lanes of ``value`` to new local memory; return this memory."""
    memory = f.array(value.type.lanes, value.type.of(1))
    _spill(memory, 0, value)
    return memory


def _spill(memory: Array, index: Operand, value: Value) -> None:
    memory.cast(value.type)[index] = value
