"""Metrics of tracking runs, declared as reductions of the signals.

The machine code computes the reductions inside its time loop, and NumPy computes them from a log.
The two sum in another order.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache, partial

import numpy as np

from diagramc import Reduction
from kneexo.analysis.signals import rms, saturation, to_rpm
from kneexo.common.result import Array
from kneexo.diagrams import SIGNALS
from kneexo.errors import ParameterError
from kneexo.parameters import Scenario

TRACKING_METRICS = (
    "max_error_deg",
    "rms_error_deg",
    "mean_command_change_rpm",
    "saturated_share",
    "peak_pressure_mpa",
)
"""Names of the metrics that `basic_metrics` computes."""

_LARGEST_BOUND = 1e300  # stands for no rating, because the bound of a reduction is finite


@lru_cache
def basic_reductions(settled_s: float, command_limit_rad_s: float) -> tuple[Reduction, ...]:
    """Return the reductions from which `basic_metrics` computes the `TRACKING_METRICS`."""
    error = partial(Reduction, output="knee_reference[0]", minus="knee_angle", after_s=settled_s)
    command = partial(Reduction, output="motor_speed_command", after_s=settled_s)
    pressure = partial(Reduction, output="load_pressure", magnitude=True)
    bound = saturation(command_limit_rad_s)
    saturated = partial(Reduction, output="motor_speed_command", magnitude=True, bound=bound)
    return (
        pressure("count"),
        pressure("maximum"),
        command("count", magnitude=True),
        error("maximum", magnitude=True),
        error("rms"),
        command("variation"),
        saturated("count"),
    )


@lru_cache
def torque_reductions(settled_s: float) -> tuple[Reduction, ...]:
    """Return the reductions that compute the `INTERACTION_METRICS`."""
    torque = partial(Reduction, output="interaction_torque", after_s=settled_s)
    return torque("maximum", magnitude=True), torque("rms")


@lru_cache
def tracking_reductions(
    settled_s: float, command_limit_rad_s: float, pressure_rating_pa: float, power_rating_w: float
) -> tuple[Reduction, ...]:
    """Return the reductions from which `all_metrics` computes the fields of `TrackingMetrics`."""
    error = partial(Reduction, output="knee_reference[0]", minus="knee_angle")
    power = partial(Reduction, output="shaft_power")

    def above(output: str, rating: float) -> Reduction:
        # A reduction counts values at or above its bound, and a share those above the rating.
        bound = math.nextafter(min(rating, _LARGEST_BOUND), math.inf)
        return Reduction("count", output, magnitude=True, bound=bound)

    return (
        *basic_reductions(settled_s, command_limit_rad_s),
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


def scenario_reductions(scenario: Scenario, settled_s: float) -> tuple[Reduction, ...]:
    """Return the `tracking_reductions` with the limits of a scenario."""
    return tracking_reductions(
        settled_s,
        scenario.command_limit_rad_s,
        scenario.pressure_rating_pa,
        scenario.power_rating_w,
    )


def basic_metrics(values: Sequence[float]) -> dict[str, float]:
    """Return the `TRACKING_METRICS` from the values of the `basic_reductions`.

    Raises `ParameterError` for fewer than two samples.
    """
    samples, pressure, settled_samples, error, rms_error, variation, saturated = values
    if samples < 2:
        raise ParameterError(
            f"{samples:.0f} samples are too few for metrics: the run must be longer than the "
            f"sample time"
        )
    metrics = dict.fromkeys(TRACKING_METRICS, math.nan)
    metrics["peak_pressure_mpa"] = 1e-6 * pressure
    metrics["saturated_share"] = saturated / samples
    if settled_samples > 1:
        metrics["max_error_deg"] = math.degrees(error)
        metrics["rms_error_deg"] = math.degrees(rms_error)
        metrics["mean_command_change_rpm"] = to_rpm(variation / (settled_samples - 1))
    return metrics


def all_metrics(values: Sequence[float]) -> dict[str, float]:
    """Return the fields of `TrackingMetrics` from the values of the `tracking_reductions`.

    Raises `ParameterError` for fewer than two samples.
    """
    *basic, error, rms_error, command, over_pressure, power, over_power = values[:-3]
    energy, absolute_energy, hydraulic_energy = values[-3:]
    samples = basic[0]
    return basic_metrics(basic) | {
        "max_error_overall_deg": math.degrees(error),
        "rms_error_overall_deg": math.degrees(rms_error),
        "peak_command_rpm": to_rpm(command),
        "pressure_over_rating_share": over_pressure / samples,
        "peak_shaft_power_w": power,
        "power_over_rating_share": over_power / samples,
        "shaft_energy_j": energy,
        "shaft_energy_delivered_j": 0.5 * (energy + absolute_energy),  # max(P, 0) = (P + |P|)/2
        "hydraulic_energy_j": hydraulic_energy,
    }


def reduce_signals(
    reductions: Sequence[Reduction], time_s: Array, signals: Mapping[str, Array]
) -> list[float]:
    """Return the value of each reduction of logged signals, as `Reduction` defines it.

    ``signals`` maps the name of a column to its values (n,), which belong to ``time_s`` (n,). The
    outputs of the reductions are names of `kneexo.diagrams.SIGNALS`.
    """
    values = []
    for reduction in reductions:
        first = int(np.searchsorted(time_s, reduction.after_s - 1e-9))
        samples = signals[_column(reduction.output)][first:]
        if reduction.minus is not None:
            samples = samples - signals[_column(reduction.minus)][first:]
        if reduction.magnitude:
            samples = np.abs(samples)
        values.append(_reduced(reduction, samples, time_s[first:]))
    return values


def _column(output: str) -> str:
    """Return the column of an element of an output port, such as ``knee_reference[0]``."""
    name, _, index = output.rstrip("]").partition("[")
    return SIGNALS[name][int(index or 0)]


def _reduced(reduction: Reduction, samples: Array, time_s: Array) -> float:
    match reduction.kind:
        case "maximum":
            return float(np.max(samples)) if samples.size else math.nan
        case "rms":
            return rms(samples) if samples.size else math.nan
        case "variation":
            return float(np.sum(np.abs(np.diff(samples))))
        case "integral":
            return float(np.trapezoid(samples, time_s))
        case "count":
            return float(np.count_nonzero(samples >= reduction.bound))
    raise NotImplementedError(f"a reduction of kind {reduction.kind} of logged signals")
