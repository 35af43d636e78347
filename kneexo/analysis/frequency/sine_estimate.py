"""Response of the closed loop to one sine of any amplitude, with its uncertainty.

`estimate_sine` extends the run until the response has settled.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydantic import model_validator

from kneexo.analysis.frequency.frequency_response import require_sampled, require_sine
from kneexo.common.result import Array, Result
from kneexo.parameters import Scenario
from kneexo.parameters.fields.quantity import Parameters, quantity
from kneexo.parameters.paths import changed
from kneexo.simulation import Run, needs_runs, simulate


class SineEstimateSettings(Parameters):
    """Ramp, settling criterion and number of averaged cycles of `estimate_sine`."""

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
    """Complex response θ_p/θ_d of the knee angle to a sine in its reference.

    The response is an average over the last cycles of a run. ``uncertainty`` is the absolute error
    of the complex response (`response_uncertainty`); errors that are equal in all cycles do not
    count. ``settled`` is True if each averaged cycle agrees with the next within the tolerance. If
    the response has not settled, the averaged cycles are the second half of the run.
    ``speed_limited_share`` is the share of the averaged samples in which the motor is within 1 % of
    its speed limit, and ``acceleration_limited_share`` is the same for the acceleration limit.
    """

    frequency_hz: float
    amplitude_deg: float
    response: complex
    uncertainty: float
    settled: bool
    averaged_cycles: int
    cycles: int
    """Number of simulated cycles after the ramp."""
    mean_deg: float
    """Mean knee angle of the averaged cycles.

    While the motor is at its limits, this mean can differ from the mean of the reference.
    """
    speed_limited_share: float
    acceleration_limited_share: float

    @property
    def gain(self) -> float:
        """Absolute value of ``response``."""
        return abs(self.response)


def motor_limits(scenario: Scenario) -> tuple[float, float]:
    """Return the largest speed in rad/s and the largest acceleration in rad/s² of the motor.

    The acceleration of an ideal motor is inf.
    """
    pump, command = scenario.plant.pump, scenario.command_limit_rad_s
    if scenario.plant.ideal_motor:
        return command, math.inf
    return min(command, pump.speed_limit_rad_s), pump.acceleration_limit_rad_s2


_HARMONICS = 3
"""Number of harmonics fitted to a cycle.

If a cycle is no whole number of samples, the fitted fundamental would be wrong if second and third
harmonics were not fitted too.
"""


def cycle_responses(
    run: Run,
    frequency_hz: float,
    start_s: float,
    cycles: int,
    *,
    output: str = "knee_angle_rad",
    reference: str = "knee_reference_rad",
) -> tuple[Any, Array]:
    """Return the response and the mean of the output in each cycle of a run.

    The response is the fundamental of the column ``output``, divided by the fundamental of the
    column ``reference``, complex with the shape (cycles,). The means of ``output`` have the shape
    (cycles,). The run must contain at least three cycles, and the first cycle begins at
    ``start_s``. A cycle need not contain a whole number of samples. The mean of the output can
    drift while the motor is at its limits. So the function estimates a linear drift from the means
    of neighbouring cycles and removes it.
    """
    means, amplitudes = np.empty((cycles, 3)), np.empty((cycles, 3), complex)
    phase = 2.0 * np.pi * frequency_hz * run.time_s
    basis = [np.ones_like(phase)]
    for n in range(1, _HARMONICS + 1):
        basis += [np.cos(n * phase), -np.sin(n * phase)]
    rows = np.column_stack(basis)
    signals = np.column_stack([run[output], run[reference], run.time_s])
    for cycle in range(cycles):
        # A sample on the border belongs to the next cycle, in spite of rounding of its time.
        limits = start_s + (cycle + np.arange(2)) / frequency_hz - 1e-9
        inside = slice(*np.searchsorted(run.time_s, limits))
        about_middle = signals[inside] - [0.0, 0.0, limits.mean()]
        fitted = np.linalg.lstsq(rows[inside], about_middle, rcond=None)[0]
        means[cycle], amplitudes[cycle] = fitted[0], fitted[1] + 1j * fitted[2]
    # The fit of a ramp gives the time to which a mean belongs and the fundamental of a drift.
    times = np.arange(cycles) / frequency_hz + means[:, 2]
    drift = np.gradient(means[:, 0], times, edge_order=2)
    measured, commanded, ramp = amplitudes.T
    return (measured - drift * ramp) / commanded, means[:, 0]


def settled_cycles(responses: Any, tolerance: float) -> int:
    """Return the number of last cycles over which the response has settled.

    ``responses`` (n,) are the complex responses of n cycles. Each of these last cycles agrees with
    the next cycle. Two responses agree if their difference is at most ``tolerance`` times the
    magnitude of the later response.
    """
    change = np.abs(np.diff(responses)) > tolerance * np.abs(responses[1:])
    return len(responses) - (int(np.flatnonzero(change)[-1]) + 1 if change.any() else 0)


def response_uncertainty(responses: Any) -> float:
    """Return the uncertainty of the mean of ``responses``, complex (n >= 2,).

    The uncertainty is the standard error of the mean, plus the distance between the mean of the
    first half and the mean of the last half.
    """
    n = len(responses)
    scatter = math.sqrt(float(np.sum(np.abs(responses - np.mean(responses)) ** 2)) / (n - 1))
    drift = abs(np.mean(responses[-(n // 2) :]) - np.mean(responses[: n // 2]))
    return scatter / math.sqrt(n) + float(drift)


@dataclass(frozen=True)
class SettledRun:
    """A run of a sine whose response has settled, or that has the largest number of cycles.

    ``responses`` and ``means`` (n,) belong to the n cycles that are averaged.
    """

    run: Run
    responses: Any
    means: Array
    settled: bool
    cycles: int


def settled_run(
    frequency_hz: float,
    settings: SineEstimateSettings,
    run_of: Callable[[float, float], Run],
    **columns: str,
) -> SettledRun:
    """Repeat a run with twice the number of cycles until `settled_cycles` are enough, or the most.

    Parameters
    ----------
    frequency_hz
        Frequency of the sine in Hz.
    settings
        When the response counts as settled, and how long the amplitude grows.
    run_of
        Function that returns a run. Its arguments are the time in which the amplitude grows, and
        the duration, both in s.
    columns
        The ``output`` and ``reference`` of `cycle_responses`.
    """
    ramp_s = max(settings.ramp_cycles / frequency_hz, settings.ramp_min_s)
    cycles, simulated = min(settings.averaged_cycles + 1, settings.largest_cycles), 0
    while True:
        if simulated < cycles:
            # The last run repeats no run before: it is long enough for both numbers of cycles.
            simulated = cycles if 2 * cycles < settings.largest_cycles else settings.largest_cycles
            whole = run_of(ramp_s, ramp_s + simulated / frequency_hz)
        run = _begin(whole, ramp_s + cycles / frequency_hz)
        responses, means = cycle_responses(run, frequency_hz, ramp_s, cycles, **columns)
        count = settled_cycles(responses, settings.tolerance)
        settled = count >= settings.averaged_cycles
        if settled or cycles == settings.largest_cycles:
            break
        if simulated == cycles:
            del run, whole  # saves memory while other calls in lockstep hold runs too
        cycles = min(2 * cycles, settings.largest_cycles)
    if not settled:
        count = max(settings.averaged_cycles, cycles // 2)
    return SettledRun(run, responses[-count:], means[-count:], settled, cycles)


def _begin(run: Run, duration_s: float) -> Run:
    """Return the samples of a run up to a time, as a run of this duration has them."""
    count = int(np.searchsorted(run.time_s, duration_s * (1.0 + 1e-12), side="right"))
    data = {name: values[:count] for name, values in run.data.items()}
    return replace(run, time_s=run.time_s[:count], data=data)


@needs_runs
def estimate_sine(
    scenario: Scenario = Scenario(),
    settings: SineEstimateSettings = SineEstimateSettings(),
) -> SineEstimate:
    """Measure the response of the closed loop to the sinusoidal reference of a scenario.

    The amplitude of the reference grows smoothly from zero. The run is repeated with twice the
    number of cycles until ``settings.averaged_cycles`` successive cycles agree, or until
    ``settings.largest_cycles`` are reached. Ramp and duration of the scenario are replaced.

    Raises `ParameterError` when the reference is not a sine, does not move, or has fewer than ten
    samples a period. Also raises the errors of `kneexo.simulation.simulate`.
    """
    reference = require_sine(scenario)
    frequency = reference.frequency_hz
    require_sampled(frequency, scenario)

    def run_of(ramp_s: float, duration_s: float) -> Run:
        values = {"reference.ramp_s": ramp_s, "simulation.duration_s": duration_s}
        signals = ("knee_reference", "knee_angle", "motor_speed")
        return simulate(changed(scenario.undisturbed(), values), signals=signals)

    found = settled_run(frequency, settings, run_of)
    run, count = found.run, len(found.responses)
    speed = run["motor_speed_rad_s"][run.time_s > run.time_s[-1] - count / frequency]
    acceleration = np.diff(speed) / scenario.controller.sample_time_s
    speed_limit, acceleration_limit = motor_limits(scenario)
    return SineEstimate(
        frequency_hz=frequency,
        amplitude_deg=reference.amplitude_deg,
        response=complex(np.mean(found.responses)),
        uncertainty=response_uncertainty(found.responses),
        mean_deg=math.degrees(np.mean(found.means)),
        settled=found.settled,
        averaged_cycles=count,
        cycles=found.cycles,
        speed_limited_share=float(np.mean(np.abs(speed) >= 0.99 * speed_limit)),
        acceleration_limited_share=float(
            np.mean(np.abs(acceleration) >= 0.99 * acceleration_limit)
        ),
    )
