"""A compiled model as a leaf system, for Drake's Simulator, loggers and Meshcat."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, LeafSystem, ValueProducer

from .model_base import ModelBase, not_finite
from .native.arguments import OUTPUT_NOT_FINITE
from .native.runner import STEP_S, Runner, element_name
from .run_data import Array, InputTable, State, slices


class CompiledSystem(LeafSystem):
    """A leaf system that contains a compiled model and advances it by one tick in each update.

    The ports have the names that they have in the model. The input ports are the open inputs of the
    model, and their values are held over a tick. The output ports are the outputs of the model.
    Numeric parameters: ``model.parameter_names``. Discrete state: first the continuous states of
    the model, then the discrete states of the model. The tick is the longest one that divides all
    sample times of the model, but at most 2 ms with ``exact_hold``. Ticks at multiples of the
    shortest sample time have exactly the times that Drake gives to updates of this period.

    As in every discrete system, an update at a tick changes the state right after the tick. So
    outputs and logs at a tick equal the outputs of the compiled diagram at that tick. Between two
    ticks the outputs already have the values of the next tick. An input from another discrete
    system arrives one tick later, because an update sees the values before all updates. Compile
    that system too to avoid this delay.

    The step size and the Jacobians of the integrator are a cache entry of the Context, not part of
    the state. So a run that continues from a copied state agrees with the original run only within
    the tolerance of the integrator.

    Parameters
    ----------
    model
        A `CompiledModel`.
    parameters, state
        Parameters and state of the default Context. ``state`` is the state before the
        initialization events. The leaf system has the same initialization events as the model.
    integrator, step_s, tolerance
        As in `CompiledModel.simulate`. An update raises the errors of that method.
    tick_s
        Time in s that the tick must divide; required for a model without sample time.

    Raises
    ------
    ValueError
        ``tick_s`` is wrong, or is required and missing.
    """

    def __init__(
        self,
        model: ModelBase,
        parameters: Array,
        state: State,
        *,
        integrator: str = "exact_hold",
        step_s: float = STEP_S,
        tolerance: float | None = None,
        tick_s: float | None = None,
    ) -> None:
        if tick_s is None and not model.sample_times_s:
            raise ValueError("tick_s is needed: the model has no sample time")
        if tick_s is not None and not 0.0 < tick_s < math.inf:
            raise ValueError(f"tick_s = {tick_s} s: must be finite and > 0")
        super().__init__()
        self.model = model
        self._options: dict[str, Any] = {
            "integrator": integrator,
            "step_s": step_s,
            "tolerance": tolerance,
            "record_period_s": tick_s,
        }
        grid = Runner(model.code, **self._options).timing
        self._tick = grid.tick
        self.DeclareNumericParameter(BasicVector(np.asarray(parameters, dtype=float)))
        self.DeclareDiscreteState(np.concatenate((state.continuous, state.discrete)))
        for name, size in model.inputs.items():
            self.DeclareVectorInputPort(name, size)
        self._running = self.DeclareCacheEntry(
            "runner",
            ValueProducer(lambda: Value[object](), self._make_runner),
            {self.all_parameters_ticket()},
        )
        tickets = {self.time_ticket(), self.all_state_ticket(), self.all_parameters_ticket()}
        tickets_with_inputs = tickets | {self.all_input_ports_ticket()}
        entries = [
            self.DeclareCacheEntry(
                "outputs", ValueProducer(lambda: Value[object](), partial(self._record, used)), by
            )
            for used, by in ((False, tickets), (True, tickets_with_inputs))
        ]
        self._size, self._width = len(model.state_names), sum(model.outputs.values())
        for name, place in slices(model.outputs).items():
            entry = entries[name in model.feedthrough]
            self.DeclareVectorOutputPort(
                name,
                model.outputs[name],
                partial(self._copy_output, name, entry, place),
                {entry.ticket()},
            )
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        # The sum of many ticks has other bits than a multiple of the period, and the events of
        # other systems are at such multiples: one event for each tick of a period.
        period_s = min(model.sample_times_s, default=grid.unit)
        for offset_s in grid.times(np.arange(round(period_s / grid.tick))):
            self.DeclarePeriodicDiscreteUpdateEvent(period_s, offset_s, self._advance)

    def _make_runner(self, context: Any, value: Any) -> None:
        parameters = self.model.checked_parameters(context.get_numeric_parameter(0).value()[None])
        value.set_value(_Running(self, parameters))

    def _state(self, context: Any) -> Array:
        """Return a copy of the state: the model's continuous states, then its discrete states."""
        values: Array = context.get_discrete_state(0).CopyToVector()
        return values

    def _inputs(self, context: Any) -> InputTable:
        if not self.model.inputs:
            return self.model.no_inputs
        ports = (self.get_input_port(i).Eval(context) for i in range(self.num_input_ports()))
        return InputTable(np.empty(0), np.concatenate(list(ports))[None, :, None])

    def _initialize(self, context: Any, discrete_state: Any) -> None:
        values = self._state(context)
        before = State(values[: self._size], values[self._size :])
        parameters = context.get_numeric_parameter(0).CopyToVector()
        state = self.model.initialized(parameters, before, self._inputs(context))
        discrete_state.set_value(0, np.concatenate((state.continuous, state.discrete)))

    def _advance(self, context: Any, discrete_state: Any) -> None:
        tick = round(context.get_time() / self._tick)
        running = self._running.Eval(context)
        values = running.advanced(self._state(context), tick, self._inputs(context))
        discrete_state.set_value(0, values)

    def _record(self, with_inputs: bool, context: Any, value: Any) -> None:
        # A time just after a tick, by rounding, is the time of this tick.
        tick = math.ceil(context.get_time() / self._tick - 1e-9)
        inputs = self._inputs(context) if with_inputs else self.model.no_inputs
        value.set_value(self._running.Eval(context).outputs(self._state(context), tick, inputs))

    @staticmethod
    def _copy_output(name: str, entry: Any, part: slice, context: Any, output: Any) -> None:
        values = entry.Eval(context)[part]
        finite = np.isfinite(values)
        if not finite.all():
            element = int(np.argmin(finite))
            raise not_finite(context.get_time(), element_name(name, element, values.size))
        output.set_value(values)


class _Running:
    """Runs the model with the parameters of one Context.

    All runs share the same arrays, so that no run allocates memory.
    """

    def __init__(self, system: CompiledSystem, parameters: Array) -> None:
        self._system, self._parameters = system, parameters
        model = system.model
        self._runner = Runner(model.code, **system._options).restart(parameters)
        self._x = np.empty((system._size, 1))
        self._d = np.empty((len(model.discrete_names), 1))
        self._last = np.zeros(1, dtype=np.int64)
        self._outputs = np.empty((1, system._width, 1))
        self._runner.bind(self._x, self._d, self._last, self._outputs)

    def __deepcopy__(self, memo: Any) -> _Running:
        """Return a new object with empty memory, for Drake's copy of the Context."""
        return _Running(self._system, self._parameters)

    def advanced(self, state: Array, tick: int, inputs: InputTable) -> Array:
        """Run the model from ``state`` at ``tick`` for one tick; return the new state.

        Raises the errors of `CompiledModel.simulate`.
        """
        self._run(state, tick, tick + 1, 0, inputs)
        return np.concatenate((self._x[:, 0], self._d[:, 0]))

    def outputs(self, state: Array, tick: int, inputs: InputTable) -> Array:
        """Return the values of all output ports in one array, in the order of the ports.

        ``state`` is the state at the sample number ``tick``, and ``inputs`` are the open inputs.
        """
        self._run(state, tick, tick, 1, inputs)
        return self._outputs[0, :, 0].copy()

    def _run(self, state: Array, first: int, last: int, rows: int, inputs: InputTable) -> None:
        size = self._system._size
        self._x[:, 0], self._d[:, 0], self._last[0] = state[:size], state[size:], last
        status = self._runner.call_once(first, last, rows, [inputs])
        # An output that is not finite is an error only for a reader of its port.
        if status[0, 0] != OUTPUT_NOT_FINITE:
            after = State(self._x[:, 0].copy(), self._d[:, 0].copy())
            outcome, parameters = status[0].tolist(), self._parameters[0]
            if error := self._system.model.fault(outcome, self._runner, parameters, after):
                raise error
