"""Calls the machine code of a model to make runs, one run in each lane."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..reductions import Reduction
from ..rosenbrock import TOLERANCE_RANGES, TOLERANCES
from ..run_data import Array, InputTable, Integers, ResumableState, State
from . import exact_hold, jacobian_slots
from .arguments import DOUBLES, INPUT, INTEGRATORS, MEMO_LINES, OK, RUN, SUSPECTS
from .machine_code import MachineCode
from .reductions import Reducer
from .stability import Rates, UnstableStep, unstable_step
from .timing import timing

STEP_S = 2e-4
"""Default step of the integrators ``rk4`` and ``runge_kutta3`` in s.

With it RK4 is wrong by 7e-10 of the stroke of the knee's rod, and by 3e-9 with the weight of the
shank, in 30 s (``benchmarks/compare.py``).
"""

ROUGH_STEP_S = 2e-5
"""Step of RK4 in s.

RK4 repeats runs that miss the tolerance of the exact hold.
With this step RK4 is accurate up to modes of 1e4 1/s, where h |λ| is 0.2, and stable up to
1.3e5 1/s. Valves can be faster: `unstable_step` then says which step works.
"""

LONGEST_TICK_S = 2e-3
"""Longest tick of the exact hold in s. A longer time between two events is divided into ticks.

The exact hold evaluates the derivatives at the start, the middle and the end of a tick. An input
with a period of half a tick has the same value at these points, so it would look constant. 2 ms is
a choice: the sample time of the paper's controller, whose runs therefore have one tick a sample. An
input with a period of 1 ms can still look constant.
"""

TOLERANCE = 1e-8
"""Default tolerance of the exact hold: error of a state x in one step, divided by 1 + |x|.

With 1e-7 some runs read another count of the encoder (``benchmarks/tolerance.py``). With 1e-9 the
full order takes four times as long.

The 1 makes the tolerance absolute for states below 1. So give a state a unit in which it is of
order one: the knee has pressures in MPa and motor speeds in krad/s.
"""

PIECE_S = 0.2
"""Intended duration in s of one call of the machine code. Ctrl-C ends a run between two calls."""

_FIRST_PIECE = 160_000  # steps; a run of 30 s with the default step is a single piece


def address(array: NDArray[Any]) -> int:
    """Return the memory address of the first element of a contiguous array."""
    return int(array.__array_interface__["data"][0])


def element_name(port: str, element: int, size: int) -> str:
    """Return ``port[element]``, the name of an element; ``port`` if the port has one element."""
    return f"{port}[{element}]" if size > 1 else port


def output_elements(sizes: Mapping[str, int]) -> list[tuple[str, str]]:
    """Return, for each element of the outputs in order, its name and the name of its port.

    ``sizes`` maps the name of a port to its number of elements.
    """
    return [
        (element_name(port, index, size), port)
        for port, size in sizes.items()
        for index in range(size)
    ]


@dataclass(frozen=True)
class Snapshots:
    """Ticks (n,) at which a run stores its states, and memory for the stored states.

    ``x`` (n, continuous states) and ``d`` (n, discrete states) are the states after the events at
    the tick. The tick -1 stands for the states before the events at tick 0.
    """

    ticks: Integers
    x: Array
    d: Array

    def after(self, first: int) -> Snapshots:
        """Return the snapshots at the tick ``first`` and later; all snapshots if ``first`` is 0."""
        start = int(np.searchsorted(self.ticks, first)) if first else 0
        return Snapshots(self.ticks[start:], self.x[start:], self.d[start:])


@dataclass(frozen=True)
class GivenTimes:
    """Times of records ``times`` (rows,) in s, ascending, and the last tick before each time.

    Ticks are -1 for records at the start. Such a record has the states before the events there.
    """

    times: Array
    ticks: Integers


_NEVER = 2**62  # a row that no run reaches


class Runner:
    """Machine code of a model with one integrator, and the memory that the code works on.

    The memory keeps the step and the Jacobians of each lane from one call to the next.
    """

    def __init__(
        self,
        code: MachineCode,
        *,
        lanes: int = 1,
        outputs: Sequence[str] | None = None,
        record_period_s: float | None = None,
        integrator: str = "exact_hold",
        step_s: float = STEP_S,
        tolerance: float | None = None,
        reductions: Sequence[Reduction] = (),
        given_times: bool = False,
    ) -> None:
        """Check the arguments, which `CompiledModel.simulate` explains, and get the machine code.

        `CompiledModel.simulate_batch` explains ``reductions``. ``given_times``: whether the runs
        record at given times in place of a record period. Raises `ValueError` for an unknown
        output or integrator, for a step or a record period that is not finite and positive, and
        for a tolerance that the integrator does not allow.
        """
        if integrator not in INTEGRATORS:
            raise ValueError(
                f"integrator = {integrator!r}: must be one of {', '.join(INTEGRATORS)}"
            )
        least, most = 0.0, math.inf
        default = TOLERANCE
        if integrator == "rosenbrock":
            (least, most), default = TOLERANCE_RANGES["double"], TOLERANCES["double"]
        tolerance = default if tolerance is None else tolerance
        for name, value in (("step_s", step_s), ("tolerance", tolerance)):
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} = {value}: must be finite and > 0")
        if not least <= tolerance <= most:
            raise ValueError(
                f"tolerance = {tolerance:g}: must be in {least:g} … {most:g} for {integrator}"
            )
        layout = code.layout
        self.sizes = sizes = dict(layout.outputs)
        """Dictionary from the name of each output port of the model to its number of elements."""
        for name in outputs or ():
            if name not in sizes:
                raise ValueError(f"output {name!r} is unknown; known: {', '.join(sizes)}")
        self.names = tuple(sizes) if outputs is None else tuple(outputs)
        """Names of the output ports that are recorded."""
        self.code, self.lanes, self.integrator = code, lanes, integrator
        longest = LONGEST_TICK_S if integrator == "exact_hold" else math.inf
        self.timing = timing(layout.periods, record_period_s, longest)
        elements = output_elements(sizes)
        self.reducer = Reducer(reductions, {e: n for n, (e, _) in enumerate(elements)}, lanes)
        """Memory for the reductions of the runs."""

        def columns_of(ports: Iterable[str]) -> Integers:
            columns = [n for port in ports for n, (_, p) in enumerate(elements) if p == port]
            return np.array(columns, dtype=np.int64)

        self.columns = columns_of(self.names)
        """Indices of the recorded elements among the elements of all outputs."""
        used = {elements[n][1] for n in self.reducer.used}
        self._checked = columns_of((*self.names, *sorted(used.difference(self.names))))
        ports = used.union(self.names)
        self._requested = np.array([name in ports for name in sizes], dtype=np.uint8)
        controlled = integrator in ("exact_hold", "rosenbrock")
        # An integrator that controls its error counts as ten steps a tick, so that
        # 30 s with ticks of 2 ms are a single piece.
        steps = 10.0 if controlled else max(1.0, self.timing.tick / step_s)
        self.piece = max(1, int(_FIRST_PIECE / steps))
        """Number of ticks that the first machine-code call of a long run makes."""
        self._run = code.run_function(integrator, lanes, given_times)
        self._constants = code.start_function("constants")
        self._lane_c = np.empty((lanes, layout.constants))
        self._c = np.empty((layout.constants, lanes))
        self._at = memory = jacobian_slots.Memory(len(layout.states))
        self._memory = np.empty((lanes, memory.size))
        shared = exact_hold.Shared(len(layout.states))
        self._shared = np.empty(shared.size * lanes)
        # What decides the next step of each lane; a view.
        self._steps = self._shared[: shared.head * lanes].reshape(-1, lanes)
        self._begins = np.full(lanes, -1, dtype=np.int64)
        solver = integrator, step_s, tolerance
        self.settings: tuple[Any, ...] = (
            code.key,
            self.names,
            self.timing.tick,
            self.timing.record_every,
            *solver,
        )
        self.settings += tuple(replace(item, after_s=0.0, bound=0.0) for item in reductions)
        """What a run and the run that goes on from its end have in common."""
        self._tags = np.empty(len(layout.memos) * MEMO_LINES * lanes)
        self._values = np.empty(sum(layout.memos) * MEMO_LINES * lanes)
        self._status = np.zeros((lanes, 3), dtype=np.int64)
        self._inputs = np.zeros((lanes, len(INPUT)), dtype=np.int64)
        self._windows = np.full(lanes, _NEVER, dtype=np.int64)
        self._vectors = len(layout.states), len(layout.discrete)
        self._suspects = np.zeros((lanes, SUSPECTS, 4 + sum(self._vectors) + layout.input_count))
        self._has_inputs = bool(layout.inputs)
        self._arguments = _arguments(
            RUN,
            c=self._c,
            lane_c=self._lane_c,
            inputs=self._inputs,
            tick=self.timing.tick,
            unit=self.timing.unit,
            split=self.timing.split,
            periods=self.timing.periods,
            offsets=self.timing.offsets,
            requested=self._requested,
            columns=self._checked,
            column_count=self.columns.size,
            checked_count=self._checked.size,
            reductions=self.reducer.table,
            reduction_ends=self.reducer.ends,
            begins=self.reducer.begins,
            bounds=self.reducer.bounds,
            reduced=self.reducer.values,
            memory=self._memory,
            shared=self._shared,
            tags=self._tags,
            values=self._values,
            status=self._status,
            step=step_s,
            tolerance=tolerance,
            windows=self._windows,
            suspects=self._suspects,
            begins_of_lanes=self._begins,
        )
        self._address = ctypes.addressof(self._arguments)

    def restart(self, parameters: Array, last: Integers | None = None) -> Runner:
        """Prepare new runs with these parameters (lanes, parameters); return this runner.

        The method clears what belongs to the runs before: Jacobians, look-up tables, and the log of
        suspected steps. The log keeps one step for each of `SUSPECTS` windows of equal length, into
        which a run is divided. ``last`` (lanes,) has the last tick of each run. None: one window
        covers all ticks.
        """
        self._windows[:] = _NEVER if last is None else last // SUSPECTS + 1
        self._suspects[:, :, 0] = 0.0
        for lane, row in enumerate(np.ascontiguousarray(parameters, dtype=float)):
            self._constants(address(row), address(self._lane_c[lane]))
        self._c[:] = self._lane_c.T
        self._memory[:, : self._at.head] = 0.0
        self._steps[:] = 0.0
        self._begins[:] = -1
        self._tags.fill(np.nan)  # equals no whole number, so that all rows are empty
        return self

    def resume(self, states: Sequence[State]) -> int:
        """Put back what belongs to the states of all lanes after `restart`.

        Return the first tick of all lanes.
        """
        for lane, state in enumerate(states):
            if isinstance(state, ResumableState):
                self._memory[lane, : state.memory.size] = state.memory
                self._steps[:, lane] = state.shared
                self.reducer.values[:, :, lane] = state.reduced
                self._begins[lane] = state.tick
        return max(0, int(self._begins.min()))

    def resumable(self, lane: int, state: State, tick: int, record: Array) -> ResumableState:
        """Return the state of a lane at the end of its run, with the memory of the integrator.

        ``tick``: last tick of the run; ``record`` (columns, rows): records of the run.
        """
        memory = self._memory[lane]
        # The slots that hold no Jacobian are left out.
        slots = int(memory[self._at.filled : self._at.filled + 1].view(np.int64)[0])
        return ResumableState(
            state.continuous,
            state.discrete,
            tick,
            self.settings,
            memory[: self._at.slots + slots * self._at.slot_size].copy(),
            self._steps[:, lane].copy(),
            self.reducer.values[:, :, lane].copy(),
            record,
        )

    def run(
        self,
        x: Array,
        d: Array,
        first: int,
        last: Integers,
        inputs: Sequence[InputTable],
        record: Array | None = None,
        snapshots: Snapshots | None = None,
        cancelled: Callable[[], bool] = lambda: False,
        given: GivenTimes | None = None,
    ) -> Integers:
        """Advance the states of each lane from tick ``first`` to the last tick of the lane.

        A long run is split into several calls of the machine code, so that Ctrl-C can end the run.
        The split does not change the bits of the results.

        Parameters
        ----------
        x, d
            Continuous states (states, lanes) and discrete states (discrete states, lanes). The
            method changes these arrays in place.
        first, last
            Number of the first tick, and number of the last tick of each lane, (lanes,).
        inputs
            Open inputs of each lane.
        record
            Memory for the records (lanes, columns, rows). If the first tick is the last tick, the
            run records this tick.
        snapshots
            Ticks at which the states are stored, and memory for them; with a single lane only.
        cancelled
            Called between two calls of the machine code; if it returns True, the run ends with
            `KeyboardInterrupt`.
        given
            Times of the records of all lanes, if the runs record at given times.

        Returns the status (lanes, 3): for each lane the outcome, the tick at which the run failed,
        and the index of the limit that stopped the run or of the output that is not finite.
        """
        longest, ends, unseen = int(last.max()), np.empty_like(last), 0
        every = self.timing.record_every
        rows = 0 if record is None else record.shape[2]
        status = np.zeros_like(self._status)
        piece = self.piece
        while True:
            until = min(first + piece, longest)
            np.minimum(last, until, out=ends)
            ends[status[:, 0] != OK] = -1  # a failed lane makes no tick
            self.bind(x, d, ends, record, snapshots and snapshots.after(first), given)
            begin = perf_counter()
            row = -(-first // every)  # -(-a // b) rounds up
            if given is not None:
                row = int(np.searchsorted(given.ticks, first)) if first else 0
            # A record at the last tick of a call is made again by the next call.
            outcome = self.call_once(first, until, rows, inputs, row, unseen)
            unseen = until // every + 1
            failed = outcome[:, 0] != OK
            status[failed] = outcome[failed]
            if not (last[status[:, 0] == OK] > until).any():
                return status
            if cancelled():
                raise KeyboardInterrupt
            elapsed_s = perf_counter() - begin
            # The size at most doubles from one call to the next: at half of the intended duration
            # the quotient below is 2 too. Doubling is a choice. It costs some more calls at the
            # start of a long run.
            if elapsed_s < 0.5 * PIECE_S:
                piece = 2 * piece
            else:
                piece = max(1, int(piece * PIECE_S / elapsed_s))
            first = until

    def bind(
        self,
        x: Array,
        d: Array,
        last: Integers,
        record: Array | None,
        snapshots: Snapshots | None = None,
        given: GivenTimes | None = None,
    ) -> None:
        """Set the arrays that the next calls of `call_once` read and write: see `run`.

        A caller of many short runs binds its arrays once, and then changes only their content.
        """
        arrays = {"x": x, "d": d, "last": last}
        if snapshots is not None:
            arrays |= {
                "snapshots": snapshots.ticks,
                "snapshot_x": snapshots.x,
                "snapshot_d": snapshots.d,
            }
        if given is not None:
            most = int(np.unique(given.ticks, return_counts=True)[1].max(initial=0))
            steps = np.empty((most, 2 + 2 * self._vectors[0], self.lanes))
            arrays |= {"times": given.times, "time_ticks": given.ticks, "steps": steps}
        _set(self._arguments, **arrays)
        self._arguments.snapshot_count = 0 if snapshots is None else snapshots.ticks.size
        self._bound = arrays  # the arrays must live as long as their addresses
        if record is not None:  # which the caller keeps
            _set(self._arguments, record=record)

    def call_once(
        self,
        first: int,
        longest: int,
        rows: int,
        inputs: Sequence[InputTable],
        row: int = 0,
        unseen: int = 0,
    ) -> Integers:
        """Call the machine code once, with the arrays of `bind`.

        ``first``: first tick; ``longest``: largest last tick of all lanes; ``rows``: number of rows
        of the record; ``row``: first row to write; ``unseen``: first row to reduce. Returns the
        status as `run` does, in an array that the next call overwrites.
        """
        if self._has_inputs:
            self._inputs[:] = [_input_argument(table) for table in inputs]
        self._status.fill(0)
        arguments = self._arguments
        arguments.first, arguments.longest, arguments.rows = first, longest, rows
        arguments.record_every = self.timing.record_every if first < longest else 1
        arguments.row, arguments.unseen = row, unseen if self.reducer.used else _NEVER
        self._run(self._address)
        return self._status

    def unstable_step(self, lane: int) -> UnstableStep | None:
        """Return the first step since `restart` that was too long for a mode of the model, or None.

        ``lane``: the lane of the run.
        """
        suspects = self._suspects[lane, self._suspects[lane, :, 0] > 0.0]
        if not suspects.size:
            return None
        return unstable_step(self.integrator, self._rates(lane), suspects, self._vectors)

    def fastest_per_s(self, snapshots: Snapshots, inputs: InputTable) -> float:
        """Return the largest |λ| in 1/s of the modes λ of a model at the snapshots of a run.

        The run has a single lane, and the open inputs ``inputs``.
        """
        rates, largest = self._rates(0), 0.0
        times = self.timing.times(np.maximum(snapshots.ticks, 0))
        for t, d, x in zip(times, snapshots.d, snapshots.x, strict=True):
            _, jacobian = rates(d, inputs.value(t), t, x)
            largest = max(largest, float(np.abs(np.linalg.eigvals(jacobian)).max(initial=0.0)))
        return largest

    def _rates(self, lane: int) -> Rates:
        """Return a Python function that calls the machine code of dx/dt and its Jacobian.

        The function has the parameters of the run in ``lane``: see `Rates`.
        """
        compute_rates, size, c = self.code.rates_function(), self._vectors[0], self._lane_c[lane]

        def rates(d: Array, u: Array, t: float, x: Array) -> tuple[Array, Array]:
            values, jacobian = np.empty(size), np.empty((size, size))
            arrays = np.array([t]), x, d, u, c, values, jacobian
            compute_rates(*map(address, arrays))
            return values, jacobian.T  # the machine code writes column by column

        return rates


def _input_argument(table: InputTable) -> tuple[int, ...]:
    """Return the numbers and addresses that describe an input table, in the order of `INPUT`."""
    breaks, coefficients = table.breaks, table.coefficients
    return breaks.size, address(breaks), coefficients.shape[2], address(coefficients)


@cache
def _structure(names: tuple[str, ...]) -> type[ctypes.Structure]:
    """Return a ctypes class with the fields ``names``. Each field has eight bytes."""
    fields = [(n, ctypes.c_double if n in DOUBLES else ctypes.c_int64) for n in names]
    return type("Arguments", (ctypes.Structure,), {"_fields_": fields})


def _arguments(names: tuple[str, ...], **values: Any) -> Any:
    arguments = _structure(names)()
    _set(arguments, **values)
    return arguments


def _set(arguments: Any, **values: Any) -> None:
    """Set fields of a ctypes structure; for an array, set the field to the array's address.

    The caller must keep the arrays alive as long as machine code uses the structure.
    """
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            assert value.flags.c_contiguous, name
            value = address(value)
        setattr(arguments, name, value)
