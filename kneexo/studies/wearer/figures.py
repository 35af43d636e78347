"""Figures of a `kneexo.studies.wearer.wearer.WearerResult`, one for each question."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median_low
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from kneexo.common.plotting import BLUE, BROWN, GOLD, PURPLE, SERIES, TEAL, decimal_ticks
from kneexo.common.result import Array
from kneexo.parameters.task.gait import gait_start_percent
from kneexo.studies.plots import OUTLINE, legend_below
from kneexo.studies.wearer.wearer import (
    HELD,
    HELPING,
    HIGHER,
    INERTIA,
    PAPER,
    SIZED,
    UNLIMITED,
    WearerResult,
    WearerRow,
)

_SHOWN = {
    HELD: "0.6",
    PAPER: GOLD,
    UNLIMITED: PURPLE,
    SIZED: BLUE,
    SIZED + HIGHER: TEAL,
    INERTIA: BROWN,
}
"""Designs in the figures, and their colours."""
_STYLES = ("-", "--", ":", "-.", (0, (5, 1)))
_ANKLE_N_M = 2.26  # largest mean torque of miniHydrA


def figures(result: WearerResult) -> dict[str, Figure]:
    """Draw the figures. Return a dictionary from name to figure."""
    return {
        "wearer_torque": _torque(result),
        "wearer_cadence": _cadence(result),
        "wearer_help": _help(result),
    }


def _cycle(row: WearerRow) -> tuple[Array, Any]:
    """Return abscissa and order of the samples of a trace.

    For walking the abscissa is the gait cycle in % from heel contact. For rising the abscissa is
    the time in s.
    """
    time = np.asarray(row.trace.time_s)
    if np.isnan(row.cadence_hz):
        return time, np.arange(time.size)
    percent = (100.0 * time * row.cadence_hz + gait_start_percent())[:-1] % 100.0
    order = np.argsort(percent)
    return percent[order], order


def _torque(result: WearerResult) -> Figure:
    cadence = median_low(result.settings.cadences_hz)
    rise = median_low(result.settings.rise_times_s)
    figure, axes = plt.subplots(2, 2, figsize=(9.5, 6.0), sharex="col", layout="constrained")
    figure.set_label(
        "What torque does the leg feel? Above: angle of the leg and of the exoskeleton. The "
        "difference is the deflection of the cuff. Below: torque with which the leg must push "
        "the exoskeleton, positive in flexion. The desired torque is zero. A free leg would push "
        "with 0 N·m."
    )
    titles = f"walking, {cadence:g} strides/s", f"standing up and sitting down, {rise:g} s each"
    for column, title in zip(axes.T, titles, strict=True):
        column[0].set(title=title)
    for design in (PAPER, SIZED, SIZED + HIGHER):
        rows = [row for row in result.transparency if row.design == design]
        walks = [row for row in rows if row.cadence_hz == cadence]
        rises = [row for row in rows if row.rise_time_s == rise]
        for column, row in zip(axes.T, (*walks[:1], *rises[:1]), strict=True):
            x, order = _cycle(row)
            if design == PAPER:
                column[0].plot(x, np.array(row.trace.leg_deg)[order], "k", lw=2.5, label="leg")
            style = {"color": _SHOWN[design], "lw": 1.4}
            column[0].plot(x, np.array(row.trace.knee_deg)[order], **style)
            column[1].plot(x, np.array(row.trace.torque_n_m)[order], label=design, **style)
    for axis in axes[1]:
        axis.axhline(0.0, color="0.7", lw=0.8, zorder=0)
    axes[0, 0].set_ylabel("knee angle (deg)")
    axes[1, 0].set(ylabel="torque of the leg (N·m)", xlabel="gait cycle from heel contact (%)")
    axes[1, 1].set_xlabel("time (s)")
    legend_below(figure, axes[:, 0], ncols=4)
    return figure


def _bars(ax: Axes, heights: Mapping[str, Sequence[float]], digits: int) -> None:
    """Draw a group of bars at 0, 1, …. ``heights`` has the heights of each design (groups,)."""
    width = 0.8 / len(heights)
    for index, (label, values) in enumerate(heights.items()):
        x = np.arange(len(values)) + (index - 0.5 * (len(heights) - 1)) * width
        bars = ax.bar(x, values, 0.92 * width, label=label, color=_SHOWN[label])
        style: dict[str, Any] = {"fontsize": 8, "rotation": 90, "path_effects": OUTLINE}
        ax.bar_label(bars, fmt=f"%.{digits}g", padding=2, **style)


def _cadence(result: WearerResult) -> Figure:
    settings = result.settings
    figure, axes = plt.subplots(
        1,
        2,
        figsize=(10.5, 4.6),
        sharey=True,
        layout="constrained",
        width_ratios=(len(settings.cadences_hz), len(settings.rise_times_s)),
    )
    figure.set_label(
        "How does the torque depend on the speed of the motion? Root mean square of the torque "
        "with which the leg must push the exoskeleton, without desired torque. The bars of the "
        "motor without limits show the torque that the limits of the motor do not cause. The "
        "dotted line is the largest mean magnitude of the torque of miniHydrA, an "
        "electro-hydraulic ankle."
    )
    for ax, walking in zip(axes, (True, False), strict=True):
        rows = [row for row in result.transparency if np.isfinite(row.cadence_hz) == walking]
        torques = {
            name: [row.rms_torque_n_m for row in rows if row.design == name] for name in _SHOWN
        }
        _bars(ax, torques, digits=2)
        ax.axhline(_ANKLE_N_M, color="k", ls=":", lw=1.2, label="miniHydrA, 0…5 Hz, mean")
        speeds = settings.cadences_hz if walking else settings.rise_times_s
        ax.set_xticks(range(len(speeds)), [f"{speed:g}" for speed in speeds])
    axes[0].set(xlabel="walking, strides per second (Hz)", ylabel="rms torque of the leg (N·m)")
    axes[1].set(xlabel="standing up, time (s)", yscale="log")
    decimal_ticks(axes[0].yaxis)
    axes[0].set_ylim(top=2.0 * axes[0].get_ylim()[1])  # room for the numbers
    legend_below(figure, axes[:1], ncols=3)
    return figure


def _help(result: WearerResult) -> Figure:
    cadence = median_low(result.settings.help_cadences_hz)
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 4.6), layout="constrained")
    figure.set_label(
        "How much does the exoskeleton help a weak leg? Left: torque that the leg of the average "
        f"wearer gets at {cadence:g} strides per second, with the {HELPING[1]}. Right: the largest "
        "deviation of this leg from its path, with both pumps."
    )
    rows = [r for r in result.help if (r.wearer, r.cadence_hz) == ("average", cadence)]
    helped = [row for row in rows if row.design == HELPING[1]]
    for row, colour, style in zip(helped, SERIES, _STYLES, strict=False):
        x, order = _cycle(row)
        torque = -np.array(row.trace.torque_n_m)[order]
        axes[0].plot(x, torque, color=colour, ls=style, lw=1.4, label=row.mode)
    axes[0].axhline(0.0, color="0.7", lw=0.8, zorder=0)
    axes[0].set(
        xlabel="gait cycle from heel contact (%)",
        ylabel="torque that the leg gets (N·m), positive flexes",
    )
    deviations = {
        name: [row.deviation_deg for row in rows if row.design == name] for name in HELPING
    }
    _bars(axes[1], deviations, digits=3)
    axes[1].set_xticks(range(len(helped)), [row.mode.replace(" ", "\n", 1) for row in helped])
    axes[1].set(ylabel="largest deviation of the leg from its path (deg)")
    axes[1].set_ylim(top=1.15 * axes[1].get_ylim()[1])  # room for the legend
    axes[0].legend(loc="lower right", fontsize=8)
    axes[1].legend(loc="upper center", ncols=2, fontsize=8)
    return figure
