"""Tracking metrics that the compiled engine computes inside its time loop, without a log."""

from __future__ import annotations

import math
from functools import lru_cache, partial

import numpy as np

from kneexo.analysis.interaction import INTERACTION_METRICS, INTERACTION_SIGNALS
from kneexo.analysis.signals import period_s, rms, saturation, to_rpm
from kneexo.analysis.tracking import (
    TRACKING_METRICS,
    TRACKING_SIGNALS,
    TrackingMetrics,
    basic_tracking_metrics,
    peak,
    require_samples,
    track,
)
from kneexo.compiler import Reduction
from kneexo.parameters import Scenario
from kneexo.simulation import awaitable, can_reduce, needs_runs, reduce_run, simulate


@needs_runs
async def track_basic_metrics(scenario: Scenario) -> dict[str, float]:
    """Simulate a scenario and return its `TRACKING_METRICS`.

    With a wearer the result has the `INTERACTION_METRICS` too, over the samples after the first
    period. If `can_reduce` accepts the scenario, the compiled engine computes the metrics inside
    its time loop, without a log. Otherwise the run logs the signals, and NumPy computes the
    metrics. The two ways round sums differently.
    """
    settled_s, limit = period_s(scenario), scenario.command_limit_rad_s
    wearer = scenario.wearer.kind != "none"
    if can_reduce(scenario):
        basic = _basic_reductions(settled_s, limit)
        more = _torque_reductions(settled_s) if wearer else ()
        values = await awaitable(reduce_run, scenario, basic + more)
        metrics = _reduced_metrics(*values[: len(basic)])
        return metrics | dict(zip(INTERACTION_METRICS, values[len(basic) :].tolist(), strict=False))
    signals = (*TRACKING_SIGNALS[:4], *INTERACTION_SIGNALS[:1] * wearer)
    run = await awaitable(simulate, scenario, signals=signals)
    metrics = basic_tracking_metrics(
        run.time_s,
        run["knee_reference_rad"] - run["knee_angle_rad"],
        run["motor_speed_command_rad_s"],
        run["load_pressure_pa"],
        settled_s=settled_s,
        command_limit_rad_s=limit,
    )
    if wearer:
        torque = run["interaction_torque_n_m"][np.searchsorted(run.time_s, settled_s - 1e-9) :]
        torques = (peak(torque), rms(torque)) if torque.size else (math.nan, math.nan)
        metrics |= dict(zip(INTERACTION_METRICS, torques, strict=True))
    return metrics


@needs_runs
async def track_metrics(scenario: Scenario) -> TrackingMetrics:
    """Simulate a scenario and return the metrics of `track`.

    As in `track_basic_metrics`, the compiled engine computes them without a log.
    """
    if not can_reduce(scenario):
        return (await awaitable(track, scenario)).metrics
    plant = scenario.plant
    basic = _basic_reductions(period_s(scenario), scenario.command_limit_rad_s)
    more = _more_reductions(plant.cylinder.pressure_rating_pa, plant.pump.rated_power_w)
    values = (await awaitable(reduce_run, scenario, basic + more)).tolist()
    samples = values[0]
    error, rms_error, command, pressures, power, powers, energy, moved, hydraulic = values[
        len(basic) :
    ]
    return TrackingMetrics(
        **_reduced_metrics(*values[: len(basic)]),
        max_error_overall_deg=math.degrees(error),
        rms_error_overall_deg=math.degrees(rms_error),
        peak_command_rpm=to_rpm(command),
        pressure_over_rating_share=pressures / samples,
        peak_shaft_power_w=power,
        power_over_rating_share=powers / samples,
        shaft_energy_j=energy,
        shaft_energy_delivered_j=0.5 * (energy + moved),  # max(P, 0) = (P + |P|)/2
        hydraulic_energy_j=hydraulic,
    )


@lru_cache
def _basic_reductions(settled_s: float, command_limit_rad_s: float) -> tuple[Reduction, ...]:
    """Return the reductions from which `_reduced_metrics` computes the `TRACKING_METRICS`."""
    error = partial(Reduction, output="knee_reference[0]", minus="knee_angle", after_s=settled_s)
    command = partial(Reduction, output="motor_speed_command", after_s=settled_s)
    pressure = partial(Reduction, output="load_pressure", magnitude=True)
    return (
        pressure("count"),
        pressure("maximum"),
        command("count", magnitude=True),
        error("maximum", magnitude=True),
        error("rms"),
        command("variation"),
        command("count", magnitude=True, bound=saturation(command_limit_rad_s)),
    )


@lru_cache
def _torque_reductions(settled_s: float) -> tuple[Reduction, ...]:
    """Return the reductions that compute the `INTERACTION_METRICS`."""
    torque = partial(Reduction, output="interaction_torque", after_s=settled_s)
    return torque("maximum", magnitude=True), torque("rms")


@lru_cache
def _more_reductions(pressure_rating_pa: float, power_rating_w: float) -> tuple[Reduction, ...]:
    """Return the reductions from which `track_metrics` computes the other metrics."""
    error = partial(Reduction, output="knee_reference[0]", minus="knee_angle")
    power = partial(Reduction, output="shaft_power")

    def above(output: str, rating: float) -> Reduction:
        bound = math.nextafter(rating, math.inf)
        return Reduction("count", output, magnitude=True, bound=bound)

    return (
        error("maximum", magnitude=True),
        error("rms"),
        Reduction("maximum", "motor_speed_command", magnitude=True),
        above("load_pressure", pressure_rating_pa),
        power("maximum", magnitude=True),
        above("shaft_power", power_rating_w),
        power("integral"),
        power("integral", magnitude=True),
        Reduction("integral", "hydraulic_power"),
    )


def _reduced_metrics(
    samples: float,
    peak_pressure: float,
    settled_samples: float,
    peak_error: float,
    rms_error: float,
    variation: float,
    saturated: float,
) -> dict[str, float]:
    """Return the `TRACKING_METRICS` from the values of the `_basic_reductions`."""
    require_samples(samples)
    metrics = dict.fromkeys(TRACKING_METRICS, math.nan)
    metrics["peak_pressure_mpa"] = 1e-6 * float(peak_pressure)
    if settled_samples > 1:
        metrics["max_error_deg"] = math.degrees(peak_error)
        metrics["rms_error_deg"] = math.degrees(rms_error)
        metrics["mean_command_change_rpm"] = to_rpm(float(variation) / (settled_samples - 1))
        metrics["saturated_share"] = float(saturated) / settled_samples
    return metrics
