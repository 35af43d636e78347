"""A compiled model as a leaf system, for Drake's Simulator, loggers and Meshcat."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, LeafSystem, ValueProducer

from kneexo.compilation.model import CompiledModel
from kneexo.compilation.runner import STEP_S, TOLERANCE, Array, InputTable, Runner, State
from kneexo.compilation.time_loop import OK


class CompiledSystem(LeafSystem):
    """A compiled model that advances by one tick in each discrete update.

    Ports: the open inputs of the model, held over a tick, and its outputs, under their own names.
    Numeric parameters: ``model.parameter_names``. Discrete state: x and d of the model. The tick is
    the model's sample time, or the longest that divides all of them.

    As in every discrete system the state changes right after an update: at the ticks, outputs and
    logs are those of the diagram that was compiled, and in between they are those of the next tick.
    An input that a discrete system drives arrives one tick later, for an update sees what was
    before it: compile that system too.
    What the integrator remembers is a cache entry, so a run agrees with another one that started
    from its state within the tolerance.
    """

    def __init__(
        self,
        model: CompiledModel,
        parameters: Array,
        state: State,
        *,
        integrator: str = "exact_hold",
        step_s: float = STEP_S,
        tolerance: float = TOLERANCE,
        tick_s: float | None = None,
    ) -> None:
        """``parameters`` and ``state``: defaults, before the initialization events of the diagram,
        which this system has too. ``integrator``, ``step_s`` and ``tolerance`` as in
        `CompiledModel.simulate`, whose errors each update raises. ``tick_s``: a shorter tick;
        needed for a model without sample time, else `ValueError`.
        """
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
        self._tick = Runner(model, **self._options).timing.tick
        self.DeclareNumericParameter(BasicVector(np.asarray(parameters, dtype=float)))
        self.DeclareDiscreteState(np.concatenate((state.continuous, state.held)))
        for name, size in model.inputs.items():
            self.DeclareVectorInputPort(name, size)
        self._running = self.DeclareCacheEntry(
            "runner",
            ValueProducer(lambda: Value[object](), self._make_runner),
            {self.all_parameters_ticket()},
        )
        of_state = {self.time_ticket(), self.all_state_ticket(), self.all_parameters_ticket()}
        entries = [
            self.DeclareCacheEntry(
                "outputs", ValueProducer(lambda: Value[object](), partial(self._record, used)), by
            )
            for used, by in ((False, of_state), (True, of_state | {self.all_input_ports_ticket()}))
        ]
        self._size, self._width = len(model.state_names), sum(model.outputs.values())
        first = 0
        for name, size in model.outputs.items():
            entry = entries[name in model.feedthrough]
            self.DeclareVectorOutputPort(
                name,
                size,
                partial(self._copy_output, entry, slice(first, first + size)),
                {entry.ticket()},
            )
            first += size
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(self._tick, 0.0, self._advance)

    def _make_runner(self, context: Any, value: Any) -> None:
        parameters = self.model.checked_parameters(context.get_numeric_parameter(0).value()[None])
        value.set_value(_Running(self, parameters))

    def _state(self, context: Any) -> tuple[Array, Array, Array]:
        """A copy of the discrete state, and its parts x and d."""
        values = context.get_discrete_state(0).CopyToVector()
        return values, values[: self._size], values[self._size :]

    def _inputs(self, context: Any) -> InputTable:
        if not self.model.inputs:
            return self.model.no_inputs
        ports = (self.get_input_port(i).Eval(context) for i in range(self.num_input_ports()))
        return InputTable(np.empty(0), np.concatenate(list(ports))[None, :, None])

    def _initialize(self, context: Any, discrete_state: Any) -> None:
        _, x, d = self._state(context)
        parameters = context.get_numeric_parameter(0).CopyToVector()
        state = self.model.initialized(parameters, State(x, d), self._inputs(context))
        discrete_state.set_value(0, np.concatenate((state.continuous, state.held)))

    def _advance(self, context: Any, discrete_state: Any) -> None:
        values, x, d = self._state(context)
        tick = round(context.get_time() / self._tick)
        self._running.Eval(context).run(x, d, tick, tick + 1, self._inputs(context))
        discrete_state.set_value(0, values)

    def _record(self, with_inputs: bool, context: Any, value: Any) -> None:
        _, x, d = self._state(context)
        tick = math.ceil(context.get_time() / self._tick - 1e-9)
        record = np.empty((1, self._width, 1))
        inputs = self._inputs(context) if with_inputs else self.model.no_inputs
        self._running.Eval(context).run(x, d, tick, tick, inputs, record)
        value.set_value(record[0, :, 0])

    @staticmethod
    def _copy_output(entry: Any, part: slice, context: Any, output: Any) -> None:
        output.set_value(entry.Eval(context)[part])


class _Running:
    """A runner with the parameters of a Context."""

    def __init__(self, system: CompiledSystem, parameters: Array) -> None:
        self._system, self._parameters = system, parameters
        self._runner = Runner(system.model, **system._options).restart(parameters)

    def __deepcopy__(self, memo: Any) -> _Running:
        """A new one, with the memory empty: Drake copies cache entries with a Context."""
        return _Running(self._system, self._parameters)

    def run(
        self,
        x: Array,
        d: Array,
        first: int,
        last: int,
        inputs: InputTable,
        record: Array | None = None,
    ) -> None:
        """Advance ``x`` and ``d``; raises what `CompiledModel.simulate` raises."""
        ends = np.array([last])
        (outcome,) = self._runner.run(x, d, first, ends, [inputs], record).tolist()
        if outcome[0] != OK:
            model, tick_s = self._system.model, self._runner.timing.tick
            raise model.fault(outcome, tick_s, self._parameters[0], State(x, d))
