"""Response of the closed loop to one sine of any amplitude, with its uncertainty.

`estimate_sine` extends the run until the response has settled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import model_validator

from kneexo.analysis.frequency_response import require_sampled, require_sine
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.quantity import Parameters, quantity
from kneexo.result import Array, Result
from kneexo.simulation import Run, awaitable, needs_runs, simulate


class SineEstimateSettings(Parameters):
    """How the response to one sine is estimated: ramp, settling, averaging."""

    ramp_cycles: float = quantity(
        1.0, "cycles", "assumption: over which the amplitude grows from zero", ge=0, le=1000
    )
    ramp_min_s: float = quantity(
        0.5,
        "s",
        "assumption: five times the slowest time constant of the default loop, so that short "
        "cycles do not start its transients",
        ge=0,
        le=1e3,
    )
    tolerance: float = quantity(
        2e-3,
        "1",
        "assumption: change of the response from one cycle to the next, relative to it, below "
        "which the loop has settled",
        ge=1e-6,
        le=0.5,
    )
    averaged_cycles: int = quantity(
        3,
        "cycles",
        "Section 5: more than three cycles, of which the ramp is the first",
        ge=2,
        le=1000,
    )
    largest_cycles: int = quantity(
        24, "cycles", "assumption: then it has not settled", ge=3, le=10_000
    )

    @model_validator(mode="after")
    def _enough_cycles(self) -> SineEstimateSettings:
        if self.largest_cycles <= self.averaged_cycles:
            raise ValueError(
                f"largest_cycles = {self.largest_cycles}: too few cycles, must be more than "
                f"averaged_cycles = {self.averaged_cycles}"
            )
        return self


@dataclass(frozen=True, repr=False)
class SineEstimate(Result):
    """Response θ_p/θ_d of the fundamental to one sine, the mean of its last cycles.

    ``uncertainty`` is an absolute error of the complex response: the standard error of that mean
    (the cycles' scatter over the root of their number) plus the distance between the means of
    their first and second half (what still drifts). It leaves out errors that are the same in
    every cycle. ``settled``: each of the averaged cycles agrees with the one before within the
    tolerance; otherwise they are the second half of the largest number of cycles.
    ``speed_limited_share`` and ``acceleration_limited_share`` are the shares of their samples in
    which the motor is within 1 % of its limit.
    """

    frequency_hz: float
    amplitude_deg: float
    response: complex
    uncertainty: float
    settled: bool
    averaged_cycles: int
    cycles: int
    """Simulated cycles after the ramp."""
    mean_deg: float
    """Mean knee angle of the averaged cycles: with the motor at its limits it leaves the
    reference's."""
    speed_limited_share: float
    acceleration_limited_share: float

    @property
    def gain(self) -> float:
        """|response|."""
        return abs(self.response)


def motor_limits(scenario: Scenario) -> tuple[float, float]:
    """Largest motor speed in rad/s and acceleration in rad/s²; the latter inf when it is ideal."""
    pump, command = scenario.plant.pump, scenario.command_limit_rad_s
    if scenario.plant.ideal_motor:
        return command, math.inf
    return min(command, pump.speed_limit_rad_s), pump.acceleration_limit_rad_s2


_HARMONICS = 3
"""Fitted to a cycle: without the second and third, those of a signal leak into its fundamental
where a cycle is no whole number of samples."""


def cycle_responses(
    run: Run,
    frequency_hz: float,
    start_s: float,
    cycles: int,
    *,
    output: str = "knee_angle_rad",
    reference: str = "knee_reference_rad",
) -> tuple[Any, Array]:
    """Response of the fundamental and mean of the output in each of n >= 3 cycles from ``start_s``.

    The ratio of the fundamentals of two columns, complex (n,), and the means, (n,). A cycle need
    not have a whole number of samples. While a motor is at its limits, the mean of the output may
    drift: the linear drift estimated from neighbouring cycle means is removed.
    """
    means, amplitudes = np.empty((cycles, 3)), np.empty((cycles, 3), complex)
    for cycle in range(cycles):
        # A sample on the border belongs to the next cycle, whatever its time's last bit is.
        limits = start_s + (cycle + np.arange(2)) / frequency_hz - 1e-9
        inside = slice(*np.searchsorted(run.time_s, limits))
        time = run.time_s[inside]
        phase = 2.0 * np.pi * frequency_hz * time
        basis = [np.ones_like(phase)]
        for n in range(1, _HARMONICS + 1):
            basis += [np.cos(n * phase), -np.sin(n * phase)]
        signals = (run[output][inside], run[reference][inside], time - limits.mean())
        fitted = np.linalg.lstsq(np.column_stack(basis), np.column_stack(signals), rcond=None)[0]
        means[cycle], amplitudes[cycle] = fitted[0], fitted[1] + 1j * fitted[2]
    # A drift's own fit says at which time a mean holds, and what the drift does to a fundamental.
    times = np.arange(cycles) / frequency_hz + means[:, 2]
    drift = np.gradient(means[:, 0], times, edge_order=2)
    measured, asked, ramp = amplitudes.T
    return (measured - drift * ramp) / asked, means[:, 0]


def settled_cycles(responses: Any, tolerance: float) -> int:
    """How many of the last ``responses`` (n,) agree, each with the one before it."""
    change = np.abs(np.diff(responses)) > tolerance * np.abs(responses[1:])
    return len(responses) - (int(np.flatnonzero(change)[-1]) + 1 if change.any() else 0)


def response_uncertainty(responses: Any) -> float:
    """Standard error of the mean of ``responses`` (n >= 2,) plus the drift between its halves."""
    n = len(responses)
    scatter = math.sqrt(float(np.sum(np.abs(responses - np.mean(responses)) ** 2)) / (n - 1))
    drift = abs(np.mean(responses[-(n // 2) :]) - np.mean(responses[: n // 2]))
    return scatter / math.sqrt(n) + float(drift)


@needs_runs
async def estimate_sine(
    scenario: Scenario = Scenario(),
    settings: SineEstimateSettings = SineEstimateSettings(),
) -> SineEstimate:
    """Measure the closed loop's response to the scenario's own sine.

    The amplitude grows smoothly (the scenario's own ramp and duration are replaced), then the run
    is made longer, twice each time, until the fundamentals of ``settings.averaged_cycles``
    successive cycles agree or ``settings.largest_cycles`` are reached.

    Raises `ParameterError` when the reference is no sine, does not move, or has fewer than ten
    samples a period; and what the simulation raises.
    """
    reference = require_sine(scenario)
    frequency = reference.frequency_hz
    require_sampled(frequency, scenario)
    ramp = max(settings.ramp_cycles / frequency, settings.ramp_min_s)
    cycles = min(settings.averaged_cycles + 1, settings.largest_cycles)
    while True:
        run = await awaitable(
            simulate,
            changed(
                scenario,
                {"reference.ramp_s": ramp, "simulation.duration_s": ramp + cycles / frequency},
            ),
            signals=("knee_reference", "knee_angle", "motor_speed"),
        )
        responses, means = cycle_responses(run, frequency, ramp, cycles)
        count = settled_cycles(responses, settings.tolerance)
        settled = count >= settings.averaged_cycles
        if settled or cycles == settings.largest_cycles:
            break
        cycles = min(2 * cycles, settings.largest_cycles)
        del run  # other calls wait with their runs too
    if not settled:
        count = max(settings.averaged_cycles, cycles // 2)
    averaged = responses[-count:]
    speed = run["motor_speed_rad_s"][run.time_s > run.time_s[-1] - count / frequency]
    acceleration = np.diff(speed) / scenario.controller.sample_time_s
    speed_limit, acceleration_limit = motor_limits(scenario)
    return SineEstimate(
        frequency_hz=frequency,
        amplitude_deg=reference.amplitude_deg,
        response=complex(np.mean(averaged)),
        uncertainty=response_uncertainty(averaged),
        mean_deg=math.degrees(np.mean(means[-count:])),
        settled=settled,
        averaged_cycles=count,
        cycles=cycles,
        speed_limited_share=float(np.mean(np.abs(speed) >= 0.99 * speed_limit)),
        acceleration_limited_share=float(
            np.mean(np.abs(acceleration) >= 0.99 * acceleration_limit)
        ),
    )
