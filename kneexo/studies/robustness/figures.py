"""Figures of a `kneexo.studies.robustness.robustness.RobustnessResult`."""

from __future__ import annotations

import math
from contextlib import suppress
from itertools import cycle, islice
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from kneexo.analysis.linear.sampled_loop import SampledLoop, linearize_loop
from kneexo.common.plotting import BLUE, GOLD, RED, SERIES, decimal_ticks
from kneexo.errors import KneexoError
from kneexo.parameters import Uncertainty
from kneexo.parameters.labels import labels, value_text
from kneexo.parameters.uncertainty import realize
from kneexo.studies.plots import CENTRED, ecdf, legend_below
from kneexo.studies.robustness.robustness import (
    COMPARED,
    MERITS,
    Assessment,
    RobustnessResult,
    merit_value,
    merit_values,
    worst,
    worst_value,
)
from kneexo.systems.knee_reference import run_middle_deg


def distribution(result: RobustnessResult) -> Figure:
    """Draw how each figure of merit is distributed, with the nominal plant and the worst corner.

    Failed samples count but are not drawn. So the curve ends below one if larger values are worse,
    and begins above zero if smaller values are worse.
    """
    names = [merit for merit in result.merits if not merit.startswith("rms_")]
    columns = min(3, len(names))
    rows = math.ceil(len(names) / columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(2.9 * columns, 2.8 * rows), layout="constrained", squeeze=False
    )
    figure.set_label(
        "Distribution of each metric over the sampled plants. A curve shows the share of the "
        "samples up to each value. A failed sample counts but is not drawn."
    )
    for ax, merit in zip(axes.flat, names, strict=False):
        _plot_distribution(ax, result, merit)
    for ax in axes.flat[len(names) :]:
        ax.set_visible(False)
    for row in axes:
        row[0].set_ylabel("share of the samples")
    legend_below(figure, axes.flat, ncols=3)
    return figure


def _plot_distribution(ax: Axes, result: RobustnessResult, merit: str) -> None:
    values = merit_values(result.samples, merit)
    finite = np.isfinite(values)
    nominal = merit_value(result.nominal, merit)
    corner = worst_value(result.corners, merit)
    ecdf(ax, values, color=BLUE, label="samples")
    for value, colour, ls, lw, label in (
        (nominal, "0.4", "--", 1.0, "nominal"),
        (corner, RED, ":", 1.5, "worst corner"),
    ):
        if np.isfinite(value):  # a line of points, which the axis keeps clear of its edge
            ax.plot([value, value], [0.0, 1.02], color=colour, ls=ls, lw=lw, label=label)
    shown_values = np.append(values[finite], [v for v in (nominal, corner) if np.isfinite(v)])
    if shown_values.size and 0.0 < 20.0 * shown_values.min() < shown_values.max():
        ax.set_xscale("log")
        decimal_ticks(ax.xaxis)
    failed = int(np.sum(~finite))
    why = "fail" if MERITS[merit].sign_of_worse > 0.0 else "fail or are unstable"
    ax.set_title(f"{failed} of {values.size} {why}" if failed else " ", fontsize=8, color=RED)
    ax.set(xlabel=MERITS[merit].label, ylim=(0.0, 1.02))
    ax.grid(alpha=0.3)


def tornado(result: RobustnessResult) -> Figure:
    """Draw how a single uncertain value changes error or torque, bandwidth and disk margin.

    All panels have the same rows. The effect of a value on a metric is relative to the largest
    effect of all values on this metric. The value with the largest effect on any metric is on top.
    The label of a row names the ends of the interval, or the options, with their marks.
    """
    merits = [merit for merit in COMPARED if merit in result.merits]
    order = _by_effect(result, merits)
    figure, axes = plt.subplots(
        1,
        len(merits),
        figsize=(2.6 + 2.2 * len(merits), 1.5 + 0.42 * len(order)),
        layout="constrained",
        squeeze=False,
        sharey=True,
    )
    figure.set_label(
        "The largest error or torque, the bandwidth and the disk margin, if a single value of the "
        "plant varies. All other values are nominal. The value with the largest effect is on top."
    )
    for ax, merit in zip(axes[0], merits, strict=True):
        _plot_tornado(ax, result, merit, order)
    names = labels(order)
    rows = [f"{names[path]}\n{_levels_text(result, path)}" for path in order]
    axes[0, 0].set_yticks(range(len(order)), rows, fontsize=8)
    entries = {"low end": (BLUE, "<"), "high end": (GOLD, ">")}
    if any(span.options for span in result.uncertainty.values.values()):
        entries["options"] = ("0.4", "o")
    if any(np.isinf(merit_values(result.one_at_a_time, merit)).any() for merit in merits):
        entries["fails or is unstable"] = (RED, "x")
    handles = [
        Line2D([], [], color=colour, marker=marker, ls="", ms=5)
        for colour, marker in entries.values()
    ]
    handles.append(Line2D([], [], color="0.4", ls="--", lw=1))
    texts = [*entries, "nominal"]
    figure.legend(handles, texts, loc="outside lower center", ncols=5, fontsize=9)
    return figure


def _by_effect(result: RobustnessResult, merits: list[str]) -> list[str]:
    """Return the paths of the uncertain values in the order of their effect, the largest last."""
    paths = list(result.uncertainty.values)
    spreads = np.array([[result.spread(merit, path) for path in paths] for merit in merits])
    infinite = np.where(np.isinf(spreads), np.finfo(float).max, np.nan_to_num(spreads))
    largest = np.maximum(infinite.max(axis=1, keepdims=True), np.finfo(float).tiny)
    ranks = (infinite / largest).max(axis=0)
    return [paths[index] for index in np.argsort(ranks, kind="stable")]


def _marks(span: Uncertainty) -> list[tuple[str, str, str]]:
    """Return marker, letter of the same shape, and colour of each level of an uncertain value."""
    if not span.options:
        return [("<", "◀", BLUE), (">", "▶", GOLD)]
    marks = zip(cycle("os^Dv"), cycle("●■▲◆▼"), cycle(SERIES), strict=False)
    return list(islice(marks, len(span.options)))


def _levels_text(result: RobustnessResult, path: str) -> str:
    """Return the levels of an uncertain value, each behind its mark."""
    span = result.uncertainty.values[path]
    pairs = zip(_marks(span), span.levels, strict=True)
    return "  ".join(f"{letter} {value_text(path, level)}" for (_, letter, _), level in pairs)


def _plot_tornado(ax: Axes, result: RobustnessResult, merit: str, order: list[str]) -> None:
    effects = result.effects(merit)
    nominal = merit_value(result.nominal, merit)
    finite = [v for values in effects.values() for v in [*values, nominal] if math.isfinite(v)]
    low, high = (min(finite), max(finite)) if finite else (0.0, 1.0)
    margin = 0.15 * (high - low) or 0.1 * abs(high) or 1.0
    failed_at = high + margin if MERITS[merit].sign_of_worse > 0.0 else low - margin
    for row, path in enumerate(order):
        values = effects[path]
        ends = [v for v in [*values, nominal] if math.isfinite(v)]
        if ends:
            ax.plot([min(ends), max(ends)], [row, row], color="0.8", lw=7, solid_capstyle="butt")
        marks = _marks(result.uncertainty.values[path])
        for value, (marker, _, colour) in zip(values, marks, strict=True):
            if math.isfinite(value):
                ax.plot([value], [row], marker, color=colour, ms=5)
            else:
                ax.plot([failed_at], [row], "x", color=RED, ms=5)
    if math.isfinite(nominal):
        ax.axvline(nominal, color="0.4", ls="--", lw=1)
    ax.set(xlabel=MERITS[merit].label)
    ax.margins(x=0.08)
    ax.xaxis.set_major_locator(MaxNLocator(4))
    ax.grid(axis="x", alpha=0.3)


def importance(result: RobustnessResult) -> Figure:
    """Draw two tables with a row for each uncertain value and a column for each figure of merit.

    The left table has rank correlations over the samples. The right table has the linear effect of
    each value's whole interval, in % of the nominal figure of merit.
    """
    names = labels(result.uncertainty.values)
    merits = list(result.merits)
    correlations = result.correlations()
    ranks = np.array([[correlations[m][path] for m in merits] for path in names])
    figure, axes = plt.subplots(
        1, 2, figsize=(9.4, 1.9 + 0.36 * len(names)), layout="constrained", sharey=True
    )
    figure.set_label(
        "Importance of each uncertain value. "
        "The left panel shows the rank correlation ρ with each metric over the samples, and for "
        "options the correlation ratio η. "
        "The right panel shows the linear effect of the whole interval, in percent of the nominal "
        "metric."
    )
    chosen = np.array([bool(result.uncertainty.values[path].options) for path in names])
    row_labels = [
        name + (", η" if has_options else "")
        for name, has_options in zip(names.values(), chosen, strict=True)
    ]
    _plot_table(axes[0], ranks, merits, row_labels, chosen)
    axes[0].set_title("rank correlation ρ, or correlation ratio η", fontsize=9)
    local = [m for m in merits if m in result.local]
    linear = np.array([[result.linear_effect(m, path) for m in local] for path in names])
    scale = np.array([abs(result.nominal.metrics[m]) for m in local])
    if local:
        _plot_table(axes[1], 100.0 * linear / scale, local, row_labels, chosen, limit=100.0)
        axes[1].set_title("effect of the whole interval, % of the nominal metric", fontsize=9)
    else:
        axes[1].set_visible(False)
    key = {
        "#b2182b": "a larger value is worse",
        BLUE: "a larger value is better",
        "0.5": "options, which have no order: strength alone",
    }
    patches = [Patch(color=colour, alpha=0.8, label=label) for colour, label in key.items()]
    figure.legend(handles=patches, loc="outside lower center", ncols=3, fontsize=8)
    return figure


def _cell(value: float) -> str:
    """Return a number as text for a table cell. A value that rounds to zero has no minus sign."""
    text = f"{value:.0f}" if abs(value) >= 10.0 else f"{round(value, 2) + 0.0:.2f}"
    return text.replace("-", "−")


def _plot_table(
    ax: Axes, values: Any, merits: list[str], labels: list[str], unsigned: Any, limit: float = 1.0
) -> None:
    """Draw a table of numbers in coloured cells.

    A cell is red if a larger uncertain value makes the figure of merit worse, and blue if better.
    Rows marked in ``unsigned`` are grey. The columns are ``merits``, labelled without units because
    the numbers are relative. Colours saturate at ``limit``.
    """
    signs = np.array([MERITS[merit].sign_of_worse for merit in merits])
    is_unsigned = np.broadcast_to(unsigned[:, None], values.shape)
    ax.set_facecolor("0.92")
    for shades, hidden, cmap, low in (
        (values * signs, is_unsigned, "RdBu_r", -limit),
        (values, ~is_unsigned, "Greys", 0.0),
    ):
        ax.imshow(
            np.ma.masked_array(shades, hidden | ~np.isfinite(values)),
            cmap=cmap,
            vmin=low,
            vmax=limit,
            aspect="auto",
            alpha=0.8,
        )
    for (row, column), value in np.ndenumerate(values):
        if math.isfinite(value):
            color = "w" if abs(value) > 0.7 * limit else "k"
            ax.text(column, row, _cell(value), fontsize=7, color=color, **CENTRED)
    ax.set_xticks(
        range(len(merits)),
        [MERITS[merit].label.split(" (")[0] for merit in merits],
        fontsize=7,
        rotation=35,
        ha="right",
        rotation_mode="anchor",
    )
    ax.set_yticks(range(len(labels)), labels, fontsize=8)


def nyquist(result: RobustnessResult) -> Figure:
    """Draw the Nyquist plots of the first ``nyquist_loops`` samples, unstable loops in red.

    The stable loop with the smallest disk margin is drawn together with the disk that it touches.
    The title counts the unstable plants.
    """
    figure, ax = plt.subplots(figsize=(6.0, 6.4), layout="constrained")
    figure.set_label(
        "Nyquist plots of the sampled plants. The blue loop has the smallest disk margin and "
        "touches the disk. A red loop is unstable."
    )
    assessments = [*result.samples, *result.corners, *result.one_at_a_time, result.nominal]
    stable = [assessment for assessment in assessments if assessment.metrics["stable"]]
    loops = [
        _loop(result, assessment) for assessment in result.samples[: result.settings.nyquist_loops]
    ]
    drawn = [loop for loop in loops if loop is not None]
    unstable_drawn = sum(not loop.stable for loop in drawn)
    labels_left = {
        True: f"L of {len(drawn) - unstable_drawn} samples",
        False: f"L of {unstable_drawn} unstable samples",
    }
    for loop in drawn:
        f = np.geomspace(0.02, 0.5 / loop.sample_time_s, 2000)
        response = loop.loop_response(f)
        colour = "0.6" if loop.stable else RED
        label = labels_left.pop(loop.stable, None)  # the legend names each colour once
        ax.plot(response.real, response.imag, color=colour, lw=0.5, alpha=0.6, label=label)
    unstable = sum(assessment.metrics["stable"] is False for assessment in assessments)
    title = ""
    if stable:
        nearest = _loop(result, worst(stable, "disk_margin"))
        if nearest is not None:
            nearest.plot_nyquist(ax)
            title = f"blue: the smallest disk margin of {len(stable)} stable plants"
    if unstable:
        title += f"\n{unstable} of {len(assessments)} plants are unstable"
    ax.set_title(title, fontsize=9)
    if legend := ax.get_legend():
        legend.remove()
    legend_below(figure, [ax], ncols=3, fontsize=9)
    return figure


def _loop(result: RobustnessResult, assessment: Assessment) -> SampledLoop | None:
    """Linearize an assessed plant's loop at the posture of `assess`. Return None if this fails."""
    with suppress(KneexoError):
        plant = realize(result.scenario, result.uncertainty, assessment.values)
        return linearize_loop(plant, knee_angle_deg=run_middle_deg(plant))
    return None


def figures(result: RobustnessResult) -> dict[str, Figure]:
    """Draw distribution, tornado, importance and Nyquist plots. Return a dictionary of figures."""
    return {
        "robustness_distribution": distribution(result),
        "robustness_tornado": tornado(result),
        "robustness_importance": importance(result),
        "robustness_nyquist": nyquist(result),
    }
