"""Compares equations with the Python code that they were read from, by numbers."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from os import sep
from pathlib import Path
from typing import Any

import numpy as np
import pydrake

from ..run_data import Array

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


@dataclass(frozen=True)
class LeafPoints:
    """Points at which a leaf system is evaluated. Each array has a column for each point."""

    time_s: Array
    parameters: Array
    continuous: Array
    discrete: Array
    inputs: Mapping[int, Array]
    """Values of the connected input ports, by their index."""

    @property
    def rows(self) -> Array:
        """All values in one array, (points, size), with the time first."""
        parts = self.time_s[None], self.parameters, self.continuous, self.discrete
        return np.concatenate([*parts, *self.inputs.values()]).T


def is_compared(system: Any, trusted: Iterable[str | Path]) -> bool:
    """Return whether a leaf system is written in Python by a user.

    Such a leaf lies outside pydrake, this compiler and the folders ``trusted``.
    """
    module = sys.modules.get(type(system).__module__)
    file = getattr(module, "__file__", None) or ""
    folders = Path(pydrake.__file__).parent, Path(__file__).parents[1], *trusted
    return not file.startswith(tuple(f"{Path(folder)}{sep}" for folder in folders))


def points_around(values: Array, random: np.random.Generator, spread: bool = True) -> Array:
    """Return values (size,) at the Context, and at eight points around it, (size, 9).

    Without ``spread`` the values change by a tenth at most, so that a zero stays zero.
    """
    changes = random.uniform(-1.0, 1.0, (2, values.size, len(_SCALES)))
    around = values[:, None] * (1.0 + 0.1 * np.sign(_SCALES) * changes[0])
    return around + (np.array(_SCALES) * changes[1] if spread else 0.0)


def differing_part(system: Any, points: LeafPoints, read: Mapping[str, Array]) -> str:
    """Return what a leaf of floats computes otherwise than its equations; empty if nothing.

    The leaf is called at each point, without cached values, and once more in reverse order, which
    finds state that it hides. A point where it fails or is not finite does not count.

    Parameters
    ----------
    system
        The leaf system of floats.
    points
        The points.
    read
        Values of the equations (values, points), by the name of what was read: the name of an
        output port after ``output port``, or ``time derivatives`` or ``discrete update``.
    """
    rows = points.rows
    for part, found in read.items():

        def value(row: Array, part: str = part, size: int = len(found)) -> Array:
            return _value(system, points, part, row, size)

        forward = np.array([value(row) for row in rows])
        backward = np.array([value(row) for row in rows[::-1]])[::-1]
        for numbers in (forward, backward):
            counts = np.isfinite(numbers).all(axis=1)
            if differ(value, rows[counts], found.T[counts], numbers[counts], inexact=[0]):
                return part
    return ""


def _value(system: Any, points: LeafPoints, part: str, row: Array, size: int) -> Array:
    """Return the values (size,) of a part of a leaf at a row of points; nan where it fails."""
    context = system.CreateDefaultContext()
    context.DisableCaching()
    values = row.tolist()

    def taken(count: int) -> list[float]:
        first = values[:count]
        del values[:count]
        return first

    try:
        context.SetTime(taken(1)[0])
        for group in range(context.num_numeric_parameter_groups()):
            vector = context.get_mutable_numeric_parameter(group)
            vector.SetFromVector(taken(vector.size()))
        if context.num_continuous_states():
            context.SetContinuousState(taken(context.num_continuous_states()))
        for group in range(context.num_discrete_state_groups()):
            vector = context.get_mutable_discrete_state(group)
            vector.SetFromVector(taken(vector.size()))
        for index, elements in points.inputs.items():
            system.get_input_port(index).FixValue(context, taken(len(elements)))
        if part == "time derivatives":
            result = system.EvalTimeDerivatives(context).CopyToVector()
        elif part == "discrete update":
            updated = system.EvalUniquePeriodicDiscreteUpdate(context)
            groups = range(updated.num_groups())
            result = np.concatenate([updated.get_vector(group).CopyToVector() for group in groups])
        else:
            result = system.GetOutputPort(part.removeprefix("output port ")).Eval(context)
        return np.array(result, dtype=float)
    except (Exception, SystemExit):  # a user's code may raise any error, and Drake exits
        return np.full(size, np.nan)
