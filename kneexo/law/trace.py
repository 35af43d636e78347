"""Control law of the user, written as a function, as a leaf system."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import cache
from inspect import getclosurevars
from itertools import chain
from numbers import Real
from types import FunctionType
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, Variable

from diagramc import ExpressionGraph, called_twice, differ, truth_of_scalars
from kneexo.common.result import Array
from kneexo.common.user_code import place_in_user_code, text_of, user_code
from kneexo.errors import CompilationError, ParameterError, SimulationError, shortened
from kneexo.parameters import LAW_INPUTS, CylinderParameters, KneeParameters, Law, LawParameters
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


def call_law(law: Law, function: Any, arguments: Mapping[str, Any]) -> list[Any]:
    """Call the function of a law; return the command in rad/s and then the next state.

    ``arguments`` has an array for each argument. The function gets a scalar for an array of one
    element, except for ``state``. A constant Expression in the result of a call with numbers, such
    as pydrake's ``if_then_else`` returns, becomes a float. Raises `ParameterError` if the function
    fails or returns something else.
    """
    kinds = {type(value) for values in arguments.values() for value in values}
    scalars = kinds & {AutoDiffXd, Expression}
    memo = _memo(law)
    # With numbers, pydrake's if_then_else returns constant Expressions.
    has_scalars = scalars or "if_then_else" in law.names
    with user_code(f"law {law.short_name}: the function fails"):
        with _arithmetic_of_scalars() if has_scalars else nullcontext():
            if memo.get("needs_constants") and not scalars:
                arguments = _expressions(arguments)
            try:
                result = function(**_plain(arguments))
            except TypeError as error:
                # Drake 1.58 accepts no comparison of NumPy scalars, but one of Expressions.
                # `hides_state` finds that out with a copy, so a run calls no object twice.
                known = scalars or memo.get("needs_constants")
                if known or "if_then_else()" not in text_of(error):
                    raise
                memo["needs_constants"] = True
                return call_law(law, function, arguments)
        return _checked_result(law, arguments, result, scalars)


def _checked_result(
    law: Law, arguments: Mapping[str, Any], result: Any, scalars: set[type]
) -> list[Any]:
    """Return the command and the next state that a function has returned: see `call_law`.

    Values of the types ``scalars`` are returned unchanged, and all others as floats.
    """
    parts, expected = [result], "must return the motor speed in rad/s, one number"
    count = 1
    if "state" in arguments:
        size = arguments["state"].size
        expected = f"must return (command, next_state), with {size} numbers in next_state"
        if not isinstance(result, tuple | list) or len(result) != 2:
            raise _wrong_result(law, result, expected)
        parts = list(result)
        count += size
    values = [value for part in parts for value in np.asarray(part, dtype=object).reshape(-1)]
    suited = all(isinstance(v, _NUMBERS) and not isinstance(v, _NO_NUMBERS) for v in values)
    # NumPy replaces a masked value by zero.
    suited &= not any(type(p) not in _UNMASKED and np.ma.is_masked(p) for p in parts)
    if len(values) != count or np.size(parts[0]) != 1 or not suited:
        raise _wrong_result(law, result, expected)
    return [v if type(v) in scalars else _number(v) for v in values]


_NUMBERS = (Real, Expression, AutoDiffXd)
_NO_NUMBERS = (bool, np.timedelta64)  # although they are instances of Real
_UNMASKED = (float, int, list, tuple, np.float64, np.ndarray, Expression, AutoDiffXd)
"""Types that need no import of ``numpy.ma``, which takes 20 ms."""


def _number(value: Any) -> float:
    """Return a number or a constant Expression as a float."""
    return float(value.Evaluate() if isinstance(value, Expression) else value)


@contextmanager
def _arithmetic_of_scalars() -> Iterator[None]:
    """Context manager: the body calculates with scalars of Drake."""
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


def _expressions(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return arrays of numbers or variables as arrays of Expressions."""
    return {name: np.array([Expression(v) for v in values]) for name, values in arguments.items()}


def _wrong_result(law: Law, result: Any, expected: str) -> ParameterError:
    shown = shortened(" ".join(repr(result).split()), 60)
    return ParameterError(f"law {law.short_name}: returns {shown}; {expected}")


def _declare_command(leaf: NamedLeaf) -> None:
    """Declare the output port of the first element of the discrete state, in rad/s."""
    leaf._declare_output(
        "motor_speed_command", 1, lambda c: discrete_state(c)[:1], leaf.xd_ticket()
    )


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
        _declare_command(self)
        self._declare_output(COMMAND_AND_STATE, 1 + self._states, discrete_state, self.xd_ticket())

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
        _declare_command(self)


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
        _declare_command(self)

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

_STROKE_M = CylinderParameters().stroke_m
_MOTION_RAD = math.radians(KneeParameters().flexion_max_deg)
_LARGEST = {  # magnitudes of the inputs at the points of comparison, in SI units
    "rod_extension": (_STROKE_M,),
    "rod_reference": (_STROKE_M, 0.1, 1.0, 10.0),
    "estimated_state": (_STROKE_M, 0.1, 1.0),
    "knee_angle": (_MOTION_RAD,),
    "knee_reference": (_MOTION_RAD, 1.0, 1.0, 10.0),
    "encoder_reading": (_MOTION_RAD,),
    "rod_state": (_STROKE_M, 0.1, 1.0),
}
_SCALES = (
    (64, 1.0, 1.0, 30.0),
    (12, 1e-3, 0.0, 0.0),
    (12, 1.0, 10.0, 0.01),
    (12, 1e-2, 1e3, 1.0),
)
"""Number of points of comparison, scales of inputs and states, and the largest time in s.

States can be flags, counters or integrals. Small inputs leave a command within its limits.
"""
_SAMPLES = 300  # a difference in 1 % of the samples is missed by 5 % of such random choices
_MOST_TIME_S = 0.012  # processor time of a pass through the points, for a slow function
_ZERO = Expression(0.0)
_CHANGES = "the object changes when it is called"
_DIFFER = "the equations that were read off differ from calls with numbers"


@dataclass
class Trace:
    """The equations of a law's function, or the reason why there are none."""

    why_not_compiled: str
    """Reason why the function cannot become equations; empty if it can."""
    graph: ExpressionGraph | None = None
    """Command and next state as functions of the arguments; gains are variables."""
    key: str = ""
    """Hash of the equations and the names of the arguments; empty without equations."""
    replayed: bool = False
    """Whether the equations were compared with calls at the samples of a run."""


_memos: WeakKeyDictionary[Any, dict[Any, Any]] = WeakKeyDictionary()


def _memo(law: Law) -> dict[Any, Any]:
    """Return the dictionary in which this process remembers what it has found out about a law.

    Several `Law` objects of one function share the dictionary of this function.
    """
    is_function = isinstance(law.target, FunctionType)
    return _memos.setdefault(law.target, law.memo) if is_function else law.memo


def trace(law: Law, states: int) -> Trace:
    """Trace the function of a law with symbolic variables, and compare it with calls with numbers.

    ``states`` is the number of elements of its argument ``state``. Values that the function reads
    may change between two runs. So each call traces the function anew, and repeats the comparison
    if the equations have changed. Raises `ParameterError` if the function hides state that cannot
    be copied.
    """
    if hides_state(law, states):
        return Trace(_CHANGES)
    memo, graph = _memo(law), None
    known: Trace = memo.get(("trace", states), Trace(""))
    variables = _variables(tuple(argument_sizes(law, states).items()))
    try:
        results = call_law(law, law.copy_of_target(), _expressions(variables))
        expressions = [_ZERO + value for value in results]
        if known.graph is None or not known.graph.is_of(expressions):
            graph = ExpressionGraph(expressions, [*chain(*variables.values())])
    except (ParameterError, CompilationError) as error:
        return Trace(_reason(error))
    if graph is not None:
        fault = _fault(law, states, _points(law, states), graph)
        known = memo["trace", states] = Trace(fault, graph, "" if fault else graph.key)
    return known


@cache
def _variables(sizes: tuple[tuple[str, int], ...]) -> dict[str, Any]:
    """Return an array of symbolic variables for each argument of a function, (name, size)."""
    return {name: np.array([Variable(f"{name}{n}") for n in range(size)]) for name, size in sizes}


def replay(law: Law, samples: Array, states: int) -> None:
    """Compare the equations of a law with calls of its function at samples of a run.

    `trace` has read the equations, and knows the result of the comparison from then on.

    Parameters
    ----------
    law
        A law that is a function.
    samples
        Values of all `argument_sizes`, (samples, size).
    states
        Number of elements of the argument ``state``.

    Raises
    ------
    ParameterError
        The function hides state that cannot be copied.
    """
    traced: Trace = _memo(law)["trace", states]
    assert traced.graph is not None
    columns = np.hstack([samples, traced.graph.values(samples)])
    extremes = np.concatenate([columns.argmin(axis=0), columns.argmax(axis=0)])
    even = np.linspace(0, len(columns) - 1, min(_SAMPLES, len(columns))).astype(int)
    rows = np.concatenate([extremes, np.random.default_rng(0).permutation(even)])
    fault = _fault(law, states, samples[rows], traced.graph, in_run=True)
    traced.why_not_compiled, traced.replayed = fault, True
    _memo(law)["hides_state", states] = fault == _CHANGES


def _fault(
    law: Law, states: int, points: Array, graph: ExpressionGraph | None, *, in_run: bool = False
) -> str:
    """Return why a graph does not have the equations of a law, or an empty text.

    The function is called at points; without a graph, only to find out whether it hides state. A
    point where the function fails does not count, unless the points are samples ``in_run``. Raises
    `ParameterError` for a law whose copies do not start afresh, such as a function.
    """
    function = law.copy_of_target()
    first = _caller(law, function, states)
    second, third = (_caller(law, law.copy_of_target(), states) for _ in range(2))
    before = _outer_values(function)
    with np.errstate(all="ignore"):
        # The second pass goes backwards, which finds hidden state that two passes in one order
        # would repeat.
        numbers, repeats = called_twice(first, second, points, _MOST_TIME_S)
        points = points[: len(numbers)]
        if not repeats or before != _outer_values(function):
            again = [third(point) for point in points]
            if function is law.target or not np.array_equal(again, numbers, equal_nan=True):
                raise ParameterError(
                    f"law {law.short_name}: hides state: it changes outer variables, or returns "
                    f"two commands for equal arguments; must take the argument state and return "
                    f"(command, next_state)"
                )
            return _CHANGES
        if graph is None:
            return ""
        finite = np.isfinite(numbers).all(axis=1)
        if not finite.any():
            return "the function fails for numbers within the usual range"
        fails = in_run and not finite.all()
        return _DIFFER if fails or differ(first, points, graph.values(points), numbers) else ""


def _caller(law: Law, function: Any, states: int) -> Callable[[Array], list[Any]]:
    """Return a function of a point that calls the function of a law: command, next state or nan."""
    places, first = {}, 0
    for name, size in argument_sizes(law, states).items():
        places[name] = slice(first, first := first + size)

    def call(point: Array) -> list[Any]:
        try:
            return call_law(law, function, {name: point[place] for name, place in places.items()})
        except ParameterError:
            return [math.nan] * (1 + states)

    return call


def hides_state(law: Law, states: int) -> bool:
    """Return True if a law is an object that changes when it is called.

    Raises `ParameterError` if a function changes outer variables, or returns two commands for equal
    arguments. Such a function cannot start a second run afresh.
    """
    memo = _memo(law)
    if ("hides_state", states) not in memo:
        points = _points(law, states)
        if "if_then_else" in law.names:  # a copy apart finds whether pydrake wants Expressions
            _caller(law, law.copy_of_target(), states)(points[0])
        memo["hides_state", states] = _fault(law, states, points, None) == _CHANGES
    return bool(memo["hides_state", states])


def _outer_values(function: Any) -> list[bytes]:
    """Return the pickled attributes of a function or object, and the function's outer variables.

    The outer variables are those of its closure, and the globals that it names. A value that pickle
    cannot write is left out.
    """
    values: list[Any] = []
    with suppress(Exception):  # an object without attributes, no function, or an empty cell
        values += vars(getattr(function, "__self__", function)).values()
        variables = getclosurevars(function)
        values += [*variables.nonlocals.values(), *variables.globals.values()]
    pickled = []
    for value in values:
        with suppress(Exception):  # a user's object may raise any error
            pickled.append(pickle.dumps(value))
    return pickled


def argument_sizes(law: Law, states: int) -> dict[str, int]:
    """Return the number of elements of each argument of a law's function, by its name."""
    arguments = law.arguments
    sizes = {name: LAW_INPUTS[name] for name in arguments.inputs}
    sizes |= dict.fromkeys(arguments.gains, 1)
    if arguments.time:
        sizes["time_s"] = 1
    if arguments.state:
        sizes["state"] = states
    return sizes


def _points(law: Law, states: int) -> Array:
    """Return random points of comparison, with a column for each argument's element.

    Gains have their defaults.
    """
    random, gains = np.random.default_rng(0), law.arguments.gains
    points = []
    for count, scale, largest_state, largest_time_s in _SCALES:
        largest: dict[str, Any] = {name: scale * np.array(v) for name, v in _LARGEST.items()}
        largest |= {"state": largest_state, "time_s": largest_time_s}
        columns = []
        for name, size in argument_sizes(law, states).items():
            shares = random.uniform(-1.0, 1.0, (count, size))
            if name != "state":
                shares[:, 0] = np.abs(shares[:, 0])  # positions and times are positive
            is_gain = name in gains
            columns.append(np.full_like(shares, gains[name]) if is_gain else shares * largest[name])
        points.append(np.hstack(columns))
    return random.permutation(np.vstack(points))


def _reason(error: Exception) -> str:
    """Return in words why a call with variables failed, with the line."""
    cause = error.__cause__
    if cause is None:
        return str(error)
    place = place_in_user_code(cause)
    line = f" (line {place[1]})" if place else ""
    if any(f"`{name}`" in text_of(cause) for name in ("__bool__", "__eq__", "__ne__")):
        return f"the function branches on a value{line}"
    if isinstance(cause, TypeError):
        return f"the function needs plain numbers{line}"
    return f"the function raises {type(cause).__name__} for symbolic variables{line}"
