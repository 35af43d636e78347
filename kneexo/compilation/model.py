"""Compiled models: a Drake diagram as machine code, run with plain arrays."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from kneexo.compilation.cache import load_text
from kneexo.compilation.codegen import source_text
from kneexo.compilation.equations import Node, read_equations
from kneexo.compilation.runner import (
    LONGEST_TICK_S,
    STEP_S,
    TOLERANCE,
    Array,
    InputTable,
    Runner,
    State,
    require_shape,
)
from kneexo.errors import KneexoError, ParameterError, SimulationError, StiffnessError


@dataclass(frozen=True)
class Simulation:
    """Recorded outputs of one run: ``time_s`` (n,), each output (n, size), and the last state."""

    time_s: Array
    outputs: dict[str, Array]
    final: State

    def __getitem__(self, output: str) -> Array:
        """The output port of that name, (n, size)."""
        return self.outputs[output]


class CompiledModel:
    """A diagram as machine code; made by `compile_diagram`.

    Parameters, initial state and inputs are arguments of each run, so one compiled model serves
    every diagram that differs in numbers only. Runs do not touch Drake and release the GIL.
    """

    def __init__(
        self,
        module: ModuleType,
        context_at: Callable[[Array], tuple[Node, Any]] | None = None,
    ) -> None:
        """``context_at``: diagram and Context for a parameter vector, to explain a failed run."""
        self.module = module
        self._context_at = context_at
        self.parameter_names: tuple[str, ...] = module.PARAMETERS
        self.state_names: tuple[str, ...] = module.STATES
        self.held_names: tuple[str, ...] = module.HELD
        self.inputs: dict[str, int] = module.INPUTS
        """Size of each input port that stayed open."""
        self.no_inputs = InputTable(
            coefficients=np.zeros((1, max(sum(module.INPUTS.values()), 1), 1))
        )
        self.feedthrough: frozenset[str] = frozenset(module.FEEDTHROUGH)
        """Output ports whose value depends on an open input at once."""
        self.outputs: dict[str, int] = {name: size for name, (_, size) in module.OUTPUTS.items()}
        """Size of each output port."""
        self.sample_times_s: tuple[float, ...] = tuple(
            dict.fromkeys(period for period, _ in module.PERIODS)
        )

    def initialized(
        self, parameters: Array, state: State, inputs: InputTable | None = None
    ) -> State:
        """The state after the initialization events of ``Simulator.Initialize()``, at t = 0."""
        module = self.module
        inputs = inputs or self.no_inputs
        c = self.constants(parameters)
        x, d = self._checked_state(state, inputs)
        u, after = np.zeros(max(sum(self.inputs.values()), 1)), d.copy()
        if self.inputs:
            evaluate = getattr(module.evaluate_inputs, "py_func", module.evaluate_inputs)
            evaluate(0.0, inputs.breaks, inputs.coefficients, u)  # once: not worth compiling
        with np.errstate(all="ignore"):
            module.initialize(0.0, x, d, u, c, after)
        return State(x, after)

    def constants(self, parameters: Array) -> Array:
        """What of the equations depends on parameters alone, computed once a run.

        Raises `ParameterError` for a parameter that is not finite.
        """
        parameters = np.asarray(parameters, dtype=float)
        require_shape("parameters", parameters, (len(self.parameter_names),))
        finite = np.isfinite(parameters)
        if not finite.all():
            name, value = self.parameter_names[np.argmin(finite)], parameters[np.argmin(finite)]
            raise ParameterError(f"{name} = {value}: must be finite")
        constants = np.empty(self.module.CONSTANT_COUNT)
        with np.errstate(all="ignore"):  # a branch not taken may divide by zero
            self.module.constants(parameters, constants)
        return constants

    def _checked_state(self, state: State, inputs: InputTable) -> tuple[Array, Array]:
        """Copies of the state; machine code does not check shapes."""
        x, d = (np.array(values, dtype=float) for values in (state.continuous, state.held))
        require_shape("state.continuous", x, (len(self.state_names),))
        require_shape("state.held", d, (len(self.held_names),))
        table = inputs.coefficients
        expected = (inputs.breaks.size + 1, max(sum(self.inputs.values()), 1), table.shape[2])
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
        integrator: str = "exact_hold",
        step_s: float = STEP_S,
        tolerance: float = TOLERANCE,
        inputs: InputTable | None = None,
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
            A state is not finite or a system left its limits; `StiffnessError` where the exact
            hold cannot follow.
        ParameterError
            A parameter is not finite.
        """
        if record_times_s is not None and not self.sample_times_s:
            record_period_s = record_period_s or LONGEST_TICK_S
        runner = Runner(
            self,
            parameters,
            outputs=outputs,
            record_period_s=record_period_s,
            integrator=integrator,
            step_s=step_s,
            tolerance=tolerance,
        )
        if not 0.0 <= duration_s < math.inf:
            raise ValueError(f"duration_s = {duration_s} s: must be finite and >= 0")
        tick, every = runner.timing.tick, runner.timing.record_every
        inputs = inputs or self.no_inputs
        x, d = self._checked_state(state, inputs)
        ticks = int(duration_s / tick * (1.0 + 1e-12))
        if record_times_s is None:
            times = tick * np.arange(0.0, ticks + 1.0, every)
            record = np.empty((times.size, runner.columns.size))
            runner.run(x, d, 0, ticks, inputs, record)
        else:
            times = np.array(record_times_s, dtype=float)
            end = duration_s * (1.0 + 1e-12)
            if times.ndim != 1 or not (np.diff(times, prepend=0.0, append=end) >= 0.0).all():
                raise ValueError(f"record_times_s: must ascend within 0 … {duration_s:g} s")
            record = runner.run_with_records(x, d, ticks, inputs, times)
        recorded, first = {}, 0
        for name in runner.names:
            recorded[name] = record[:, first : first + self.outputs[name]]
            first += self.outputs[name]
        return Simulation(times, recorded, State(x, d))

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
        **options: Any,
    ) -> list[Any]:
        """`simulate` for each row of ``parameters`` (n, parameters), in threads.

        ``states``, ``duration_s`` and ``inputs``: one for each run, or one for all. ``reduce``
        turns each `Simulation` into what is kept of it as soon as it is there, so that memory
        stays flat.
        ``failures``: ``raise`` the first error of a run, or ``return`` it in its run's place.
        ``threads``: all cores of this process by default. ``options``: see `simulate`.
        """
        if failures not in ("raise", "return"):
            raise ValueError(f"failures = {failures!r}: must be one of raise, return")
        parameters = list(parameters)
        count = len(parameters)
        of_states = [states] * count if isinstance(states, State) else list(states)
        of_inputs: list[InputTable | None]
        if inputs is None or isinstance(inputs, InputTable):
            of_inputs = [inputs] * count
        else:
            of_inputs = list(inputs)
        if isinstance(duration_s, int | float):
            durations = [float(duration_s)] * count
        else:
            durations = list(duration_s)
        for name, given in (
            ("states", len(of_states)),
            ("duration_s", len(durations)),
            ("inputs", len(of_inputs)),
        ):
            if given != count:
                raise ValueError(f"{name}: has {given} for {count} runs")

        def one(index: int) -> Any:
            try:
                run = self.simulate(
                    parameters[index],
                    of_states[index],
                    durations[index],
                    inputs=of_inputs[index],
                    **options,
                )
            except KneexoError as error:
                if failures == "raise":
                    raise
                return error
            return run if reduce is None else reduce(run)

        if not count:
            return []
        first = one(0)  # alone: it may compile
        cores = len(os.sched_getaffinity(0))
        with ThreadPoolExecutor(cores if threads is None else threads) as pool:
            try:
                return [first, *pool.map(one, range(1, count))]
            except BaseException:  # KeyboardInterrupt too: what waits is not begun
                pool.shutdown(cancel_futures=True)
                raise

    def as_system(self, parameters: Array, state: State, **options: Any) -> Any:
        """The model as a leaf system for Drake's Simulator: `CompiledSystem`."""
        from kneexo.compilation.compiled_system import CompiledSystem

        return CompiledSystem(self, parameters, state, **options)

    def fault(
        self,
        status: int,
        time: float,
        which: int,
        parameters: Array,
        state: State,
    ) -> SimulationError:
        """What a run that ended with ``status`` raises."""
        module = self.module
        if status == module.NOT_FINITE:
            return SimulationError(
                f"t = {time:.6g} s: {self.state_names[which]} is not finite; reduce the step or "
                f"check the parameters"
            )
        if status == module.TOO_ROUGH:
            return StiffnessError(
                f"t = {time:.6g} s: the integrator exact_hold cannot hold its tolerance (the "
                f"derivatives jump too often); use rk4"
            )
        path = module.LIMITS[which]
        if self._context_at is not None:
            root, context = self._context_at(parameters)
            self._set_state(root, context, time, state)
            leaf = next(leaf for leaf in root.leaves() if leaf.path == path)
            try:
                # The system itself says best what went wrong.
                leaf.system._check(leaf.context(context))
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


class DiagramModel(CompiledModel):
    """A compiled model together with its diagram of floats."""

    def __init__(self, diagram: Any, module: ModuleType) -> None:
        self.diagram = diagram
        self._root = Node(diagram)
        super().__init__(module, self._default_context)

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

    The first call takes some seconds; machine code is kept on disk (`kneexo.compilation.cache`).

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
        Names the subsystem and port that cannot be converted.
    """
    equations = read_equations(diagram, tuple(inputs))
    return DiagramModel(diagram, load_text(source_text(equations)))
