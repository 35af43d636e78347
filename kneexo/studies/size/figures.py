"""Figures of a `kneexo.studies.size.result.SizeResult`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from kneexo.analysis.frequency.bandwidth import rod_amplitude_m, rod_limits
from kneexo.analysis.frequency.frequency_response import require_sine
from kneexo.analysis.signals import to_rpm
from kneexo.common.plotting import BLUE, GOLD, RED, SERIES, decimal_ticks
from kneexo.common.result import Array
from kneexo.parameters import Scenario
from kneexo.parameters.device.plant import LOWEST_PRESSURE_PA
from kneexo.parameters.task.gait import gait_knee_flexion, gait_start_percent
from kneexo.studies.hardware import (
    ACCELERATION_ALONE_RATIO,
    ACCELERATION_LIMIT,
    DISPLACEMENT,
    HARDWARE,
    ONE_PERCENT_RATIO,
    SPEED_LIMIT,
)
from kneexo.studies.plots import (
    CENTRED,
    OUTLINE,
    Worse,
    colour_map,
    heat_map,
    ink,
    legend_below,
    mark_failures,
    merged_legend,
    plain_ticks,
)
from kneexo.studies.size.result import SizeResult

if TYPE_CHECKING:
    from kneexo.view.legs import Motion

HARDWARE_LABELS = {"nominal": "hardware as it is", "sized": "sized hardware"}
"""Labels of the two sets of hardware whose walking runs are in the traces of `SizeResult`."""

_STYLES: tuple[dict[str, Any], ...] = tuple(
    {"marker": marker, "ls": line, "color": colour}
    for marker, line, colour in zip(
        "os^vDx", ("-", "--", ":", "-", "-", "-."), (*SERIES, "0.45"), strict=True
    )
)
"""Style of each row of `HARDWARE` in the sweeps."""


def figures(result: SizeResult) -> dict[str, Figure]:
    """Draw the figures of a sizing. Return a dictionary from name to figure.

    The figures show sweeps and maps of the hardware, the gains, tracking and demand over a gait
    cycle, and pressures over a whole stride.
    """
    return {
        "sizing_sweeps": _sweeps(result),
        "sizing_maps": _maps(result),
        "walking_gains": _gains(result),
        "walking_tracking": _tracking(result),
        "walking_demand": _demand(result),
        "stride_pressure": _stride(result),
    }


def _sweeps(result: SizeResult) -> Figure:
    figure, grid = plt.subplots(2, 2, figsize=(8.4, 7.6), layout="constrained")
    axes, settings = grid.ravel()[:3], result.settings
    figure.set_label(
        "Bandwidth and largest error over each value of the hardware, with all other values "
        "unchanged. A point without marker is a run that fails."
    )
    panels = (
        (result.sweeps, settings.factors, "bandwidth_hz", "−3 dB bandwidth (Hz)"),
        (result.sweeps, settings.factors, "max_error_deg", "largest error (deg)"),
        (result.walking_sweeps, settings.walking_factors, "max_error_deg", "largest error (deg)"),
    )
    for axis, (sweeps, factors, merit, label) in zip(axes, panels, strict=True):
        for (path, sweep), style in zip(sweeps.items(), _STYLES, strict=True):
            values = [row[merit] for row in sweep]
            axis.plot(factors, values, ms=4.5, lw=1.2, label=HARDWARE[path][0], **style)
        axis.set(xscale="log", yscale="log", xlabel="factor on the value", ylabel=label)
        plain_ticks(axis.xaxis, factors[::2])
        decimal_ticks(axis.yaxis)
        axis.grid(alpha=0.3)
    for path, bound_style, label in (
        (SPEED_LIMIT, "k-.", "bound: motor speed limit"),
        (DISPLACEMENT, "k--", "bound: pump displacement"),
        (ACCELERATION_LIMIT, "k:", "bound: acceleration limit"),
    ):
        bound = [row["expected_bandwidth_hz"] for row in result.sweeps[path]]
        axes[0].plot(settings.factors, bound, bound_style, lw=1.2, label=label)
    bound_label = f"(c) bound of the paper, {settings.error_bound_deg:g}°"
    axes[2].axhline(settings.error_bound_deg, color=RED, ls="--", lw=1, label=bound_label)
    reference, frequency = require_sine(result.scenario), result.designs[0].frequency_hz
    low, high = reference.range_deg
    axes[0].set_title(f"(a) {low:g}…{high:g}°, hardware as it is")
    axes[1].set_title(f"(b) {low:g}…{high:g}° at {reference.frequency_hz:g} Hz, hardware as it is")
    axes[2].set_title(f"(c) walking at {frequency:.3g} Hz, sized hardware")
    grid[1, 1].set_axis_off()  # the legend has this place
    entries = merged_legend((axes[0], axes[2]))
    grid[1, 1].legend(entries.values(), entries, loc="center", title="the varied value")
    return figure


def _maps(result: SizeResult) -> Figure:
    figure, axes = plt.subplots(2, 1, figsize=(7.5, 9.5), layout="constrained")
    figure.set_label(
        "Bandwidth (a) and largest error in walking (b) over the limits of rod speed and motor "
        "acceleration. Darker is worse. In a hatched cell the run fails."
    )
    design, settings = result.designs[0], result.settings
    error = "largest error (deg)"
    panels: tuple[tuple[Scenario, tuple[float, ...], Array, str, Worse], ...] = (
        (result.scenario, settings.factors, result.bandwidth_map_hz, "−3 dB bandwidth (Hz)", "low"),
        (design.scenario, settings.walking_factors, result.walking_map_deg, error, "high"),
    )
    for axis, (scenario, factors, values, label, worse) in zip(axes, panels, strict=True):
        speed = 1e3 * rod_limits(scenario)[0] * np.asarray(factors)
        limit = scenario.plant.pump.acceleration_limit_rad_s2 * np.asarray(factors)
        axis.set(xlabel="rod speed limit R (mm/s)", ylabel="acceleration limit (rad/s²)")
        if np.isnan(values).all():
            axis.set(xlim=speed[[0, -1]], ylim=limit[[0, -1]], xscale="log", yscale="log")
            axis.text(0.5, 0.5, "every run fails", transform=axis.transAxes, ha="center")
        else:
            _cells(axis, speed, limit, values, label, worse)
        plain_ticks(axis.xaxis, [float(f"{v:.2g}") for v in speed])
        plain_ticks(axis.yaxis, [float(f"{v:.3g}") for v in limit])
        axis.tick_params(axis="x", rotation=45)
    _regimes(axes[0], result)
    _walking_limits(axes[1], result)
    axes[0].set_title("(a) controller as it is", loc="left", fontsize=10)
    title = f"(b) walking at {design.frequency_hz:.3g} Hz, sized controller"
    axes[1].set_title(title, loc="left", fontsize=10)
    return figure


def _cells(axis: Axes, speed: Array, limit: Array, values: Array, label: str, worse: Worse) -> None:
    """Draw a heat map with a number in each cell that has one.

    The rows of ``values`` are acceleration limits in rad/s², the columns are rod speed limits in
    mm/s.
    """
    norm = LogNorm(np.nanmin(values), np.nanmax(values) * 1.001)
    colours = heat_map(axis, speed, limit, values.T, norm=norm, label=label, worse=worse)
    for (row, column), value in np.ndenumerate(values):
        if math.isfinite(value):
            cell = colours(norm(value))
            # The box hides the lines of `_regimes` and `_walking_limits` behind the number.
            box = {"facecolor": cell, "lw": 0.0, "pad": 0.8}
            at = float(speed[column]), float(limit[row])
            axis.text(*at, f"{value:.2g}", fontsize=7, color=ink(cell), bbox=box, **CENTRED)


def _regimes(axis: Axes, result: SizeResult) -> None:
    """Draw two lines on a map, at the limits of the ratio A a/R².

    A (m/s²) and R (m/s) are the rod's acceleration and speed limits, a (m) is its amplitude. Below
    ``ONE_PERCENT_RATIO`` the limit A reduces the bandwidth by over 1 %. Below
    ``ACCELERATION_ALONE_RATIO`` the limit R has no effect on the bandwidth.
    """
    speed = np.array(axis.get_xlim())
    motor = result.scenario.plant.pump.speed_limit_rad_s
    amplitude = rod_amplitude_m(result.scenario)
    for ratio, style, below in (
        (ONE_PERCENT_RATIO, "--", "the acceleration limit counts"),
        (ACCELERATION_ALONE_RATIO, ":", "it alone counts"),
    ):
        limit = ratio * motor * 1e-3 * speed / amplitude
        label = f"A = {ratio:.2g} R²/a; below, {below}"
        axis.plot(speed, limit, style, color=RED, lw=1.6, label=label, path_effects=OUTLINE)
    _legend_below(axis)


def _walking_limits(axis: Axes, result: SizeResult) -> None:
    """Draw the rod speed and motor acceleration that walking requires, and the sized hardware."""
    speed = np.array(axis.get_xlim())
    peaks, design = result.demands[0].peaks(), result.designs[0].scenario
    motor = design.plant.pump.speed_limit_rad_s
    needed = peaks["peak_rod_acceleration_m_s2"] * motor / (1e-3 * speed)
    label = "speed and acceleration of the motion"
    style: dict[str, Any] = {"color": RED, "ls": "--", "lw": 1.6}
    axis.plot(speed, needed, label=label, path_effects=OUTLINE, **style)
    axis.axvline(1e3 * peaks["peak_rod_speed_m_s"], path_effects=OUTLINE, **style)
    sized = 1e3 * rod_limits(design)[0], design.plant.pump.acceleration_limit_rad_s2
    axis.plot(*sized, "ks", ms=17, mfc="none", mew=1.8, ls="", label="sized")
    _legend_below(axis)


def _legend_below(axis: Axes) -> None:
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), fontsize=9)


def _gains(result: SizeResult) -> Figure:
    settings = result.settings
    shape = (len(settings.observer_s), len(settings.slope_per_s), len(settings.lambda_per_s))
    errors, margins, meets = (
        np.reshape([row[name] for row in result.gains], shape)
        for name in ("max_error_deg", "disk_margin", "meets")
    )
    figure, axes = plt.subplots(
        1, shape[0], figsize=(1.2 + 3.8 * shape[0], 4.4), layout="constrained", squeeze=False
    )
    figure.set_label(
        "Largest error in walking (first number, colour) and disk margin (second number) over the "
        "gains. Darker is worse. In a hatched cell the run fails. "
        "Bold gains have enough margin and no chattering."
    )
    norm = LogNorm(float(np.nanmin(errors)), float(np.nanmax(errors)) * 1.001)
    colours = colour_map("high")
    for index, axis in enumerate(axes[0]):
        mark_failures(axis, np.zeros(1))
        cells = np.ma.masked_invalid(errors[index])
        mesh = axis.pcolormesh(cells, norm=norm, cmap=colours, edgecolors="w")
        for (row, column), error in np.ndenumerate(errors[index]):
            margin = margins[index, row, column]
            lines = ["fails" if math.isnan(error) else f"{error:.1f}°"]
            lines.append("unstable" if math.isnan(margin) else f"{margin:.2f}")
            axis.text(
                column + 0.5,
                row + 0.5,
                "\n".join(lines),
                fontsize=8,
                weight="bold" if meets[index, row, column] else "normal",
                color="k" if math.isnan(error) else ink(colours(norm(error))),
                path_effects=OUTLINE if math.isnan(error) else None,
                **CENTRED,
            )
        axis.set_xticks(np.arange(shape[2]) + 0.5, [f"{v:g}" for v in settings.lambda_per_s])
        axis.set_yticks(np.arange(shape[1]) + 0.5, [f"{v:g}" for v in settings.slope_per_s])
        axis.set(xlabel="λ (1/s)", ylabel="k/Φ (1/s)")
        axis.set_title(f"T_f = {1e3 * settings.observer_s[index]:g} ms")
    bar = figure.colorbar(mesh, ax=axes[0], label="largest error in walking (deg)")
    decimal_ticks(bar.ax.yaxis)
    return figure


def _tracking(result: SizeResult) -> Figure:
    figure, axes = plt.subplots(
        3, 1, figsize=(7, 7.4), sharex=True, layout="constrained", height_ratios=(2, 1.1, 1.2)
    )
    figure.set_label(
        "Knee angle, tracking error and motor speed over a gait cycle of level walking, with the "
        "unchanged and with the sized hardware."
    )
    frequency = result.designs[0].frequency_hz
    percent, mean, deviation = gait_knee_flexion()
    axes[0].fill_between(
        percent, mean - deviation, mean + deviation, color="0.8", label="measured, mean ± SD"
    )
    for (name, label), color in zip(HARDWARE_LABELS.items(), (GOLD, BLUE), strict=True):
        if not result.traces[name]:
            continue
        cycle, trace = last_stride(result.traces[name], frequency)
        angle = np.degrees(trace["knee_angle_rad"])
        reference = np.degrees(trace["knee_reference_rad"])
        axes[0].plot(cycle, angle, color, lw=1.6, label=label)
        axes[1].plot(cycle, reference - angle, color, lw=1.2)
        axes[2].plot(cycle, to_rpm(trace["motor_speed_rad_s"]), color, lw=1.2)
    demand = result.demands[0]
    axes[0].plot(demand.cycle_percent, demand.knee_angle_deg, "k--", lw=1, label="reference")
    limit = to_rpm(result.scenario.plant.pump.speed_limit_rad_s)
    bound = result.settings.error_bound_deg
    for axis, value, style, label in (
        (axes[1], bound, "--", f"bound, ±{bound:g}°"),
        (axes[2], limit, ":", f"limit, ±{limit:.0f} rpm"),
    ):
        for sign in (-1, 1):
            axis.axhline(sign * value, color=RED, ls=style, lw=1.2, label=label)
    axes[0].set(ylabel="knee flexion (deg)", title=f"walking at {frequency:.3g} Hz")
    legend_below(figure, axes, ncols=3)  # inside, each would hide a curve
    axes[1].set_ylabel("error (deg)\nlogarithmic beyond ±2")
    axes[1].set_yscale("symlog", linthresh=2.0, linscale=1.5)
    axes[1].set_yticks([-50, -10, -2, 0, 2, 10, 50], ["−50", "−10", "−2", "0", "2", "10", "50"])
    axes[2].set(ylabel="motor speed (rpm)", xlabel="gait cycle (%)", xlim=(0, 100))
    return figure


def motions(result: SizeResult) -> dict[str, Motion]:
    """Return the walking runs with the scenario's and with the sized hardware. Skip failed runs."""
    plant = result.scenario.plant
    return {
        label: (plant, {**trace, "time_s": trace["time_s"] - trace["time_s"][0]})
        for name, label in HARDWARE_LABELS.items()
        if (trace := result.traces[name])
    }


def last_stride(
    trace: Mapping[str, Array], frequency_hz: float
) -> tuple[Array, Mapping[str, Array]]:
    """Return the gait cycle in % and the signals of the last stride, from heel contact on."""
    last = trace["time_s"] > trace["time_s"][-1] - 1.0 / frequency_hz + 1e-9
    cycle = (100.0 * frequency_hz * trace["time_s"][last] + gait_start_percent()) % 100.0
    order = np.argsort(cycle)
    return cycle[order], {name: values[last][order] for name, values in trace.items()}


def _demand(result: SizeResult) -> Figure:
    figure, axes = plt.subplots(2, 2, figsize=(8.4, 6.2), sharex=True, layout="constrained")
    figure.set_label(
        "Rod speed, pump flow, load pressure and shaft power that walking requires over a gait "
        "cycle, and those of the closed loop with the sized hardware."
    )
    design = result.designs[0]
    reach = 1e3 * rod_limits(result.scenario)[0]
    axes[0, 0].axhspan(-reach, reach, color="0.8", label="reach of the hardware as it is")
    needed = [(BLUE, "needed, moving mass of Eq. 16", result.demands[0])]
    needed += [
        (GOLD, "needed, inertia of the shank", demand) for demand in result.segment_demands[:1]
    ]
    for color, label, demand in needed:
        lw = 3.0 if color == BLUE else 1.3  # speed and flow of both coincide
        x = demand.cycle_percent
        axes[0, 0].plot(x, 1e3 * demand.rod_speed_m_s, color, lw=lw)
        axes[0, 1].plot(x, 6e4 * demand.load_flow_m3_s, color, lw=lw)
        axes[1, 0].plot(x, 1e-6 * demand.load_pressure_pa, color, lw=lw, label=label)
        axes[1, 1].plot(x, demand.shaft_power_w, color, lw=lw)
    if result.traces["sized"]:
        _closed_loop_demand(axes, result)
    axes[0, 0].set(ylabel="rod speed (mm/s)", xlim=(0, 100), title="(a)")
    axes[0, 1].set(ylabel="pump flow (L/min)", title="(b)")
    axes[1, 0].set(ylabel="load pressure (MPa)", xlabel="gait cycle (%)", title="(c)")
    axes[1, 1].set(ylabel="shaft power (W)", xlabel="gait cycle (%)", title="(d)")
    axes[0, 0].legend(loc="upper left", fontsize=8)
    figure.suptitle(f"walking at {design.frequency_hz:.3g} Hz", fontsize=11)
    figure.legend(*axes[1, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def _stride(result: SizeResult) -> Figure:
    figure, axes = plt.subplots(2, figsize=(8, 7), sharex=True, sharey=True, layout="constrained")
    figure.set_label(
        "Chamber pressures over a measured stride, for shares of the knee moment. The grey line is "
        "the pressure of the growing chamber while the leg is faster than the pump."
    )
    for axis, (hardware, loads) in zip(axes, list(result.strides().items())[::2], strict=True):
        for (share, load), line in zip(loads.items(), ("-", "--", ":"), strict=False):
            time = load.time_s - load.time_s[0]
            cap, rod_side = 1e-6 * load.cap_pressure_pa, 1e-6 * load.rod_side_pressure_pa
            axis.plot(time, cap, BLUE, ls=line, label=f"cap $P_1$, share {share:g}")
            axis.plot(time, rod_side, GOLD, ls=line, label=f"rod side $P_2$, share {share:g}")
        overrun_mpa, label = 1e-6 * load.overrun_pressure_pa, "growing chamber, pump too slow"
        axis.plot(time, overrun_mpa, "0.45", lw=1, label=label)
        for limit, line, label in (
            (load.relief_pressure_pa, "--", "relief valves open"),
            (LOWEST_PRESSURE_PA, ":", "oil evaporates"),
        ):
            axis.axhline(1e-6 * limit, color=RED, ls=line, lw=1.2, label=label)
        axis.set(title=hardware, ylabel="pressure (MPa)", xlim=time[[0, -1]])
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("time in the stride (s)")
    legend_below(figure, axes, ncols=3)
    return figure


def _closed_loop_demand(axes: Any, result: SizeResult) -> None:
    design = result.designs[0]
    pump = design.scenario.plant.pump
    cycle, trace = last_stride(result.traces["sized"], design.frequency_hz)
    flow = pump.displacement_m3_per_rad / pump.gear_ratio * trace["motor_speed_rad_s"]
    axes[0, 1].plot(cycle, 6e4 * flow, "k--", lw=1)
    axes[1, 0].plot(cycle, 1e-6 * trace["load_pressure_pa"], "k--", lw=1, label="closed loop")
    axes[1, 1].plot(cycle, trace["shaft_power_w"], "k--", lw=1)
