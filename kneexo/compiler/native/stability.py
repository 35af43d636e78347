"""Judges by eigenvalues whether steps of a Runge-Kutta integrator were unstable.

The machine code only suspects a step: see `integrators`. Here the Jacobian of the rates decides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from ..run_data import Array, State

STABILITY = {
    "rk4": (1.0, 1.0, 1.0 / 2.0, 1.0 / 6.0, 1.0 / 24.0),
    "runge_kutta3": (1.0, 1.0, 1.0 / 2.0, 1.0 / 6.0),
}
"""Coefficients of each integrator's R(z): a step of length h multiplies the mode λ by R(h λ)."""

SAFETY = 0.5
"""Ratio of the step that an error names and the longest stable step that was found.

Only the suspected steps are judged, and a correct run meets other states than an unstable one.
"""

_HALVINGS = 12
_EVEN_GROWTH = 1.05
"""Largest ratio of |R(z)| and |exp(z)| of a step that is accurate for a growing mode."""

Rates = Callable[[float, Array, Array, Array], tuple[Array, Array]]
"""``rates(t, x, d, u)`` returns dx/dt (states,) and its Jacobian (states, states)."""


@dataclass(frozen=True)
class UnstableStep:
    """The first unstable step of a run.

    ``time_s`` and ``state``: start of the step; ``step_s``: its length. ``eigenvalue``: the mode λ
    in 1/s that the step amplifies; ``shares`` (states,): participation factors of the states in
    this mode, with the sum one. ``stable_s``: longest stable step at all unstable steps that were
    logged, in s.
    """

    time_s: float
    step_s: float
    state: State
    eigenvalue: complex
    shares: Array
    stable_s: float


@cache
def _reach(integrator: str) -> tuple[Array, Array]:
    """Return angles in 0 … π, and the largest stable |z| of z at each angle; inf without a limit.

    A step is unstable for a mode that decays if |R(z)| > 1. For a mode that grows it is unstable if
    |R(z)| exceeds |exp(z)|, the growth in the exact solution, by 5 %. Below |z| = 1 it is stable.
    """
    angles, radii = np.linspace(0.0, np.pi, 721), np.linspace(1.0, 4.0, 3001)[:, None]
    z = radii * np.exp(1j * angles)
    growth = np.abs(np.polynomial.polynomial.polyval(z, STABILITY[integrator]))
    unstable = growth > np.maximum(1.0, _EVEN_GROWTH * np.exp(z.real))
    return angles, np.where(unstable.any(axis=0), radii[unstable.argmax(axis=0), 0], np.inf)


def excess(integrator: str, h_lambda: Array) -> Array:
    """Return |z| divided by the largest stable |z| of the same argument, for each z = h λ (n,)."""
    return np.abs(h_lambda) / np.interp(np.abs(np.angle(h_lambda)), *_reach(integrator))


def unstable_step(
    integrator: str, rates: Rates, suspects: Array, sizes: tuple[int, int]
) -> UnstableStep | None:
    """Return the first unstable step among the logged steps of a run; None if all are stable.

    ``suspects`` (n, 3 + states + discrete states + inputs): see `RUN`; ``sizes``: numbers of
    continuous and of discrete states.
    """
    first: UnstableStep | None = None
    stable_s = np.inf
    for row in suspects:
        t, h = row[1], row[2]
        x, d, u = np.split(row[3:], np.cumsum(sizes))
        jacobian = _steepest(integrator, lambda z, at=(t, d, u): rates(at[0], z, *at[1:]), x, h)
        if not np.isfinite(jacobian).all():
            continue
        values, vectors = np.linalg.eig(jacobian)
        excesses = excess(integrator, h * values)
        worst = int(np.argmax(excesses))
        if excesses[worst] <= 1.0:
            continue
        stable_s = min(stable_s, h / excesses[worst])
        if first is None:
            parts = np.abs(vectors[:, worst] * np.linalg.pinv(vectors)[worst])
            shares = parts / parts.sum()
            first = UnstableStep(t, h, State(x, d), complex(values[worst]), shares, stable_s)
    return first and replace(first, stable_s=float(stable_s))


def _steepest(
    integrator: str, rates: Callable[[Array], tuple[Array, Array]], x: Array, h: float
) -> Array:
    """Return the Jacobian where the rates change most between two stages of a step.

    Between the stages may lie a short range with other derivatives, such as the band in which
    friction changes its sign. Bisection finds the steepest place.
    """
    scale = 1.0 + np.abs(x)
    points = [(x, *rates(x))]
    for z in _stages(integrator, points, h):
        points.append((z, *rates(z)))

    def slope(ends: tuple[Any, Any]) -> float:
        (z, f, _), (other_z, other_f, _) = ends
        change = np.linalg.norm((other_z - z) / scale)
        return float(np.linalg.norm((other_f - f) / scale) / change) if change > 0.0 else 0.0

    a, b = max(pairwise(points), key=slope)
    for _ in range(_HALVINGS):
        z = 0.5 * (a[0] + b[0])
        middle = (z, *rates(z))
        a, b = max(((a, middle), (middle, b)), key=slope)
    return b[2]


def _stages(integrator: str, points: list[Any], h: float) -> Iterator[Array]:
    """Yield the states at the further stages; the caller appends each with its rates."""
    x, k1, _ = points[0]
    yield x + 0.5 * h * k1
    if integrator == "rk4":
        yield x + 0.5 * h * points[1][1]
        yield x + h * points[2][1]
    else:
        yield x + h * (2.0 * points[1][1] - k1)
