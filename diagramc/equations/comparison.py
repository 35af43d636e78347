"""Compares equations with the Python code that they were read from, by numbers."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Sequence
from os import sep
from pathlib import Path
from time import process_time
from typing import Any, TypeAlias

import numpy as np
from pydrake.autodiffutils import AutoDiffXd

from ..run_data import Array
from .contexts import discrete_values, sources_of

_TOLERANCE = 1e-9  # sums in another order; conditioning of a law with gains up to 1e6
_NEAR = 16  # random signs of the rounding errors of the inputs; as many as the signs of four inputs
_SCALES = (0.0, 1e-3, 1e-3, 0.1, 0.1, 1.0, 1.0, 10.0, 10.0)
"""Distance from the Context of each point where a leaf is compared.

Each distance but zero has two points, one on each side, so that a branch at the Context is met.
"""


Function: TypeAlias = Callable[[Array], Sequence[float]]
"""A function that returns values (values,) at a point (size,)."""
Evaluate: TypeAlias = Callable[[Any, Any], Sequence[Any]]
"""A function of a leaf system and its Context, both of floats or both symbolic."""


def called_twice(
    first: Function, second: Function, points: Array, most_time_s: float = math.inf
) -> tuple[Array, bool]:
    """Call a function at points, and then a copy of it in reverse order.

    A function with hidden state, such as a counter of its calls, then gives other values.

    Returns the values (points, values) of the first, and whether the second gives equal values.

    Parameters
    ----------
    first, second
        The function and its copy. Where they raise an error, their values must be nan.
    points
        Points, (points, size).
    most_time_s
        Processor time for the first function. The points that it does not reach are left out.
    """
    until, rows = process_time() + most_time_s, []
    for point in points:
        rows.append(first(point))
        if process_time() > until:
            break
    again = [second(point) for point in points[: len(rows)][::-1]]
    return np.array(rows), np.array_equal(rows, again[::-1], equal_nan=True)


def differ(function: Function, points: Array, found: Array, numbers: Array) -> bool:
    """Return whether equations gave other values than the function that they were read from.

    Points where the function is not finite do not count.

    Equations round differently than the function, and at a branch a rounding error can decide. So
    the function is called near each point that differs, and a value between its results counts as
    equal. Flags and counters, which are whole numbers at all points, have no rounding error and are
    not changed for these calls.

    Parameters
    ----------
    function
        The function.
    points
        Points, (points, size).
    found, numbers
        Values of the equations and of the function, (points, values).
    """
    # A fixed seed: an equal function passes or fails each time.
    random = np.random.default_rng(0)
    exact = (points == np.rint(points)).all(axis=0)
    close = np.isclose(found, numbers, _TOLERANCE, _TOLERANCE).all(axis=1)
    for row in np.nonzero(np.isfinite(numbers).all(axis=1) & ~close)[0].tolist():
        point = points[row]
        errors = np.where(exact, 0.0, random.choice([-_TOLERANCE, _TOLERANCE], (_NEAR, point.size)))
        near = np.array([numbers[row], *(function(point * (1.0 + error)) for error in errors)])
        slack = _TOLERANCE * (1.0 + np.abs(near).max(axis=0))
        inside = (near.min(axis=0) - slack <= found[row]) & (found[row] <= near.max(axis=0) + slack)
        if not inside.all():
            return True
    return False


def rates_of(system: Any, context: Any) -> Any:
    """Return the time derivatives of a leaf system."""
    return system.EvalTimeDerivatives(context).CopyToVector().tolist()


def update_of(system: Any, context: Any) -> list[Any]:
    """Return the discrete states of a leaf system after its periodic update."""
    return discrete_values(system.EvalUniquePeriodicDiscreteUpdate(context))


def margin_of(system: Any, context: Any) -> list[Any]:
    """Return the margin of a leaf system, which has one."""
    return [system.margin(context)]


def output_of(index: int) -> Evaluate:
    """Return the function of a leaf system and its Context that gives an output port's value."""
    return lambda system, context: system.get_output_port(index).Eval(context)


def values_and_gradients(duals: Iterable[Any], width: int) -> tuple[Array, Array]:
    """Return the values (size,) of scalars of AutoDiffXd, and their gradients (size, width)."""
    zero = AutoDiffXd(0.0, np.zeros(width))  # Drake leaves out gradients of zero
    full = [zero + dual for dual in duals]
    gradients = np.array([dual.derivatives() for dual in full])
    return np.array([dual.value() for dual in full]), gradients.reshape(-1, width)


def central_differences(function: Function, point: Array, change: Array) -> tuple[Array, Array]:
    """Return the effects of a change (size,) by central differences over the change and half of it.

    The extrapolation of Richardson is (4 half − wide)/3. The results have the shape (values,).
    """
    wide, half = (
        np.subtract(function(point + near), function(point - near)) for near in (change, change / 2)
    )
    return wide / 2.0, half


_trusted = [f"{Path(__file__).parents[1]}{sep}"]


def trust(folder: str | Path) -> None:
    """Compile leaf systems from Python files of a folder without a comparison with their calls."""
    _trusted.append(f"{folder}{sep}")


def is_compared(system: Any) -> bool:
    """Return whether the equations of a leaf system are compared with calls of the leaf.

    They are compared if the leaf has a class in Python outside pydrake, outside diagramc, and
    outside the folders that `trust` got.
    """
    names = {kind.__module__ for kind in type(system).__mro__}
    users = [name for name in names if not name.startswith(("builtins", "pydrake", "pybind11"))]
    files = [getattr(sys.modules.get(name), "__file__", None) or "" for name in users]
    return not all(file.startswith(tuple(_trusted)) for file in files)


def points_around(values: Array, random: np.random.Generator, scale: float | Array = 1.0) -> Array:
    """Return values (size,) at the Context, and at eight points around it, (size, 9).

    With the ``scale`` 0 the values change by a tenth at most, so that a zero stays zero. An array
    (size, 1) has a scale for each value.
    """
    pairs = random.uniform(-1.0, 1.0, (2, values.size, len(_SCALES) // 2))
    changes = np.zeros((2, values.size, len(_SCALES)))
    changes[:, :, 1::2], changes[:, :, 2::2] = pairs, -pairs  # on both sides of each value
    return values[:, None] * (1.0 + 0.1 * changes[0]) + scale * np.array(_SCALES) * changes[1]


class CalledLeaf:
    """A leaf system of any scalar type as a function of points.

    A point has the time, parameters, continuous and discrete states, and inputs, (size,).

    Parameters
    ----------
    system
        The leaf system.
    inputs
        Indices of the input ports that have a value, which must be vectors.
    base
        Context of floats with the time and all parameters. A point then has neither.
    """

    def __init__(self, system: Any, inputs: Iterable[int], base: Any = None) -> None:
        self.system, self.base = system, base
        self.error: BaseException | None = None
        """What the leaf raised when it was last called in vain."""
        self.sources = sources_of(system, inputs, states_only=base is not None)
        ends = np.cumsum([source.size for source in self.sources]).tolist()
        self.places = [slice(e - s.size, e) for s, e in zip(self.sources, ends, strict=True)]

    def context(self, point: Any) -> Any:
        """Return a new Context at a point."""
        context = self.system.CreateDefaultContext()
        if self.base is not None:
            context.SetTimeStateAndParametersFrom(self.base)
        for source, place in zip(self.sources, self.places, strict=True):
            source.write(context, point[place])
        return context

    def point(self, context: Any) -> list[Any]:
        """Return the point of a Context."""
        return [scalar for source in self.sources for scalar in source.read(context)]

    def function(self, evaluate: Evaluate, size: int) -> Function:
        """Return the function of a point that ``evaluate`` gives; nan (size,) where it fails."""

        def values(point: Array) -> Sequence[float]:
            try:
                with np.errstate(all="ignore"):  # points without a finite value do not count
                    return evaluate(self.system, self.context(point))
            except (Exception, SystemExit) as error:  # a user's code may raise any; Drake exits
                self.error = error
                return [math.nan] * size

        return values
