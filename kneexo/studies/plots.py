"""Parts of figures that several studies use: heat maps, distributions, ticks, legends."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from numpy.typing import ArrayLike

from kneexo.common.plotting import decimal_ticks
from kneexo.common.result import Array

CENTRED: dict[str, Any] = {"ha": "center", "va": "center"}
"""Keyword arguments that centre a Matplotlib text at its point."""

OUTLINE: list[AbstractPathEffect] = [withStroke(linewidth=3.0, foreground="w")]
"""Path effects with which a mark or line is visible on each colour of a map."""
Worse = Literal["low", "high"]
"""The end of a quantity that is worse. Maps draw this end dark."""

_HATCHED: dict[str, Any] = {"fc": "0.88", "ec": "0.6", "hatch": "////", "lw": 0.0}
_CLOSEST = 0.065  # smallest distance of two tick labels, as a share of the axis


def merged_legend(axes: Iterable[Axes]) -> dict[str, Any]:
    """Return a dictionary from each label in the Matplotlib ``axes`` to its handle."""
    return {
        label: handle
        for ax in axes
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)
    }


def legend_below(figure: Figure, axes: Iterable[Axes], ncols: int, **style: Any) -> None:
    """Draw one legend below the figure. Each label in the Matplotlib ``axes`` occurs once."""
    entries = merged_legend(axes)
    figure.legend(entries.values(), entries, loc="outside lower center", ncols=ncols, **style)


def cell_borders(values: ArrayLike) -> Array:
    """Return the n + 1 borders of map cells around n ``values`` on a logarithmic axis."""
    logs = np.log(np.asarray(values, dtype=float))
    half = 0.5 * np.diff(logs) if logs.size > 1 else np.array([0.5])
    return np.exp(np.concatenate([[logs[0] - half[0]], logs[:-1] + half, [logs[-1] + half[-1]]]))


def plain_ticks(axis: Any, values: Any) -> None:
    """Label a logarithmic axis with plain numbers, only at ``values`` (n,).

    A value too close to the last labelled value gets no tick, so that labels do not overlap.
    """
    logs = np.log(np.asarray(values, dtype=float))
    gap = _CLOSEST * float(np.ptp(logs))
    labelled: list[int] = []
    for index, value in enumerate(logs):
        if not labelled or abs(value - logs[labelled[-1]]) >= gap:
            labelled.append(index)
    axis.set_major_locator(FixedLocator([values[index] for index in labelled]))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def shades(count: int) -> Array:
    """Return ``count`` colours (count, 4) from light to dark, for curves whose values ascend."""
    return plt.get_cmap("viridis_r")(np.linspace(0.25, 1.0, count))


def colour_map(worse: Worse) -> Colormap:
    """Return the colour map in which a darker colour is worse, for people with any vision.

    ``worse`` says whether low or high values are worse.
    """
    return plt.get_cmap("viridis" if worse == "low" else "viridis_r")


def ink(colour: ArrayLike) -> str:
    """Return the colour of a text that can be read on ``colour`` (red, green, blue, alpha)."""
    luminance = np.dot(np.asarray(colour)[:3] ** 2.2, [0.2126, 0.7152, 0.0722])
    return "k" if luminance > 0.18 else "w"  # equal contrast with black and white


def mark_failures(ax: Axes, values: Array) -> None:
    """Hatch the background of a map. The hatching is visible where ``values`` is not finite.

    If a value is missing, the legend of the axes names the hatching.
    """
    ax.patch.set(**_HATCHED)
    if not np.isfinite(values).all():
        ax.fill([np.nan], [np.nan], label="no result", **_HATCHED)


def heat_map(
    ax: Axes,
    x: ArrayLike,
    y: ArrayLike,
    values: Array,
    *,
    norm: Any,
    label: str,
    worse: Worse,
) -> Colormap:
    """Draw ``values`` (len(x), len(y)) as colours over x and y. Return the colour map.

    A darker cell is worse, as ``worse`` says in `colour_map`. A cell whose value is not finite is
    hatched. Both axes are logarithmic, with fixed limits that curves drawn later do not change.
    ``label`` stands above the map, and the colour bar beside it.
    """
    mark_failures(ax, values)
    colours = colour_map(worse)
    columns, rows = cell_borders(x), cell_borders(y)
    mesh = ax.pcolormesh(
        columns,
        rows,
        np.ma.masked_invalid(values.T),
        norm=norm,
        cmap=colours,
        rasterized=True,
    )
    ax.set(xscale="log", yscale="log", xlim=columns[[0, -1]], ylim=rows[[0, -1]])
    finite = values[np.isfinite(values)]
    below, above = bool(np.any(finite < norm.vmin)), bool(np.any(finite > norm.vmax))
    extend = ("neither", "max", "min", "both")[2 * below + above]
    bar = ax.figure.colorbar(mesh, ax=ax, extend=extend)
    if isinstance(norm, LogNorm):
        decimal_ticks(bar.ax.yaxis)
    ax.set_title(label, fontsize=9, loc="right")
    return colours


def ecdf(ax: Axes, values: ArrayLike, **style: Any) -> None:
    """Draw the empirical distribution of ``values`` (n,): the share of values up to each value.

    Infinite values count but are not drawn. With inf among the values the curve ends below one.
    With −inf among the values the curve begins above zero.
    """
    ordered = np.sort(np.asarray(values, dtype=float))
    share = np.arange(1, ordered.size + 1) / ordered.size
    finite = np.isfinite(ordered)
    ax.step(ordered[finite], share[finite], where="post", **style)
