"""Control law of the user, written as a function, as a leaf system."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from numbers import Real
from typing import Any, NamedTuple

import cloudpickle
import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, Variable

from kneexo.compiler import expressions_key, truth_of_scalars
from kneexo.errors import ParameterError, SimulationError, shortened
from kneexo.parameters import LAW_INPUTS, Law, LawParameters
from kneexo.systems._leaf import NamedLeaf, clip, discrete_state, fill, leaf_template
from kneexo.user_code import place_in_user_code, user_code

LAW_COMMAND = "law_command"
"""Name of the input port of `HeldCommand`."""


def context_values(parameters: LawParameters) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `FunctionLaw`."""
    return {
        **parameters.values,
        **{f"initial_state_{n}": value for n, value in enumerate(parameters.initial_state)},
        "command_limit_rad_s": parameters.command_limit_rad_s,
    }


def call_law(law: Law, function: Any, arguments: Mapping[str, Any]) -> list[Any]:
    """Call the function of a law; return the command in rad/s and then the next state.

    ``arguments`` has an array for each argument. The function gets a scalar for an array of one
    element, except for ``state``. A constant Expression in the result of a call with numbers, such
    as pydrake's ``if_then_else`` returns, becomes a float. Raises `ParameterError` if the function
    fails or returns something else.
    """
    kinds = {type(value) for values in arguments.values() for value in values}
    scalars = kinds & {AutoDiffXd, Expression}
    # With numbers, pydrake's if_then_else returns constant Expressions.
    has_scalars = bool(scalars) or "if_then_else" in law.names
    with user_code(f"law {law.short_name}: the function fails"), _arithmetic(has_scalars):
        try:
            result = function(**_plain(arguments))
        except TypeError as error:
            # Drake 1.58 accepts no comparison of NumPy scalars, but one of Expressions.
            if scalars or "if_then_else()" not in str(error) or function is not law.target:
                raise
            constants = {name: _constants(values) for name, values in arguments.items()}
            result = function(**_plain(constants))
    values, expected = [result], "must return the motor speed in rad/s, one number"
    count = 1
    if "state" in arguments:
        size = arguments["state"].size
        expected = f"must return (command, next_state), with {size} numbers in next_state"
        if not isinstance(result, tuple | list) or len(result) != 2:
            raise _wrong_result(law, result, expected)
        values = [result[0], *np.asarray(result[1], dtype=object).reshape(-1)]
        count += size
    values[:1] = np.asarray(values[0], dtype=object).reshape(-1)
    suited = (isinstance(v, _NUMBERS) and not isinstance(v, bool) for v in values)
    if len(values) != count or not all(suited):
        raise _wrong_result(law, result, expected)
    return [v if type(v) in scalars else _number(v) for v in values]


_NUMBERS = (Real, Expression, AutoDiffXd)


def _number(value: Any) -> float:
    """Return a number or a constant Expression as a float."""
    return float(value.Evaluate() if isinstance(value, Expression) else value)


@contextmanager
def _arithmetic(with_scalars: bool) -> Iterator[None]:
    """Context manager: the body calculates with scalars of Drake if ``with_scalars``."""
    if not with_scalars:
        yield
        return
    # NumPy raises false alarms for arrays of Expression.
    with truth_of_scalars(), np.errstate(invalid="ignore"):
        yield


def require_finite_result(law: Law, time_s: float, result: Sequence[float]) -> None:
    """Raise `SimulationError` if the command or a next state of a law is not finite.

    ``result`` is the result of `call_law` at the time ``time_s``.
    """
    if not all(map(math.isfinite, result)):
        what = "command and next state" if len(result) > 1 else "command"
        values = ", ".join(f"{value:g}" for value in result)
        raise SimulationError(
            f"t = {time_s:.6g} s: law {law.short_name} returns {shortened(values, 60)} as {what}; "
            f"must be finite; correct that code"
        )


def _plain(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a function: a scalar for an array of one element, but not `state`."""
    return {
        name: values.copy() if name == "state" or values.size > 1 else values.item()
        for name, values in arguments.items()
    }


def _constants(values: Any) -> Any:
    """Return an array of numbers as an array of constant Expressions."""
    return np.array([Expression(value) for value in values])


def _wrong_result(law: Law, result: Any, expected: str) -> ParameterError:
    shown = shortened(" ".join(repr(result).split()), 60)
    return ParameterError(f"law {law.short_name}: returns {shown}; {expected}")


class FunctionLaw(NamedLeaf):
    """Control law of the user, a function that is called once a sample: u⁺ = clip(f(…), ±u_max).

    The names of f's arguments choose the input ports among `kneexo.parameters.law.LAW_INPUTS`. A
    port of one element gives f a scalar, any other port an array. ``time_s`` is the time in s, and
    ``state`` is an array of the discrete states after the first. With ``state``, f returns the
    command and the next state.

    ====================  =====  ======  ================================================
    port                  size   unit
    ====================  =====  ======  ================================================
    inputs of the law     1…4    SI      see `kneexo.parameters.law.LAW_INPUTS`
    **output port**
    motor_speed_command   1      rad/s   within ±``command_limit_rad_s``
    ====================  =====  ======  ================================================

    An update every ``sample_time_s`` computes the discrete state, which contains the command and
    the state of f. The output port shows the command. Context parameters by name: the gains of f,
    ``initial_state_0``, … and ``command_limit_rad_s``.

    An update raises `ParameterError` if the function fails or returns something else, and
    `SimulationError` if the command or a state is not finite.
    """

    def __init__(self, parameters: LawParameters) -> None:
        self._law = law = parameters.function
        self._function = law.copy_of_target()
        self._arguments_of_law = law.arguments
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
        self._declare_output(
            "motor_speed_command", 1, lambda c: discrete_state(c)[:1], self.xd_ticket()
        )

    def _start(self, context: Any) -> list[Any]:
        p = self.parameters(context)
        return [0.0, *(getattr(p, f"initial_state_{n}") for n in range(self._states))]

    def _update(self, context: Any) -> list[Any]:
        p = self.parameters(context)
        arguments = {name: port.Eval(context) for name, port in self._ports.items()}
        arguments |= {name: np.array([getattr(p, name)]) for name in self._gains}
        if self._arguments_of_law.time:
            arguments["time_s"] = np.array([context.get_time()])
        if self._states:
            arguments["state"] = context.get_discrete_state(0).CopyToVector()[1:]
        result = call_law(self._law, self._function, arguments)
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
        self._declare_output(
            "motor_speed_command", 1, lambda c: discrete_state(c)[:1], self.xd_ticket()
        )


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
        Names of the inputs that the law reads, see `kneexo.parameters.law.LAW_INPUTS`.
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
        self._declare_output(
            "motor_speed_command", 1, lambda c: discrete_state(c)[:1], self.xd_ticket()
        )

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


# ------------------------------------------------------------------------------ tracing

_TYPICAL = {  # largest magnitudes of the inputs at the points of comparison, in SI units
    "rod_extension": (0.1,),
    "rod_reference": (0.1, 0.1, 1.0, 10.0),
    "estimated_state": (0.1, 0.1, 1.0),
    "knee_angle": (1.5,),
    "knee_reference": (1.5, 1.0, 1.0, 10.0),
    "encoder_reading": (1.5,),
    "rod_state": (0.1, 0.1, 1.0),
}
_SCALES = ((1.0, 1.0, 30.0), (1e-3, 0.0, 0.0), (1.0, 10.0, 0.01), (1e-2, 1e3, 1.0))
"""Scales of inputs and states and the largest time in s of each point of comparison.

States can be flags, counters or integrals. Small inputs leave a command within its limits.
"""
_ZERO = Expression(0.0)
_TOLERANCE = 1e-9  # sums in another order; conditioning of a law with gains up to 1e6


class Trace(NamedTuple):
    """The equations of a law's function, or the reason why there are none."""

    why_not_compiled: str
    """Reason why the function cannot become equations; empty if it can."""
    expressions: tuple[Any, ...] = ()
    """Symbolic expressions of the command and then the next state."""
    key: str = ""
    """Hash of the expressions and the names of the arguments; gains are variables."""


def trace(law: Law, states: int) -> Trace:
    """Trace the function of a law with symbolic variables, and compare it with calls with numbers.

    ``states`` is the number of elements of its argument ``state``. Values that the function reads
    may change between two runs. So each call traces the function anew, and repeats the comparison
    if the equations have changed. Raises `ParameterError` if the function hides state that cannot
    be copied.
    """
    if hides_state(law, states):
        return Trace("the object changes when it is called")
    if ("variables", states) not in law.memo:
        law.memo["variables", states] = _variables(law, states)
    variables = law.memo["variables", states]
    try:
        expressions = _symbolic_call(law, variables)
        known = law.memo.get(("trace", states))
        if known is None or not _are_equal(known.expressions, expressions):
            again = _symbolic_call(law, variables)
            known = law.memo["trace", states] = _compared(law, variables, expressions, again)
    except ParameterError as error:
        return Trace(_reason(error))
    return known


def _variables(law: Law, states: int) -> dict[str, Any]:
    """Return an array of symbolic variables for each argument of the function."""
    return {
        name: np.array([Variable(f"{name}{n}") for n in range(size)])
        for name, size in _sizes(law, states).items()
    }


def _symbolic_call(law: Law, variables: Mapping[str, Any]) -> tuple[Any, ...]:
    symbols = {name: np.array([Expression(v) for v in vs]) for name, vs in variables.items()}
    return tuple(_ZERO + value for value in call_law(law, law.copy_of_target(), symbols))


def _are_equal(expressions: Iterable[Any], others: Iterable[Any]) -> bool:
    return all(one.EqualTo(other) for one, other in zip(expressions, others, strict=True))


def _compared(
    law: Law, variables: Mapping[str, Any], expressions: tuple[Any, ...], again: tuple[Any, ...]
) -> Trace:
    """Return the trace of a law whose two symbolic calls gave ``expressions`` and ``again``.

    The expressions become equations if they are equal, and if calls with numbers agree with them.
    """
    states = len(expressions) - 1
    differ = "the equations that were read off differ from calls with numbers"
    if not _are_equal(expressions, again):
        return Trace(differ, expressions)
    random = np.random.default_rng(0)
    function = law.copy_of_target()
    for scales in _SCALES:
        point = _random_point(law, states, random, *scales)
        values = {
            variable: value
            for name, vs in variables.items()
            for variable, value in zip(vs, point[name], strict=True)
        }
        try:
            numbers = call_law(law, function, point)
            read = [expression.Evaluate(values) for expression in expressions]
        except (ParameterError, RuntimeError, ValueError):
            return Trace("the function fails for numbers within the usual range", expressions)
        if not np.allclose(read, numbers, rtol=_TOLERANCE, atol=_TOLERANCE, equal_nan=True):
            return Trace(differ, expressions)
    return Trace("", expressions, expressions_key(expressions, [*chain(*variables.values())]))


def hides_state(law: Law, states: int) -> bool:
    """Return True if a law is an object that changes when it is called.

    Raises `ParameterError` if a function changes outer variables, or returns two commands for equal
    arguments. Such a function cannot start a second run afresh.
    """
    if ("hides_state", states) not in law.memo:
        law.memo["hides_state", states] = _hides_state(law, states)
    hides: bool = law.memo["hides_state", states]
    return hides


def _hides_state(law: Law, states: int) -> bool:
    function = law.copy_of_target()
    is_object = function is not law.target
    before, of_original = _values(function), _values(law.target)
    random = np.random.default_rng(1)
    changed = False
    try:
        for _ in range(2):
            point = _random_point(law, states, random)
            first, again = (call_law(law, function, point) for _ in range(2))
            changed |= not np.array_equal(first, again, equal_nan=True)
    except ParameterError:
        return False  # the run or the trace reports the cause
    changed |= before != _values(function) or (is_object and before is None)
    if changed and (not is_object or _values(law.target) != of_original):
        raise ParameterError(
            f"law {law.short_name}: hides state: it changes outer variables, or returns two "
            f"commands for equal arguments; must take the argument state and return "
            f"(command, next_state)"
        )
    return changed


def _values(function: Any) -> bytes | None:
    """Return the pickled attributes and closure of a law; None if they cannot be pickled."""
    values = [getattr(function, name, None) for name in ("__dict__", "__closure__")]
    try:
        pickled: bytes = cloudpickle.dumps(values)
    except Exception:  # pickling a user's object may raise any error
        return None
    return pickled


def _sizes(law: Law, states: int) -> dict[str, int]:
    """Return the number of elements of each argument of the function."""
    arguments = law.arguments
    sizes = {name: LAW_INPUTS[name] for name in arguments.inputs}
    sizes |= dict.fromkeys(arguments.gains, 1)
    if arguments.time:
        sizes["time_s"] = 1
    if arguments.state:
        sizes["state"] = states
    return sizes


def _random_point(
    law: Law,
    states: int,
    random: np.random.Generator,
    scale: float = 1.0,
    largest_state: float = 1.0,
    largest_time_s: float = 30.0,
) -> dict[str, Any]:
    """Return arguments of usual size, an array for each: default gains, random other values."""
    point: dict[str, Any] = {}
    for name, size in _sizes(law, states).items():
        if name in law.arguments.gains:
            point[name] = np.array([law.arguments.gains[name]])
        elif name == "time_s":
            point[name] = random.uniform(0.0, largest_time_s, 1)
        elif name == "state":
            point[name] = random.uniform(-largest_state, largest_state, size)
        else:
            point[name] = scale * random.uniform(-1.0, 1.0, size) * np.array(_TYPICAL[name])
            point[name][0] = abs(point[name][0])
    return point


def _reason(error: ParameterError) -> str:
    """Return in words why a call with variables failed, with the line."""
    cause = error.__cause__
    if cause is None:
        return str(error)
    place = place_in_user_code(cause)
    line = f" (line {place[1]})" if place else ""
    if "__bool__" in str(cause):
        return f"the function branches on a value{line}"
    if isinstance(cause, TypeError):
        return f"the function needs plain numbers{line}"
    return f"the function raises {type(cause).__name__} for symbolic variables{line}"
