"""Metrics of tracking runs: error, chattering, pressure, power and energy of a closed loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from kneexo.analysis.signals import settled_s, to_rpm
from kneexo.analysis.tracking.clauses import said
from kneexo.analysis.tracking.interaction import INTERACTION_SIGNALS, TORQUE_SIGNALS
from kneexo.analysis.tracking.limit_cycle import limit_cycle
from kneexo.analysis.tracking.reductions import (
    all_metrics,
    reduce_signals,
    scenario_reductions,
    tracking_reductions,
)
from kneexo.analysis.tracking.stop import first_stop
from kneexo.analysis.tracking.verdict import Verdict, verdict_of
from kneexo.common.plotting import BLUE, BROWN, GOLD, PURPLE, RED, TEAL, axes_or_new
from kneexo.common.result import Array, Result, data_frame
from kneexo.diagrams import SIGNALS, available_signals
from kneexo.diagrams.signals import PROTECTION_OUTPUTS
from kneexo.law.decision import makers_called_once
from kneexo.parameters import Scenario
from kneexo.parameters.criteria import RECOVERY_BAND_DEG, SETTLING_BAND
from kneexo.parameters.device.safety_states import STATES
from kneexo.parameters.scenario_file import as_scenario
from kneexo.simulation import Run, needs_runs, simulate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TRACKING_SIGNALS = (
    "knee_reference",
    "knee_angle",
    "motor_speed_command",
    "load_pressure",
    "shaft_power",
    "hydraulic_power",
)
"""Names of the signals from which `TrackingMetrics` are computed."""


@dataclass(frozen=True, repr=False)
class TrackingMetrics(Result):
    """Metrics of a tracking run.

    Errors and commands hardly depend on the solver's step. Pressure, power and energy depend on the
    step when they consist mainly of the oil's mode at 447 Hz, for example without load. Check such
    values with half the step.

    Metrics "after the first period" exclude the first period of a sinusoidal reference if the run
    has at least two periods. Of a shorter run, and for other references, they include the whole
    run. Shares are shares of all samples of the run.
    """

    max_error_deg: float
    """Largest |θ_d − θ_p| after the first period."""
    rms_error_deg: float
    """Root mean square of θ_d − θ_p after the first period."""
    max_error_overall_deg: float
    rms_error_overall_deg: float
    mean_command_change_rpm: float
    """Chattering index: mean |change of the command| per sample, after the first period."""
    saturated_share: float
    """Share of the samples in which the command is at its limit."""
    peak_command_rpm: float
    peak_pressure_mpa: float
    pressure_over_rating_share: float
    """Share of the samples in which the load pressure |P_L| exceeds the cylinder's rating."""
    peak_shaft_power_w: float
    power_over_rating_share: float
    """Share of the samples in which the shaft power exceeds the motor's rating."""
    shaft_energy_j: float
    """Work of the motor on the pump over the run. Power from pump to motor counts as negative."""
    shaft_energy_delivered_j: float
    """Work of the motor on the pump over the run. Power from pump to motor does not count."""
    hydraulic_energy_j: float
    """Work of the pump on the cylinder over the run."""


def mean_change(values: Array) -> float:
    """Return the mean absolute difference of neighbouring samples of ``values`` (n,)."""
    change = values[1:] - values[:-1]
    return float(np.mean(np.abs(change, out=change)))


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
    """Return the `TrackingMetrics` of uniformly sampled signals, (n,) each.

    Parameters
    ----------
    time_s
        Times of the samples in s, at equal distances.
    error_rad
        Tracking error θ_d − θ_p of the knee in rad.
    command_rad_s
        Command of the motor speed in rad/s.
    pressure_pa
        Load pressure P_L in Pa.
    shaft_power_w, hydraulic_power_w
        Power of the motor on the pump, and of the pump on the cylinder, in W.
    settled_s
        Time in s at which the metrics "after the first period" begin.
    command_limit_rad_s, pressure_rating_pa, power_rating_w
        Limits for the shares of samples at or above a limit. The last one is infinite by default.

    Raises
    ------
    ParameterError
        There are fewer than two samples.
    """
    reductions = tracking_reductions(
        settled_s, command_limit_rad_s, pressure_rating_pa, power_rating_w
    )
    signals = {
        "knee_reference_rad": error_rad,
        "knee_angle_rad": np.zeros_like(error_rad),
        "motor_speed_command_rad_s": command_rad_s,
        "load_pressure_pa": pressure_pa,
        "shaft_power_w": shaft_power_w,
        "hydraulic_power_w": hydraulic_power_w,
    }
    return TrackingMetrics(**all_metrics(reduce_signals(reductions, time_s, signals)))


def run_metrics(
    scenario: Scenario, time_s: Array, signals: Mapping[str, Array], *, settled_s: float
) -> TrackingMetrics:
    """Return the `TrackingMetrics` of the columns of a run, with the limits of ``scenario``.

    ``signals`` maps the name of each column of `TRACKING_SIGNALS` to its values (n,).
    """
    reductions = scenario_reductions(scenario, settled_s)
    return TrackingMetrics(**all_metrics(reduce_signals(reductions, time_s, signals)))


@dataclass(frozen=True, repr=False)
class StepMetrics(Result):
    """Metrics of the response to a step of the reference, as MATLAB's ``stepinfo`` defines them.

    Times count from the step. The final value is the reference after the step, not the last sample.
    A response with a remaining error therefore does not settle.
    """

    step_deg: float
    """Size of the step, negative if the knee extends."""
    rise_time_s: float
    """Time from 10 % to 90 % of the step; nan if the response does not reach 90 %."""
    overshoot_percent: float
    """Largest excess over the end of the step in % of the step, at least 0."""
    settling_time_s: float
    """First time after which the response stays within `SETTLING_BAND`.

    The settling time is nan if the response is outside the band at the end of the run.
    """
    final_error_deg: float
    """End of the step minus knee angle, at the last sample."""

    @property
    def settles(self) -> bool:
        """Whether the response is within `SETTLING_BAND` at the end of the run."""
        return math.isfinite(self.settling_time_s)

    @property
    def line(self) -> str:
        """One line with the metrics."""
        settles = "settles" if self.settles else "does not settle"
        rises = "rises" if math.isfinite(self.rise_time_s) else "does not rise"
        numbers = vars(self) | {"step_deg": abs(self.step_deg)}
        return f"{said(settles, rises, 'overshoots', **numbers)}."


def step_metrics(
    time_s: Array, angle_deg: Array, *, start_deg: float, end_deg: float, step_s: float
) -> StepMetrics | None:
    """Return the `StepMetrics` of a knee angle that follows a step of its reference.

    The result is None if the reference does not jump, or if no sample follows the step.

    Parameters
    ----------
    time_s, angle_deg
        Times of the samples in s, and the knee angle at these times in deg, (n,) each.
    start_deg, end_deg
        Reference before and after the step in deg.
    step_s
        Time in s just after which the reference jumps.
    """
    first = int(np.searchsorted(time_s, step_s - 1e-9))
    if start_deg == end_deg or first >= time_s.size - 1:
        return None
    time = time_s[first:] - step_s
    response = (angle_deg[first:] - start_deg) / (end_deg - start_deg)
    low, high = (np.flatnonzero(response >= level) for level in (0.1, 0.9))
    outside = np.flatnonzero(np.abs(response - 1.0) >= SETTLING_BAND)
    settled = int(outside[-1]) + 1 if outside.size else 0
    return StepMetrics(
        step_deg=end_deg - start_deg,
        rise_time_s=float(time[high[0]] - time[low[0]]) if high.size else math.nan,
        overshoot_percent=100.0 * max(0.0, float(np.max(response)) - 1.0),
        settling_time_s=float(time[settled]) if settled < time.size else math.nan,
        final_error_deg=float(end_deg - angle_deg[-1]),
    )


@dataclass(frozen=True, repr=False)
class PushResponse(Result):
    """How a push moves the knee, measured from the same run without the push."""

    largest_deviation_deg: float
    """Largest difference of the knee angles with and without the push."""
    recovery_time_s: float
    """Time from the start of the push to the first sample after which the knee stays in the band.

    The band is `RECOVERY_BAND_DEG`. The value is nan if the knee is outside at the end of the run.
    """

    @property
    def line(self) -> str:
        """One line with both numbers."""
        back = "is not back"
        if self.largest_deviation_deg <= RECOVERY_BAND_DEG:
            back = "stays"
        elif math.isfinite(self.recovery_time_s):
            back = f"is back {self.recovery_time_s:.3g} s after its start,"
        return (
            f"{said('push', **vars(self))}. The knee {back} within "
            f"{RECOVERY_BAND_DEG:g}° of the run without it."
        )


def push_response(
    time_s: Array, angle_deg: Array, free_deg: Array, *, start_s: float
) -> PushResponse:
    """Return the `PushResponse` of a run.

    Parameters
    ----------
    time_s
        Times of the samples in s, (n,).
    angle_deg, free_deg
        Knee angle in deg with and without the push at these times, (n,) each.
    start_s
        Start of the push in s.
    """
    deviation = np.abs(angle_deg - free_deg)
    outside = np.flatnonzero(deviation > RECOVERY_BAND_DEG)
    back = int(outside[-1]) + 1 if outside.size else 0
    recovery = max(float(time_s[back]) - start_s, 0.0) if back < time_s.size else math.nan
    return PushResponse(float(np.max(deviation)), recovery)


@dataclass(frozen=True, repr=False)
class TrackingResult(Result):
    """A simulated run: the scenario, its signals and its tracking metrics.

    ``print`` shows the verdict on the run.
    """

    scenario: Scenario
    run: Run
    metrics: TrackingMetrics

    @cached_property
    def verdict(self) -> Verdict:
        """Tracking, torques, saturation and the margins of the loop in a few lines.

        The loop of the scenario is linearized when the verdict is first asked for.
        """
        step = self.step
        described = None if step is None else (step.settles, step.line)
        return verdict_of(self.scenario, self.run, step=described)

    @property
    def step(self) -> StepMetrics | None:
        """Rise time, overshoot, settling time and final error of the response to a step.

        A response that leaves the settling band in a limit cycle does not settle.
        The value is None if the reference has no step, and with a torque controller.
        """
        reference, time_s = self.scenario.reference, self.run.time_s
        if reference.kind != "step" or self.scenario.controller.kind == "torque":
            return None
        metrics = step_metrics(
            time_s,
            np.degrees(self.run["knee_angle_rad"]),
            start_deg=reference.start_deg,
            end_deg=reference.end_deg,
            step_s=reference.time_s,
        )
        if metrics is None or limit_cycle(self.run) is None:
            return metrics
        # A limit cycle that leaves the band goes on for ever, also if the run ends in the band.
        if metrics.settling_time_s > 0.5 * (time_s[-1] - reference.time_s):
            return replace(metrics, settling_time_s=math.nan)
        return metrics

    @cached_property
    def push(self) -> PushResponse | None:
        """How the push of the scenario moves the knee; None without a push.

        The scenario is run again, without the push, when the value is first asked for.
        """
        push = self.scenario.push
        if push is None:
            return None
        free = simulate(self.scenario.changed({"push": None}), signals=("knee_angle",))
        angles = (np.degrees(run["knee_angle_rad"]) for run in (self.run, free))
        return push_response(self.run.time_s, *angles, start_s=push.start_s)

    def __str__(self) -> str:
        """Return the lines of the verdict."""
        return self.verdict.text

    def __getitem__(self, column: str) -> Array:
        """Return the values of a column of the run, (n,), as `Run` does.

        Raises `ResultError` if the run has no such column.
        """
        return self.run[column]

    @property
    def error_deg(self) -> Array:
        """Tracking error of the knee, θ_d − θ_p in deg, (n,)."""
        return np.degrees(self.run["knee_reference_rad"] - self.run["knee_angle_rad"])

    def to_dataframe(self) -> Any:
        """Return signals and ``error_deg`` as a `pandas.DataFrame` with the index ``time_s``.

        Raises `PackageError` without pandas.
        """
        columns = {"time_s": self.run.time_s, **self.run.data, "error_deg": self.error_deg}
        return data_frame(columns, "time_s")

    def plot_angle(self, ax: Axes | None = None) -> Axes:
        """Plot reference and knee angle over time, and the angle of a wearer's leg."""
        ax = axes_or_new(ax, caption="Knee angle and its reference over time.")
        time = self.run.time_s
        angle, reference = (
            np.degrees(self.run[name]) for name in ("knee_angle_rad", "knee_reference_rad")
        )
        ax.plot(time, angle, BLUE, lw=2.5, alpha=0.6, label="knee angle")
        if "wearer_angle_rad" in self.run.data:
            ax.plot(time, np.degrees(self.run["wearer_angle_rad"]), GOLD, lw=1.2, label="leg")
        ax.plot(time, reference, "k--", lw=1, label="reference")
        ax.set(xlabel="time (s)", ylabel="knee angle (deg)")
        _legend_above(ax)
        return ax

    def _mark(self, ax: Axes) -> None:
        """Shade push and faults, and mark the first stop."""
        time, active = self.run.time_s, self.run.columns.get("active_faults", np.zeros(1))
        if (push := self.scenario.push) is not None:
            ax.axvspan(push.start_s, push.end_s, color=GOLD, alpha=0.3, label="push")
        if active.any():  # the edge of the area shows a fault of one sample
            across: dict[str, Any] = {"transform": ax.get_xaxis_transform(), "label": "fault"}
            ax.fill_between(time, 0.0, 1.0, where=active > 0, color=RED, alpha=0.2, **across)
        if (stop := first_stop(self.scenario, self.run)) is not None:
            ax.axvline(stop.time_s, color="k", lw=0.8, label="stop")

    def plot_states(self, ax: Axes | None = None) -> Axes:
        """Plot the states of the supervisor over time; the run has a protection."""
        ax = axes_or_new(ax, caption="States of the supervisor over time.", figsize=(7, 2))
        # A row shows the state that began at the update of the row before.
        ax.step(self.run.time_s, self.run["safety_state"], BROWN, where="pre")
        ax.set(xlabel="time (s)", yticks=range(len(STATES)), yticklabels=STATES)
        return ax

    def plot_error(self, ax: Axes | None = None) -> Axes:
        """Plot the tracking error over time."""
        ax = axes_or_new(ax, caption="Tracking error, reference minus knee angle, over time.")
        ax.plot(self.run.time_s, self.error_deg, PURPLE, lw=1)
        ax.axhline(0.0, color="0.7", lw=0.8, zorder=0)
        ax.set(xlabel="time (s)", ylabel="tracking error (deg)")
        return ax

    def plot_torque(self, ax: Axes | None = None) -> Axes:
        """Plot the torques on the knee of the exoskeleton over time.

        The plot has the torque of the wearer, the torque of the actuator and its desired value, as
        far as the run has their signals.
        """
        caption = "Torques of wearer and actuator on the exoskeleton over time; positive flexes."
        ax = axes_or_new(ax, caption=caption)
        time, data = self.run.time_s, self.run.data
        if {"rod_force_n", "moment_arm_m"} <= set(data):
            ax.plot(time, -data["moment_arm_m"] * data["rod_force_n"], BLUE, lw=1, label="actuator")
        if "desired_torque_n_m" in data:
            ax.plot(time, data["desired_torque_n_m"], "k--", lw=1, label="actuator, desired")
        if "interaction_torque_n_m" in data:
            ax.plot(time, data["interaction_torque_n_m"], GOLD, lw=1, label="wearer")
        ax.set(xlabel="time (s)", ylabel="torque (N·m)")
        _legend_above(ax)
        return ax

    def plot_command(self, ax: Axes | None = None) -> Axes:
        """Plot the command of the motor speed over time, with its limit."""
        ax = axes_or_new(ax, caption="Motor speed command over time.")
        limit = to_rpm(self.scenario.command_limit_rad_s)
        ax.plot(self.run.time_s, to_rpm(self.run["motor_speed_command_rad_s"]), TEAL, lw=0.8)
        ax.set(xlabel="time (s)", ylabel="motor speed command (rpm)")
        if limit < 1e6:
            for sign, label in ((-1, None), (1, f"limit ±{limit:.0f} rpm")):
                ax.axhline(sign * limit, color=RED, ls=":", lw=1.2, label=label)
            _legend_above(ax)
        return ax

    def plot_pressure(self, ax: Axes | None = None) -> Axes:
        """Plot the pressures of both chambers over time, with the pressure of the relief valves.

        In the reduced order plot |P_L|, with the rating of the cylinder.
        """
        ax = axes_or_new(ax, caption="Pressures in the cylinder over time.")
        run, full = self.run, self.scenario.plant.full_order
        curves = {"|load pressure|": np.abs(run["load_pressure_pa"])}
        name, limit_mpa = "rating", 1e-6 * self.scenario.pressure_rating_pa
        if full is not None and "cap_pressure_pa" in run.data:
            curves = {"cap": run["cap_pressure_pa"], "rod side": run["rod_side_pressure_pa"]}
            name, limit_mpa = "relief valves", 1e-6 * full.relief_pressure_pa
        for (label, pressure_pa), colour in zip(curves.items(), (BLUE, GOLD), strict=False):
            ax.plot(run.time_s, 1e-6 * pressure_pa, colour, lw=1, label=label)
        if limit_mpa < math.inf:
            ax.axhline(limit_mpa, color=RED, ls=":", label=f"{name} {limit_mpa:.3g} MPa")
        ax.set(xlabel="time (s)", ylabel="pressure (MPa)")
        _legend_above(ax)
        return ax

    def plot(self, ax: Any = None) -> Any:
        """Plot angle, error, torques, motor speed command and pressures. Return the axes.

        A run without wearer and torque controller has no torques, and a run with torque controller
        has no error. All plots shade the push and the time of faults, and mark the stop of the
        protection. A run that is stopped has a strip with the states of the supervisor below.
        ``ax`` has one Matplotlib axes for each plot, below each other. If it is None, a new figure
        is made.
        """
        torque_control = self.scenario.controller.kind == "torque"
        plots = {"knee angle with its reference": self.plot_angle}
        if not torque_control:
            plots["tracking error (reference minus knee angle)"] = self.plot_error
        if torque_control or "interaction_torque_n_m" in self.run.data:
            plots["torques on the exoskeleton (positive flexes)"] = self.plot_torque
        plots["motor speed command"] = self.plot_command
        plots["pressures in the cylinder"] = self.plot_pressure
        if first_stop(self.scenario, self.run) is not None:
            plots["states of the supervisor"] = self.plot_states
        *names, last = plots
        caption = f"{', '.join(names)}, and {last} over time.".capitalize()
        size = (7, 1.0 + 2.0 * len(plots))
        ax = axes_or_new(ax, len(plots), 1, caption=caption, sharex=True, figsize=size)
        for axes, plot in zip(ax, plots.values(), strict=True):
            self._mark(axes)
            plot(axes)
        for upper in ax[:-1]:
            upper.set_xlabel("")
        return ax


def _legend_above(ax: Axes) -> None:
    """Draw a legend above the curves."""
    low, high = ax.get_ylim()
    ax.set_ylim(low, high + 0.25 * (high - low))
    ax.legend(loc="upper right", ncols=5, columnspacing=1.2)


def _verdict_signals(scenario: Scenario) -> tuple[str, ...]:
    """Return names of additional signals that the verdict on a run of ``scenario`` requires."""
    names = [*INTERACTION_SIGNALS, "biological_moment", "chamber_pressures", "active_faults"]
    names += (*PROTECTION_OUTPUTS, "motor_current")
    if scenario.controller.kind == "torque" or scenario.protection is not None:
        names += (*TORQUE_SIGNALS, "motor_speed")
    available = available_signals(scenario)
    names += (name for name in available if name not in SIGNALS)  # of parts of the user
    return tuple(name for name in dict.fromkeys(names) if name in available)


@needs_runs
@makers_called_once()
def track(
    scenario: Scenario | str | PathLike[str] = Scenario(),
    *,
    all_signals: bool = False,
    progress: Callable[[float], Any] | None = None,
    law: Any = None,
    initial_state: Sequence[float] = (),
) -> TrackingResult:
    """Simulate a scenario, or the scenario of a file, and compute its tracking metrics.

    The result has the metrics, the verdict on the run and its plots.

    Parameters
    ----------
    scenario
        A scenario, or the path of a scenario file.
    all_signals
        True: the run logs all available signals. False: only the signals that the metrics require.
    progress
        Function that is called with the simulated time in s. The compiled engine calls it once, at
        the end of the run.
    law
        A control law of the user that replaces the law of the scenario: a function such as
        ``lambda rod_extension, rod_reference: 1.3e5 * (rod_reference[0] - rod_extension)``, a
        Drake system, or ``FILE.py:NAME``. `kneexo.parameters.LawParameters` describes laws.
    initial_state
        First value of the argument ``state`` of the law. Empty: the default of this argument.

    Raises
    ------
    ScenarioError
        The scenario file is faulty.
    ParameterError
        The law cannot be used.
    SimulationError
        The run diverges or leaves its range.

    Examples
    --------
    The default scenario follows 30 s of the paper's sine of 30° at 0.1 Hz.

    >>> import kneexo as kx
    >>> result = kx.track()
    >>> print(f"largest error {result.metrics.max_error_deg:.2f} deg")
    largest error 0.05 deg
    """
    scenario = as_scenario(scenario, law, initial_state)
    signals: tuple[str, ...] | None = None
    if not all_signals:
        signals = TRACKING_SIGNALS + _verdict_signals(scenario)
    run = simulate(scenario, signals=signals, progress=progress)
    metrics = run_metrics(scenario, run.time_s, run.data, settled_s=settled_s(scenario))
    return TrackingResult(scenario, run, metrics)
