"""Leaf systems of the user's law: the law itself, or what takes the place of a law in Python."""

from __future__ import annotations

from typing import Any

import numpy as np

from kneexo.law.call import call_law, require_finite_result
from kneexo.parameters import LAW_INPUTS, LawParameters
from kneexo.systems._leaf import NamedLeaf, clip, discrete_state, fill, leaf_template

LAW_COMMAND = "law_command"
"""Name of the input port of `HeldCommand`."""
COMMAND_AND_STATE = "command_and_state"
"""Name of the output port of `FunctionLaw` with its discrete state."""


def context_values(parameters: LawParameters) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `FunctionLaw`."""
    return {
        **parameters.values,
        **{f"initial_state_{n}": value for n, value in enumerate(parameters.initial_state)},
        "command_limit_rad_s": parameters.command_limit_rad_s,
    }


class FunctionLaw(NamedLeaf):
    """Control law of the user, a function that is called once a sample: u⁺ = clip(f(…), ±u_max).

    The names of f's arguments choose the input ports among
    `kneexo.parameters.device.law.LAW_INPUTS`. A port of one element gives f a scalar, any other
    port an array. ``time_s`` is the time in s, and ``state`` is an array of the discrete states
    after the first. With ``state``, f returns the command and the next state.

    ====================  =====  ======  ================================================
    port                  size   unit
    ====================  =====  ======  ================================================
    inputs of the law     1…4    SI      see `kneexo.parameters.device.law.LAW_INPUTS`
    **output port**
    motor_speed_command   1      rad/s   within ±``command_limit_rad_s``
    command_and_state     1…     rad/s   the whole discrete state
    ====================  =====  ======  ================================================

    An update every ``sample_time_s`` computes the discrete state, which contains the command and
    the state of f. The output ports show the discrete state. Context parameters by name: the gains
    of f, ``initial_state_0``, … and ``command_limit_rad_s``.

    An update raises `ParameterError` if the function fails or returns something else, and
    `SimulationError` if the command or a state is not finite.
    """

    def __init__(self, parameters: LawParameters) -> None:
        self._law = law = parameters.function
        self._function = law.copy_of_target()
        self._declare_parameters(context_values(parameters))
        self._states = len(parameters.initial_state)
        self._gains = tuple(parameters.values)
        self._ports = {
            name: self.DeclareVectorInputPort(name, LAW_INPUTS[name])
            for name in law.arguments.inputs
        }
        self._declare_update(parameters.sample_time_s, 1 + self._states, self._update)
        if self._states:
            self._declare_initialization(self._start)
        self._declare_command()
        self._declare_output(COMMAND_AND_STATE, 1 + self._states, discrete_state, self.xd_ticket())

    def _start(self, context: Any) -> list[Any]:
        p = self.parameters(context)
        return [0.0, *(getattr(p, f"initial_state_{n}") for n in range(self._states))]

    def _update(self, context: Any) -> list[Any]:
        p = self.parameters(context)
        values = {name: port.Eval(context) for name, port in self._ports.items()}
        values |= {name: np.array([getattr(p, name)]) for name in self._gains}
        values["time_s"] = np.array([context.get_time()])
        values["state"] = context.get_discrete_state(0).CopyToVector()[1:]
        result = call_law(self._law, self._function, values)
        if self._scalar is float:
            require_finite_result(self._law, context.get_time(), result)
        limit = p.command_limit_rad_s
        return [clip(result[0], -limit, limit), *result[1:]]


FunctionLaw_ = leaf_template(FunctionLaw)
"""Template of `FunctionLaw` classes by scalar type of Drake."""


class HeldCommand(NamedLeaf):
    """Hold a command from outside the diagram for a sample: u⁺ = ``law_command``.

    This system replaces a control law that runs as Python beside a compiled plant. Input ports: the
    inputs that the law reads, without effect, and ``law_command`` (1) in rad/s. Output port:
    ``motor_speed_command`` (1), the discrete state, updated every ``sample_time_s``.
    """

    def __init__(self, sample_time_s: float, inputs: tuple[str, ...]) -> None:
        for name in inputs:
            self.DeclareVectorInputPort(name, LAW_INPUTS[name])
        command = self.DeclareVectorInputPort(LAW_COMMAND, 1)
        self._declare_update(sample_time_s, 1, lambda c: [command.Eval(c)[0]])
        self._declare_command()


HeldCommand_ = leaf_template(HeldCommand)
"""Template of `HeldCommand` classes by scalar type of Drake."""


class LinearLaw(NamedLeaf):
    """Replace a control law that runs as Python by its linear form, near an operating point.

    The matrix M holds the linear form. The product M (1, x, z, y) contains dx/dt of the continuous
    states x of the law, the command u in rad/s, and the discrete states z of the law. The vector y
    has the elements of the inputs. The discrete state of this system is (u, z), updated every
    ``sample_time_s``. The output port ``motor_speed_command`` (1) shows u, without limit. The
    elements of M are Context parameters, see `set_matrix`.

    Parameters
    ----------
    sample_time_s
        Time in s between two updates.
    inputs
        Names of the inputs that the law reads, see `kneexo.parameters.device.law.LAW_INPUTS`.
    continuous, discrete
        Numbers of elements of x and z.
    """

    def __init__(
        self, sample_time_s: float, inputs: tuple[str, ...], continuous: int, discrete: int
    ) -> None:
        self._ports = [self.DeclareVectorInputPort(name, LAW_INPUTS[name]) for name in inputs]
        rows = continuous + 1 + discrete
        self._shape = rows, rows + sum(LAW_INPUTS[name] for name in inputs)
        self._declare_parameters(
            {f"m_{row}_{column}": 0.0 for row, column in np.ndindex(*self._shape)}
        )
        self._continuous = continuous
        self.DeclareContinuousState(continuous)
        self._declare_update(
            sample_time_s, 1 + discrete, lambda c: self._linear_form(c)[continuous:]
        )
        self._declare_command()

    def set_matrix(self, context: Any, matrix: Any) -> None:
        """Set the Context parameters to a matrix M, whose rows give dx/dt, then u, then z."""
        context.get_mutable_numeric_parameter(0).SetFromVector(np.reshape(matrix, -1))

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
        """Compute the rates of the continuous states."""
        fill(derivatives.get_mutable_vector(), self._linear_form(context)[: self._continuous])

    def _linear_form(self, context: Any) -> list[Any]:
        matrix = np.reshape(context.get_numeric_parameter(0).CopyToVector(), self._shape)
        states = context.get_continuous_state_vector().CopyToVector().tolist()
        signals = [element for port in self._ports for element in port.Eval(context)]
        values = [1.0, *states, *discrete_state(context)[1:], *signals]
        return [sum(m * value for m, value in zip(row, values, strict=True)) for row in matrix]


LinearLaw_ = leaf_template(LinearLaw)
"""Template of `LinearLaw` classes by scalar type of Drake."""
