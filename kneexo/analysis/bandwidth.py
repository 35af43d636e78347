"""Bandwidth of the closed loop from small to large amplitudes, and what limits it.

Bandwidth is where the gain of the fundamental first falls below 1/√2, everywhere in kneexo. A
small sine sees the linear loop. A larger one meets the motor's limits: with at most speed R and
acceleration A of the rod, a fundamental of rod amplitude a at ω has, whatever the controller,

    gain <= (4/π) R/(aω) and gain <= (4/π) A/(aω²),

the fundamentals of the fastest triangle and of the fastest parabolas. Below these bounds
`kneexo.analysis.rate_limit` has the closed form of what a follower with speed limit R does.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import scipy

from kneexo import linkage
from kneexo.analysis.frequency_response import (
    MINUS_3_DB,
    fundamental,
    highest_frequency_hz,
    require_sine,
)
from kneexo.analysis.rate_limit import rate_limit_bandwidth_hz, rate_limited_follower
from kneexo.analysis.sampled_loop import linearize_loop
from kneexo.analysis.sine_estimate import SineEstimateSettings, estimate_sine, motor_limits
from kneexo.errors import LinearizationError
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.result import Array
from kneexo.simulation import awaitable, needs_runs, search_async

LOWEST_HZ = 0.02
"""Where a search for a bandwidth ends, downwards."""

_SEARCH_STEP = 1.25
_GAIN_TOLERANCE = 5e-4
_NO_GAIN = 1e-12  # as of a sine between two counts of the encoder
_FOLLOWER_STEPS = 2000  # a cycle
_KNEE_TABLE_RAD = np.radians(np.linspace(-1.0, 91.0, 20_001))


# --------------------------------------------------------------------- limits of the motor


def rod_limits(scenario: Scenario) -> tuple[float, float]:
    """Largest speed (m/s) and acceleration (m/s²) that the motor gives the rod, mean area."""
    pump = scenario.plant.pump
    ratio = pump.displacement_m3_per_rad / pump.gear_ratio / scenario.plant.cylinder.mean_area_m2
    speed, acceleration = motor_limits(scenario)
    return ratio * speed, ratio * acceleration


def acceleration_bound_hz(acceleration_limit: float, amplitude: float) -> float:
    """Frequency in Hz above which no controller reaches −3 dB, √(4√2 A/(π a))/2π.

    ``acceleration_limit`` A and ``amplitude`` a in the same unit of length.
    """
    return math.sqrt(4.0 * math.sqrt(2.0) / math.pi * acceleration_limit / amplitude) / math.tau


def rod_of(scenario: Scenario, knee_angle_rad: Array) -> Array:
    """Rod extension in m at knee angles in rad, by the plant's own map."""
    if scenario.plant.rod_map == "polynomial":
        return np.asarray(linkage.polynomial(scenario.polynomial.p_si, knee_angle_rad))
    return linkage.rod_extension(scenario.plant.linkage, knee_angle_rad)


def rod_amplitude_m(scenario: Scenario) -> float:
    """Half the rod's way in m between the ends of the scenario's reference."""
    ends = rod_of(scenario, np.radians(scenario.reference.range_deg))
    return 0.5 * float(abs(ends[1] - ends[0]))


def speed_limit_reached_hz(scenario: Scenario) -> float:
    """Frequency in Hz from which the scenario's sine asks for more than the rod's largest speed."""
    reference = require_sine(scenario)
    phase = np.linspace(0.0, math.pi, 10_001)
    knee = np.radians(reference.mean_deg - reference.amplitude_deg * np.cos(phase))
    steepest = float(np.max(np.abs(np.gradient(rod_of(scenario, knee), phase))))
    return rod_limits(scenario)[0] / (math.tau * steepest)


def follower_response(scenario: Scenario, frequency_hz: float) -> complex:
    """Response of the scenario's knee sine if the rod did nothing but obey its speed limit.

    Kinematics alone: the rod moves towards that of the reference at most at the limit; the knee
    follows the rod. The plant's own map, at one frequency in Hz.
    """
    reference = require_sine(scenario)
    time = np.arange(3 * _FOLLOWER_STEPS + 1) / (_FOLLOWER_STEPS * frequency_hz)
    mean, amplitude = math.radians(reference.mean_deg), math.radians(reference.amplitude_deg)
    target = mean + amplitude * np.sin(math.tau * frequency_hz * time)
    table = rod_of(scenario, _KNEE_TABLE_RAD)
    rod = rate_limited_follower(
        time, np.interp(target, _KNEE_TABLE_RAD, table), rod_limits(scenario)[0]
    )
    knee = np.interp(rod, table[::-1], _KNEE_TABLE_RAD[::-1])
    last = slice(2 * _FOLLOWER_STEPS, 3 * _FOLLOWER_STEPS)
    measured, asked = (fundamental(time[last], s[last], frequency_hz) for s in (knee, target))
    return measured / asked


def follower_bandwidth_hz(scenario: Scenario) -> float:
    """−3 dB frequency in Hz of `follower_response`."""
    guess = math.log(rate_limit_bandwidth_hz(rod_limits(scenario)[0], rod_amplitude_m(scenario)))

    def excess(log_frequency: float) -> float:
        return abs(follower_response(scenario, math.exp(log_frequency))) - MINUS_3_DB

    return math.exp(float(scipy.optimize.brentq(excess, guess - 1.5, guess + 1.5, xtol=1e-6)))


# ------------------------------------------------------------------- large-signal bandwidth


@needs_runs
async def large_signal_bandwidth_hz(
    scenario: Scenario = Scenario(),
    settings: SineEstimateSettings = SineEstimateSettings(averaged_cycles=2, largest_cycles=6),
) -> float:
    """Frequency in Hz where the gain of the scenario's own sine first falls below 1/√2.

    Measured by `estimate_sine` at a few frequencies: from 0.8 times the lowest of the rate-limit
    closed form, the acceleration bound and the linear bandwidth upwards in steps of 1.25 until the
    gain has fallen (a narrower dip is not seen), then by interpolation of log gain over log f
    until the frequency is known to 0.1 % or the gain is 1/√2 to 0.05 %. nan when the gain does not
    fall between `LOWEST_HZ` and ten samples a period.

    Raises `ParameterError` when the reference is no sine or does not move, and what the simulation
    raises.
    """
    require_sine(scenario)
    highest = highest_frequency_hz(scenario)

    async def excess(log_frequency: float) -> float:
        frequency = min(math.exp(log_frequency), highest)
        at = changed(scenario, {"reference.frequency_hz": frequency})
        estimate = await awaitable(estimate_sine, at, settings)
        log_gain = math.log(max(estimate.gain, _NO_GAIN) / MINUS_3_DB)
        return log_gain if abs(log_gain) > _GAIN_TOLERANCE else 0.0

    bottom, top = math.log(LOWEST_HZ), math.log(highest)
    start = min(max(bottom, math.log(0.8 * _expected_hz(scenario))), top)
    return await search_async(lambda value: _first_fall_hz(value, bottom, start, top), excess)


def _first_fall_hz(
    excess: Callable[[float], float], bottom: float, start: float, top: float
) -> float:
    """Where ``excess`` of log f, searched from ``start``, first falls below zero; nan: nowhere."""
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


def _expected_hz(scenario: Scenario) -> float:
    """Lowest −3 dB frequency that speed limit, acceleration limit or linear loop suggest."""
    speed, acceleration = rod_limits(scenario)
    amplitude = rod_amplitude_m(scenario)
    limits = [
        rate_limit_bandwidth_hz(speed, amplitude),
        acceleration_bound_hz(acceleration, amplitude),
    ]
    linear = _linear_bandwidth_hz(scenario)
    return min(limits if math.isnan(linear) else [*limits, linear])


def _linear_bandwidth_hz(scenario: Scenario) -> float:
    """Small-signal bandwidth at the reference's mean; nan where there is no linear loop."""
    try:
        return linearize_loop(scenario, require_sine(scenario).mean_deg).bandwidth_hz()
    except LinearizationError:
        return math.nan
