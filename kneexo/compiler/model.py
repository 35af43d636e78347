"""Compiled models: a Drake diagram as machine code, run with plain arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Event, local
from typing import Any

import numpy as np
from pydrake.systems.framework import System

from .equations.reader import Equations, Node, read_equations
from .errors import (
    CompilationError,
    Error,
    ParameterError,
    SimulationError,
    StiffnessError,
)
from .native.cores import available_cores
from .native.llvm import LANES
from .native.machine_code import MachineCode, equations_key
from .native.runner import (
    LONGEST_TICK_S,
    RECORDS,
    Array,
    InputTable,
    Integers,
    Runner,
    State,
    Timing,
    address,
    not_finite,
    require_shape,
)
from .native.time_loop import NOT_FINITE, OK, OUTPUT_NOT_FINITE, TOO_ROUGH


@dataclass(frozen=True, repr=False)
class Simulation:
    """Recorded outputs of one run: ``time_s`` (n,), each output (n, size), and the last state."""

    time_s: Array
    outputs: dict[str, Array]
    final: State

    def __getitem__(self, output: str) -> Array:
        """The output port of that name, (n, size)."""
        return self.outputs[output]

    def __repr__(self) -> str:
        """Number of records, and names of the outputs."""
        return f"Simulation({self.time_s.size} records of {', '.join(self.outputs) or 'nothing'})"


@dataclass(frozen=True)
class _Batch:
    """Arguments of runs of one model: a row, a state, a duration and inputs for each."""

    parameters: Array
    states: Sequence[State]
    ticks: Integers
    inputs: Sequence[InputTable]


class CompiledModel:
    """A diagram as machine code; made by `compile_diagram`.

    Parameters, initial state and inputs are arguments of each run, so one compiled model serves
    every diagram that differs in numbers only. Runs do not touch Drake and release the GIL.
    """

    def __init__(
        self,
        code: MachineCode,
        context_at: Callable[[Array], tuple[Node, Any]] | None = None,
    ) -> None:
        """``context_at``: diagram and Context for a parameter vector, to explain a failed run."""
        self.code = code
        self.layout = layout = code.layout
        self._context_at = context_at
        self.parameter_names: tuple[str, ...] = layout.parameters
        self.state_names: tuple[str, ...] = layout.states
        self.held_names: tuple[str, ...] = layout.held
        self.inputs: dict[str, int] = dict(layout.inputs)
        """Size of each input port that stayed open."""
        self.no_inputs = InputTable(coefficients=np.zeros((1, max(layout.input_count, 1), 1)))
        self.feedthrough: frozenset[str] = frozenset(layout.feedthrough)
        """Output ports whose value depends on an open input at once."""
        self.outputs: dict[str, int] = dict(layout.outputs)
        """Size of each output port."""
        self.sample_times_s: tuple[float, ...] = tuple(
            dict.fromkeys(period for period, _ in layout.periods)
        )

    def __reduce__(self) -> tuple[type[CompiledModel], tuple[MachineCode]]:
        return CompiledModel, (self.code,)

    def initialized(
        self, parameters: Array, state: State, inputs: InputTable | None = None
    ) -> State:
        """The state after the initialization events of ``Simulator.Initialize()``, at t = 0."""
        c = self.constants(parameters)
        table = inputs or self.no_inputs
        x, d = self._checked_state(state, table)
        u, after = table.value(0.0), d.copy()
        self.code.start("initialize")(*map(address, (x, d, u, c, after)))
        return State(x, after)

    def constants(self, parameters: Array) -> Array:
        """What of the equations depends on parameters alone, computed once a run.

        Raises `ParameterError` for a parameter that is not finite.
        """
        row = self.checked_parameters(np.asarray(parameters, dtype=float)[None])[0]
        constants = np.empty(self.layout.constants)
        self.code.start("constants")(address(row), address(constants))
        return constants

    def checked_parameters(self, parameters: Array) -> Array:
        """Parameters (runs, parameters) as machine code wants them."""
        rows = np.ascontiguousarray(parameters, dtype=float)
        require_shape("parameters", rows[0], (len(self.parameter_names),))
        finite = np.isfinite(rows)
        if not finite.all():
            run, column = (int(indices[0]) for indices in np.nonzero(~finite))
            name, value = self.parameter_names[column], rows[run, column]
            raise ParameterError(f"{name} = {value}: must be finite")
        return rows

    def _checked_state(self, state: State, inputs: InputTable) -> tuple[Array, Array]:
        """Copies of the state; machine code does not check shapes."""
        x, d = (np.array(values, dtype=float) for values in (state.continuous, state.held))
        require_shape("state.continuous", x, (len(self.state_names),))
        require_shape("state.held", d, (len(self.held_names),))
        table = inputs.coefficients
        expected = (inputs.breaks.size + 1, max(self.layout.input_count, 1), table.shape[2])
        require_shape("inputs.coefficients", table, expected)
        return x, d

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
        **options: Any,
    ) -> Simulation:
        """Run from t = 0 with all events exactly at their times.

        Parameters
        ----------
        parameters
            One value for each of ``parameter_names``.
        state
            At t = 0, after initialization: see `initialized`.
        duration_s
            The run ends with the last whole tick within, or as far as ``record_times_s`` need.
        outputs
            Output ports to record; all by default.
        record_period_s
            Distance of the records, by default the (shortest) sample time. Records at t see the
            state before the updates at t, as those of Drake's `VectorLogSink`.
        record_times_s
            Records at these ascending times instead. Between two events they come from RK4 with
            steps of 20 µs, which leave the run as it is.
        integrator
            ``exact_hold``, exponential, with error control by ``tolerance``; ``rk4`` or
            ``runge_kutta3`` (as Drake's), with steps of at most ``step_s``.
        inputs
            What the open inputs do.

        Raises
        ------
        SimulationError
            A state or a recorded output is not finite, or a system left its limits;
            `StiffnessError` where the exact hold cannot follow.
        ParameterError
            A parameter is not finite.
        """
        if record_times_s is not None and not self.sample_times_s:
            record_period_s = record_period_s or LONGEST_TICK_S
        runner = Runner(self, outputs=outputs, record_period_s=record_period_s, **options)
        batch = self._batch(
            runner, np.asarray(parameters, dtype=float)[None], [state], [duration_s], [inputs]
        )
        if record_times_s is None:
            (run,) = self._run_lanes(runner, batch, [0])
        else:
            times = np.array(record_times_s, dtype=float)
            end = duration_s * (1.0 + 1e-12)
            if times.ndim != 1 or not (np.diff(times, prepend=0.0, append=end) >= 0.0).all():
                raise ValueError(f"record_times_s: must ascend within 0 … {duration_s:g} s")
            run = self._run_with_records(runner, batch, times)
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
        record_period_s: float | None = None,
        **options: Any,
    ) -> list[Any]:
        """`simulate` for each row of ``parameters`` (n, parameters): in lanes, and in threads.

        The runs of several lanes go in lock-step, each with its own steps: a run has the same bits
        as alone.

        ``states``, ``duration_s`` and ``inputs``: one for each run, or one for all. ``reduce``
        turns each `Simulation` into what is kept of it as soon as it is there, so that memory stays
        flat. ``failures``: ``raise`` the first error of a run, or ``return`` it in its run's place.
        ``threads``: all cores of this process by default. The other options: see `simulate`.
        """
        if failures not in ("raise", "return"):
            raise ValueError(f"failures = {failures!r}: must be one of raise, return")
        count = len(parameters)
        of_states = [states] * count if isinstance(states, State) else list(states)
        tables = [inputs] * count if not isinstance(inputs, Sequence) else list(inputs)
        alone = np.ndim(duration_s) == 0
        durations = np.full(count, duration_s) if alone else np.asarray(duration_s, dtype=float)
        for name, given in (("states", of_states), ("inputs", tables), ("duration_s", durations)):
            if len(given) != count:
                raise ValueError(f"{name}: has {len(given)} for {count} runs")
        if not count:
            return []
        lanes = LANES if count >= LANES else 1
        settings = {"outputs": outputs, "record_period_s": record_period_s} | options
        runners, cancelled = local(), Event()
        runners.own = Runner(self, lanes=lanes, **settings)  # makes the code before threads want it
        batch = self._batch(
            runners.own, np.asarray(parameters, dtype=float), of_states, durations, tables
        )
        order = np.argsort(-batch.ticks, kind="stable").tolist()  # runs of one length together
        sets = [order[first : first + lanes] for first in range(0, count, lanes)]

        def run_set(indices: list[int]) -> list[Any]:
            if not hasattr(runners, "own"):
                runners.own = Runner(self, lanes=lanes, **settings)
            runs = self._run_lanes(runners.own, batch, indices, cancelled.is_set)
            return [
                run if isinstance(run, Error) or reduce is None else reduce(run) for run in runs
            ]

        results: list[Any] = [None] * count
        of_sets = _in_threads(run_set, sets, threads, cancelled)
        for indices, values in zip(sets, of_sets, strict=True):
            for index, value in zip(indices, values, strict=True):
                results[index] = value
        if failures == "raise":
            for result in results:
                if isinstance(result, Error):
                    raise result
        return results

    def _batch(
        self,
        runner: Runner,
        parameters: Array,
        states: Sequence[State],
        durations: Sequence[float] | Array,
        inputs: Sequence[InputTable | None],
    ) -> _Batch:
        """Checked arguments; raises `ValueError` and `ParameterError`."""
        rows = self.checked_parameters(parameters)
        tables = [table or self.no_inputs for table in inputs]
        seen: set[tuple[int, int]] = set()
        for state, table in zip(states, tables, strict=True):
            if (id(state), id(table)) not in seen:
                self._checked_state(state, table)
                seen.add((id(state), id(table)))
        for duration in durations:
            if not 0.0 <= duration < math.inf:
                raise ValueError(f"duration_s = {duration} s: must be finite and >= 0")
        tick = runner.timing.tick
        ticks = [int(duration / tick * (1.0 + 1e-12)) for duration in durations]
        return _Batch(rows, states, np.array(ticks, dtype=np.int64), tables)

    def _run_lanes(
        self,
        runner: Runner,
        batch: _Batch,
        indices: list[int],
        cancelled: Callable[[], bool] = lambda: False,
    ) -> list[Simulation | SimulationError]:
        """Runs of a batch, one in each lane; lanes without a run of their own repeat the last."""
        lanes = [*indices, *indices[-1:] * (runner.lanes - len(indices))]
        x = _columns([batch.states[i].continuous for i in lanes])
        d = _columns([batch.states[i].held for i in lanes])
        last = batch.ticks[lanes]
        every = runner.timing.record_every
        record = RECORDS.array((len(lanes), runner.columns.size, int(last.max()) // every + 1))
        runner.restart(batch.parameters[lanes])
        tables = [batch.inputs[i] for i in lanes]
        status = runner.run(x, d, 0, last, tables, record, cancelled=cancelled)
        times = runner.timing.times(np.arange(0, last.max() + 1, every))
        runs: list[Simulation | SimulationError] = []
        for lane, index in enumerate(indices):
            final = State(x[:, lane].copy(), d[:, lane].copy())
            outcome = _outcome(status[lane], int(last[lane]), final)
            if outcome[0] != OK:
                output = ""
                if outcome[0] == OUTPUT_NOT_FINITE:
                    output = runner.output_not_finite(record[lane, :, outcome[1] // every])
                parameters = batch.parameters[index]
                runs.append(self.fault(outcome, runner.timing, parameters, final, output))
                continue
            rows = int(last[lane]) // every + 1
            runs.append(self._simulation(runner, times[:rows], record[lane, :, :rows], final))
        return runs

    def _simulation(self, runner: Runner, times: Array, record: Array, final: State) -> Simulation:
        """The run whose record is (columns, rows)."""
        outputs, first = {}, 0
        for name in runner.names:
            size = self.outputs[name]
            outputs[name] = record[first : first + size].T
            first += size
        return Simulation(times, outputs, final)

    def _run_with_records(
        self, runner: Runner, batch: _Batch, times: Array
    ) -> Simulation | SimulationError:
        """The only run of a batch, recorded at ``times``."""
        x, d = (_columns([v]) for v in (batch.states[0].continuous, batch.states[0].held))
        tick = runner.timing.tick
        # Each comes from the last tick before it, so that it sees the state before the updates.
        ticks, places = np.unique(
            np.ceil(times / tick - 1e-9).astype(np.int64) - 1, return_inverse=True
        )
        kept = (ticks, np.empty((ticks.size, len(x))), np.empty((ticks.size, len(d))))
        last = batch.ticks.copy()
        if ticks.size:
            last = np.maximum(last, ticks[-1] + 1)
        runner.restart(batch.parameters)
        (status,) = runner.run(x, d, 0, last, batch.inputs, kept=kept)
        final = State(x[:, 0].copy(), d[:, 0].copy())
        outcome = _outcome(status, int(last[0]), final)
        if outcome[0] != OK:
            return self.fault(outcome, runner.timing, batch.parameters[0], final)
        (record,) = runner.records_between(kept, batch.inputs[0], times, places.astype(np.int64))
        finite = np.isfinite(record).all(axis=0)
        if not finite.all():
            row = int(np.argmin(finite))
            return not_finite(times[row], runner.output_not_finite(record[:, row]))
        return self._simulation(runner, times, record, final)

    def as_system(
        self, parameters: Array, state: State, *, tick_s: float | None = None, **options: Any
    ) -> Any:
        """The model as a leaf system for Drake's Simulator: `CompiledSystem`.

        ``tick_s``: period of its updates; `ValueError` without it when the model has no sample
        time.
        """
        from .compiled_system import CompiledSystem

        return CompiledSystem(self, parameters, state, tick_s=tick_s, **options)

    def __repr__(self) -> str:
        """Sizes, and names of inputs and outputs."""
        return (
            f"{type(self).__name__}({len(self.parameter_names)} parameters, "
            f"{len(self.state_names)} continuous and {len(self.held_names)} discrete states, "
            f"inputs: {', '.join(self.inputs) or 'none'}, outputs: "
            f"{', '.join(self.outputs) or 'none'})"
        )

    def fault(
        self,
        outcome: Sequence[int],
        timing: Timing,
        parameters: Array,
        state: State,
        output: str = "",
    ) -> SimulationError:
        """Return the error of a run that ended with ``outcome``: status, tick, index of the limit.

        ``output``: name of the output that is not finite, if this ended the run.
        """
        status, tick, which = outcome
        time = timing.times(tick)
        if status in (NOT_FINITE, OUTPUT_NOT_FINITE):
            finite = np.isfinite(np.concatenate((state.continuous, state.held)))
            names = (*self.state_names, *self.held_names)
            # If a state is not finite too, the state is the cause.
            return not_finite(time, output if finite.all() else names[int(np.argmin(finite))])
        if status == TOO_ROUGH:
            return StiffnessError(
                f"t = {time:.6g} s: the integrator exact_hold cannot hold its tolerance (the "
                f"derivatives jump too often); use rk4"
            )
        path = self.layout.limits[which]
        if self._context_at is not None:
            root, context = self._context_at(parameters)
            self._set_state(root, context, time, state)
            leaf = next(leaf for leaf in root.leaves() if leaf.path == path)
            try:
                # The system itself says best what went wrong.
                leaf.system.check(leaf.context(context))
            except SimulationError as error:
                return error
            except AttributeError:
                pass  # no such check
        return SimulationError(f"t = {time:.6g} s: {path} left its limits")

    def _set_state(self, root: Node, context: Any, time: float, state: State) -> None:
        context.SetTime(time)
        continuous, held = list(state.continuous), list(state.held)
        for leaf in root.leaves():
            if not leaf.has_equations:
                continue
            own = leaf.context(context)
            size = own.num_continuous_states()
            if size:
                own.SetContinuousState(continuous[:size])
            del continuous[:size]
            for group in range(own.num_discrete_state_groups()):
                vector = own.get_mutable_discrete_state(group)
                vector.SetFromVector(held[: vector.size()])
                del held[: vector.size()]


def parameters_of(root: Node, context: Any) -> Array:
    """The parameter vector of the Context of a diagram of floats."""
    values: list[float] = []
    for leaf in root.leaves():
        if leaf.has_equations:
            own = leaf.context(context)
            for group in range(own.num_numeric_parameter_groups()):
                values += own.get_numeric_parameter(group).CopyToVector().tolist()
    return np.array(values)


def set_parameters(root: Node, context: Any, parameters: Array) -> None:
    """Write a parameter vector into the Context of a diagram of floats."""
    values = parameters.tolist()
    for leaf in root.leaves():
        if leaf.has_equations:
            own = leaf.context(context)
            for group in range(own.num_numeric_parameter_groups()):
                vector = own.get_mutable_numeric_parameter(group)
                vector.SetFromVector(values[: vector.size()])
                del values[: vector.size()]


def state_of(root: Node, context: Any) -> State:
    """The state of the Context of a diagram of floats."""
    continuous: list[float] = []
    held: list[float] = []
    for leaf in root.leaves():
        if not leaf.has_equations:
            continue
        own = leaf.context(context)
        continuous += own.get_continuous_state_vector().CopyToVector().tolist()
        for group in range(own.num_discrete_state_groups()):
            held += own.get_discrete_state(group).CopyToVector().tolist()
    return State(np.array(continuous), np.array(held))


def _outcome(status: Integers, last: int, final: State) -> list[int]:
    """Return status, tick and index of the limit; checks discrete states at the end of the run."""
    outcome: list[int] = status.tolist()
    if outcome[0] == OK and not np.isfinite(final.held).all():
        return [NOT_FINITE, last, 0]
    return outcome


def _columns(vectors: Sequence[Array]) -> Array:
    """Vectors, one a lane, as the columns of an array (elements, lanes)."""
    return np.ascontiguousarray(np.array(vectors, dtype=float).reshape(len(vectors), -1).T)


def _in_threads(
    function: Callable[[list[int]], Any],
    items: Sequence[list[int]],
    threads: int | None,
    cancelled: Event,
) -> Iterator[Any]:
    """Results in the order of ``items``; sets ``cancelled`` when Ctrl-C ends the wait for them."""
    count = available_cores() if threads is None else threads
    if count == 1 or len(items) == 1:
        yield from map(function, items)
        return
    with ThreadPoolExecutor(count) as pool:
        try:
            yield from pool.map(function, items)
        except BaseException:  # KeyboardInterrupt too: what waits is not begun
            cancelled.set()
            pool.shutdown(cancel_futures=True)
            raise


class DiagramModel(CompiledModel):
    """A compiled model together with its diagram of floats."""

    def __init__(self, diagram: Any, equations: Equations) -> None:
        self.diagram = diagram
        self._root = Node(diagram)
        code = MachineCode(equations_key(equations), equations)
        super().__init__(code, self._default_context)

    def _default_context(self, parameters: Array) -> tuple[Node, Any]:
        context = self.diagram.CreateDefaultContext()
        set_parameters(self._root, context, parameters)
        return self._root, context

    def parameters(self, context: Any | None = None) -> Array:
        """The parameter vector of a root Context; of the default one by default."""
        context = self.diagram.CreateDefaultContext() if context is None else context
        return parameters_of(self._root, context)

    def state(self, context: Any | None = None) -> State:
        """The state of a root Context; by default of the default one, not initialized."""
        context = self.diagram.CreateDefaultContext() if context is None else context
        return state_of(self._root, context)


def compile_diagram(diagram: Any, *, inputs: Iterable[str] = ()) -> DiagramModel:
    """Compile a diagram of floats that converts to symbolic Expression.

    Machine code is made when it is first used and kept on disk (`kneexo.compiler.native.cache`).

    Parameters
    ----------
    diagram
        A Diagram or leaf system with continuous states, discrete states with periodic updates, or
        both. Sample times must have a common divisor.
    inputs
        Its input ports that stay inputs of the compiled model; the others count as unconnected.

    Raises
    ------
    CompilationError
        Names the subsystem and port that cannot be converted; ``diagram`` is something else.
    """
    if not isinstance(diagram, System):
        raise CompilationError(
            f"{type(diagram).__name__} {diagram!r:.60}: cannot be compiled; must be a Diagram or "
            f"leaf system of floats"
        )
    name = diagram.get_name() or type(diagram).__name__
    ports = [diagram.get_input_port(i).get_name() for i in range(diagram.num_input_ports())]
    open_ports = (inputs,) if isinstance(inputs, str) else tuple(inputs)
    for port in open_ports:
        if port not in ports:
            raise CompilationError(
                f"{name}: has no input port {port!r}; it has {', '.join(ports) or 'none'}"
            )
    try:
        equations = read_equations(diagram, open_ports)
    except CompilationError as error:
        # A single leaf system has no path, and a port is not known to be one of `inputs`.
        text = f"{name}{error}" if str(error).startswith(": ") else str(error)
        if "is not connected" in text:
            text += "; connect it, or name the diagram's port in inputs"
        raise CompilationError(text) from error
    return DiagramModel(diagram, equations)
