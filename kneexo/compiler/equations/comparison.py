"""Compares equations with the Python code that they were read from, by numbers."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from os import sep
from pathlib import Path
from typing import Any

import numpy as np

from ..run_data import Array, State
from .contexts import discrete_values, parameters_of, set_parameters, set_state, state_of
from .tree import Node

TOLERANCE = 1e-9  # sums in another order; conditioning of a law with gains up to 1e6
_NEAR = 16  # random signs of the rounding errors of the inputs; as many as the signs of four inputs
_SCALES = (0.0, 1e-3, 1e-3, 0.1, 0.1, 1.0, 1.0, 10.0, 10.0)
"""Distance from the Context of each point where a leaf is compared."""


def differ(
    function: Callable[[Array], Array],
    points: Array,
    found: Array,
    numbers: Array,
    inexact: Iterable[int] = (),
) -> bool:
    """Return whether equations gave other values than the function that they were read from.

    Equations round differently, which decides at a branch. So values between those that the
    function returns near the point count as equal too. Flags and counters are whole numbers, which
    do not change near the point, because they have no rounding error.

    Parameters
    ----------
    function
        Returns the values (values,) at a point (size,).
    points
        Points, (points, size).
    found, numbers
        Values of the equations and of the function, (points, values).
    inexact
        Indices of elements of a point that have rounding errors also if they are whole, such as the
        time.
    """
    random = np.random.default_rng(0)
    close = np.isclose(found, numbers, TOLERANCE, TOLERANCE, equal_nan=True)
    for row in np.nonzero(~close.all(axis=1))[0].tolist():
        point = points[row]
        exact = point == np.rint(point)
        exact[[*inexact]] = False
        errors = np.where(exact, 0.0, random.choice([-TOLERANCE, TOLERANCE], (_NEAR, point.size)))
        near = np.array([numbers[row], *(function(point * (1.0 + error)) for error in errors)])
        slack = TOLERANCE * (1.0 + np.abs(near).max(axis=0))
        inside = (near.min(axis=0) - slack <= found[row]) & (found[row] <= near.max(axis=0) + slack)
        if not inside.all():
            return True
    return False


_trusted = [f"{Path(__file__).parents[1]}{sep}"]


def trust(folder: str | Path) -> None:
    """Compile leaf systems from Python files of a folder without a comparison with their calls."""
    _trusted.append(f"{folder}{sep}")


def is_compared(system: Any) -> bool:
    """Return whether a leaf system is written in Python, but not in a folder with `trust`."""
    names = {kind.__module__ for kind in type(system).__mro__}
    users = [name for name in names if not name.startswith(("builtins", "pydrake", "pybind11"))]
    files = [getattr(sys.modules.get(name), "__file__", None) or "" for name in users]
    return not all(file.startswith(tuple(_trusted)) for file in files)


def points_around(values: Array, random: np.random.Generator, scale: float = 1.0) -> Array:
    """Return values (size,) at the Context, and at eight points around it, (size, 9).

    With the ``scale`` 0 the values change by a tenth at most, so that a zero stays zero.
    """
    pairs = random.uniform(-1.0, 1.0, (2, values.size, len(_SCALES) // 2))
    changes = np.zeros((2, values.size, len(_SCALES)))
    changes[:, :, 1::2], changes[:, :, 2::2] = pairs, -pairs  # on both sides of each value
    return values[:, None] * (1.0 + 0.1 * changes[0]) + scale * np.array(_SCALES) * changes[1]


def differing_part(
    system: Any, points: Array, inputs: Mapping[int, int], read: Mapping[str, Array]
) -> str:
    """Return what a leaf of floats computes otherwise than its equations; empty if nothing.

    The leaf is called at each point, without cached values, and once more in reverse order, which
    finds state that it hides. A point where it fails or is not finite does not count.

    Parameters
    ----------
    system
        The leaf system of floats.
    points
        Time, parameters, continuous and discrete states, and inputs at each point, (points, size).
    inputs
        Number of elements of each input port that has a value, by its index.
    read
        Values of the equations (points, values), by the name of what was read: the name of an
        output port after ``output port``, or ``time derivatives`` or ``discrete update``.
    """
    for part, found in read.items():

        def value(row: Array, part: str = part, size: int = found.shape[1]) -> Array:
            try:
                return _value(system, part, row, inputs)
            except (Exception, SystemExit):  # a user's code may raise any error, and Drake exits
                return np.full(size, np.nan)

        forward = np.array([value(row) for row in points])
        backward = np.array([value(row) for row in points[::-1]])[::-1]
        counts = np.isfinite(forward).all(axis=1)
        hides = not np.array_equal(forward, backward, equal_nan=True)
        if hides or differ(value, points[counts], found[counts], forward[counts], inexact=[0]):
            return part
    return ""


def _value(system: Any, part: str, row: Array, inputs: Mapping[int, int]) -> Array:
    """Return the values of a part of a leaf at a point: see `differing_part`."""
    node, context = Node(system), system.CreateDefaultContext()
    context.DisableCaching()
    state = state_of(node, context)
    sizes = [1, parameters_of(node, context).size, state.continuous.size, state.discrete.size]
    ends = np.cumsum([*sizes, *inputs.values()])[:-1]
    (time_s,), parameters, continuous, discrete, *values = np.split(row, ends)
    context.SetTime(time_s)
    set_parameters(node, context, parameters)
    set_state(node, context, State(continuous, discrete))
    for index, value in zip(inputs, values, strict=True):
        system.get_input_port(index).FixValue(context, value)
    if part == "time derivatives":
        return system.EvalTimeDerivatives(context).CopyToVector()
    if part == "discrete update":
        return np.array(discrete_values(system.EvalUniquePeriodicDiscreteUpdate(context)))
    return np.array(system.GetOutputPort(part.removeprefix("output port ")).Eval(context))
