"""Figures of a `kneexo.studies.faults.faults.FaultsResult`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from kneexo.common.plotting import BLUE, GOLD, RED, TEAL, decimal_ticks
from kneexo.studies.faults.faults import FaultRow, FaultsResult, not_seen
from kneexo.studies.plots import legend_below

_MARKS = {
    "in time": ("o", TEAL),
    "late": ("s", GOLD),
    "missed": ("X", RED),
    "made worse": ("D", RED),
}
"""Mark and colour of each verdict but `not_seen`."""


def figures(result: FaultsResult) -> dict[str, Figure]:
    """Draw the worst case, the margins, and deviations with and without protection."""
    return {
        "worst_case": plot_worst_case(result),
        "margins": plot_margins(result),
        "protection": plot_protection(result),
    }


def plot_worst_case(result: FaultsResult) -> Figure:
    """Draw the knee over time, without fault, with the fault alone, and with protection."""
    worst = result.worst
    figure, ax = plt.subplots(figsize=(7.5, 3.6), layout="constrained")
    figure.set_label(
        f"The worst case: {worst.fault} ({worst.cause}) begins at {worst.start_s:g} s. A curve "
        "ends early if the run ends with an error."
    )
    styles: dict[str, tuple[str, Any]] = {
        "healthy": ("without the fault", {"color": "0.6", "lw": 3.0}),
        "alone": ("with the fault", {"color": GOLD}),
        "protected": ("with the fault and protection", {"color": BLUE, "ls": "--"}),
    }
    for name, (label, style) in styles.items():
        if trace := result.traces.get(name):
            ax.plot(trace["time_s"], trace["knee_deg"], label=label, **style)
    ax.axvline(worst.start_s, color=RED, lw=1.0, label="start of the fault")
    end_s = worst.start_s + result.settings.observed_s
    if math.isfinite(worst.safe_after_s):
        safe_s = worst.start_s + worst.safe_after_s
        end_s = max(end_s, safe_s + 1.0)
        ax.axvline(safe_s, color=TEAL, lw=1.0, ls=":", label="motor safe")
    ax.set(
        xlim=(worst.start_s - 1.0, end_s),
        xlabel="time (s)",
        ylabel="knee flexion (deg)",
    )
    legend_below(figure, [ax], 3)
    return figure


def _marked(result: FaultsResult) -> Iterator[tuple[str, list[FaultRow], str, str]]:
    """Yield each verdict with its rows, mark and colour."""
    marks = {not_seen(result.settings.observed_s): ("o", "0.6")} | _MARKS
    for verdict, (marker, colour) in marks.items():
        if rows := [row for row in result.rows if row.verdict == verdict]:
            yield verdict, rows, marker, colour


def plot_margins(result: FaultsResult) -> Figure:
    """Draw the time to the safe state over the critical duration, with a mark for each case."""
    figure, ax = plt.subplots(figsize=(6.0, 5.0), layout="constrained")
    figure.set_label(
        "Each mark is a fault at one time. Below the line the motor is safe within the critical "
        "duration. A case above the line can be in time, because a detector keeps implausible "
        "readings from the law. At the right edge are faults that the knee tolerates as long as it "
        "is observed, at the upper edge faults after which the motor does not become safe."
    )

    def values_of(row: FaultRow) -> tuple[float, float]:
        return math.inf if row.censored else row.critical_duration_s, row.safe_after_s

    finite = [v for row in result.rows for v in values_of(row) if 0.0 < v < math.inf]
    low, high = 1e3 * min(finite, default=1e-3) / 2.0, 1e3 * max(finite, default=1.0) * 4.0
    for verdict, rows, marker, colour in _marked(result):
        values = zip(*map(values_of, rows), strict=True)
        x, y = ([min(max(1e3 * value, low), high) for value in axis] for axis in values)
        ax.plot(x, y, marker, color=colour, ls="", label=f"{verdict} ({len(rows)})", clip_on=False)
    ax.plot([low, high], [low, high], color="k", lw=0.8)
    ax.set(
        xscale="log",
        yscale="log",
        xlim=(low, high),
        ylim=(low, high),
        xlabel="critical duration without protection (ms)",
        ylabel="time to the safe state (ms)",
    )
    decimal_ticks(ax.xaxis)
    decimal_ticks(ax.yaxis)
    legend_below(figure, [ax], 3)
    return figure


def plot_protection(result: FaultsResult) -> Figure:
    """Draw the deviation with protection over that without, with a mark for each case."""
    figure, ax = plt.subplots(figsize=(6.0, 5.0), layout="constrained")
    figure.set_label(
        "Each mark is a fault at one time: the largest deviation of the knee before the motor is "
        "safe, over the largest deviation without protection, in the observed time or until the "
        "error of the run."
    )
    largest = (max(r.alone.deviation_deg, r.protected.deviation_deg) for r in result.rows)
    high = 1.1 * max(*largest, result.settings.bound_deg)
    for verdict, rows, marker, colour in _marked(result):
        x = [row.alone.deviation_deg for row in rows]
        y = [row.protected.deviation_deg for row in rows]
        ax.plot(x, y, marker, color=colour, ls="", label=f"{verdict} ({len(rows)})")
    ax.axhline(result.settings.bound_deg, color=RED, lw=0.8, label="bound")
    ax.plot([0.0, high], [0.0, high], color="k", lw=0.8)
    ax.set(
        xlim=(0.0, high),
        ylim=(0.0, high),
        xlabel="deviation without protection (deg)",
        ylabel="deviation with protection (deg)",
    )
    legend_below(figure, [ax], 3)
    return figure
