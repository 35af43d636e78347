"""Calls the function of a control law, and checks what it returns."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from numbers import Real
from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression

from diagramc import truth_of_scalars
from kneexo.common.user_code import text_of, user_code
from kneexo.errors import ParameterError, SimulationError, shortened
from kneexo.parameters import LAW_INPUTS, Law


def argument_sizes(law: Law, states: int) -> dict[str, int]:
    """Return the number of elements of each argument of a law's function, by its name."""
    sizes = LAW_INPUTS | {"time_s": 1, "state": states}
    return {name: sizes.get(name, 1) for name in law.arguments.names}


def call_law(law: Law, function: Any, values: Mapping[str, Any]) -> list[Any]:
    """Call the function of a law; return the command in rad/s and then the next state.

    ``values`` has an array for each argument, and may have more. The function gets a scalar for an
    array of one element, except for ``state``. A constant Expression in the result of a call with
    numbers, such as pydrake's ``if_then_else`` returns, becomes a float. Raises `ParameterError` if
    the function fails or returns something else.
    """
    arguments = {name: values[name] for name in law.arguments.names}
    kinds = {type(value) for values in arguments.values() for value in values}
    scalars = kinds & {AutoDiffXd, Expression}
    # With numbers, pydrake's if_then_else returns constant Expressions.
    has_scalars = scalars or "if_then_else" in law.names
    with user_code(f"law {law.short_name}: the function fails"):
        # NumPy raises false alarms for arrays of Expression.
        false_alarms = np.errstate(invalid="ignore") if has_scalars else nullcontext()
        with truth_of_scalars() if has_scalars else nullcontext(), false_alarms:
            if law.memo.get("needs_constants") and not scalars:
                arguments = expressions(arguments)
            try:
                result = function(**_plain(arguments))
            except TypeError as error:
                # Drake 1.58 accepts no comparison of NumPy scalars, but one of Expressions.
                # `trace` finds that out with a copy, so a run calls no object twice.
                known = scalars or law.memo.get("needs_constants")
                if known or "if_then_else()" not in text_of(error):
                    raise
                law.memo["needs_constants"] = True
                return call_law(law, function, arguments)
        return _checked_result(law, arguments, result, scalars)


def _checked_result(
    law: Law, arguments: Mapping[str, Any], result: Any, scalars: set[type]
) -> list[Any]:
    """Return the command and the next state that a function has returned: see `call_law`.

    Values of the types ``scalars`` are returned unchanged, and all others as floats.
    """
    parts, count = [result], 1
    expected = "must return the motor speed in rad/s, one number"
    if "state" in arguments:
        size = arguments["state"].size
        expected = f"must return (command, next_state), with {size} numbers in next_state"
        is_pair = isinstance(result, tuple | list) and len(result) == 2
        parts, count = list(result) if is_pair else [], 1 + size
    values = [value for part in parts for value in np.asarray(part, dtype=object).reshape(-1)]
    suited = all(isinstance(v, _NUMBERS) and not isinstance(v, _NO_NUMBERS) for v in values)
    # NumPy replaces a masked value by zero.
    suited &= not any(type(p) not in _UNMASKED and np.ma.is_masked(p) for p in parts)
    if len(values) != count or np.size(parts[0]) != 1 or not suited:
        shown = shortened(" ".join(repr(result).split()), 60)
        raise ParameterError(f"law {law.short_name}: returns {shown}; {expected}")
    return [v if type(v) in scalars else _number(v) for v in values]


_NUMBERS = (Real, Expression, AutoDiffXd)
_NO_NUMBERS = (bool, np.timedelta64)  # although they are instances of Real
_UNMASKED = (float, int, list, tuple, np.float64, np.ndarray, Expression, AutoDiffXd)
"""Types that need no import of ``numpy.ma``, which takes 20 ms."""


def _number(value: Any) -> float:
    """Return a number or a constant Expression as a float."""
    return float(value.Evaluate() if isinstance(value, Expression) else value)


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


def expressions(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return arrays of numbers or variables as arrays of Expressions."""
    return {name: np.array([Expression(v) for v in values]) for name, values in arguments.items()}
