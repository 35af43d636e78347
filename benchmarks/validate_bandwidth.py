"""Check measured frequency responses against closed forms and the linear loop.

    python benchmarks/validate_bandwidth.py

Prints the table "what | required | found"; ten seconds, or minutes without the compiled engine.
Bandwidth is where the gain of the fundamental first falls below 1/√2.
"""

from __future__ import annotations

import cmath
import math

import numpy as np
from scipy.optimize import brentq

from kneexo.analysis import linearize_loop, rate_limit_bandwidth_hz, simulate
from kneexo.analysis.frequency.bandwidth import (
    follower_bandwidth_hz,
    follower_response,
    large_signal_bandwidth_hz,
    rod_limits,
)
from kneexo.analysis.frequency.sine_estimate import cycle_responses, estimate_sine
from kneexo.geometry.linkage import polynomial
from kneexo.geometry.rod_polynomial import controller_polynomial
from kneexo.parameters import SampledReference, Scenario
from kneexo.parameters.criteria import MINUS_3_DB
from kneexo.parameters.paths import changed

STIFFER_PER_S = 40.0
"""Twice the default λ: the sliding surface is met later, and nearer to where the follower does."""

SMALL_SINES_HZ = (0.3, 1.0, 2.3, 5.0, 7.7, 13.7, 20.0)
SMALL_DEG = 0.01
"""So small that the motor stays off its acceleration limit up to 20 Hz."""


def row(what: str, required: str, found: object) -> None:
    """Print one row of the table."""
    print(f"{what} | {required} | {found}", flush=True)


def rod_sine(scenario: Scenario, frequency_hz: float, cycles: int) -> SampledReference:
    """Knee reference whose rod, by Table 1, is a cosine between the ends of the scenario's."""
    angles = np.radians(np.linspace(5.0, 75.0, 20_001))
    p_si = controller_polynomial(scenario).p_si
    table = polynomial(p_si, angles)
    high, low = (polynomial(p_si, math.radians(a)) for a in scenario.reference.range_deg)
    phase = np.linspace(0.0, 2.0 * math.pi * cycles, 400 * cycles + 1)
    rod = 0.5 * (high + low) + 0.5 * (high - low) * np.cos(phase)
    knee = np.degrees(np.interp(rod, table[::-1], angles[::-1]))
    times = phase / (2.0 * math.pi * frequency_hz)
    return SampledReference(times_s=tuple(times.tolist()), angles_deg=tuple(knee.tolist()))


def rod_sine_gain(scenario: Scenario, frequency_hz: float) -> float:
    """Gain x/x_d of the fundamental for a sine in the rod, in the third of four cycles."""
    at = changed(
        scenario,
        {
            "reference": rod_sine(scenario, frequency_hz, 4).model_dump(),
            "simulation.duration_s": 4.0 / frequency_hz,
        },
    )
    columns = {"output": "rod_extension_m", "reference": "rod_reference_m"}
    run = simulate(at, signals=("rod_extension", "rod_reference"))
    responses, _ = cycle_responses(run, frequency_hz, 0.0, 4, **columns)
    return float(abs(responses[2]))


def rod_sine_bandwidths_hz(scenario: Scenario) -> tuple[float, float]:
    """−3 dB frequency of a sine in the rod between the reference's ends: measured, closed form."""
    p_si = controller_polynomial(scenario).p_si
    ends = polynomial(p_si, np.radians(scenario.reference.range_deg))
    closed = rate_limit_bandwidth_hz(rod_limits(scenario)[0], 0.5 * abs(ends[1] - ends[0]))

    def excess(log_frequency: float) -> float:
        return math.log(rod_sine_gain(scenario, math.exp(log_frequency)) / MINUS_3_DB)

    span = math.log(closed) + np.log([0.95, 1.05])
    return math.exp(brentq(excess, *span, xtol=1e-4)), closed


def linear_deviation(frequency_hz: float, amplitude_deg: float, *, quantized: bool) -> float:
    """|G/G_linear − 1| for a sine in the knee angle."""
    scenario = changed(
        Scenario(),
        {
            "reference.amplitude_deg": amplitude_deg,
            "reference.frequency_hz": frequency_hz,
            "encoder.quantized": quantized,
        },
    )
    predicted = linearize_loop(scenario, knee_angle_deg=40.0).output_response(frequency_hz)[0]
    return float(abs(estimate_sine(scenario).response / predicted - 1.0))


def phases_deg(lambdas_per_s: tuple[float, ...]) -> list[float]:
    """Phase of 30° at 1 Hz, far beyond the speed limit, by λ."""
    at = [
        changed(Scenario(), {"reference.frequency_hz": 1.0, "controller.lambda_per_s": value})
        for value in lambdas_per_s
    ]
    return [math.degrees(cmath.phase(estimate_sine(scenario).response)) for scenario in at]


def main() -> None:
    """Print the table."""
    row("what", "required", "found")
    row("---", "---", "---")
    stiffer = changed(Scenario(), {"controller.lambda_per_s": STIFFER_PER_S})
    cases = (("", Scenario(), "1 %", "1.5 %"), (f", λ = {STIFFER_PER_S:g} 1/s", stiffer, "–", "–"))
    for name, scenario, required, _ in cases:
        measured, closed = rod_sine_bandwidths_hz(scenario)
        row(
            f"−3 dB, sine in x{name}, against the closed form {closed:.4f} Hz",
            required,
            f"{measured:.4f} Hz, {100 * (measured / closed - 1):+.2f} %",
        )
    for name, scenario, _, required in cases:
        measured, follower = large_signal_bandwidth_hz(scenario), follower_bandwidth_hz(scenario)
        row(
            f"−3 dB, sine in θ{name}, against the follower {follower:.4f} Hz",
            required,
            f"{measured:.4f} Hz, {100 * (measured / follower - 1):+.2f} %",
        )
    for what, amplitude, quantized in (
        ("without quantizer", SMALL_DEG, False),
        ("with quantizer", 1.0, True),
    ):
        frequencies = [f for f in SMALL_SINES_HZ if f <= 2.3 or not quantized]
        deviation = max(linear_deviation(f, amplitude, quantized=quantized) for f in frequencies)
        row(
            f"sine of {amplitude:g}°, {frequencies[0]:g}…{frequencies[-1]:g} Hz, {what}, against "
            f"the linear loop",
            "0.1 %" if not quantized else "–",
            f"{100 * deviation:.3f} %",
        )
    phases = ", ".join(f"{deg:.0f}°" for deg in phases_deg((10.0, 20.0, 40.0, 80.0)))
    row("phase of 30° at 1 Hz with λ = 10, 20, 40, 80 1/s", "–", phases)
    follower = follower_response(Scenario(), 1.0)
    row("the same of the follower", "–", f"{math.degrees(cmath.phase(follower)):.0f}°")


if __name__ == "__main__":
    main()
