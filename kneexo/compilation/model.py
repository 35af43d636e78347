"""Compiled models: a Drake diagram as machine code, run with plain arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kneexo.compilation.cache import load_text
from kneexo.compilation.codegen import INTEGRATORS, source_text
from kneexo.compilation.expressions import Node, read_equations
from kneexo.errors import CompilationError, SimulationError, StiffnessError

Array = NDArray[np.float64]

STEP_S = 2e-4
"""Default step of the Runge-Kutta integrators: 11 a period of the 447 Hz mode of the oil."""

TOLERANCE = 1e-8
"""Default of the exact hold: local error of each state, relative to one plus the state."""


@dataclass(frozen=True)
class State:
    """Continuous states (n,) and discrete states (m,) of a compiled model."""

    continuous: Array
    held: Array


@dataclass(frozen=True)
class InputTable:
    """Inputs as piecewise polynomials of time.

    ``coefficients[segment, input, power]``, in powers of the time since the last of ``breaks``
    (n,); there are n + 1 segments, one before the first break and one after the last. Without
    arguments a single input that is zero.
    """

    breaks: Array = field(default_factory=lambda: np.empty(0))
    coefficients: Array = field(default_factory=lambda: np.zeros((1, 1, 1)))


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
        self._module = module
        self._context_at = context_at
        self.parameter_names: tuple[str, ...] = module.PARAMETERS
        self.state_names: tuple[str, ...] = module.STATES
        self.held_names: tuple[str, ...] = module.HELD
        self.input_names: tuple[str, ...] = module.INPUTS
        self.outputs: dict[str, int] = {name: size for name, (_, size) in module.OUTPUTS.items()}
        """Size of each output port."""
        self.sample_times_s: tuple[float, ...] = tuple(period for period, _ in module.PERIODS)

    def initialized(
        self, parameters: Array, state: State, inputs: InputTable = InputTable()
    ) -> State:
        """The state after the initialization events of ``Simulator.Initialize()``, at t = 0."""
        module = self._module
        c, x, d = self._checked(parameters, state, inputs)
        u, after = np.zeros(max(len(self.input_names), 1)), d.copy()
        if self.input_names:
            module.evaluate_inputs(0.0, inputs.breaks, inputs.coefficients, u)
        if d.size:
            module.initialize(0.0, x, d, u, c, after)
        return State(x, after)

    def _checked(
        self, parameters: Array, state: State, inputs: InputTable
    ) -> tuple[Array, Array, Array]:
        """Constants of the run and copies of the state; machine code does not check shapes."""
        parameters, x, d = (
            np.array(values, dtype=float) for values in (parameters, state.continuous, state.held)
        )
        table = inputs.coefficients
        for name, shape, expected in (
            ("parameters", parameters.shape, (len(self.parameter_names),)),
            ("state.continuous", x.shape, (len(self.state_names),)),
            ("state.held", d.shape, (len(self.held_names),)),
            (
                "inputs.coefficients",
                table.shape,
                (inputs.breaks.size + 1, max(len(self.input_names), 1), table.shape[2]),
            ),
        ):
            if shape != expected:
                raise ValueError(f"{name} has the shape {shape}: must be {expected}")
        constants = np.empty(self._module.CONSTANT_COUNT)
        self._module.constants(parameters, constants)
        return constants, x, d

    def simulate(
        self,
        parameters: Array,
        state: State,
        duration_s: float,
        *,
        outputs: Sequence[str] | None = None,
        record_period_s: float | None = None,
        integrator: str = "exact_hold",
        step_s: float = STEP_S,
        tolerance: float = TOLERANCE,
        inputs: InputTable = InputTable(),
    ) -> Simulation:
        """Run from t = 0 with all events exactly at their times.

        Parameters
        ----------
        parameters
            One value for each of ``parameter_names``.
        state
            At t = 0, after initialization: see `initialized`.
        duration_s
            The run ends with the last event or record within.
        outputs
            Output ports to record; all by default.
        record_period_s
            Distance of the records, by default the (shortest) sample time. Records at t see the
            state before the updates at t, as those of Drake's `VectorLogSink`.
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
        """
        if integrator not in INTEGRATORS:
            raise ValueError(
                f"integrator = {integrator!r}: must be one of {', '.join(INTEGRATORS)}"
            )
        module = self._module
        names = tuple(self.outputs) if outputs is None else tuple(outputs)
        for name in names:
            if name not in self.outputs:
                raise ValueError(f"output {name!r} is unknown; known: {', '.join(self.outputs)}")
        timing = _timing(module.PERIODS, record_period_s)
        ticks = int(duration_s / timing.tick * (1.0 + 1e-12))
        columns = np.array(
            [module.OUTPUTS[n][0] + i for n in names for i in range(self.outputs[n])],
            dtype=np.int64,
        )
        record = np.empty((ticks // timing.record_every + 1, columns.size))
        c, x, d = self._checked(parameters, state, inputs)
        status, tick, which = getattr(module, f"run_{integrator}")(
            c,
            x,
            d,
            inputs.breaks,
            inputs.coefficients,
            timing.tick,
            ticks,
            timing.periods,
            timing.offsets,
            timing.record_every,
            np.array([name in names for name in self.outputs], dtype=np.bool_),
            columns,
            step_s,
            tolerance,
            record,
        )
        if status != module.OK:
            raise self._fault(status, tick * timing.tick, which, parameters, State(x, d), inputs)
        ticks_recorded = np.arange(0.0, ticks + 1.0, timing.record_every)
        recorded, first = {}, 0
        for name in names:
            recorded[name] = record[:, first : first + self.outputs[name]]
            first += self.outputs[name]
        return Simulation(timing.tick * ticks_recorded, recorded, State(x, d))

    def _fault(
        self,
        status: int,
        time: float,
        which: int,
        parameters: Array,
        state: State,
        inputs: InputTable,
    ) -> SimulationError:
        module = self._module
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


@dataclass(frozen=True)
class _Timing:
    """Whole numbers of ticks between events, and between records."""

    tick: float
    periods: NDArray[np.int64]
    offsets: NDArray[np.int64]
    record_every: int


def _timing(periods: Sequence[tuple[float, float]], record_period_s: float | None) -> _Timing:
    """The longest tick of which all sample times, offsets and the record period are multiples."""
    if record_period_s is None:
        if not periods:
            raise ValueError("record_period_s is needed: the model has no sample time")
        record_period_s = min(period for period, _ in periods)
    if not 0.0 < record_period_s < math.inf:
        raise ValueError(f"record_period_s = {record_period_s} s: must be finite and > 0")
    spans = [record_period_s, *(span for pair in periods for span in pair)]
    base = min(span for span in spans if span > 0.0)
    ratios = [Fraction(span / base).limit_denominator(1000) for span in spans]
    if any(abs(span / base - ratio) > 1e-9 for span, ratio in zip(spans, ratios, strict=True)):
        raise CompilationError(
            f"sample times {', '.join(f'{span:g}' for span in spans)} s have no common divisor"
        )
    parts = math.lcm(*(ratio.denominator for ratio in ratios))
    counts = [int(ratio * parts) for ratio in ratios]
    shared = math.gcd(*counts)
    counts = [count // shared for count in counts]
    return _Timing(
        base * shared / parts,
        np.array(counts[1::2], dtype=np.int64),
        np.array(counts[2::2], dtype=np.int64),
        counts[0],
    )


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
    return DiagramModel(diagram, load_text(source_text(diagram.get_name(), equations)))
