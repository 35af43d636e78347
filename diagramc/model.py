"""Compiled models: Drake diagrams as machine code, which runs with plain arrays."""

from __future__ import annotations

import math
import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from threading import Event, local
from typing import Any

import numpy as np

from .compiled_system import CompiledSystem
from .diagram_equations import DiagramEquations, read_diagram
from .equations.contexts import set_parameters
from .equations.equations import Equations
from .equations.tree import Node
from .errors import Error, ResultError, SimulationError
from .model_base import ContextAt, ModelBase, not_finite
from .native.arguments import NOT_FINITE, OK
from .native.buffers import RECORDS
from .native.cores import available_cores
from .native.llvm import LANES
from .native.machine_code import MachineCode
from .native.reductions import starts_and_bounds
from .native.runner import LONGEST_TICK_S, GivenTimes, Runner, Snapshots, output_elements
from .reductions import Reduction
from .run_data import Array, InputTable, Integers, ResumableState, State, slices

_MOST_RUNNERS = 2
"""Number of runners that a model keeps for its next single runs.

A run of 30 s then starts 0.3 ms sooner. A runner has memory for the records and Jacobians of a run.
"""


@dataclass(frozen=True, repr=False)
class Simulation:
    """The records of one run: times ``time_s`` (n,), outputs (n, size) by name, and final state.

    ``reduced`` (m,) has the values of the reductions that `CompiledModel.simulate_batch` computed.
    """

    time_s: Array
    outputs: dict[str, Array]
    final: State
    reduced: Array = field(default_factory=lambda: np.empty(0))

    def __getitem__(self, output: str) -> Array:
        """Return the records of the output port ``output``, (n, size).

        Raises `ResultError` if the run has not recorded this port.
        """
        if output not in self.outputs:
            raise ResultError(
                f"output {output!r}: was not recorded; recorded outputs: "
                f"{', '.join(self.outputs) or 'none'}"
            )
        return self.outputs[output]

    def __repr__(self) -> str:
        """Return a text with the number of records and the names of the recorded outputs."""
        return f"Simulation({self.time_s.size} records of {', '.join(self.outputs) or 'nothing'})"


@dataclass(frozen=True)
class _Batch:
    """Checked arguments of several runs of one model. Each field has one element for each run."""

    parameters: Array
    """Parameters of all runs, (runs, parameters)."""
    states: Sequence[State]
    ticks: Integers
    """Duration of each run in ticks."""
    inputs: Sequence[InputTable]
    begins: Integers
    """Row of the first sample of each reduction, (runs, reductions)."""
    bounds: Array
    """Bound of each reduction, (runs, reductions)."""
    rows: Integers
    """Number of records of each run."""
    given: GivenTimes | None
    """Given times of the records of all runs; a run has those up to its duration."""


class CompiledModel(ModelBase):
    """A diagram as machine code, made by `compile_diagram`.

    Parameters, initial state and inputs are arguments of each run. So all diagrams that differ only
    in numbers can share one compiled model. Runs do not call Drake, and they release the GIL.
    """

    def __init__(self, code: MachineCode, context_at: ContextAt | None = None) -> None:
        """Store the code, and the function that makes a Context for a leaf's ``check``."""
        super().__init__(code, context_at)
        self._runners: OrderedDict[Any, Runner] = OrderedDict()

    def __reduce__(self) -> tuple[type[CompiledModel], tuple[MachineCode]]:
        return CompiledModel, (self.code,)

    @contextmanager
    def _runner(self, **settings: Any) -> Iterator[Runner]:
        """Lend a runner with a single lane; keep the runner for a later run with equal settings.

        To make a runner, and to get fresh memory for it, takes a tenth of a run of 30 s.
        """
        key = tuple(sorted(settings.items()))
        runner = self._runners.pop(key, None) or Runner(self.code, **settings)
        yield runner
        self._runners[key] = runner
        if len(self._runners) > _MOST_RUNNERS:
            self._runners.popitem(last=False)

    def simulate(
        self,
        parameters: Array,
        state: State,
        duration_s: float,
        *,
        outputs: Sequence[str] | None = None,
        record_period_s: float | None = None,
        record_times_s: Sequence[float] | Array | None = None,
        inputs: InputTable | None = None,
        resumable: bool = False,
        **options: Any,
    ) -> Simulation:
        """Run the model from t = 0 and return the records. Each event occurs exactly at its time.

        Parameters
        ----------
        parameters
            Values of ``parameter_names``, in this order.
        state
            State at t = 0, after the initialization events: see `initialized`. If the state is the
            ``final`` state of a run with ``resumable``, the run goes on from the end of that run,
            and returns the same numbers, to the last bit, as a run from t = 0. The two runs must
            have the same outputs, record period, integrator and tolerance. Parameters and inputs
            may differ, if those of this run would not have changed the run before.
        duration_s
            Duration in s, counted from t = 0. The run ends at the last tick up to this time. If
            ``record_times_s`` has a time after that tick, the run ends one tick later.
        outputs
            Names of the output ports to record; all by default.
        record_period_s
            Time between two records in s, by default the shortest sample time. As in Drake's
            `VectorLogSink`, a record at t sees the state before the updates at t.
        record_times_s
            Ascending times of the records in s, in place of a record period. A record at a sample
            sees the state before the updates there. A record between two ticks comes from the step
            of the integrator around its time: ``exact_hold`` solves the linear part of the step,
            and the other integrators make a shorter step. The records do not change the run.
        integrator
            ``exact_hold`` is an exponential integrator whose error control uses ``tolerance``.
            ``rk4`` and ``runge_kutta3`` are Runge-Kutta integrators with steps of at most
            ``step_s``. ``runge_kutta3`` is the method of Drake's integrator with this name.
            ``rosenbrock`` is the method of exported C for stiff equations, with the same
            ``tolerance`` and the same substeps.
        inputs
            Open inputs as piecewise polynomials of time; zero by default.
        resumable
            Whether the ``final`` state is a `ResumableState`, from which a later run can go on.

        Raises
        ------
        ValueError
            A ``state`` to go on from is of a run with other settings, or later than ``duration_s``.
            Or ``record_times_s`` is given with such a state, or with ``resumable``.
        SimulationError
            A state or a recorded output is not finite, or a system left its limits. The error is a
            `StiffnessError` if ``exact_hold`` cannot meet the tolerance.
        ParameterError
            A parameter is not finite.
        """
        names = None if outputs is None else tuple(outputs)
        rows = np.asarray(parameters, dtype=float)[None]
        options |= {"outputs": names} | self._records(record_period_s, record_times_s)
        with self._runner(**options) as runner:
            batch = self._batch(runner, rows, [state], [duration_s], [inputs], (), record_times_s)
            if batch.given and (resumable or isinstance(state, ResumableState)):
                raise ValueError("record_times_s: must be left out in a run that goes on")
            (run,) = self._run_lanes(runner, batch, [0], resumable)
        if isinstance(run, Error):
            raise run
        return run

    def simulate_batch(
        self,
        parameters: Sequence[Array] | Array,
        states: Sequence[State] | State,
        duration_s: float | Sequence[float] | Array,
        *,
        inputs: Sequence[InputTable] | InputTable | None = None,
        reduce: Callable[[Simulation], Any] | None = None,
        failures: str = "raise",
        threads: int | None = None,
        outputs: Sequence[str] | None = None,
        reductions: Sequence[Reduction] = (),
        record_period_s: float | None = None,
        record_times_s: Sequence[float] | Array | None = None,
        resumable: bool = False,
        **options: Any,
    ) -> list[Any]:
        """Run once for each row of ``parameters`` (n, parameters); return a list of all results.

        Each result is a `Simulation`, unless ``reduce`` or ``failures`` replaces it.

        One call of the machine code makes several runs, each in a lane of the processor's vector
        registers. Several threads make such calls at the same time. Each lane has its own steps, so
        each run has the same bits as a run made alone.

        Parameters
        ----------
        parameters
            Values of ``parameter_names``, a row for each run, (n, parameters).
        states, duration_s, inputs
            One value for each run, or a single value for all runs; see `simulate`.
        reduce
            Function that is called with each `Simulation` right after its run. Its result replaces
            the simulation in the list, so that the memory of the records is free again.
        failures
            ``raise``: after all runs, raise the error of the first failed run. ``return``: put the
            error of each failed run in the list.
        threads
            Number of threads; by default the number of cores that this process may use.
        outputs
            Names of the output ports to record; all by default, or none if there are reductions.
        reductions
            Numbers that the runs compute from the samples of their outputs, such as the largest
            error. ``Simulation.reduced`` has their values. Reductions take less time than records.
        record_period_s, resumable, options
            As in `simulate`. A run that goes on must have the ``reductions`` of the run before. A
            reduction has a sample at the time of each record.
        record_times_s
            As in `simulate`, up to the longest duration, and without ``reductions``. Each run has
            the records up to its own duration.

        Raises
        ------
        ValueError
            An argument is wrong, or its length is not the number of runs.
        SimulationError, ParameterError
            As in `simulate`.
        """
        if failures not in ("raise", "return"):
            raise ValueError(f"failures = {failures!r}: must be one of raise, return")
        if threads is not None and (type(threads) is not int or threads < 1):
            raise ValueError(f"threads = {threads!r}: must be an integer >= 1, or None")
        is_sequence = isinstance(reductions, Sequence)
        if not is_sequence or not all(isinstance(item, Reduction) for item in reductions):
            raise ValueError("reductions: must be a sequence of Reduction")
        if reductions and record_times_s is not None:
            raise ValueError("reductions: need a record period in place of record_times_s")
        count = len(parameters)
        initial = [states] * count if isinstance(states, State) else list(states)
        tables = [inputs] * count if not isinstance(inputs, Sequence) else list(inputs)
        scalar = np.ndim(duration_s) == 0
        durations = np.full(count, duration_s) if scalar else np.asarray(duration_s, dtype=float)
        for name, values in (("states", initial), ("inputs", tables), ("duration_s", durations)):
            if len(values) != count:
                raise ValueError(f"{name}: has {len(values)} for {count} runs")
        if not count:
            return []
        # Fewer runs use the code of `simulate`: in lanes, copies of the last run would fill up.
        lanes = LANES if count >= LANES else 1
        settings = options | {"outputs": () if reductions and outputs is None else outputs}
        settings |= {"reductions": reductions} | self._records(record_period_s, record_times_s)
        runners, cancelled = local(), Event()
        # The first runner compiles the code, before any thread needs it.
        runners.of_thread = Runner(self.code, lanes=lanes, **settings)
        batch = self._batch(
            runners.of_thread,
            np.asarray(parameters, dtype=float),
            initial,
            durations,
            tables,
            reductions,
            record_times_s,
        )
        # Runs of about the same length share a call, because a lane that ends waits for the others.
        order = np.argsort(-batch.ticks, kind="stable").tolist()
        sets = [order[first : first + lanes] for first in range(0, count, lanes)]

        def run_set(indices: list[int]) -> list[Any]:
            if not hasattr(runners, "of_thread"):
                runners.of_thread = Runner(self.code, lanes=lanes, **settings)
            runner = runners.of_thread
            runs = self._run_lanes(runner, batch, indices, resumable, cancelled.is_set)
            return [
                run if isinstance(run, Error) or reduce is None else reduce(run) for run in runs
            ]

        results: list[Any] = [None] * count
        results_of_sets = _in_threads(run_set, sets, threads, cancelled)
        for indices, set_results in zip(sets, results_of_sets, strict=True):
            for index, result in zip(indices, set_results, strict=True):
                results[index] = result
        if failures == "raise":
            for result in results:
                if isinstance(result, Error):
                    raise result
        return results

    def _records(self, record_period_s: float | None, times: Any) -> dict[str, Any]:
        """Return the settings of a runner with this record period or these times of records."""
        if times is not None and not self.sample_times_s:
            record_period_s = record_period_s or LONGEST_TICK_S
        return {"record_period_s": record_period_s, "given_times": times is not None}

    def _batch(
        self,
        runner: Runner,
        parameters: Array,
        states: Sequence[State],
        durations: Sequence[float] | Array,
        inputs: Sequence[InputTable | None],
        reductions: Sequence[Reduction] = (),
        record_times_s: Sequence[float] | Array | None = None,
    ) -> _Batch:
        """Check the arguments of all runs and convert durations to ticks. Return a ``_Batch``.

        Raises `ValueError` or `ParameterError` for a wrong argument.
        """
        values = self.checked_parameters(parameters)
        tables = [table or self.no_inputs for table in inputs]
        # By identity, because usually all runs share one state and one table.
        checked: set[tuple[int, int]] = set()
        for state, table in zip(states, tables, strict=True):
            if (id(state), id(table)) not in checked:
                self._checked_state(state, table)
                checked.add((id(state), id(table)))
        for duration in durations:
            if not 0.0 <= duration < math.inf:
                raise ValueError(f"duration_s = {duration} s: must be finite and >= 0")
        tick = runner.timing.tick
        ticks = np.array([int(d / tick * _WITHIN) for d in durations], dtype=np.int64)
        rows, given = ticks // runner.timing.record_every + 1, None
        if record_times_s is not None:
            given = _given_times(record_times_s, max(durations, default=0.0), tick)
            rows = np.searchsorted(given.times, np.array(durations) * _WITHIN, side="right")
            ticks = np.maximum(ticks, np.append(-1, given.ticks)[rows] + 1)
        if note := runner.timing.offset_note(int(ticks.max(initial=0))):
            warnings.warn(note, stacklevel=3)
        for state, last in zip(states, ticks, strict=True):
            if isinstance(state, ResumableState):
                if state.settings != runner.settings:
                    raise ValueError(
                        "state: is of a run with other outputs, record period, integrator, step, "
                        "tolerance or reductions"
                    )
                if state.tick > last:
                    raise ValueError("duration_s: must not end before the state to go on from")
        reduced = starts_and_bounds(reductions, runner.timing, len(values))
        return _Batch(values, states, ticks, tables, *reduced, rows, given)

    def _run_lanes(
        self,
        runner: Runner,
        batch: _Batch,
        indices: list[int],
        resumable: bool,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> list[Simulation | SimulationError]:
        """Make the runs ``indices`` of a batch by one call of machine code, one run in each lane.

        If there are fewer runs than lanes, the other lanes repeat the last run. Return for each run
        its records, or the error if the run failed. For ``cancelled`` see `Runner.run`.
        """
        lanes = [*indices, *indices[-1:] * (runner.lanes - len(indices))]
        states = [batch.states[i] for i in lanes]
        x = _columns([state.continuous for state in states])
        d = _columns([state.discrete for state in states])
        last = batch.ticks[lanes]
        every, given, rows = runner.timing.record_every, batch.given, batch.rows[lanes]
        record = RECORDS.array((len(lanes), runner.columns.size, int(rows.max())))
        runner.restart(batch.parameters[lanes], last)
        runner.reducer.restart(batch.begins[lanes], batch.bounds[lanes])
        tables = [batch.inputs[i] for i in lanes]
        first = runner.resume(states)
        status = runner.run(x, d, first, last, tables, record, cancelled=cancelled, given=given)
        times = given.times if given else runner.timing.record_times(int(last.max()))
        reduced = runner.reducer.results(rows, times, every * runner.timing.tick)
        runs: list[Simulation | SimulationError] = []
        for lane, index in enumerate(indices):
            final = State(x[:, lane].copy(), d[:, lane].copy())
            outcome = _outcome(status[lane], int(last[lane]), final)
            parameters = batch.parameters[index]
            if error := self.fault(outcome, runner, parameters, final, lane):
                runs.append(error)
                continue
            values = record[lane, :, : rows[lane]]
            if isinstance(state := states[lane], ResumableState):
                values[:, : state.record.shape[1]] = state.record
            if given and not np.isfinite(values.sum()):  # the machine code checks other records
                finite = np.isfinite(values)
                row = int(np.argmin(finite.all(axis=0)))
                column = runner.columns[int(np.argmin(finite[:, row]))]
                runs.append(not_finite(times[row], output_elements(self.outputs)[column][0]))
                continue
            outputs = self._outputs(runner, values)
            if resumable:
                final = runner.resumable(lane, final, int(last[lane]), values)
            runs.append(Simulation(times[: rows[lane]], outputs, final, reduced[lane]))
        return runs

    def _outputs(self, runner: Runner, record: Array) -> dict[str, Array]:
        """Divide a record (columns, rows) into the outputs (rows, size) by name."""
        places = slices({name: self.outputs[name] for name in runner.names})
        return {name: record[place].T for name, place in places.items()}

    def fastest_per_s(
        self,
        parameters: Array,
        state: State,
        duration_s: float,
        inputs: InputTable | None = None,
        **options: Any,
    ) -> float:
        """Return the largest magnitude of a mode λ of the continuous states along a run, in 1/s.

        The number |λ| helps to choose the step of RK4. RK4 is stable with steps below 2.6/|λ|, and
        accurate with 0.2/|λ|. The modes are computed at each tick, and at an equal number of random
        states. A random state mixes the elements of states at different ticks.

        Parameters
        ----------
        parameters, state, duration_s, inputs, options
            As in `simulate`.

        Raises
        ------
        SimulationError, ParameterError
            As in `simulate`.
        """
        table = inputs or self.no_inputs
        runner = Runner(self.code, outputs=(), **options)
        batch = self._batch(runner, np.asarray(parameters)[None], [state], [duration_s], [table])
        ticks = np.arange(batch.ticks[0] + 1)
        vectors = (state.continuous, state.discrete)
        x, d = (_columns([vector]) for vector in vectors)
        visited = [np.empty((ticks.size, vector.size)) for vector in vectors]
        runner.restart(batch.parameters, batch.ticks)
        (status,) = runner.run(x, d, 0, batch.ticks, [table], snapshots=Snapshots(ticks, *visited))
        final = State(x[:, 0], d[:, 0])
        if error := self.fault(status.tolist(), runner, batch.parameters[0], final):
            raise error
        # A fixed seed, so that equal diagrams give equal exports, byte by byte.
        mixed = [np.random.default_rng(0).permuted(values, axis=0) for values in visited]
        return max(
            runner.fastest_per_s(Snapshots(ticks, *states), table) for states in (visited, mixed)
        )

    def as_system(
        self, parameters: Array, state: State, *, tick_s: float | None = None, **options: Any
    ) -> CompiledSystem:
        """Return the model as a leaf system of Drake, to connect it to other systems.

        Parameters
        ----------
        parameters, state
            Values of ``parameter_names``, and the state before the initialization events.
        tick_s
            Time in s that the tick must divide; required for a model without sample time.
        options
            ``integrator``, ``step_s`` and ``tolerance`` as in `simulate`.

        Raises
        ------
        ValueError
            ``tick_s`` is wrong, or is required and missing.
        """
        return CompiledSystem(self, parameters, state, tick_s=tick_s, **options)

    def __repr__(self) -> str:
        """Return a text with the number of parameters, the number of states, and all port names."""
        return (
            f"{type(self).__name__}({len(self.parameter_names)} parameters, "
            f"{len(self.state_names)} continuous and {len(self.discrete_names)} discrete states, "
            f"inputs: {', '.join(self.inputs) or 'none'}, outputs: "
            f"{', '.join(self.outputs) or 'none'})"
        )


def _outcome(status: Integers, last: int, final: State) -> list[int]:
    """Return the outcome of a run: status, last tick, index of the limit or the output.

    Machine code checks discrete states only where an output or a derivative uses them. So this
    function turns the status `OK` into `NOT_FINITE` if a final discrete state is not finite.
    """
    outcome: list[int] = status.tolist()
    if outcome[0] == OK and not np.isfinite(final.discrete).all():
        return [NOT_FINITE, last, 0]
    return outcome


_WITHIN = 1.0 + 1e-12  # 0.3 s / 0.1 s is 2.9999999999999996, and would lose a tick or a record


def _given_times(times_s: Any, longest_s: float, tick_s: float) -> GivenTimes:
    """Check the times of records up to ``longest_s``, and return them with their ticks.

    Raises `ValueError` for times that do not ascend from 0 to ``longest_s``.
    """
    times, end = np.array(times_s, dtype=float), longest_s * _WITHIN
    if times.ndim != 1 or not (np.diff(times, prepend=0.0, append=end) >= 0.0).all():
        raise ValueError(f"record_times_s: must ascend within 0 … {longest_s:g} s")
    # A record belongs to the last tick before its time: it sees the state before the updates.
    return GivenTimes(times, np.ceil(times / tick_s - 1e-9).astype(np.int64) - 1)


def _columns(vectors: Sequence[Array]) -> Array:
    """Return the vectors of the lanes as the columns of an array (elements, lanes)."""
    return np.ascontiguousarray(np.array(vectors, dtype=float).reshape(len(vectors), -1).T)


def _in_threads(
    function: Callable[[list[int]], Any],
    items: Sequence[list[int]],
    threads: int | None,
    cancelled: Event,
) -> Iterator[Any]:
    """Call ``function(item)`` for all items in several threads. Yield the results in item order.

    An exception, for example from Ctrl-C, sets ``cancelled`` and drops the items that have not
    begun.
    """
    count = available_cores() if threads is None else threads
    if count == 1 or len(items) == 1:
        yield from map(function, items)
        return
    # Threads and no processes, because machine code runs without the GIL.
    with ThreadPoolExecutor(count) as pool:
        try:
            yield from pool.map(function, items)
        except BaseException:
            cancelled.set()
            pool.shutdown(cancel_futures=True)
            raise


class DiagramModel(CompiledModel):
    """A compiled model together with the Drake diagram, of scalar type float, behind it."""

    def __init__(self, read: DiagramEquations) -> None:
        """Make the model of a diagram. ``read`` is the result of `read_diagram`."""
        self.read = read
        self.diagram = read.diagram
        code = MachineCode(read.key, read.equations)
        super().__init__(code, partial(_context_at, lambda: read.diagram))

    def parameters(self, context: Any | None = None) -> Array:
        """Return the parameters in ``context``, by default in the diagram's default Context."""
        return self.read.parameters(context)

    def state(self, context: Any | None = None) -> State:
        """Return the state in ``context``, by default in the diagram's default Context.

        The state is the state before the initialization events: see `initialized`.
        """
        return self.read.state(context)


def _context_at(make_diagram: Callable[[], Any], parameters: Array) -> tuple[Node, Any]:
    """Return the tree of a diagram, and a default Context in which ``parameters`` are set."""
    root = Node(make_diagram())
    context = root.system.CreateDefaultContext()
    set_parameters(root, context, parameters)
    return root, context


def compile_diagram(diagram: Any, *, inputs: Iterable[str] = ()) -> DiagramModel:
    """Compile a diagram of floats whose leaves convert to Drake's Expression.

    A leaf on which no state, margin or output depends, such as a logger, need not convert. The
    machine code is made when it is first used, and stored on disk in `cache_directory`.

    The equations of a leaf that is written in Python are compared with calls of the leaf of floats,
    at the default Context and at eight points around it. Leaves from a folder with `trust` are not.

    Parameters
    ----------
    diagram
        A Diagram or leaf system. Its states are continuous, or discrete with periodic updates. Its
        sample times must have a common divisor.
    inputs
        Names of the diagram's input ports that stay open. Each run gives the values of the open
        ports. All other input ports of the diagram count as unconnected. A name
        ``path/of/system:port`` stands for a port inside the diagram: see `read_diagram`.

    Raises
    ------
    CompilationError
        ``diagram`` is no system of floats, or a subsystem cannot be converted. The message names
        the subsystem and the port.
    DifferenceError
        A leaf in Python computes otherwise than its symbolic form, such as a leaf that hides state.
    """
    return DiagramModel(read_diagram(diagram, inputs=inputs))


def compile_by_key(
    key: str, make_diagram: Callable[[], Any], **ports: Sequence[str]
) -> CompiledModel:
    """Return a compiled model. The diagram is built later, and only if it is needed.

    The diagram is needed if the cache has no machine code for ``key``, and to explain a failed run.

    Parameters
    ----------
    key
        Text by which the cache finds the machine code. Diagrams with different equations must have
        different keys. So the key must change when the code that builds the diagram changes.
    make_diagram
        Function that returns the diagram of floats. A model can be pickled only if this function
        can be pickled.
    ports
        ``inputs`` that stay open, and ``outputs`` inside the diagram, by name: see `read_diagram`.
    """
    code = MachineCode(key, partial(_equations, make_diagram, ports))
    return CompiledModel(code, partial(_context_at, make_diagram))


def _equations(make_diagram: Callable[[], Any], ports: Mapping[str, Sequence[str]]) -> Equations:
    return read_diagram(make_diagram(), **ports).equations
