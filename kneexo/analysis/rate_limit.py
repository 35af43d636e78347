"""Closed form of a rate-limited sine: what a speed limit alone does to a frequency response.

A follower that moves at most at speed R tracks a sin ωt. With φ = ωt, in units of a, its rate is
at most ρ = R/(aω) per radian.

- ρ >= 1: the follower keeps up; gain 1.
- ρ <= 2/√(π² + 4): it never catches up and is a triangle of slope ±ρ, whose fundamental is 4ρ/π.
  It turns where it meets the sine: a triangle that lags by ψ has its peak πρ/2 at φ = π/2 + ψ, so
  cos ψ = πρ/2.
- between: it leaves the sine where that becomes too steep downwards, at φ_a = π − arccos ρ, runs
  straight, sin φ_a − ρ(φ − φ_a), until it meets the sine again at φ_b, and follows it to φ_a + π,
  where the other half begins. The fundamental is the Fourier integral over that half period.
"""

from __future__ import annotations

import cmath
import math

import numpy as np
import scipy
from numpy.typing import ArrayLike

from kneexo.analysis.frequency_response import MINUS_3_DB
from kneexo.errors import ParameterError
from kneexo.result import Array

TRIANGLE_RATIO = 2.0 / math.sqrt(math.pi**2 + 4.0)
"""ρ below which the follower never meets the sine for more than an instant: 0.5370."""


def _gain(ratio: float) -> complex:
    if not ratio > 0.0:
        raise ParameterError(f"ratio = {ratio:g}: must be > 0")
    if ratio >= 1.0:
        return 1.0 + 0.0j
    if ratio <= TRIANGLE_RATIO:
        return cmath.rect(4.0 * ratio / math.pi, -math.acos(0.5 * math.pi * ratio))
    leave = math.pi - math.acos(ratio)
    offset = math.sin(leave) + ratio * leave  # the straight part is offset − ρφ

    def gap(phase: float) -> float:
        return offset - ratio * phase - math.sin(phase)

    # The gap opens at leave, is widest where the sine has the same slope again, closes before
    # leave + π.
    meet = scipy.optimize.brentq(gap, math.pi + math.acos(ratio), leave + math.pi)

    def sine_part(phase: float) -> float:  # ∫ (offset − ρφ) sin φ dφ
        return -offset * math.cos(phase) - ratio * (math.sin(phase) - phase * math.cos(phase))

    def cosine_part(phase: float) -> float:  # ∫ (offset − ρφ) cos φ dφ
        return offset * math.sin(phase) - ratio * (math.cos(phase) + phase * math.sin(phase))

    end = leave + math.pi
    in_phase = sine_part(meet) - sine_part(leave)
    in_phase += 0.5 * (end - meet) - 0.25 * (math.sin(2.0 * end) - math.sin(2.0 * meet))
    quadrature = cosine_part(meet) - cosine_part(leave)
    quadrature += 0.5 * (math.sin(end) ** 2 - math.sin(meet) ** 2)
    return 2.0 / math.pi * complex(in_phase, quadrature)


def rate_limited_gain(ratio: ArrayLike) -> np.ndarray[tuple[int, ...], np.dtype[np.complex128]]:
    """Complex fundamental gain of a follower with speed limit R on a sin ωt, for ρ = R/(aω).

    ``ratio`` any shape, > 0; returns the same shape. Raises `ParameterError` otherwise.
    """
    ratios = np.asarray(ratio, dtype=float)
    return np.array([_gain(float(r)) for r in ratios.ravel()]).reshape(ratios.shape)


def rate_limit_bandwidth_hz(speed_limit: float, amplitude: float) -> float:
    """Frequency in Hz at which the gain falls to 1/√2: 0.28656 R/a.

    ``speed_limit`` R and ``amplitude`` a in the same unit of length (per second and alone). Raises
    `ParameterError` unless both are positive.
    """
    for name, value in (("speed_limit", speed_limit), ("amplitude", amplitude)):
        if not 0.0 < value < math.inf:
            raise ParameterError(f"{name} = {value:g}: must be finite and > 0")
    ratio = scipy.optimize.brentq(
        lambda r: abs(_gain(r)) - MINUS_3_DB, TRIANGLE_RATIO, 1.0, xtol=1e-14
    )
    return speed_limit / (2.0 * math.pi * ratio * amplitude)


def rate_limited_follower(time_s: Array, target: Array, speed_limit: float) -> Array:
    """Kinematic follower of a sampled target (n,): moves towards it at most at ``speed_limit``."""
    follower = np.empty_like(target)
    position = follower[0] = target[0]
    for index, step in enumerate(np.diff(time_s), start=1):
        reach = speed_limit * step
        position += min(max(target[index] - position, -reach), reach)
        follower[index] = position
    return follower
