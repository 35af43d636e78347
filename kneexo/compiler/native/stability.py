"""Judges by eigenvalues whether steps of a Runge-Kutta integrator were unstable.

The machine code only suspects a step: see `integrators`. Here the Jacobian of the rates decides.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise
from typing import Any

import numpy as np

from ..run_data import Array, State

STABILITY = {
    "rk4": (1.0, 1.0, 1.0 / 2.0, 1.0 / 6.0, 1.0 / 24.0),
    "runge_kutta3": (1.0, 1.0, 1.0 / 2.0, 1.0 / 6.0),
}
"""Coefficients of each integrator's R(z): a step of length h multiplies the mode λ by R(h λ)."""

_STAGES: dict[str, tuple[tuple[float, ...], ...]] = {
    "rk4": ((0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    "runge_kutta3": ((0.5,), (-1.0, 2.0)),
}
"""Weights by which a step multiplies the rates before each further stage (Butcher's table)."""

SAFETY = 0.2
"""Ratio of the step that an error names and the longest stable step in the state of the error.

In other states of the run a mode may be faster, and accuracy requires a shorter step too.
"""

_HALVINGS = 12
"""Number of bisections: a band of 1/4000 of the way between two stages is found."""

_LARGEST_ERROR = 0.05
"""Largest error in a step of an oscillation, relative to its amplitude.

RK4 reaches it at h |λ| = 1.4. Up to 2.83 RK4 is stable, but damps the oscillation like nothing in
the plant does: load pressures were 29 % wrong.
"""

Rates = Callable[[float, Array, Array, Array], tuple[Array, Array]]
"""``rates(t, d, u, x)`` returns dx/dt (states,) and its Jacobian (states, states)."""


@dataclass(frozen=True)
class UnstableStep:
    """The first unstable step of a run.

    ``time_s`` and ``state``: start of the step; ``step_s``: its length. ``eigenvalue``: the mode λ
    in 1/s that the step does not follow; ``shares`` (states,): participation factors of the states
    in this mode. ``safe_s``: `SAFETY` times the longest stable step in s.
    """

    time_s: float
    step_s: float
    state: State
    eigenvalue: complex
    shares: Array
    safe_s: float


@cache
def _reach(integrator: str) -> tuple[Array, Array]:
    """Return angles in 0 … π, and for each the largest |z| whose step does not fail.

    A step fails for a mode that decays faster than it oscillates if |R(z)| > 1. For an oscillation
    it fails if R(z) differs too much from exp(z), the exact solution: see `_LARGEST_ERROR`. A mode
    that grows faster than it oscillates has no limit, because the equations themselves diverge.
    """
    angles, radii = np.linspace(0.0, np.pi, 721), np.linspace(1.0, 4.0, 3001)[:, None]
    z = radii * np.exp(1j * angles)
    factor = np.polynomial.polynomial.polyval(z, STABILITY[integrator])
    error = np.abs(factor - np.exp(z)) / np.maximum(1.0, np.exp(z.real))
    decays = z.real < -np.abs(z.imag)
    fails = np.where(decays, np.abs(factor) > 1.0, error > _LARGEST_ERROR)
    return angles, np.where(angles < 0.25 * np.pi, 1e300, radii[fails.argmax(axis=0), 0])


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
    for _, t, h, *vectors in suspects:
        x, d, u = np.split(np.array(vectors), np.cumsum(sizes))
        with np.errstate(all="ignore"):  # a run that diverges overflows
            places = (_steepest(integrator, partial(rates, t, d, u), x, h), rates(t, d, u, x)[1])
        jacobian = next((j for j in places if np.isfinite(j).all()), np.eye(len(x)))
        values, modes = np.linalg.eig(jacobian)
        excesses = excess(integrator, h * values)
        worst = int(np.argmax(excesses))
        if excesses[worst] > 1.0:
            shares = np.abs(modes[:, worst] * np.linalg.pinv(modes)[worst])
            safe_s = SAFETY * h / float(excesses[worst])
            start = State(x, d)
            return UnstableStep(float(t), h, start, complex(values[worst]), shares, safe_s)
    return None


def _steepest(
    integrator: str, rates: Callable[[Array], tuple[Array, Array]], x: Array, h: float
) -> Array:
    """Return the Jacobian where the rates change most between two stages of a step.

    Between the stages may lie a short range with other derivatives, such as the band in which
    friction changes its sign. Bisection finds the steepest place.
    """
    points, scale = [(x, *rates(x))], 1.0 + np.abs(x)
    for weights in _STAGES[integrator]:
        z = x + h * sum(w * point[1] for w, point in zip(weights, points, strict=False))
        points.append((z, *rates(z)))

    def slope(ends: tuple[Any, Any]) -> float:
        (z, f, _), (other_z, other_f, _) = ends
        rise, run = (np.linalg.norm(v / scale) for v in (other_f - f, other_z - z))
        return float(rise / run) if run > 0.0 else 0.0

    a, b = max(pairwise(points), key=slope)
    for _ in range(_HALVINGS):
        z = 0.5 * (a[0] + b[0])
        middle = (z, *rates(z))
        a, b = max(((a, middle), (middle, b)), key=slope)
    return b[2]
