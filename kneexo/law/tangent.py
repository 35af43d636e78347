"""Linear form of a control law that runs as Python, around an operating point."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator

from kneexo.common.result import Array
from kneexo.common.user_code import user_code
from kneexo.errors import LinearizationError, SimulationError
from kneexo.law.decision import law_inputs, users_system
from kneexo.law.leaves import FunctionLaw, LinearLaw
from kneexo.law.python_law import SIGNAL_OF
from kneexo.parameters import LawParameters, Scenario

_RELATIVE_STEP = 6e-6  # cube root of the rounding error: the best step of a central difference
_SMALLEST_SCALE = 1e-2  # m, rad, rad/s, …: values below it are differentiated with its step


class LawTangent:
    """A law that runs as Python, and the `LinearLaw` that replaces it near an operating point.

    Central differences give the derivatives, because such a law may need floats.
    """

    def __init__(self, scenario: Scenario) -> None:
        law = scenario.with_loaded_law().controller
        assert isinstance(law, LawParameters)
        self._name, self._sample_time_s = law.function.short_name, law.sample_time_s
        self._inputs, is_system = law_inputs(scenario), law.function.is_system
        self._system = users_system(scenario) if is_system else FunctionLaw(law)
        self._held = [] if is_system else [0.0]
        """Discrete states before those of the law: the command of a `FunctionLaw`, or none."""
        self._context = self._system.CreateDefaultContext()
        continuous, discrete = self._states()
        self.sizes = continuous.size, discrete.size
        """Numbers of continuous and of discrete states."""

    def linear_law(self) -> LinearLaw:
        """Return a `LinearLaw` with the inputs and the numbers of states of the law."""
        return LinearLaw(self._sample_time_s, self._inputs, *self.sizes)

    def start_in(self, diagram: Any, context: Any) -> None:
        """Initialize the law, and give its states to the `LinearLaw` of a closed loop.

        ``diagram`` is the closed loop. ``context`` is its Context, to which the states are written.
        """
        self._fix_inputs(self._signals(diagram, context))
        with user_code(f"law {self._name}: the system fails"):
            Simulator(self._system, self._context).Initialize()
        continuous, discrete = self._states()
        subcontext = _linear_law(diagram).GetMyMutableContextFromRoot(context)
        subcontext.SetContinuousState(continuous)
        subcontext.SetDiscreteState([0.0, *discrete])

    def set(self, diagram: Any, context: Any) -> None:
        """Linearize the law at the state in ``context``, and store the result in its `LinearLaw`.

        ``diagram`` is the closed loop that contains the `LinearLaw`, and ``context`` is the Context
        of the loop. The method writes the matrix of the `LinearLaw` to ``context``. Raises
        `LinearizationError` if the command or a state of the law is not finite near this state.
        """
        linear_law = _linear_law(diagram)
        subcontext = linear_law.GetMyMutableContextFromRoot(context)
        continuous = subcontext.get_continuous_state_vector().CopyToVector()
        discrete = subcontext.get_discrete_state_vector().CopyToVector()[1:]
        point = np.concatenate([continuous, discrete, *self._signals(diagram, context)])
        steps = np.diag(_RELATIVE_STEP * np.maximum(np.abs(point), _SMALLEST_SCALE))
        try:
            values = self._sample(point)
            columns = [
                (self._sample(point + step) - self._sample(point - step)) / (2.0 * step.sum())
                for step in steps
            ]
        except SimulationError as error:
            raise LinearizationError(str(error)) from None
        slopes = np.column_stack(columns)
        linear_law.set_matrix(subcontext, np.column_stack([values - slopes @ point, slopes]))

    def _sample(self, point: Array) -> Array:
        """Call the law at a point (x, z, y), to compute its differences.

        x and z are the continuous and discrete states of the law, and y the signals that the law
        reads. Returns dx/dt, the command and the next z in one array.
        """
        system, context = self._system, self._context
        x, z, y = np.split(point, np.cumsum(self.sizes))
        ends = np.cumsum([system.GetInputPort(name).size() for name in self._inputs])
        self._fix_inputs(np.split(y, ends[:-1]))
        context.SetContinuousState(x)
        z = np.concatenate([self._held, z])
        for index in range(context.num_discrete_state_groups()):
            size = context.get_discrete_state(index).size()
            context.SetDiscreteState(index, z[:size])
            z = z[size:]
        with user_code(f"law {self._name}: the system fails"):
            rates = system.EvalTimeDerivatives(context).CopyToVector()
            if context.num_discrete_state_groups():
                updated = system.EvalUniquePeriodicDiscreteUpdate(context)
                context.get_mutable_discrete_state().SetFrom(updated)
            command = system.GetOutputPort("motor_speed_command").Eval(context)
        return np.concatenate([rates, command, self._states()[1]])

    def _states(self) -> tuple[Array, Array]:
        """Return the continuous states, and the discrete states of all groups but the command."""
        context, discrete = self._context, [np.empty(0)]
        for index in range(context.num_discrete_state_groups()):
            discrete.append(context.get_discrete_state(index).CopyToVector())
        own = np.concatenate(discrete)[len(self._held) :]
        return context.get_continuous_state_vector().CopyToVector(), own

    def _fix_inputs(self, signals: list[Array]) -> None:
        for name, value in zip(self._inputs, signals, strict=True):
            self._system.GetInputPort(name).FixValue(self._context, value)

    def _signals(self, diagram: Any, context: Any) -> list[Array]:
        """Return the signals of a closed loop that the law reads."""
        return [diagram.GetOutputPort(SIGNAL_OF[name]).Eval(context) for name in self._inputs]


def _linear_law(diagram: Any) -> Any:
    return diagram.GetSubsystemByName("controller").GetSubsystemByName("law")
