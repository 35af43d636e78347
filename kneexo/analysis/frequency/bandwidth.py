"""Large-signal bandwidth of the closed loop, and the bounds that the motor sets on it.

The bandwidth is the frequency at which the gain of the fundamental first falls below 1/√2. For a
small sine this frequency is the bandwidth of the linear loop. For a large sine the limits of the
motor reduce the bandwidth. Let R be the largest speed and A the largest acceleration of the rod.
Let a be the amplitude and ω the angular frequency of the rod's reference. Then every controller
obeys

    gain <= (4/π) R/(aω) and gain <= (4/π) A/(aω²).

These are the fundamentals of a triangle wave of slope ±R and of parabolas of curvature ±A.
`kneexo.analysis.frequency.rate_limit` gives the gain of a follower whose only limit is the speed R.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from functools import cache

import numpy as np
import scipy

from kneexo.analysis.frequency.frequency_response import (
    fundamental,
    highest_frequency_hz,
    require_sine,
)
from kneexo.analysis.frequency.rate_limit import rate_limit_bandwidth_hz, rate_limited_follower
from kneexo.analysis.frequency.sine_estimate import (
    SineEstimateSettings,
    estimate_sine,
    motor_limits,
)
from kneexo.analysis.linear.sampled_loop import SampledLoop, linearize_loop
from kneexo.common.result import Array
from kneexo.errors import LinearizationError
from kneexo.geometry import linkage
from kneexo.geometry.rod_polynomial import controller_polynomial
from kneexo.parameters import Scenario
from kneexo.parameters.criteria import MINUS_3_DB
from kneexo.parameters.paths import changed
from kneexo.simulation import needs_runs

LOWEST_HZ = 0.02
"""Lowest frequency in Hz at which a bandwidth is searched."""

_SEARCH_STEP = 1.25
_GAIN_TOLERANCE = 5e-4
_NO_GAIN = 1e-12  # replaces a gain of zero, as of a sine between two counts of the encoder
_FOLLOWER_STEPS = 2000  # steps per cycle
_KNEE_TABLE_RAD = np.radians(np.linspace(-1.0, 91.0, 20_001))


# --------------------------------------------------------------------- limits of the motor


def rod_limits(scenario: Scenario) -> tuple[float, float]:
    """Return the largest speed (m/s) and acceleration (m/s²) of the rod that the motor can drive.

    The mean piston area converts flow to rod speed.
    """
    pump = scenario.plant.pump
    ratio = pump.displacement_m3_per_rad / pump.gear_ratio / scenario.plant.cylinder.mean_area_m2
    speed, acceleration = motor_limits(scenario)
    return ratio * speed, ratio * acceleration


def acceleration_bound_hz(acceleration_limit: float, amplitude: float) -> float:
    """Return √(4√2 A/(π a))/2π, the frequency in Hz above which any controller has a gain < 1/√2.

    A is the ``acceleration_limit`` of the rod, and a is the ``amplitude`` of the rod's sinusoidal
    reference. A and a must have the same unit of length, such as m/s² and m.
    """
    return math.sqrt(4.0 * math.sqrt(2.0) / math.pi * acceleration_limit / amplitude) / math.tau


def rod_of(scenario: Scenario, knee_angle_rad: Array) -> Array:
    """Compute the rod extension in m at knee angles in rad, using the plant's rod map."""
    if scenario.plant.rod_map == "polynomial":
        return np.asarray(linkage.polynomial(controller_polynomial(scenario).p_si, knee_angle_rad))
    return linkage.rod_extension(scenario.plant.linkage, knee_angle_rad)


def rod_amplitude_m(scenario: Scenario) -> float:
    """Return half the distance in m that the rod moves over the range of the reference."""
    ends = rod_of(scenario, np.radians(scenario.reference.range_deg))
    return 0.5 * float(abs(ends[1] - ends[0]))


def speed_limit_reached_hz(scenario: Scenario) -> float:
    """Return the frequency in Hz above which the scenario's sine exceeds the rod's speed limit."""
    reference = require_sine(scenario)
    phase = np.linspace(0.0, math.pi, 10_001)
    knee = np.radians(reference.mean_deg - reference.amplitude_deg * np.cos(phase))
    steepest = float(np.max(np.abs(np.gradient(rod_of(scenario, knee), phase))))
    return rod_limits(scenario)[0] / (math.tau * steepest)


def follower_response(scenario: Scenario, frequency_hz: float) -> complex:
    """Return the knee's response to the scenario's sine if the rod's only limit is its speed.

    The rod follows the reference exactly, except where its speed limit prevents this
    (`rate_limited_follower`). The result is the complex fundamental of the knee angle, divided by
    the fundamental of the reference, at ``frequency_hz``.
    """
    reference = require_sine(scenario)
    # Three cycles, of which the last is measured, because the follower starts without lag.
    time = np.arange(3 * _FOLLOWER_STEPS + 1) / (_FOLLOWER_STEPS * frequency_hz)
    mean, amplitude = math.radians(reference.mean_deg), math.radians(reference.amplitude_deg)
    target = mean + amplitude * np.sin(math.tau * frequency_hz * time)
    table = rod_of(scenario, _KNEE_TABLE_RAD)
    rod = rate_limited_follower(
        time, np.interp(target, _KNEE_TABLE_RAD, table), rod_limits(scenario)[0]
    )
    knee = np.interp(rod, table[::-1], _KNEE_TABLE_RAD[::-1])
    last = slice(2 * _FOLLOWER_STEPS, 3 * _FOLLOWER_STEPS)
    measured, reference_sine = (
        fundamental(time[last], s[last], frequency_hz) for s in (knee, target)
    )
    return measured / reference_sine


def follower_bandwidth_hz(scenario: Scenario) -> float:
    """Return the frequency in Hz at which the gain of `follower_response` is 1/√2 (−3 dB)."""
    guess = math.log(rate_limit_bandwidth_hz(rod_limits(scenario)[0], rod_amplitude_m(scenario)))

    def excess(log_frequency: float) -> float:
        return abs(follower_response(scenario, math.exp(log_frequency))) - MINUS_3_DB

    return math.exp(float(scipy.optimize.brentq(excess, guess - 1.5, guess + 1.5, xtol=1e-6)))


# ------------------------------------------------------------------- large-signal bandwidth


@needs_runs
def large_signal_bandwidth_hz(
    scenario: Scenario = Scenario(),
    settings: SineEstimateSettings = SineEstimateSettings(averaged_cycles=2, largest_cycles=6),
    loop: SampledLoop | None = None,
) -> float:
    """Return the closed loop's bandwidth in Hz at the amplitude of its sinusoidal reference.

    `estimate_sine` measures the gain at several frequencies. The search starts at 0.8 times the
    smallest of three predictions: rate limit, acceleration bound and linear bandwidth. The
    frequency grows by factors of 1.25 until the gain is below 1/√2, so that the search can miss a
    narrower dip of the gain. Then a root search over log gain and log frequency continues until the
    frequency is known to 0.1 % or the gain is 1/√2 to 0.05 %.

    The result is nan when the gain does not fall below 1/√2 between `LOWEST_HZ` and the frequency
    with ten samples a period. Raises `ParameterError` when the reference is not a sine or does not
    move. Also raises the errors of `kneexo.simulation.simulate`.

    Parameters
    ----------
    scenario
        The closed loop and its sine.
    settings
        When the response to a sine counts as settled.
    loop
        The linear loop of ``scenario`` at the mean of its sine. None: the function computes it.
    """
    require_sine(scenario)
    highest = highest_frequency_hz(scenario)

    @cache  # the search asks for some values twice
    # In log frequency and log gain the fall of a rate-limited gain, 1/f, is a straight line for the
    # root search.
    def excess(log_frequency: float) -> float:
        frequency = min(math.exp(log_frequency), highest)
        at = changed(scenario, {"reference.frequency_hz": frequency})
        estimate = estimate_sine(at, settings)
        log_gain = math.log(max(estimate.gain, _NO_GAIN) / MINUS_3_DB)
        return log_gain if abs(log_gain) > _GAIN_TOLERANCE else 0.0

    bottom, top = math.log(LOWEST_HZ), math.log(highest)
    start = min(max(bottom, math.log(0.8 * _expected_hz(scenario, loop))), top)
    return _first_fall_hz(excess, bottom, start, top)


def _first_fall_hz(
    excess: Callable[[float], float], bottom: float, start: float, top: float
) -> float:
    """Return the lowest frequency in Hz at which the gain of the loop falls below −3 dB.

    ``excess(ln f)`` is the logarithm of the gain over −3 dB at the frequency f. ``bottom``,
    ``start`` and ``top`` are logarithms of frequencies in Hz. The gain at ``start`` may already be
    too low. So the search first moves down to a frequency with enough gain, at most to ``bottom``,
    and then up to the first frequency with too little gain, at most to ``top``. The result is nan
    if there is no such pair.
    """
    low, step = start, math.log(_SEARCH_STEP)
    while excess(low) < 0.0:
        if low == bottom:
            return math.nan
        low = max(low - step, bottom)
    high = low
    while excess(high) >= 0.0:
        if high == top:
            return math.nan
        low, high = high, min(high + step, top)
    return math.exp(float(scipy.optimize.brentq(excess, low, high, xtol=1e-3)))


def _expected_hz(scenario: Scenario, loop: SampledLoop | None) -> float:
    """Predict the bandwidth in Hz, so that the search for the measured bandwidth starts near it.

    The result is the smallest of up to three predictions. They follow from the speed limit, the
    acceleration limit and, if there is one, the loop that is linearized at the mean of the
    reference.
    """
    speed, acceleration = rod_limits(scenario)
    amplitude = rod_amplitude_m(scenario)
    limits = [
        rate_limit_bandwidth_hz(speed, amplitude),
        acceleration_bound_hz(acceleration, amplitude),
    ]
    with suppress(LinearizationError):
        loop = loop or linearize_loop(scenario, knee_angle_deg=require_sine(scenario).mean_deg)
        limits.append(loop.bandwidth_hz())
    return float(np.nanmin(limits))  # nan: the linear gain does not fall below 1/√2
