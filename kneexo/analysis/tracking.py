"""Tracking run: how well a closed loop follows its reference, and what it costs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from kneexo.analysis.coroutines import Steps, steps
from kneexo.analysis.simulation import Array, Run, needs_runs, period_s, rms, simulate, to_rpm
from kneexo.errors import ParameterError
from kneexo.parameters import Scenario

TRACKING_SIGNALS = (
    "knee_reference",
    "knee_angle",
    "motor_speed_command",
    "load_pressure",
    "shaft_power",
    "hydraulic_power",
)
"""The signals that the metrics need; a run that logs no more is faster."""


@dataclass(frozen=True)
class TrackingMetrics:
    """Figures of merit of a tracking run.

    Errors and commands are insensitive to the solver's step; pressure, power and energy are not
    while the 447 Hz mode of the oil dominates them (as without load): halve the step before you
    quote them.

    "After the first period" means from one period of a sinusoidal reference on, and from the start
    for every other reference; those figures are nan for a run that ends before.
    """

    max_error_deg: float
    """Largest |θ_d − θ_p| after the first period."""
    rms_error_deg: float
    """Root mean square of θ_d − θ_p after the first period."""
    max_error_overall_deg: float
    rms_error_overall_deg: float
    mean_command_change_rpm: float
    """Chattering index: mean change of the command per sample, after the first period."""
    saturated_share: float
    """Share of the samples whose command is at its limit, after the first period."""
    peak_command_rpm: float
    peak_pressure_mpa: float
    pressure_over_rating_share: float
    """Share of all samples with |P_L| above the cylinder's rating."""
    peak_shaft_power_w: float
    power_over_rating_share: float
    """Share of all samples with a shaft power above the motor's rating."""
    shaft_energy_j: float
    """Work of the motor on the pump over the run; what flows back counts negative."""
    shaft_energy_delivered_j: float
    """The same without what flows back."""
    hydraulic_energy_j: float
    """Work of the pump on the cylinder over the run."""


def mean_change(values: Array) -> float:
    """Mean absolute difference of neighbouring samples, in the unit of ``values`` (n,)."""
    return float(np.mean(np.abs(np.diff(values))))


def saturated_share(command: Array, limit: float) -> float:
    """Share of ``command`` (n,) within a millionth of ±``limit``."""
    return float(np.mean(np.abs(command) >= limit * (1.0 - 1e-6)))


def tracking_metrics(
    time_s: Array,
    error_rad: Array,
    command_rad_s: Array,
    pressure_pa: Array,
    shaft_power_w: Array,
    hydraulic_power_w: Array,
    *,
    settled_s: float,
    command_limit_rad_s: float,
    pressure_rating_pa: float,
    power_rating_w: float = math.inf,
) -> TrackingMetrics:
    """`TrackingMetrics` from equally long arrays (n,), uniformly sampled at ``time_s``.

    Raises `ParameterError` for fewer than two samples.
    """
    if time_s.size < 2:
        raise ParameterError(
            f"{time_s.size} samples are too few for metrics: the run must be longer than the "
            f"sample time"
        )
    first = int(np.searchsorted(time_s, settled_s - 1e-9))
    long_enough = time_s.size - first > 1
    settled = slice(first if long_enough else 0, None)
    error = np.degrees(error_rad)
    power = np.asarray(shaft_power_w)

    def after(value: float) -> float:
        return value if long_enough else math.nan

    return TrackingMetrics(
        max_error_deg=after(float(np.max(np.abs(error[settled])))),
        rms_error_deg=after(rms(error[settled])),
        max_error_overall_deg=float(np.max(np.abs(error))),
        rms_error_overall_deg=rms(error),
        mean_command_change_rpm=after(to_rpm(mean_change(command_rad_s[settled]))),
        saturated_share=after(saturated_share(command_rad_s[settled], command_limit_rad_s)),
        peak_command_rpm=to_rpm(float(np.max(np.abs(command_rad_s)))),
        peak_pressure_mpa=1e-6 * float(np.max(np.abs(pressure_pa))),
        pressure_over_rating_share=float(np.mean(np.abs(pressure_pa) > pressure_rating_pa)),
        peak_shaft_power_w=float(np.max(np.abs(power))),
        power_over_rating_share=float(np.mean(np.abs(power) > power_rating_w)),
        shaft_energy_j=float(np.trapezoid(power, time_s)),
        shaft_energy_delivered_j=float(np.trapezoid(np.maximum(power, 0.0), time_s)),
        hydraulic_energy_j=float(np.trapezoid(hydraulic_power_w, time_s)),
    )


@dataclass(frozen=True)
class TrackingResult:
    """A tracking run: the scenario, its signals and its metrics."""

    scenario: Scenario
    run: Run
    metrics: TrackingMetrics

    @property
    def error_deg(self) -> Array:
        """θ_d − θ_p in deg, (n,)."""
        return np.degrees(self.run["knee_reference_rad"] - self.run["knee_angle_rad"])

    def plot_angle(self, ax: Axes | None = None) -> Axes:
        """Plot reference and knee angle over time."""
        ax = plt.subplots()[1] if ax is None else ax
        time = self.run.time_s
        angle, reference = (
            np.degrees(self.run[name]) for name in ("knee_angle_rad", "knee_reference_rad")
        )
        ax.plot(time, angle, "C0", lw=2.5, alpha=0.6, label="knee angle")
        ax.plot(time, reference, "k--", lw=1, label="reference")
        ax.set(xlabel="time (s)", ylabel="knee angle (deg)")
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.25 * (high - low))  # room for the legend
        ax.legend(loc="upper right", ncols=2)
        return ax

    def plot_error(self, ax: Axes | None = None) -> Axes:
        """Plot the tracking error over time."""
        ax = plt.subplots()[1] if ax is None else ax
        ax.plot(self.run.time_s, self.error_deg, "C3", lw=1)
        ax.axhline(0.0, color="0.7", lw=0.8, zorder=0)
        ax.set(xlabel="time (s)", ylabel="tracking error (deg)")
        return ax

    def plot(self, ax: Any = None) -> Any:
        """Plot angle, error and motor speed command, one below the other.

        ``ax``: three axes; made when left out. Returns them.
        """
        if ax is None:
            ax = plt.subplots(3, 1, sharex=True, figsize=(7, 7), layout="constrained")[1]
        self.plot_angle(ax[0])
        self.plot_error(ax[1])
        limit = to_rpm(self.scenario.command_limit_rad_s)
        ax[2].plot(self.run.time_s, to_rpm(self.run["motor_speed_command_rad_s"]), "C2", lw=0.8)
        ax[2].set(xlabel="time (s)", ylabel="motor speed command (rpm)")
        if limit < 1e6:
            for sign in (-1, 1):
                ax[2].axhline(sign * limit, color="0.4", ls=":", lw=1)
        for upper in ax[:2]:
            upper.set_xlabel("")
        return ax


@needs_runs
def track(
    scenario: Scenario = Scenario(),
    *,
    all_signals: bool = False,
    progress: Callable[[float], Any] | None = None,
) -> Steps[TrackingResult]:
    """Simulate a scenario and measure how it tracks.

    ``all_signals`` logs every signal, not only those of the metrics. Raises what
    `kneexo.analysis.simulate` raises.
    """
    signals = None if all_signals else TRACKING_SIGNALS
    run = yield from steps(simulate, scenario, signals=signals, progress=progress)
    metrics = tracking_metrics(
        run.time_s,
        run["knee_reference_rad"] - run["knee_angle_rad"],
        run["motor_speed_command_rad_s"],
        run["load_pressure_pa"],
        run["shaft_power_w"],
        run["hydraulic_power_w"],
        settled_s=period_s(scenario),
        command_limit_rad_s=scenario.command_limit_rad_s,
        pressure_rating_pa=scenario.plant.cylinder.pressure_rating_pa,
        power_rating_w=scenario.plant.pump.rated_power_w,
    )
    return TrackingResult(scenario, run, metrics)
