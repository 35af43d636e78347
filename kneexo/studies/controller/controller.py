"""Effects of λ, Φ and η of the sliding-mode controller, counted over a grid.

At every point of a grid over λ, Φ and η the study simulates the scenario's own reference, a faster
sine, a small step and a large step, and computes the margins of the sampled loop. Inside the
boundary layer |s| ≤ Φ the control law depends on Φ and η only through the slope k/Φ = βη/Φ.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import product
from typing import Any, Unpack

import numpy as np

from kneexo.analysis.tracking.tracking import track
from kneexo.common.result import Array
from kneexo.errors import failure_noted
from kneexo.parameters import (
    Scenario,
    SineReference,
    StepReference,
)
from kneexo.parameters.paths import changed
from kneexo.simulation import needs_runs
from kneexo.studies.assessment import assess
from kneexo.studies.controller.result import (
    MAP_METRICS,
    METRICS,
    ControllerResult,
    LimitCycleCase,
    observed_smc,
)
from kneexo.studies.controller.settings import ControllerSettings
from kneexo.studies.hardware import tuned
from kneexo.sweeps import SweepOptions, open_sweep
from kneexo.systems.knee_reference import run_middle_deg, run_range_deg

# ------------------------------------------------------------------------------------- runs


def controller_study(
    scenario: Scenario = Scenario(),
    settings: ControllerSettings = ControllerSettings(),
    **options: Unpack[SweepOptions],
) -> ControllerResult:
    """Measure the grid over λ, Φ and η, the limit cycle, and the map over T_f and k/Φ.

    If a run of the grid fails, its metrics are nan, and ``failures`` has the reason.

    Parameters
    ----------
    scenario
        A scenario with a sampled sliding-mode controller behind an observer.
    settings
        Values of the grid, steps and sines.
    options
        Workers, checkpoint and progress: see `kneexo.sweeps.SweepOptions`.

    Raises
    ------
    ParameterError
        The scenario has another controller or estimator, or a step or the faster sine leaves the
        range of motion.
    """
    law = observed_smc(scenario)[0]
    experiments(scenario, settings)  # a reference out of range is found before the sweep

    def with_slope(slope: float, time_constant: float, lambda_: float) -> Scenario:
        gains = {"lambda_per_s": lambda_, "slope_per_s": slope, "observer_s": time_constant}
        return tuned(scenario, gains)

    axes = (settings.lambdas_per_s, settings.phis_m_s2, settings.etas_m_s3)
    points = list(product(*axes))
    grid = [_with_law(scenario, *point) for point in points]
    unlimited = settings.unlimited_acceleration_rad_s2
    # The loop with a limit cycle, and variants whose comparison shows the cause of the cycle.
    variants: dict[str, dict[str, Any]] = {
        "as built": {},
        "exact encoder": {"encoder.quantized": False},
        "unlimited acceleration": {"plant.pump.acceleration_limit_rad_s2": unlimited},
    }
    cases = list(product(settings.limit_cycle_lambdas_per_s, variants))
    slope, time_s = settings.limit_cycle_slope_per_s, settings.limit_cycle_time_constant_s
    limit_cycles = [
        changed(with_slope(slope, time_s, lambda_), variants[name]) for lambda_, name in cases
    ]
    map_axes = (settings.map_time_constants_s, settings.map_slopes_per_s)
    loops = [with_slope(slope, time, law.lambda_per_s) for time, slope in product(*map_axes)]
    with open_sweep(**options) as sweep:
        measured = sweep.map(partial(_measure, settings), grid, "grid of λ, Φ, η")
        cycled = sweep.map(partial(_limit_cycle, settings), limit_cycles, "limit cycle")
        mapped = sweep.map(assess, loops, "map of T_f, k/Φ")
    return ControllerResult(
        scenario,
        settings,
        values=_arrays(measured, METRICS, axes),
        failures={
            point: values["failure"]
            for point, values in zip(points, measured, strict=True)
            if values["failure"]
        },
        limit_cycle=tuple(
            LimitCycleCase(*case, **run) for case, run in zip(cases, cycled, strict=True)
        ),
        map_values=_arrays(mapped, MAP_METRICS, map_axes),
    )


def experiments(scenario: Scenario, settings: ControllerSettings) -> dict[str, Scenario]:
    """Return a dictionary from name to a copy of the scenario with another reference.

    The references are a faster sine, a small step, a large step, and a hold at the upper end.
    """
    high, middle = run_range_deg(scenario)[1], run_middle_deg(scenario)

    def step(start: float, end: float, duration: float) -> Scenario:
        reference = StepReference(start_deg=start, end_deg=end, time_s=0.0)
        return changed(scenario, {"reference": reference, "simulation.duration_s": duration})

    def about_the_middle(size: float) -> Scenario:
        return step(middle - 0.5 * size, middle + 0.5 * size, settings.step_duration_s)

    fast = SineReference(
        mean_deg=middle,
        amplitude_deg=settings.fast_amplitude_deg,
        frequency_hz=settings.fast_frequency_hz,
    )
    return {
        "fast": changed(
            scenario, {"reference": fast, "simulation.duration_s": settings.fast_duration_s}
        ),
        "step": about_the_middle(settings.step_deg),
        "large_step": about_the_middle(settings.large_step_deg),
        "hold": step(high - settings.step_deg, high, settings.hold_duration_s),
    }


def settling_time_s(time_s: Array, error: Array, band: float) -> float:
    """Return the last time of ``time_s`` (n,) at which |error| (n,) exceeds ``band``.

    The result is inf if the last sample exceeds the band, and 0 if no sample exceeds the band. The
    first sample does not count, because the step starts there.
    """
    outside = np.flatnonzero(np.abs(error[1:]) > band)
    if outside.size == 0:
        return 0.0
    last = int(outside[-1]) + 1
    return math.inf if last == time_s.size - 1 else float(time_s[last])


@needs_runs
def _measure(settings: ControllerSettings, scenario: Scenario) -> dict[str, Any]:
    """Return the `METRICS` of one point of the grid. ``failure`` has the first failure's reason."""
    cases = experiments(scenario, settings)
    at_reference = assess(scenario)
    fast = assess(cases["fast"], margins=False)
    metrics: dict[str, Any] = {name: at_reference[name] for name in METRICS if name in at_reference}
    metrics["fast_max_error_deg"] = fast["max_error_deg"]
    reasons = {name: at_reference[name] for name in ("tracking_failure", "margins_failure")}
    reasons["fast"] = fast["tracking_failure"]
    for name, key in (("step", "settling_s"), ("large_step", "large_settling_s")):
        metrics[key] = math.nan
        with failure_noted(reasons, name):
            step = track(cases[name])
            band = settings.settling_band_deg
            metrics[key] = settling_time_s(step.run.time_s, step.error_deg, band)
    metrics["failure"] = next(filter(None, reasons.values()), "")
    return metrics


@needs_runs
def _limit_cycle(settings: ControllerSettings, scenario: Scenario) -> dict[str, Any]:
    """Return, as plain data, all fields of a `LimitCycleCase` except λ and variant."""
    linear = assess(scenario, tracking=False)
    row = {name: linear[name] for name in ("stable", "disk_margin")}
    with failure_noted(row):
        tracked = track(scenario)
        hold = track(experiments(scenario, settings)["hold"])
        late = hold.run.time_s >= 0.5 * hold.run.time_s[-1]
        row |= {
            "max_error_deg": tracked.metrics.max_error_deg,
            "mean_command_change_rpm": tracked.metrics.mean_command_change_rpm,
            "oscillation_at_rest_deg": float(np.ptp(hold.error_deg[late])),
            "time_s": tracked.run.time_s.tolist(),
            "error_deg": tracked.error_deg.tolist(),
        }
    return row


def _with_law(scenario: Scenario, lambda_: float, phi: float, eta: float) -> Scenario:
    values = {"lambda_per_s": lambda_, "phi_m_s2": phi, "eta_m_s3": eta}
    return changed(scenario, {f"controller.{name}": value for name, value in values.items()})


def _arrays(
    figures: list[dict[str, Any]], names: tuple[str, ...], axes: tuple[tuple[float, ...], ...]
) -> dict[str, Array]:
    """Return a dictionary from a metric's name to its values at all points.

    The values form an array with one dimension for each of ``axes``. None becomes nan.
    """
    shape = [len(axis) for axis in axes]
    return {
        name: np.array([values[name] for values in figures], dtype=float).reshape(shape)
        for name in names
    }
