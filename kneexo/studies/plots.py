"""Parts of figures that several studies use: heat maps, distributions, ticks, legends."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from numpy.typing import ArrayLike

from kneexo.plotting import decimal_ticks
from kneexo.result import Array

CENTRED: dict[str, Any] = {"ha": "center", "va": "center"}
"""Keyword arguments that centre a Matplotlib text at its point."""

_CLOSEST = 0.065  # smallest distance of two tick labels, as a share of the axis


def legend_below(figure: Figure, axes: Iterable[Axes], ncols: int, **style: Any) -> None:
    """Draw one legend below the figure. Each label in the Matplotlib ``axes`` occurs once."""
    entries = {
        label: handle
        for ax in axes
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)
    }
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


def heat_map(ax: Axes, x: ArrayLike, y: ArrayLike, values: Array, *, norm: Any, label: str) -> None:
    """Draw ``values`` (len(x), len(y)) as colours over x and y, with a colour bar.

    Cells whose value is not finite are grey. Both axes are logarithmic, with fixed limits that
    curves drawn later do not change. ``label`` stands above the map.
    """
    ax.set_facecolor("0.8")
    columns, rows = cell_borders(x), cell_borders(y)
    mesh = ax.pcolormesh(
        columns,
        rows,
        np.ma.masked_invalid(values.T),
        norm=norm,
        cmap="viridis",
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


def heat_map_panels(
    axes: Iterable[Axes], x: ArrayLike, y: ArrayLike, panels: Iterable[tuple[Array, Any, str]]
) -> None:
    """Draw one `heat_map` in each of the Matplotlib ``axes``, all over the same x and y.

    ``panels`` has the values, the colour norm and the label of each map.
    """
    for ax, (values, norm, label) in zip(axes, panels, strict=True):
        heat_map(ax, x, y, values, norm=norm, label=label)


def ecdf(ax: Axes, values: ArrayLike, **style: Any) -> None:
    """Draw the empirical distribution of ``values`` (n,): the share of values up to each value.

    Infinite values count but are not drawn. With inf among the values the curve ends below one.
    With −inf among the values the curve begins above zero.
    """
    ordered = np.sort(np.asarray(values, dtype=float))
    share = np.arange(1, ordered.size + 1) / ordered.size
    finite = np.isfinite(ordered)
    ax.step(ordered[finite], share[finite], where="post", **style)
