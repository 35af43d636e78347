"""Figures of a `kneexo.studies.order.study.OrderResult`."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from kneexo.plotting import BLUE, GOLD, PURPLE, TEAL, decimal_ticks
from kneexo.studies.order.study import OrderResult, switching_force_n
from kneexo.studies.plots import legend_below, with_minus

_COLORS = {"reduced": BLUE, "full": GOLD}
_PRESSURES = {
    "load_pressure": ("P_L, reduced", BLUE),
    "cap": ("P_1, full", TEAL),
    "rod_side": ("P_2, full", PURPLE),
}
_STYLES = (("-", 5.0, 0.3), ("--", 2.2, 0.6), (":", 1.6, 1.0), ("-.", 0.8, 1.0))
"""Line style, line width and opacity of the curves. Each load has its own style."""


def tracking(result: OrderResult) -> Figure:
    """Draw tracking errors (left) and pressures (right) over time. Each load has its own row."""
    loads = result.settings.disturbances_n
    figure, ax = plt.subplots(
        len(loads),
        2,
        figsize=(8.4, 1.0 + 2.2 * len(loads)),
        sharex=True,
        layout="constrained",
        squeeze=False,
    )
    figure.set_label(
        "Tracking error and pressures with the reduced and the full order of the cylinder. "
        "P_L is the load pressure, P_1 and P_2 are the pressures of cap and rod side. "
        "Each row has another constant force on the rod."
    )
    for row, force in zip(ax, loads, strict=True):
        for case in (case for case in result.tracking if case.disturbance_n == force):
            trace, order = case.trace, case.order
            row[0].plot(trace.time_s, trace.error_deg, _COLORS[order], lw=1.2, label=order)
            for name, values in trace.pressures_mpa.items():
                label, color = _PRESSURES[name]
                row[1].plot(trace.time_s, values, color, lw=1.0, label=label)
        row[0].axhline(0.0, color="0.7", lw=0.8, zorder=0)
        row[0].set(ylabel="error (deg)", title=f"disturbance {with_minus(force)} N")
        row[1].set(ylabel="pressure (MPa)")
    for axis in ax[0]:
        low, high = axis.get_ylim()
        axis.set_ylim(low, high + 0.3 * (high - low))  # room for the legend
        axis.legend(loc="upper right", ncols=3, fontsize=8)
    for axis in ax[-1]:
        axis.set_xlabel("time (s)")
    return figure


def switching(result: OrderResult) -> Figure:
    """Draw the peak-to-peak oscillation of the rod's velocity over a constant force on the rod."""
    figure, ax = plt.subplots(figsize=(6.5, 4.6), layout="constrained")
    figure.set_label(
        "Peak-to-peak oscillation of the rod's velocity about its reference v_d, over a "
        "constant force on the rod. "
        "At the dotted line the load changes from one chamber to the other. "
        "P_r is the pressure of the reservoir, and A_1 and A_2 are the piston areas."
    )
    for direction, color, words in (("in", GOLD, "retracting"), ("out", BLUE, "extending")):
        rows = [row for row in result.switching if row.direction == direction]
        forces = [row.force_n for row in rows]
        ax.semilogy(
            forces,
            [row.velocity_swing_mm_s for row in rows],
            "o-",
            color=color,
            ms=4,
            label=words,
        )
    force = switching_force_n(result.scenario)
    ax.axvline(force, color="0.4", ls=":", label=f"P_r(A_1 − A_2) = {force:.1f} N")
    ax.set(xlabel="force on the rod (N)", ylabel="swing of the rod's velocity about v_d (mm/s)")
    decimal_ticks(ax.yaxis)
    legend_below(figure, [ax], ncols=3)
    return figure


def frequency(result: OrderResult) -> Figure:
    """Draw the plant's gain from motor speed command to rod velocity over frequency.

    The posture is the middle one of the settings. Each load has a narrower line than the load
    before, so that coinciding lines are all visible.
    """
    figure, ax = plt.subplots(figsize=(6.5, 5.0), layout="constrained")
    figure.set_label(
        "Gain of the linear plant from motor speed command to rod velocity, with both orders of "
        "the cylinder and different forces on the rod. Lines of the reduced order coincide."
    )
    postures = result.settings.postures_deg
    posture = postures[len(postures) // 2]
    styles = dict(zip(result.settings.disturbances_n, _STYLES, strict=False))
    for row in result.frequency:
        if row.posture_deg == posture and row.trace is not None:
            order, force, trace = row.order, row.disturbance_n, row.trace
            ls, lw, alpha = styles.get(force, _STYLES[0])
            ax.loglog(
                trace.frequencies_hz,
                1e3 * np.array(trace.plant_gain_m),
                color=_COLORS[order],
                ls=ls,
                lw=lw,
                alpha=alpha,
                label=f"{order}, {with_minus(force)} N",
            )
    nyquist = 0.5 / result.scenario.controller.sample_time_s
    ax.axvline(nyquist, color="0.4", ls=":", lw=1, label=f"Nyquist, {nyquist:g} Hz")
    ax.set(
        xlabel="frequency (Hz)",
        ylabel="rod velocity per command (mm/rad)",
        title=f"plant at {posture:g}°",
    )
    decimal_ticks(ax.xaxis)
    decimal_ticks(ax.yaxis)
    legend_below(figure, [ax], ncols=4, fontsize=8)
    return figure


def figures(result: OrderResult) -> dict[str, Figure]:
    """Draw all figures: ``order_tracking``, ``order_switching`` and ``order_frequency``."""
    return {
        "order_tracking": tracking(result),
        "order_switching": switching(result),
        "order_frequency": frequency(result),
    }
