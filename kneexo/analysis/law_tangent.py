"""Linear form of a control law that runs as Python, around an operating point."""

from __future__ import annotations

from typing import Any

import numpy as np

from kneexo.diagrams import SIGNALS
from kneexo.diagrams.law import law_inputs, maker_arguments
from kneexo.errors import LinearizationError
from kneexo.parameters import LawParameters, Scenario
from kneexo.result import Array
from kneexo.simulation.python_law import SIGNAL_OF
from kneexo.systems import LinearLaw
from kneexo.systems.function_law import call_law
from kneexo.user_code import user_code

_RELATIVE_STEP = 6e-6  # cube root of the rounding error: the best step of a central difference
_SMALLEST_SCALE = 1e-2  # m, rad, rad/s, …: values below it are differentiated with its step


class LawTangent:
    """A law that runs as Python, and the `LinearLaw` that replaces it near an operating point.

    At a sample the law computes its command u and its states z⁺ from z and the signals y. Central
    differences give the derivatives, because such a law may need floats.
    """

    def __init__(self, scenario: Scenario) -> None:
        assert isinstance(scenario.controller, LawParameters)
        self._parameters = scenario.controller
        self._law = self._parameters.function
        self._inputs = law_inputs(scenario)
        self.start = np.array(self._parameters.initial_state)
        """States z at the start."""
        if self._law.is_system:
            self._system = self._law.any_system(maker_arguments(scenario))
            context = self._system.CreateDefaultContext()
            if context.num_continuous_states():
                raise LinearizationError(
                    f"law {self._law.short_name}: has continuous states and does not become "
                    f"equations: there is no linear loop; write it with a sample time"
                )
            self.start = _discrete_state(context.get_discrete_state())

    def linear_law(self) -> LinearLaw:
        """Return a system with the inputs of the law, and as many states."""
        return LinearLaw(self._parameters.sample_time_s, self._inputs, self.start.size)

    def start_in(self, diagram: Any, context: Any) -> None:
        """Set the states of the `LinearLaw` of a closed loop to those of the law at the start."""
        subcontext = _linear_law(diagram).GetMyMutableContextFromRoot(context)
        subcontext.SetDiscreteState([0.0, *self.start])

    def set(self, diagram: Any, context: Any) -> None:
        """Set the Context parameters of the `LinearLaw` of a closed loop to the tangent there."""
        linear_law = _linear_law(diagram)
        subcontext = linear_law.GetMyMutableContextFromRoot(context)
        state = subcontext.get_discrete_state_vector().CopyToVector()[1:]
        ports = (diagram.GetOutputPort(SIGNAL_OF[name]) for name in self._inputs)
        point = np.concatenate([state, *(port.Eval(context) for port in ports)])
        values, slopes = self._differentiated(point)
        matrix = np.column_stack([values - slopes @ point, slopes])
        if not np.isfinite(matrix).all():
            raise LinearizationError(
                f"law {self._law.short_name}: its command, a next state or a derivative is not "
                f"finite where the loop should rest: there is no linear loop; correct that code"
            )
        linear_law.set_matrix(subcontext, matrix)

    def _differentiated(self, point: Array) -> tuple[Array, Array]:
        """Return command and next states at a point (z, y), and their central differences."""
        steps = np.diag(_RELATIVE_STEP * np.maximum(np.abs(point), _SMALLEST_SCALE))
        columns = [
            (self._sample(point + step) - self._sample(point - step)) / (2.0 * step.sum())
            for step in steps
        ]
        return self._sample(point), np.column_stack(columns)

    def _sample(self, point: Array) -> Array:
        """Return command and next states for the states z and signals y of an array (z, y)."""
        sizes = [self.start.size, *(len(SIGNALS[SIGNAL_OF[name]]) for name in self._inputs)]
        state, *signals = np.split(point, np.cumsum(sizes)[:-1])
        inputs = dict(zip(self._inputs, signals, strict=True))
        if self._law.is_system:
            return self._system_sample(state, inputs)
        law, arguments = self._law.arguments, inputs
        arguments |= {name: np.array([value]) for name, value in self._parameters.values.items()}
        if law.time:
            arguments["time_s"] = np.zeros(1)
        if law.state:
            arguments["state"] = state
        return np.array(call_law(self._law, self._law.copy_of_target(), arguments))

    def _system_sample(self, state: Array, inputs: dict[str, Array]) -> Array:
        system = self._system
        context = system.CreateDefaultContext()
        groups = context.get_discrete_state()
        first = 0
        for index in range(groups.num_groups()):
            size = groups.get_vector(index).size()
            context.SetDiscreteState(index, state[first : first + size])
            first += size
        for name, value in inputs.items():
            system.GetInputPort(name).FixValue(context, value)
        with user_code(f"law {self._law.short_name}: the system fails"):
            if first:
                updated = system.EvalUniquePeriodicDiscreteUpdate(context)
                context.get_mutable_discrete_state().SetFrom(updated)
            command = system.GetOutputPort("motor_speed_command").Eval(context)
        return np.append(command, _discrete_state(context.get_discrete_state()))


def _linear_law(diagram: Any) -> Any:
    return diagram.GetSubsystemByName("controller").GetSubsystemByName("law")


def _discrete_state(groups: Any) -> Any:
    """Return the elements of all groups of discrete states as one array."""
    vectors = [groups.get_vector(index).CopyToVector() for index in range(groups.num_groups())]
    return np.concatenate([np.empty(0), *vectors])
