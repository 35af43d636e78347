"""Newton's method, which finds equilibria."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ..run_data import Array

NEWTON_STEPS = 50
"""Largest number of Newton steps."""

_RANK_TOLERANCE = 1e-14
_STEP_TOLERANCE = 1e-13
# A smaller step that does not reduce the residual is a rounding error. Rates of 1e12 1/s, for
# example, are wrong by 1e-4 1/s, and no step brings them to zero.
_ROUNDING = 1e-9


def newton(function: Callable[[Array], tuple[Array, Array]], start: Array) -> Array:
    """Search a zero of a vector function by Newton's method; return the last point (n,).

    Each step is the least-squares solution of the linear equations with the smallest norm, so that
    a variable without influence keeps its value. Singular values of the Jacobian below 1e-14 of the
    largest one count as zero. The search ends after `NEWTON_STEPS` steps, when the step of each
    variable is below 1e-13 (1 + |variable|), or when steps below 1e-9 (1 + |variable|) no longer
    reduce the largest absolute value of the function. The search also ends at a point where a value
    or a derivative of the function is not finite.

    Parameters
    ----------
    function
        Returns its values (m,) and its Jacobian (m, n) at a point (n,).
    start
        Point from which the search starts, (n,).
    """
    point, residual = start, math.inf
    for _ in range(NEWTON_STEPS):
        values, jacobian = function(point)
        if not (np.isfinite(jacobian).all() and np.isfinite(values).all()):
            break
        before, residual = residual, float(np.max(np.abs(values)))
        step = np.linalg.lstsq(jacobian, values, rcond=_RANK_TOLERANCE)[0]
        point = point - step
        largest = np.max(np.abs(step) / (1.0 + np.abs(point)))
        if largest < _STEP_TOLERANCE or (largest < _ROUNDING and residual >= before):
            break
    return point
