"""What the figures of several studies have: heat maps, plain ticks, one legend for all axes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator
from numpy.typing import ArrayLike

from kneexo.result import Array

CENTRED: dict[str, Any] = {"ha": "center", "va": "center"}
"""Style of a text about its point."""

_CLOSEST = 0.065  # share of an axis that a number needs


def legend_below(figure: Figure, axes: Iterable[Axes], ncols: int, **style: Any) -> None:
    """A legend below the figure with each label of ``axes`` once."""
    entries = {
        label: handle
        for ax in axes
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)
    }
    figure.legend(entries.values(), entries, loc="outside lower center", ncols=ncols, **style)


def cell_borders(values: ArrayLike) -> Array:
    """Borders of cells about ``values`` (n,) on a logarithmic axis, (n + 1,)."""
    logs = np.log(np.asarray(values, dtype=float))
    half = 0.5 * np.diff(logs) if logs.size > 1 else np.array([0.5])
    return np.exp(np.concatenate([[logs[0] - half[0]], logs[:-1] + half, [logs[-1] + half[-1]]]))


def plain_ticks(axis: Any, values: Any) -> None:
    """Ticks at ``values`` (n,) alone, as plain numbers.

    The axis is logarithmic. A tick whose number would overlap that of the one before is left out.
    """
    logs = np.log(np.asarray(values, dtype=float))
    gap = _CLOSEST * float(np.ptp(logs))
    kept: list[int] = []
    for index, value in enumerate(logs):
        if not kept or abs(value - logs[kept[-1]]) >= gap:
            kept.append(index)
    axis.set_major_locator(FixedLocator([values[index] for index in kept]))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def decimal_ticks(axis: Any) -> None:
    """Ticks of a logarithmic axis as plain numbers: 1, 2, 5; 1, 3; or 1 of each decade.

    Which of them follows from the decades that the axis shows now.
    """
    low, high = sorted(axis.get_view_interval())
    decades = math.log10(high / low) if low > 0.0 else 1.0
    subs = (1.0, 2.0, 5.0) if decades < 1.5 else (1.0, 3.0) if decades < 3.0 else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def heat_map(ax: Axes, x: ArrayLike, y: ArrayLike, values: Array, *, norm: Any, label: str) -> None:
    """Show ``values`` (x, y) with a colour bar; grey where they are not finite.

    What is drawn on the map later leaves its limits as they are. The label stands above the map,
    clear of the axis of the panel on its right.
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
