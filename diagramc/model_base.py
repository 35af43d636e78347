"""The base class of a compiled model: names, argument checks, initial state and errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .equations.contexts import set_state
from .equations.tree import Node
from .errors import ParameterError, SimulationError, StiffnessError, UnstableStepError
from .native.arguments import (
    NOT_FINITE,
    OK,
    OUTPUT_NOT_FINITE,
    TOO_MANY_SUBSTEPS,
    TOO_ROUGH,
)
from .native.exact_hold import FASTEST_PER_S
from .native.machine_code import MachineCode
from .native.runner import Runner, address, output_elements
from .native.stability import UnstableStep
from .rosenbrock import MOST_SUBSTEPS
from .run_data import Array, InputTable, State

ContextAt = Callable[[Array], tuple[Node, Any]]
"""Function of a parameter vector (parameters,) that makes a Context with these parameters.

The function returns the tree of the diagram of floats, and the Context of the tree's root.
"""


class ModelBase:
    """Base of `CompiledModel`: everything about a compiled model except its runs."""

    def __init__(self, code: MachineCode, context_at: ContextAt | None = None) -> None:
        """Store the code, and the function that makes a Context for a leaf's ``check``.

        A leaf's ``check`` explains a failed run. Without ``context_at`` no ``check`` is called.
        """
        self.code = code
        self.layout = layout = code.layout
        self._context_at = context_at
        self.parameter_names: tuple[str, ...] = layout.parameters
        self.state_names: tuple[str, ...] = layout.states
        self.discrete_names: tuple[str, ...] = layout.discrete
        self.inputs: dict[str, int] = dict(layout.inputs)
        """Number of elements of each open input port, by the port's name."""
        self.no_inputs = InputTable(coefficients=np.zeros((1, max(layout.input_count, 1), 1)))
        """Input table that sets all open inputs to zero."""
        self.feedthrough: frozenset[str] = frozenset(layout.feedthrough)
        """Names of the output ports whose value depends on an open input at the same time."""
        self.outputs: dict[str, int] = dict(layout.outputs)
        """Number of elements of each output port, by the port's name."""
        self.sample_times_s: tuple[float, ...] = tuple(
            dict.fromkeys(period for period, _ in layout.periods)
        )

    def initialized(
        self, parameters: Array, state: State, inputs: InputTable | None = None
    ) -> State:
        """Apply the initialization events of ``Simulator.Initialize()``; return the state at t = 0.

        ``state`` is the state before these events; ``inputs`` are zero by default. Raises
        `ValueError` for an array of a wrong shape, `ParameterError` for a parameter that is not
        finite.
        """
        constants = self.constants(parameters)
        table = inputs or self.no_inputs
        continuous, discrete = self._checked_state(state, table)
        after = discrete.copy()
        initialize = self.code.start_function("initialize")
        arrays = continuous, discrete, table.value(0.0), constants, after
        initialize(*map(address, arrays))
        return State(continuous, after)

    def constants(self, parameters: Array) -> Array:
        """Return the values in the equations that depend on parameters alone, (constants,).

        Raises `ParameterError` for a parameter that is not finite.
        """
        values = self.checked_parameters(np.asarray(parameters, dtype=float)[None])[0]
        constants = np.empty(self.layout.constants)
        compute_constants = self.code.start_function("constants")
        compute_constants(address(values), address(constants))
        return constants

    def checked_parameters(self, parameters: Array) -> Array:
        """Return parameters (runs, parameters) as an array of doubles in C order, for machine code.

        Raises `ValueError` for a wrong number of parameters, `ParameterError` for a parameter that
        is not finite.
        """
        rows = np.ascontiguousarray(parameters, dtype=float)
        _require_shape("parameters", rows[0], (len(self.parameter_names),))
        finite = np.isfinite(rows)
        if not finite.all():
            run, column = (int(indices[0]) for indices in np.nonzero(~finite))
            name, value = self.parameter_names[column], rows[run, column]
            raise ParameterError(f"{name} = {value}: must be finite")
        return rows

    def _checked_state(self, state: State, inputs: InputTable) -> tuple[Array, Array]:
        """Return copies of the continuous and discrete states.

        Raises `ValueError` if the state or the input table has a wrong shape.
        """
        continuous = np.array(state.continuous, dtype=float)
        discrete = np.array(state.discrete, dtype=float)
        _require_shape("state.continuous", continuous, (len(self.state_names),))
        _require_shape("state.discrete", discrete, (len(self.discrete_names),))
        table = inputs.coefficients
        expected = (inputs.breaks.size + 1, max(self.layout.input_count, 1), table.shape[2])
        _require_shape("inputs.coefficients", table, expected)
        return continuous, discrete

    def fault(
        self,
        outcome: Sequence[int],
        runner: Runner,
        parameters: Array,
        state: State,
        lane: int = 0,
    ) -> SimulationError | None:
        """Return the error of a run in a lane of ``runner``; None if the run succeeded.

        The message says when and why the run failed. A run with an unstable step has failed, even
        if the run reaches its end, and the step is then the reason.

        Parameters
        ----------
        outcome
            Status of the run, its last tick, and the index of the limit that the run passed or of
            the output element that is not finite.
        parameters, state
            Parameters of the run, and the state at its end.
        """
        if step := runner.unstable_step(lane):
            time_s, state = step.time_s, step.state
            error = self._unstable(step, runner.integrator)
        elif outcome[0] == OK:
            return None
        else:
            time_s = float(runner.timing.times(outcome[1]))
            error = self._reason(outcome, time_s, parameters, state)
        names = (*self.state_names, *self.discrete_names)
        values = np.concatenate((state.continuous, state.discrete))
        error.time_s, error.state = time_s, dict(zip(names, values.tolist(), strict=True))
        return error

    def _unstable(self, step: UnstableStep, integrator: str) -> SimulationError:
        """Return the error of an unstable step, with the states that move in its mode."""
        order = np.argsort(-step.shares, kind="stable")
        names = [self.state_names[i] for i in order if step.shares[i] >= 0.5 * step.shares.max()]
        mode = f"{step.eigenvalue.real:.3g}"
        if step.eigenvalue.imag:
            mode += f" ± {abs(step.eigenvalue.imag):.3g}j"
        error = UnstableStepError(
            f"t = {step.time_s:.6g} s: {integrator} with steps of {step.step_s:.3g} s cannot "
            f"follow {' and '.join(names[:3])}, which moves in a mode of {mode} 1/s; set "
            f"step_s = {step.safe_s:.1e}, or use exact_hold"
        )
        error.step_s = step.safe_s
        return error

    def _reason(
        self, outcome: Sequence[int], time_s: float, parameters: Array, state: State
    ) -> SimulationError:
        """Return the error of a failed run for `fault`, which handles unstable steps before."""
        status, _, index = outcome
        finite = np.isfinite(np.concatenate((state.continuous, state.discrete)))
        if status in (NOT_FINITE, OUTPUT_NOT_FINITE, TOO_MANY_SUBSTEPS) and not finite.all():
            # If a state is not finite too, the state is the cause.
            names = (*self.state_names, *self.discrete_names)
            return not_finite(time_s, names[int(np.argmin(finite))])
        if status == OUTPUT_NOT_FINITE:
            return not_finite(time_s, output_elements(self.outputs)[index][0])
        if status == TOO_ROUGH and index:
            return StiffnessError(
                f"t = {time_s:.6g} s: a mode is faster than {FASTEST_PER_S:g} 1/s, the limit of "
                f"the integrator exact_hold; use rosenbrock, or slower parts"
            )
        if status == TOO_ROUGH:
            return StiffnessError(
                f"t = {time_s:.6g} s: the integrator exact_hold cannot hold its tolerance (the "
                f"derivatives jump too often); use rk4"
            )
        if status == TOO_MANY_SUBSTEPS:
            return StiffnessError(
                f"t = {time_s:.6g} s: {self.state_names[index]} changes too fast for the "
                f"integrator rosenbrock, whose {MOST_SUBSTEPS} substeps do not reach the end of "
                f"the tick; check the parameters, or use exact_hold"
            )
        path = self.layout.limits[index]
        if self._context_at is not None:
            root, context = self._context_at(parameters)
            context.SetTime(time_s)
            set_state(root, context, state)
            leaf = next(leaf for leaf in root.leaves() if leaf.path == path)
            if callable(check := getattr(leaf.system, "check", None)):
                try:
                    check(leaf.context(context))
                except SimulationError as error:
                    return error
        return SimulationError(f"t = {time_s:.6g} s: {path} left its limits")


def not_finite(time_s: float, name: str) -> SimulationError:
    """Return the error for a state or output ``name`` that is not finite at ``time_s``."""
    return SimulationError(
        f"t = {time_s:.6g} s: {name} is not finite; reduce the step or check the parameters"
    )


def _require_shape(name: str, values: Array, expected: tuple[int, ...]) -> None:
    """Raise `ValueError` for a wrong shape, because machine code does not check shapes."""
    if values.shape != expected:
        raise ValueError(f"{name} has the shape {values.shape}: must be {expected}")
