"""Figures of a `kneexo.studies.contest.contest.ContestResult`."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from kneexo.common.plotting import RED, SERIES, decimal_ticks
from kneexo.common.result import Array
from kneexo.studies.contest.contest import INFEASIBLE_DEG, ContestResult, errors_of
from kneexo.studies.plots import ecdf, legend_below


def outcome(result: ContestResult) -> Figure:
    """Draw the distribution of the controllers' errors, and disk margin over error.

    Two panels show the largest errors on the test plants, one for each of the two references.
    """
    figure, grid = plt.subplots(2, 2, figsize=(8.4, 7.6), layout="constrained")
    axes, key = grid.ravel()[:3], grid[1, 1]
    figure.set_label(
        "Largest errors of each controller on the test plants, in the task of the tuning (a) and "
        "in another task (b), and disk margin over the error of (a) (c). "
        "A curve further left is better. In (c) higher is better too: a mark is at the medians, a "
        "box has the middle half of the plants, and lines have 90 %. "
        "Thick solid lines and discs belong to the controllers that the contest tuned."
    )
    handles = []
    for name, style in _styles(result).items():
        errors = errors_of(result.tested[name])
        line = {item: style[item] for item in ("color", "ls", "lw")}
        ecdf(axes[0], errors, label=name, **line)
        ecdf(axes[1], errors_of(result.other_reference[name]), **line)
        margins = [values["disk_margin"] for values in result.tested[name]]
        _box(axes[2], np.array([errors, margins]), style)
        handles.append(Line2D([], [], label=name, **style))
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
    least = result.settings.least_disk_margin
    label = f"(c) least in the tuning, {least:g}"
    handles.append(axes[2].axhline(least, color=RED, ls=":", lw=1.2, label=label))
    key.set_axis_off()  # the legend has this place
    key.legend(handles=handles, loc="center", handlelength=3.0)
    return figure


def _box(ax: Axes, points: Array, style: Mapping[str, Any]) -> None:
    """Draw medians, box and lines of ``points`` (2, n), without those that are not finite."""
    points = points[:, np.isfinite(points).all(axis=0)]
    if points.size:
        shares = (0.05, 0.25, 0.5, 0.75, 0.95)
        x, y = np.quantile(points, shares, axis=1, method="inverted_cdf").T
        colour = style["color"]
        ax.plot(x[[0, 4]], y[[2, 2]], x[[2, 2]], y[[0, 4]], color=colour, lw=0.8)
        ax.fill(x[[1, 3, 3, 1]], y[[1, 1, 3, 3]], color=colour, alpha=0.3)
        ax.plot(x[2], y[2], color=colour, marker=style["marker"], ms=6.0)


def _styles(result: ContestResult) -> dict[str, dict[str, Any]]:
    """Return a dictionary from the name of each controller to the style of its line and marks."""
    untuned = itertools.cycle(zip(("--", ":", "-.", (0, (6, 1))), "x+^v", strict=True))
    styles: dict[str, dict[str, Any]] = {}
    for name, colour in _colours(result.entrants).items():
        tuned = name in result.settings.contestants
        line, marker = ("-", "o") if tuned else next(untuned)
        styles[name] = {"color": colour, "ls": line, "lw": 2.0 if tuned else 1.1}
        styles[name] |= {"marker": marker, "ms": 3.5, "mew": 0.8}
    return styles


def _colours(names: Iterable[str]) -> dict[str, str]:
    """Return a dictionary from the name of each controller to its colour."""
    return dict(zip(names, (*SERIES, "0.5", "k"), strict=False))


def search(result: ContestResult) -> Figure:
    """Draw, for each search, the best objective so far over the number of evaluations.

    Searches with the first seed have solid lines, the others dashed lines.
    """
    figure, ax = plt.subplots(figsize=(7, 4.8), layout="constrained")
    figure.set_label(
        "Best mean error so far in each search, over the number of evaluations. "
        "Solid lines have the first seed of the optimizer, dashed lines the others."
    )
    colours = _colours(result.settings.contestants)
    for tuning in result.tunings:
        best = np.array(tuning.history_deg)
        # The first element of the history is the best of two populations: the initial one and the
        # first generation.
        evaluations = result.settings.population * (np.arange(best.size) + 2)
        first = tuning.seed == result.settings.optimizer_seeds[0]
        ax.semilogy(
            evaluations,
            np.where(best < INFEASIBLE_DEG, best, np.nan),
            color=colours[tuning.contestant],
            ls="-" if first else "--",
            label=tuning.contestant + ("" if tuning.converged else " (not converged)"),
        )
    ax.set(xlabel="evaluations", ylabel="mean of the largest errors (deg)")
    decimal_ticks(ax.yaxis)
    ax.grid(alpha=0.3)
    legend_below(figure, [ax], ncols=3, fontsize=8)
    return figure


def figures(result: ContestResult) -> dict[str, Figure]:
    """Draw all figures of a contest. Return a dictionary of figures, which the caller closes."""
    return {"contest": outcome(result), "contest_search": search(result)}
