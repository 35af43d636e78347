"""Emits three IR texts of a model: to start a run, to advance a run, and to judge a step that may
be unstable.

A text is compiled when a runner first calls one of its functions.

Names of the arrays: ``x`` continuous states, ``d`` discrete states, ``u`` open inputs, ``c`` values
that depend on parameters alone, ``y`` outputs. The number of lanes is the number of runs that one
call makes in lock-step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial

from ..equations.passes import Group, Place, Program
from ..rosenbrock import RODAS, Elimination
from . import exact_hold, jacobian_slots
from .arguments import (
    DOUBLES,
    INPUT,
    MEMO_LINES,
    NOT_FINITE,
    OUTPUT_NOT_FINITE,
    OUTSIDE,
    RUN,
    SUSPECTS,
    TOO_MANY_SUBSTEPS,
    TOO_ROUGH,
)
from .integrators import Tick, advance_rk4, advance_runge_kutta3
from .ir import Array, Function, Module, Operand, Value, Variable
from .open_inputs import define_inputs
from .printer import (
    Printer,
    Storage,
    define_constants,
    define_derivatives,
    define_initialize,
    define_jacobian,
    define_linear,
    define_rates,
    define_second_derivatives,
)
from .reductions import define_reduce
from .rosenbrock import Rosenbrock
from .types import BOOL, BYTE, DOUBLE, INT, POINTER, Type

_CHECKS = 4  # independent sums, which the processor can compute at the same time

# Beyond these sizes the derivatives are a function that the code calls, not copies at each use.
# With a single lane, copies of more operations save no time in a run, but LLVM takes longer.
_INLINED_STATES, _INLINED_NODES, _INLINED_NODES_OF_ONE_LANE = 8, 1500, 120


def start_text(program: Program) -> str:
    """Return the IR text with the functions of `define_constants` and `define_initialize`."""
    module = Module()
    define_constants(module, program)
    define_initialize(module, program)
    return module.text()


def run_text(program: Program, integrator: str, lanes: int, given_times: bool = False) -> str:
    """Return the IR text of ``run(arguments)``, which advances the states from tick to tick.

    ``integrator``: one of `INTEGRATORS`. `RUN` lists the arguments of ``run``. ``given_times``:
    whether the records are at given times.
    """
    module = Module()
    _Run(module, program, integrator, lanes, given_times).trace()
    return module.text()


def rates_text(program: Program) -> str:
    """Return the IR text with the function of `define_rates`."""
    module = Module()
    define_rates(module, program)
    return module.text()


# ------------------------------------------------------------------------------ model parts


class _Clock:
    """Emits code that stores the number of the current tick and computes the time of this tick.

    As in `Timing.times`, a unit has ``split`` ticks. The time is (whole units) · unit + (further
    ticks) · tick, so rounding errors do not add up.
    """

    def __init__(self, f: Function, arguments: _Arguments, tick: Value) -> None:
        self.f, self.arguments = f, arguments
        split = arguments["split"]
        whole = f.instruction(f"sdiv i64 {tick.name}, {split.name}", INT)
        self.whole, self.part = f.variable(whole), f.variable(tick - whole * split)

    def time(self) -> Value:
        """Emit the time of the current tick; return this time in s."""
        part = self.f.to_double(self.part.get()) * self.arguments["tick"]
        return self.f.fma(self.f.to_double(self.whole.get()), self.arguments["unit"], part)

    def advance(self) -> None:
        """Emit code that adds 1 to the number of the current tick."""
        f, part = self.f, self.part.get() + 1
        is_whole = part.equals(self.arguments["split"])
        self.whole.set(self.whole.get() + f.flags(is_whole))
        self.part.set(f.select(is_whole, 0, part))


class _Arguments:
    """Emits loads of a function's arguments from the memory to which its only parameter points."""

    def __init__(self, f: Function, names: Sequence[str]) -> None:
        self.f = f
        memory = Array(f.arguments["arguments"], INT)
        self.values = {
            name: memory.cast(DOUBLE)[i] if name in DOUBLES else memory[i]
            for i, name in enumerate(names)
        }

    def __getitem__(self, name: str) -> Value:
        return self.values[name]

    def array(self, name: str, type_: Type = INT) -> Array:
        """Return the array of ``type_`` whose address is the argument ``name``."""
        return Array(self.f.pointer(self.values[name]), type_)


class _Model:
    """Emits the equations of a model into the function ``run``."""

    def __init__(self, f: Function, program: Program, lanes: int, arguments: _Arguments) -> None:
        self.f, self.program, self.lanes = f, program, lanes
        self.type = DOUBLE.of(lanes)
        equations = program.equations
        self.discrete_count = len(equations.discrete)
        self.input_count = sum(equations.inputs.values())
        self.output_count = sum(map(len, equations.outputs.values()))
        large = program.size > _INLINED_STATES or (
            len(program.graph.reachable(program.derivatives)) - len(program.hoisted)
            > (_INLINED_NODES if lanes > 1 else _INLINED_NODES_OF_ONE_LANE)
        )
        attributes = "noinline" if large else "alwaysinline"
        self.derivatives = define_derivatives(f.module, program, lanes, attributes)
        self.inputs = arguments.array("inputs")
        self.c = arguments.array("c", self.type)
        self.x = f.array(program.size, self.type)
        self.d = f.array(self.discrete_count, self.type)
        self.u = f.array(2 * self.input_count, self.type)  # the inputs, and then their rates
        # The last element stays zero. A reduction that subtracts no output subtracts this element.
        self.y = f.array(self.output_count + 1, self.type)
        self._lane_u = f.array(2 * self.input_count)
        self.states = (
            ("snapshot_x", self.x, program.size),
            ("snapshot_d", self.d, self.discrete_count),
        )
        """For ``x`` and for ``d``: name of the snapshots' argument, array, number of states."""
        self._windows, self._suspects = arguments.array("windows"), arguments.array("suspects")
        sizes = program.size, self.discrete_count, self.input_count
        self._log = _define_log(f.module, lanes, sizes)

    def inputs_of(self, lane: Operand, time: Value, u: Array, *, rates: bool = False) -> None:
        """Emit code that writes the open inputs of one lane at ``time`` to ``u``.

        With ``rates`` the code writes the rates of the inputs behind the inputs.
        """
        if self.input_count:
            name = "evaluate_inputs" + "_and_rates" * rates
            make = partial(define_inputs, self.f.module, self.input_count, rates=rates)
            table = self.inputs.address(self.f.coerce(lane, INT) * len(INPUT))
            self.f.call(self.f.module.shared(name, make), time, table, u.pointer)

    def set_inputs(self, time: Operand, *, rates: bool = False) -> None:
        """Emit code that sets the open inputs of all lanes, as `inputs_of` does, to ``self.u``."""
        if not self.input_count:
            return
        f, u = self.f, self._lane_u
        times = f.coerce(time, self.type)
        for lane in range(self.lanes):
            self.inputs_of(lane, f.lane(times, lane), u, rates=rates)
            for i in f.each((1 + rates) * self.input_count):
                self.u.cast(DOUBLE)[f.coerce(i, INT) * self.lanes + lane] = u[i]

    def rate(self, time: Operand, x: Array, out: Array) -> None:
        """Emit code that writes dx/dt at the states ``x`` to ``out``.

        The code first sets the open inputs to their values at ``time``.
        """
        self.set_inputs(time)
        pointers = (array.pointer for array in (x, self.d, self.u, self.c, out))
        self.f.call(self.derivatives, self.f.coerce(time, self.type), *pointers)

    def second_rate(self, time: Operand, x: Array, out: Array) -> None:
        """Emit code that writes dx/dt and then d²x/dt² at the states ``x`` to ``out``.

        The code first sets the open inputs and their rates to their values at ``time``.
        """
        self.set_inputs(time, rates=True)
        make = partial(define_second_derivatives, self.f.module, self.program, self.lanes)
        function = self.f.module.shared("second_derivatives", make)
        pointers = (array.pointer for array in (x, self.d, self.u, self.c, out))
        self.f.call(function, self.f.coerce(time, self.type), *pointers)

    def linear(
        self, entries: Sequence[tuple[int, int]], time: Operand, x: Array, out: Array
    ) -> None:
        """Emit code that calls the function of `define_linear` at the states ``x``.

        The code first sets the open inputs to their values at ``time``. ``entries`` is an argument
        of `define_linear`.
        """
        self.set_inputs(time, rates=bool(self.program.by_time))
        make = partial(define_linear, self.f.module, self.program, self.lanes, entries)
        function = self.f.module.shared("linear", make)
        pointers = (array.pointer for array in (x, self.d, self.u, self.c, out))
        self.f.call(function, self.f.coerce(time, self.type), *pointers)

    def tick(self, number: Value, start: Value, end: Value, step: Value, running: Value) -> Tick:
        """Return the `Tick` from which an integrator emits the tick ``number`` of this model."""
        report = partial(self._report, number)
        x, size = self.x, self.program.size
        tick = Tick(self.f, size, self.type, start, end, x, running, self.rate, step, report)
        second_rate = self.second_rate if self.program.second_derivatives else None
        return replace(tick, number=number, second_rate=second_rate)

    def _report(self, number: Value, lanes: Value, step: Sequence[Array]) -> None:
        """Emit code that logs the step of tick ``number``, which may be unstable, in ``lanes``.

        ``step``: ratio, start, end, h and x of the step, see `Report`. The log also gets the
        discrete states and the inputs at the end of the tick.
        """
        f = self.f
        flags = f.array(1, INT.of(self.lanes))
        flags[0] = f.flags(lanes)
        arrays = [flags, *step]
        for values, count in ((self.d, self.discrete_count), (self.u, self.input_count)):
            arrays.append(f.array(count, self.type))  # LLVM keeps a state whose memory no call sees
            for i in f.each(count):
                arrays[-1][i] = values[i]
        arrays += [self._windows, self._suspects]
        f.call(self._log, number, *(array.pointer for array in arrays))

    def instant(
        self, groups: Sequence[Group], storage: _Requested, memory: Sequence[Array] | None = None
    ) -> None:
        """Emit code that computes groups of nodes at one time: see `Printer.emit_groups`."""
        self.set_inputs(storage.time)
        Printer(self.f, self.program, storage, memory=memory).emit_groups(groups)

    def record(self, columns: Array, count: Value, record: Array, rows: Value, row: Value) -> None:
        """Emit code that copies output elements to one row of each lane's record.

        ``columns``: indices of the ``count`` recorded elements; ``rows``: number of rows of a
        record; ``row``: index of the row.
        """
        f = self.f
        for column in f.loop(count):
            value = self.y[columns[column]]
            for lane in range(self.lanes):
                place = (count * lane + column) * rows + row
                record[place] = f.lane(value, lane)


class _Requested(Storage):
    """Sources and outputs of a model at one time, without updates.

    An output port is computed if the run requests it.
    """

    def __init__(self, time: Value, model: _Model, requested: Array, **more: Array) -> None:
        arrays = {"state": model.x, "discrete": model.d, "input": model.u, "constant": model.c}
        super().__init__(time, **arrays | more, output=model.y)
        self.requested = requested

    def condition(self, condition: tuple[str, int]) -> Value:
        return self.requested[condition[1]].differs(0)


def _define_log(module: Module, lanes: int, sizes: Sequence[int]) -> Function:
    """Define the emitted function ``log(number, flags, …, windows, suspects)``.

    The arguments in between are ratio, start, end, h, x (see `Report`), d and u. The function
    writes the tick ``number`` to ``suspects`` in each lane whose flag is not zero, if the ratio of
    the lane exceeds the ratios of all earlier ticks in the window. ``windows``, ``suspects``: see
    `RUN`. ``sizes``: numbers of elements of x, d and u.
    """
    step = ("ratio", "start", "end", "h", "x", "d", "u")
    vectors = dict(zip(step, (1, 1, 1, 1, *sizes), strict=True))
    names = ("flags", *vectors, "windows", "suspects")
    arguments = {"number": INT} | dict.fromkeys(names, POINTER)
    f = module.function("log", arguments, attributes="noinline cold")
    number = f.arguments["number"]
    # One step for each window, because a run that diverges has ever larger ratios, which would
    # replace the first step that was unstable, and with it the cause.
    windows, flags = (Array(f.arguments[name], INT) for name in ("windows", "flags"))
    arrays = {name: Array(f.arguments[name], DOUBLE) for name in (*vectors, "suspects")}
    for lane in f.loop(lanes):
        window = f.instruction(f"sdiv i64 {number.name}, {windows[lane].name}", INT)
        window = f.select(window < SUSPECTS, window, SUSPECTS - 1)
        place = f.coerce(lane, INT) * SUSPECTS + window
        row = arrays["suspects"].shifted(place * sum(vectors.values()))
        with f.when(flags[lane].differs(0)), f.when(arrays["ratio"][lane] > row[0]):
            first = 0
            for name, count in vectors.items():
                for i in f.loop(count):
                    row[f.coerce(i, INT) + first] = arrays[name][f.coerce(i, INT) * lanes + lane]
                first += count
    return f


# ------------------------------------------------------------------------------------- run


@dataclass(frozen=True)
class _Now:
    """Values of the emitted code in one pass of the time loop, which handles one tick."""

    number: Value
    """Number of the tick."""
    time: Value
    """Time of the tick in s."""
    present: Value
    """True in lanes that have begun, have not failed, and are not past their last tick."""
    running: Value
    """True in lanes that have begun, have not failed, and have not reached their last tick."""
    sampled: Value
    """True in lanes whose samples count here: where `present`, unless the run before had them."""


class _Events(_Requested):
    """Sources and results of the events at a tick, which are records, checks and discrete updates.

    A record or an update computes an output only if it is due. Each output that is stored is also
    checked: a run ends at an output that is not finite.
    """

    def __init__(
        self,
        time: Value,
        model: _Model,
        requested: Array,
        after: Array,
        fires: Sequence[Value],
        recording: Value,
    ) -> None:
        """Store values of the emitted code.

        ``requested``: whether each output is requested; ``after``: discrete states after the
        updates; ``fires``: whether each update is due; ``recording``: whether a record is due.
        """
        super().__init__(time, model, requested, after=after)
        self.f, self.type = model.f, model.type
        self.fires, self.recording = fires, recording
        self.margins: dict[int, Value] = {}
        self.checks = [self.f.variable(self.f.constant(0.0, self.type)) for _ in range(_CHECKS)]
        """Each sum is NaN in a lane where an output is not finite, else 0."""

    def condition(self, condition: tuple[str, int]) -> Value:
        kind, index = condition
        if kind == "update":
            return self.fires[index]
        return super().condition(condition) & self.recording

    def store(self, place: Place, value: Operand) -> None:
        kind, index = place
        if kind == "margin":
            self.margins[index] = self.f.coerce(value, self.type)
            return
        super().store(place, value)
        if kind == "output":
            check = self.checks[index % _CHECKS]
            check.set(self.f.fma(value, 0.0, check.get()))


class _GivenTimes:
    """Emits code for the records at given times: it finds them, and keeps the steps around them."""

    def __init__(self, model: _Model, arguments: _Arguments) -> None:
        self.f, self.size, self._x = model.f, model.program.size, model.x
        self.times, self._ticks = arguments.array("times", DOUBLE), arguments.array("time_ticks")
        self._count, self._steps = arguments["rows"], arguments.array("steps", model.type)
        self._first, self._end = (self.f.variable(arguments["row"]) for _ in range(2))

    def find(self, tick: Value) -> None:
        """Emit the search for the times that lie in the tick with the number ``tick``."""
        self._first.set(self._end.get())
        with self.f.forever() as loop:
            row = self._end.get()
            loop.stop_if(row >= self._count)
            loop.stop_if(self._ticks[row] > tick)
            self._end.set(row + 1)

    def rows(self) -> Iterator[tuple[Value, Array]]:
        """Emit a loop over the times in the tick: yield the row and its kept step once."""
        first = self._first.get()
        for number in self.f.loop(self._end.get() - first):
            n = self.f.coerce(number, INT)
            yield first + n, self._steps.shifted(n * (2 + 2 * self.size))

    def keep(self, begin: Value, h: Value, end: Array, lanes: Value) -> None:
        """Emit code that keeps the step, in ``lanes``, for each time after ``begin``: see `Keep`.

        The next step replaces the kept step for the times after the end of this step.
        """
        f, x, type_ = self.f, self._x, self._x.type
        for row, kept in self.rows():
            due = f.coerce(lanes & (self.times[row] > begin), BOOL.of(type_.lanes))
            with f.when(f.any_lane(due)):
                kept[0], kept[1] = f.select(due, begin, kept[0]), f.select(due, h, kept[1])
                for i in f.each(self.size):
                    at_start, at_end = f.coerce(i, INT) + 2, f.coerce(i, INT) + (2 + self.size)
                    kept[at_start] = f.select(due, x[i], kept[at_start])
                    kept[at_end] = f.select(due, end[i], kept[at_end])


class _Run:
    """Emits the function ``run``, which advances each lane from tick ``first`` to its last tick.

    As in Drake, all events at a time see the states before these events. The next call of ``run``
    makes the discrete updates at the last tick.
    """

    def __init__(
        self, module: Module, program: Program, integrator: str, lanes: int, given_times: bool
    ) -> None:
        self.f = f = module.function("run", {"arguments": POINTER}, internal=False)
        self.program, self.integrator, self.lanes = program, integrator, lanes
        self.arguments = a = _Arguments(f, RUN)
        self.model = _Model(f, program, lanes, a)
        self.given = _GivenTimes(self.model, a) if given_times else None
        self.mask = BOOL.of(lanes)
        self.alive = f.variable(f.constant(1, self.mask))
        self.after = f.array(self.model.discrete_count, self.model.type)
        self.status = a.array("status")
        self.model.y[self.model.output_count] = 0.0
        self._reduce = define_reduce(module, self.model.type, RUN)
        self._present = f.array(1, INT.of(lanes))
        if integrator == "exact_hold" and program.size:
            self._prepare_hold()
        if integrator == "rosenbrock" and program.size:
            self._prepare_rosenbrock()

    def _prepare_hold(self) -> None:
        f, a, program = self.f, self.arguments, self.program
        self._lane_c = a.array("lane_c", DOUBLE)
        self._choose_slot = jacobian_slots.define_choose_slot(f.module, program.size)
        self._jacobian = define_jacobian(f.module, program)
        sizes = (program.size, self.model.discrete_count, self.model.input_count)
        self._lane_x, self._lane_d, self._lane_u = (f.array(size) for size in sizes)
        memory, shared = a.array("memory", DOUBLE), a.array("shared", DOUBLE)
        self.hold = exact_hold.ExactHold(
            a["tick"], a["tolerance"], memory, shared, self._choose_jacobian
        )

    def _prepare_rosenbrock(self) -> None:
        a, program = self.arguments, self.program
        elimination = Elimination(program.jacobian_rows, len(RODAS.nodes))
        self.rosenbrock = Rosenbrock(
            self.model.type,
            elimination,
            partial(self.model.linear, elimination.entries),
            bool(program.by_time),
            a["tick"],
            a["tolerance"],
            a.array("shared", self.model.type),
        )

    def _choose_jacobian(self, tick: Tick, lane: Value, memory: Array, time: Value) -> None:
        """Emit code that chooses the Jacobian of one lane: see `exact_hold.ChooseSlot`."""
        f, model = self.f, self.model
        x, d, u = self._lane_x, self._lane_d, self._lane_u
        for values, single, count in (
            (model.x, x, self.program.size),
            (model.d, d, model.discrete_count),
        ):
            spilled = f.array(count, model.type)
            for i in f.each(count):
                spilled[i] = values[i]
            for i in f.loop(count):
                single[i] = spilled.cast(DOUBLE)[f.coerce(i, INT) * self.lanes + lane]
        model.inputs_of(lane, time, u)
        c = self._lane_c.address(lane * len(self.program.hoisted))
        candidate = memory.address(jacobian_slots.Memory(tick.size).candidate)
        f.call(self._jacobian, time, x.pointer, d.pointer, u.pointer, c, candidate)
        f.call(self._choose_slot, x.pointer, memory.pointer)

    def trace(self) -> None:
        """Emit all instructions of the function ``run``."""
        f, a, model = self.f, self.arguments, self.model
        outer_x, outer_d = a.array("x", model.type), a.array("d", model.type)
        for i in f.each(self.program.size):
            model.x[i] = outer_x[i]
        for i in f.each(model.discrete_count):
            model.d[i] = outer_d[i]
        ends = a.array("last", INT.of(self.lanes))[0]
        begins = a.array("begins_of_lanes", INT.of(self.lanes))[0]
        number, clock = f.variable(a["first"]), _Clock(f, a, a["first"])
        row, snapshot = f.variable(a["row"]), f.variable(f.constant(0, INT))
        if self.lanes == 1:
            self._store_snapshot(snapshot, a["first"] - 1)
        if self.given is not None:
            self.given.find(a["first"] - 1)
            self._record_given(self.given, None)
        with f.forever() as loop:
            k = number.get()
            loop.stop_if(k > a["longest"])
            time = clock.time()
            ticks = f.coerce(k, INT.of(self.lanes))
            begun = self.alive.get() & (ticks >= begins)
            present, running = begun & (ticks <= ends), begun & (ticks < ends)
            now = _Now(k, time, present, running, present & (ticks > begins))
            self._events(now, row)
            if self.lanes == 1:
                self._store_snapshot(snapshot, k)
            alive = self.alive.get()
            loop.stop_if(~f.any_lane(alive & (ticks < ends)))
            clock.advance()
            running = alive & running
            tick = model.tick(k, time, clock.time(), a["step"], running)
            if self.given is not None:
                self.given.find(k)
                tick = replace(tick, keep=self.given.keep)
            if self.program.size:
                self._advance(replace(now, running=running), tick)
            if self.given is not None:
                tick = replace(tick, running=running & self.alive.get())
                self._record_given(self.given, tick)
            loop.stop_if(~f.any_lane(self.alive.get()))
            number.set(k + 1)
        for i in f.each(self.program.size):
            outer_x[i] = model.x[i]
        for i in f.each(model.discrete_count):
            outer_d[i] = model.d[i]

    def _store_snapshot(self, snapshot: Variable, tick: Value) -> None:
        """Emit code that stores the states as a snapshot, if the next snapshot is due at ``tick``.

        ``snapshot``: variable with the index of the next snapshot.
        """
        f, a, model = self.f, self.arguments, self.model
        ticks, number = a.array("snapshots"), snapshot.get()
        with f.when(number < a["snapshot_count"]), f.when(ticks[number].equals(tick)):
            for name, values, count in model.states:
                memory = a.array(name, DOUBLE).shifted(number * count)
                for i in f.each(count):
                    memory[i] = values[i]
            snapshot.set(number + 1)

    def _events(self, now: _Now, row: Variable) -> None:
        """Emit the records, checks and discrete updates of a tick.

        The code runs if a record or an update is due. ``row``: variable with the next row's index.
        """
        f, a, model, program = self.f, self.arguments, self.model, self.program
        recording = (now.number % a["record_every"]).equals(0) & (row.get() < a["rows"])
        if self.given is not None:
            recording = f.constant(0, BOOL)
        going = f.any_lane(now.running)
        periods, offsets = a.array("periods"), a.array("offsets")
        fires = []
        firing = f.constant(0, BOOL)
        for number in range(len(program.equations.updates)):
            since = now.number - offsets[number]
            # One condition for all lanes, which are at the same tick. So a lane that has ended
            # waits, and does not begin another run.
            fires.append(going & (since >= 0) & (since % periods[number]).equals(0))
            firing = firing | fires[number]
        requested, columns = a.array("requested", BYTE), a.array("columns")
        storage = _Events(now.time, model, requested, self.after, fires, recording)
        with f.when(recording | firing):
            if len(fires) > 1:  # a single update writes all discrete states
                for i in f.each(model.discrete_count):
                    self.after[i] = model.d[i]
            model.instant(program.groups, storage, self._memory())
            with f.when(recording):
                record = a.array("record", DOUBLE)
                model.record(columns, a["column_count"], record, a["rows"], row.get())
                with f.when(row.get() >= a["unseen"]):
                    self._present[0] = f.flags(now.sampled)
                    pointers = f.arguments["arguments"], model.y.pointer
                    f.call(self._reduce, *pointers, row.get(), self._present.pointer)
                row.set(row.get() + 1)
            # At the last tick of a run margins only count if the tick is recorded.
            checked = now.running | (now.present & recording)
            for index, margin in storage.margins.items():
                self._fail(checked & ~(margin >= 0.0), OUTSIDE, now.number, index)
            check_sum = storage.checks[0].get()
            for check in storage.checks[1:]:
                check_sum = check_sum + check.get()
            not_finite = now.present & self.alive.get() & check_sum.differs(0.0)
            self._fail(not_finite, OUTPUT_NOT_FINITE, now.number)
            with f.when(f.any_lane(not_finite), rare=True):
                self._store_bad_output(not_finite, columns)
            running = now.running & self.alive.get()
            with f.when(firing & f.any_lane(running)):
                for i in f.each(model.discrete_count):
                    before = model.d[i]
                    model.d[i] = self.after[i]
                    if self.lanes > 1:
                        model.d[i] = f.select(running, self.after[i], before)

    def _store_bad_output(self, lanes: Value, columns: Array) -> None:
        """Emit code that stores, for each of ``lanes``, the first output that is not finite."""
        f, values, count = self.f, self.model.y.cast(DOUBLE), self.arguments["checked_count"]
        flags = f.array(self.lanes, INT)
        flags.cast(INT.of(self.lanes))[0] = f.flags(lanes)
        for lane in f.loop(self.lanes):
            with f.when(flags[lane].differs(0)):
                for n in f.loop(count):
                    column = columns[count - 1 - n]
                    value = values[column * self.lanes + lane]
                    with f.when((value - value).differs(0.0)):
                        self.status[f.coerce(lane, INT) * 3 + 2] = column

    def _memory(self) -> list[Array]:
        """Return two arrays for each `Memo` in turn: tags and values of its look-up table."""
        tags, values = (self.arguments.array(name, DOUBLE) for name in ("tags", "values"))
        memory = []
        first = 0
        for number, memo in enumerate(self.program.memos):
            lines = MEMO_LINES * self.lanes
            memory += [tags.shifted(number * lines), values.shifted(first * lines)]
            first += len(memo.nodes)
        return memory

    def _fail(self, lanes: Value, code: int, tick: Value, index: Operand = 0) -> None:
        """Emit code that ends the runs in ``lanes``, and sets their status (code, tick, index).

        ``index``: one number for all lanes, or a value with a number for each lane.
        """
        f = self.f
        with f.when(f.any_lane(lanes), rare=True):
            for lane in range(self.lanes):
                with f.when(f.lane(lanes, lane)):
                    self.status[3 * lane] = code
                    self.status[3 * lane + 1] = tick
                    status = f.lane(index, lane) if isinstance(index, Value) else index
                    self.status[3 * lane + 2] = status
            self.alive.set(self.alive.get() & ~lanes)

    def _record_given(self, given: _GivenTimes, tick: Tick | None) -> None:
        """Emit code that records at the given times in a tick, which the run has just made.

        None stands for the times at the start of the run, before the events there.
        """
        f, a, model = self.f, self.arguments, self.model
        columns, requested = a.array("columns"), a.array("requested", BYTE)
        groups = [group for group in self.program.groups if group.condition[0] == "requested"]
        x = model.x
        for row, step in given.rows():
            time = given.times[row]
            if tick is not None and self.program.size:
                x = f.array(self.program.size, model.type)
                self._inside(tick, step, time, x)
                for i in f.each(self.program.size):  # a record at the end has the bits of the end
                    x[i] = f.select(time >= tick.end, model.x[i], x[i])
            model.instant(groups, _Requested(time, model, requested, state=x), self._memory())
            model.record(columns, a["column_count"], a.array("record", DOUBLE), a["rows"], row)

    def _inside(self, tick: Tick, step: Array, time: Value, out: Array) -> None:
        """Emit code that writes the states at a time within a step to ``out``.

        ``step`` holds the step as `_GivenTimes.keep` stores it. The exact hold solves its linear
        part. The other methods make a shorter step from the same start.
        """
        if self.integrator == "exact_hold":
            self.hold.inside(tick, step, time, out)
            return
        f, size, begin = self.f, self.program.size, step[0]
        for i in f.each(size):
            out[i] = step[f.coerce(i, INT) + 2]
        every = f.constant(1, self.mask)
        within = Tick(f, size, tick.type, begin, time, out, every, tick.rate, tick.step)
        if self.integrator == "rosenbrock":
            method, substep = copy(self.rosenbrock), f.array(1, tick.type)
            method.tick_s, method.substeps = f.coerce(time, tick.type) - begin, substep
            substep[0] = 0.0
            method.advance(within)
            return
        # The steps of a Runge-Kutta method are the same in all lanes.
        advance = advance_rk4 if self.integrator == "rk4" else advance_runge_kutta3
        advance(replace(within, start=f.lane(begin, 0)))

    def _advance(self, now: _Now, tick: Tick) -> None:
        f, a, model = self.f, self.arguments, self.model
        rough = stiff = None
        if self.integrator == "exact_hold":
            with f.when(now.number.equals(a["first"])):
                self.hold.prepare(tick)
            rough, stiff = self.hold.advance(tick)
        elif self.integrator == "rosenbrock":
            stuck = self.rosenbrock.advance(tick)
            with f.when(f.any_lane(stuck.lanes), rare=True):
                index = self._worst(stuck.errors)
                self._fail(stuck.lanes, TOO_MANY_SUBSTEPS, now.number, index)
        elif self.integrator == "rk4":
            advance_rk4(tick)
        else:
            advance_runge_kutta3(tick)
        # x · 0 is not 0 if x is not finite.
        check_sum = f.variable(f.constant(0.0, model.type))
        for i in f.each(self.program.size):
            check_sum.set(f.fma(model.x[i], 0.0, check_sum.get()))
        self._fail(now.running & check_sum.get().differs(0.0), NOT_FINITE, now.number + 1)
        if rough is not None and stiff is not None:
            index = f.select(stiff, f.constant(1, INT.of(self.lanes)), 0)
            self._fail(rough & self.alive.get(), TOO_ROUGH, now.number, index)

    def _worst(self, errors: Array) -> Value:
        """Emit the index of the state with the worst error in each lane: a nan, or the largest."""
        f = self.f
        worst = f.variable(f.constant(0.0, errors.type))
        index = f.variable(f.constant(0, INT.of(self.lanes)))
        for i in f.each(self.program.size):
            error, state = errors[i], f.coerce(f.coerce(i, INT), INT.of(self.lanes))
            worse = (error > worst.get()) | error.differs(error)
            worst.set(f.select(worse, error, worst.get()))
            index.set(f.select(worse, state, index.get()))
        return index.get()
