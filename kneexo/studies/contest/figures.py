"""Figures of a `kneexo.studies.contest.study.ContestResult`."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from kneexo.plotting import decimal_ticks
from kneexo.studies.contest.study import INFEASIBLE_DEG, ContestResult, errors_of
from kneexo.studies.plots import ecdf, legend_below


def outcome(result: ContestResult) -> Figure:
    """Draw the distribution of the controllers' errors, and disk margin over error.

    Two panels show the largest errors on the test plants, one for each of the two references.
    """
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.6), layout="constrained", sharey=False)
    for index, name in enumerate(result.entrants):
        tuned = name in result.settings.contestants
        style: dict[str, Any] = {"color": f"C{index}", "lw": 2.0 if tuned else 1.0}
        style["ls"] = "-" if tuned else "--"
        errors = errors_of(result.tested[name])
        ecdf(axes[0], errors, label=name, **style)
        ecdf(axes[1], errors_of(result.other_reference[name]), **style)
        margins = [values["disk_margin"] for values in result.tested[name]]
        axes[2].plot(
            np.where(np.isfinite(errors), errors, np.nan),
            margins,
            "o" if tuned else "x",
            ms=3.5,
            color=f"C{index}",
            alpha=0.6,
            mew=0.8,
        )
    other = result.settings.other_reference
    axes[0].set(ylabel="share of the test plants", title="(a) the task of the tuning")
    axes[1].set(
        ylabel="share of the test plants",
        title=f"(b) {other.amplitude_deg:g}° at {other.frequency_hz:g} Hz",
    )
    axes[2].set(ylabel="disk margin", title="(c) margins at (a), of the stable loops")
    for ax in axes:
        if not np.isfinite(ax.dataLim.minposx):  # every run failed
            ax.set_xlim(0.1, 10.0)
        ax.set(xscale="log", xlabel="largest error (deg)")
        decimal_ticks(ax.xaxis)
        ax.grid(alpha=0.3)
    for marker, label in (("o", "tuned here"), ("x", "not tuned here")):
        axes[2].plot([], [], marker, color="0.3", ms=3.5, mew=0.8, ls="none", label=f"(c) {label}")
    least = result.settings.least_disk_margin
    label = f"(c) least in the tuning, {least:g}"
    axes[2].axhline(least, color="0.4", ls=":", lw=1, label=label)
    legend_below(figure, (axes[0], axes[2]), ncols=5, fontsize=8)
    return figure


def search(result: ContestResult) -> Figure:
    """Draw, for each search, the best objective so far over the number of evaluations.

    Searches with the first seed have solid lines, the others dashed lines.
    """
    figure, ax = plt.subplots(figsize=(7, 4.2), layout="constrained")
    names = list(result.settings.contestants)
    for tuning in result.tunings:
        best = np.array(tuning.history_deg)
        evaluations = result.settings.population * (np.arange(best.size) + 2)
        first = tuning.seed == result.settings.optimizer_seeds[0]
        ax.semilogy(
            evaluations,
            np.where(best < INFEASIBLE_DEG, best, np.nan),
            color=f"C{names.index(tuning.contestant)}",
            ls="-" if first else "--",
            label=tuning.contestant + ("" if tuning.converged else " (not converged)"),
        )
    ax.set(xlabel="evaluations", ylabel="mean of the largest errors (deg)")
    decimal_ticks(ax.yaxis)
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8)
    return figure


def figures(result: ContestResult) -> dict[str, Figure]:
    """Draw all figures of a contest. Return a dictionary of figures, which the caller closes."""
    return {"contest": outcome(result), "contest_search": search(result)}
