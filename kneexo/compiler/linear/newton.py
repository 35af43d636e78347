"""Newton's method, which finds equilibria."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ..run_data import Array

NEWTON_STEPS = 50
"""Largest number of Newton steps."""

_STEP_TOLERANCE = 1e-13
_ROUNDING = 1e-9  # a smaller step that does not reduce the residual is a rounding error


def newton(
    function: Callable[[Array], tuple[Array, Array]],
    start: Array,
    *,
    rank_tolerance: float | None = None,
    relative: bool = False,
) -> tuple[Array, float]:
    """Search a zero of a vector function by Newton's method; return point (n,) and residual.

    Each step is the least-squares solution of the linear equations with the smallest norm, so that
    a variable without influence keeps its value. The search ends after `NEWTON_STEPS` steps, when
    the step of each variable is below 1e-13, or when steps below 1e-9 no longer reduce the
    residual. The residual is the largest absolute value of the function before the last step. If a
    value or a derivative of the function is not finite, the residual is nan, and the search ends at
    once.

    Parameters
    ----------
    function
        Returns its values (m,) and its Jacobian (m, n) at a point (n,).
    start
        Point from which the search starts, (n,).
    rank_tolerance
        Singular values of the Jacobian below this share of the largest one count as zero. None: the
        default of `numpy.linalg.lstsq`.
    relative
        True: the bounds on the steps are factors of 1 + |variable|. False: they are absolute.
    """
    point, residual = start, math.inf
    for _ in range(NEWTON_STEPS):
        values, jacobian = function(point)
        if not (np.isfinite(jacobian).all() and np.isfinite(values).all()):
            return point, math.nan
        before, residual = residual, float(np.max(np.abs(values)))
        step = np.linalg.lstsq(jacobian, values, rcond=rank_tolerance)[0]
        point = point - step
        scale = 1.0 + np.abs(point) if relative else 1.0
        largest = np.max(np.abs(step) / scale)
        if largest < _STEP_TOLERANCE or (largest < _ROUNDING and residual >= before):
            break
    return point, residual
