"""Reads the equations of a control law off its function, and compares them with calls."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from inspect import getclosurevars
from itertools import chain
from typing import Any

import numpy as np
from pydrake.symbolic import Expression, Variable

from diagramc import ExpressionGraph, called_twice, differ
from kneexo.common.result import Array
from kneexo.common.user_code import place_in_user_code, text_of
from kneexo.errors import CompilationError, ParameterError
from kneexo.law.call import argument_sizes, call_law, expressions
from kneexo.parameters import CylinderParameters, KneeParameters, Law

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
# Processor time of a pass through the points. 12 ms is a choice: a function that needs longer for
# all points is compared at fewer of them, so a difference at rare points is found less surely.
_MOST_TIME_S = 0.012
_ZERO = Expression(0.0)
_DIFFER = "the equations that were read off differ from calls with numbers"
HIDES_STATE = "the object changes when it is called"
"""The reason for which an object is called as Python, although it may have equations."""


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


def trace(law: Law, states: int) -> Trace:
    """Read the equations off the function of a law, and compare them with calls of the function.

    The equations result from one call with symbolic variables. They are compared with calls with
    numbers. ``states`` is the number of elements of the function's argument ``state``. Values that
    the function reads may change between two runs. So each call of ``trace`` reads the equations
    anew, and repeats the comparison if the equations have changed. Raises `ParameterError` if the
    function hides state that cannot be copied.
    """
    memo, key = law.memo, ("trace", states)
    if key not in memo:
        points = _points(law, states)
        if "if_then_else" in law.names:  # a copy apart finds whether pydrake wants Expressions
            _caller(law, law.copy_of_target(), states)(points[0])
        # With numbers first, because a function may keep what it is called with.
        memo[key] = Trace(_fault(law, states, points, None))
    known: Trace = memo[key]
    if known.why_not_compiled == HIDES_STATE:
        return known
    variables = _variables(tuple(argument_sizes(law, states).items()))
    try:
        results = call_law(law, law.copy_of_target(), expressions(variables))
        equations = [_ZERO + value for value in results]
        if known.graph is not None and known.graph.is_of(equations):
            return known
        graph = ExpressionGraph(equations, [*chain(*variables.values())])
    except (ParameterError, CompilationError) as error:
        return Trace(_reason(error))
    fault = _fault(law, states, _points(law, states), graph)
    memo[key] = Trace(fault, graph, "" if fault else graph.key)
    return memo[key]


@cache
def _variables(sizes: tuple[tuple[str, int], ...]) -> dict[str, Any]:
    """Return a dictionary from the name of an argument to its symbolic variables.

    ``sizes`` has name and number of elements of each argument of the law's function.
    """
    return {name: np.array([Variable(f"{name}{n}") for n in range(size)]) for name, size in sizes}


def replay(law: Law, samples: Array, states: int) -> None:
    """Compare the equations of a law with calls of its function at samples of a run.

    A run reaches values at which `trace` has not compared them. If the equations differ from the
    function there, the `Trace` of the law says so from then on.

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
    traced: Trace = law.memo["trace", states]
    assert traced.graph is not None
    columns = np.hstack([samples, traced.graph.values(samples)])
    extremes = np.concatenate([columns.argmin(axis=0), columns.argmax(axis=0)])
    even = np.linspace(0, len(columns) - 1, min(_SAMPLES, len(columns))).astype(int)
    rows = np.concatenate([extremes, np.random.default_rng(0).permutation(even)])
    traced.why_not_compiled = _fault(law, states, samples[rows], traced.graph, in_run=True)
    traced.replayed = True


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
            return HIDES_STATE
        if graph is None:
            return ""
        finite = np.isfinite(numbers).all(axis=1)
        if not finite.any():
            return "the function fails for numbers within the usual range"
        fails = in_run and not finite.all()
        return _DIFFER if fails or differ(first, points, graph.values(points), numbers) else ""


def _caller(law: Law, function: Any, states: int) -> Callable[[Array], list[Any]]:
    """Return ``call(point)``, which calls ``function`` with the arguments in an array (size,).

    The result is a list of the command and the next state. All are nan if the function fails.
    """
    places, first = {}, 0
    for name, size in argument_sizes(law, states).items():
        places[name] = slice(first, first := first + size)

    def call(point: Array) -> list[Any]:
        try:
            return call_law(law, function, {name: point[place] for name, place in places.items()})
        except ParameterError:
            return [math.nan] * (1 + states)

    return call


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
    """Return in words why a call of the law's function with symbolic variables failed.

    The text names the line of the function if this line is known.
    """
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
