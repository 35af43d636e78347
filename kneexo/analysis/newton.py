"""Newton's method for the equilibria of plant and loop."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from kneexo.result import Array

NEWTON_STEPS = 50
"""Largest number of Newton steps."""

_STEP_TOLERANCE = 1e-13


def newton(
    function: Callable[[Array], tuple[Array, Array]],
    start: Array,
    *,
    rank_tolerance: float | None = None,
    relative: bool = False,
) -> tuple[Array, float]:
    """Search a zero of a vector function from ``start`` (n,); return the point and the residual.

    ``function`` returns values (m,) and Jacobian (m, n) at a point. Each step solves the linear
    equations with the smallest norm of the step, so that a variable without influence keeps its
    value. Singular values below ``rank_tolerance`` times the largest count as zero (None: the
    default of `numpy.linalg.lstsq`).

    The search ends after `NEWTON_STEPS` steps, or after a step below 1e-13 in each variable; with
    ``relative`` below 1e-13 (1 + |variable|). The residual is the largest absolute value of the
    function before the last step. It is nan when the search meets a value or a derivative that is
    not finite.
    """
    point, residual = start, math.inf
    for _ in range(NEWTON_STEPS):
        values, jacobian = function(point)
        if not (np.isfinite(jacobian).all() and np.isfinite(values).all()):
            return point, math.nan
        residual = float(np.max(np.abs(values)))
        step = np.linalg.lstsq(jacobian, values, rcond=rank_tolerance)[0]
        point = point - step
        scale = 1.0 + np.abs(point) if relative else 1.0
        if np.max(np.abs(step) / scale) < _STEP_TOLERANCE:
            break
    return point, residual


def failure(residual: float, quantity: str) -> str:
    """Return the part of an error message that says why `newton` found no zero.

    ``quantity`` names the numbers of which ``residual`` is the largest absolute value.
    """
    if math.isnan(residual):
        return "Newton's method goes where the equations are not finite"
    return f"the largest {quantity} left is {residual:.3g}"
