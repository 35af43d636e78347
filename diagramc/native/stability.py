"""Judges by eigenvalues whether steps of a Runge-Kutta integrator were unstable.

The machine code only suspects a step: see `integrators`. Here the Jacobian of the rates decides.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise

import numpy as np

from ..run_data import Array, State
from .integrators import CLEAR

STABILITY = {
    "rk4": (1.0, 1.0, 1.0 / 2.0, 1.0 / 6.0, 1.0 / 24.0),
    "runge_kutta3": (1.0, 1.0, 1.0 / 2.0, 1.0 / 6.0),
}
"""Coefficients of each integrator's R(z): a step of length h multiplies the mode λ by R(h λ)."""

_TABLEAU: dict[str, tuple[tuple[float, ...], ...]] = {
    "rk4": ((0.5,), (0.0, 0.5), (0.0, 0.0, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),
    "runge_kutta3": ((0.5,), (-1.0, 2.0), (1 / 6, 2 / 3, 1 / 6)),
}
"""For each integrator, the weights of the rates in each stage after the first, and in the end."""

_DIFFERENCES = {
    "rk4": ((-0.5, 0.5, 0.0, 0.0), (1.0, 0.0, -2.0, 1.0)),
    "runge_kutta3": ((1.0, 0.0, 0.0), (1.0, -2.0, 1.0)),
}
"""Weights of the rates at the stages in the slower and the faster difference: see `integrators`."""

SAFETY = 0.2
"""Ratio of the step that an error names and the longest stable step in the state of the error.

In other states of the run a mode may be faster, and accuracy requires a shorter step too.
"""

_HALVINGS = 12
"""Number of bisections: a band of 1/4000 of the way between two stages is found."""

_LARGEST_ERROR = 0.2
"""Largest error in a step of an oscillation, relative to its amplitude.

RK4 has this error at h |λ| = 1.9, and the integrator of third order at 1.5. RK4 is stable up to
2.83, but between 1.9 and 2.83 it damps more than the plant: load pressures were 29 % wrong.
"""

Rates = Callable[[Array, Array, float, Array], tuple[Array, Array]]
"""``rates(d, u, t, x)`` returns dx/dt (states,) and its Jacobian (states, states)."""

_StateRates = Callable[[float, Array], tuple[Array, Array]]
_Point = tuple[Array, Array, Array]  # states at a stage, their rates and their Jacobian


@dataclass(frozen=True)
class UnstableStep:
    """The first unstable step of a run.

    The step begins at ``time_s`` with ``state`` and lasts ``step_s``. The step does not follow the
    mode with the ``eigenvalue`` λ in 1/s. ``shares`` (states,) are the participation factors of the
    states in this mode. ``safe_s`` is `SAFETY` times the longest stable step in s.
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
    """Return by how much a step exceeds the longest stable step, for each of its z = h λ (n,).

    The result is |z| divided by the largest stable |z| in the direction of z. The step h is
    unstable for the mode λ if this ratio exceeds 1.
    """
    return np.abs(h_lambda) / np.interp(np.abs(np.angle(h_lambda)), *_reach(integrator))


def unstable_step(
    integrator: str, rates: Rates, suspects: Array, sizes: tuple[int, int]
) -> UnstableStep | None:
    """Return the first unstable step among the logged ticks of a run; None if all are stable.

    ``suspects`` (n, 4 + states + discrete states + inputs): see `RUN`; ``sizes``: numbers of
    continuous and of discrete states.
    """
    for _, start, end, h, *vectors in suspects:
        x, d, u = np.split(np.array(vectors), np.cumsum(sizes))
        at, steps = partial(rates, d, u), max(1, round((end - start) / h))
        with np.errstate(all="ignore"):  # a run that diverges overflows
            t, points = _suspected(integrator, at, start + h * np.arange(steps), x, h)
            # A step that is far too long has its stages where no solution goes, so that the
            # Jacobian between them comes last.
            jacobians = [points[0][2], _steepest(partial(at, t), points)] if points else []
        for jacobian in filter(lambda values: np.isfinite(values).all(), jacobians):
            values, modes = np.linalg.eig(jacobian)
            excesses = excess(integrator, h * values)
            worst = int(np.argmax(excesses))
            if excesses[worst] > 1.0:
                # The modes of a matrix with too few eigenvectors have no inverse.
                shares = np.abs(modes[:, worst] * np.linalg.pinv(modes)[worst])
                safe_s = SAFETY * h / float(excesses[worst])
                state = State(points[0][0], d)
                return UnstableStep(t, float(h), state, complex(values[worst]), shares, safe_s)
    return None


def _suspected(
    integrator: str, rates: _StateRates, times: Array, x: Array, h: float
) -> tuple[float, list[_Point]]:
    """Return start and stages of the step of a tick that is most suspect of being unstable.

    This step is the first whose ratio of rates is `CLEAR`, or else the step with the largest ratio.
    ``times``: starts of the steps; ``x``: states at the start of the tick. The list of stages is
    empty if the rates at the start of the step are not finite.
    """
    largest, chosen = -1.0, (0.0, list[_Point]())
    for t in times.tolist():
        points = [(x, *rates(t, x))]
        if not all(np.isfinite(values).all() for values in points[0]):
            break
        for weights in _TABLEAU[integrator]:
            z = x + h * sum(w * f for w, (_, f, _) in zip(weights, points, strict=False))
            points.append((z, *rates(t + h * sum(weights), z)))
        end, scale = points.pop()[0], 1.0 + np.abs(x)
        slow, fast = (
            np.linalg.norm(sum(w * f for w, (_, f, _) in zip(weights, points, strict=True)) / scale)
            for weights in _DIFFERENCES[integrator]
        )
        ratio = float(np.square(fast / slow))
        if not ratio <= largest:  # also where a stage has overflowed
            largest, chosen = ratio, (t, points)
        if not ratio < CLEAR:
            break
        x = end
    return chosen


def _steepest(rates: Callable[[Array], tuple[Array, Array]], points: list[_Point]) -> Array:
    """Return the Jacobian where the rates change most between two stages of a step.

    Between the stages may lie a short range with other derivatives, such as the band in which
    friction changes its sign. Bisection finds the steepest place.
    """
    scale = 1.0 + np.abs(points[0][0])

    def slope(ends: tuple[_Point, _Point]) -> float:
        (z, f, _), (other_z, other_f, _) = ends
        rise, run = (np.linalg.norm(v / scale) for v in (other_f - f, other_z - z))
        return float(rise / run) if run > 0.0 else 0.0

    a, b = max(pairwise(points), key=slope)
    for _ in range(_HALVINGS):
        z = 0.5 * (a[0] + b[0])
        middle = (z, *rates(z))
        a, b = max(((a, middle), (middle, b)), key=slope)
    return b[2]
