"""Frequency response of a follower with a speed limit, in closed form.

The follower tracks the target a sin ωt, and its speed is at most R. Let φ = ωt be the phase, and
let the amplitude a be the unit of length. Then the slope of the follower over φ is at most
ρ = R/(aω).

- ρ >= 1: The follower equals the target, and the gain is 1.
- ρ <= 2/√(π² + 4): The follower is a triangle wave of slope ±ρ. The gain of its fundamental is
  4ρ/π. The triangle has its peak πρ/2 where it meets the sine. If the triangle lags by ψ, the peak
  lies at φ = π/2 + ψ, so that cos ψ = πρ/2.
- Otherwise: The follower leaves the sine at φ_a = π − arccos ρ, where the slope of the sine falls
  below −ρ. The follower moves along the line sin φ_a − ρ(φ − φ_a) until this line meets the sine
  again at φ_b. Then the follower equals the sine up to φ_a + π, where the opposite half period
  begins. The gain is the Fourier integral over a half period.
"""

from __future__ import annotations

import cmath
import math

import numpy as np
import scipy
from numpy.typing import ArrayLike

from kneexo.common.result import Array
from kneexo.errors import ParameterError
from kneexo.parameters.criteria import MINUS_3_DB

TRIANGLE_RATIO = 2.0 / math.sqrt(math.pi**2 + 4.0)
"""Largest ratio ρ = R/(aω), 0.5370, at which the follower is a triangle wave."""


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

    # The gap between line and sine is widest where the slope of the sine is −ρ again. It closes
    # before leave + π.
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
    """Return the complex gain of the fundamental of a follower with a speed limit.

    ``ratio`` is ρ = R/(aω) for the speed limit R and the target a sin ωt. The result has the shape
    of ``ratio``, which is arbitrary. Raises `ParameterError` unless all ratios are positive.
    """
    ratios = np.asarray(ratio, dtype=float)
    return np.array([_gain(float(r)) for r in ratios.ravel()]).reshape(ratios.shape)


def rate_limit_bandwidth_hz(speed_limit: float, amplitude: float) -> float:
    """Return 0.28656 R/a, the frequency in Hz at which a follower with speed limit has gain 1/√2.

    The ``speed_limit`` R and the ``amplitude`` a of the sine must have the same unit of length,
    such as m/s and m. Raises `ParameterError` unless R and a are finite and positive.
    """
    for name, value in (("speed_limit", speed_limit), ("amplitude", amplitude)):
        if not 0.0 < value < math.inf:
            raise ParameterError(f"{name} = {value:g}: must be finite and > 0")
    ratio = scipy.optimize.brentq(
        lambda r: abs(_gain(r)) - MINUS_3_DB, TRIANGLE_RATIO, 1.0, xtol=1e-14
    )
    return speed_limit / (2.0 * math.pi * ratio * amplitude)


def rate_limited_follower(time_s: Array, target: Array, speed_limit: float) -> Array:
    """Return the positions (n,) of a follower whose speed is at most ``speed_limit``.

    ``target`` (n,) are the positions to track at ``time_s`` (n,). The follower starts at the first
    sample of the target. Then the follower moves towards each next sample with constant speed.
    """
    position, *aims = target.tolist()  # numbers of Python, twice as fast as those of NumPy
    positions = [position]
    for aim, reach in zip(aims, (speed_limit * np.diff(time_s)).tolist(), strict=True):
        position += min(max(aim - position, -reach), reach)
        positions.append(position)
    return np.array(positions)
