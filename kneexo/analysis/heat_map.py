"""Values over two logarithmic axes as colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from numpy.typing import ArrayLike

from kneexo.analysis.simulation import Array


def cell_borders(values: ArrayLike) -> Array:
    """Borders of cells about ``values`` (n,) on a logarithmic axis, (n + 1,)."""
    logs = np.log(np.asarray(values, dtype=float))
    half = 0.5 * np.diff(logs) if logs.size > 1 else np.array([0.5])
    return np.exp(np.concatenate([[logs[0] - half[0]], logs[:-1] + half, [logs[-1] + half[-1]]]))


def plain_ticks(axis: Any, values: Any) -> None:
    """Ticks at ``values`` (n,) alone, as plain numbers."""
    axis.set_major_locator(FixedLocator(values))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def heat_map(ax: Axes, x: ArrayLike, y: ArrayLike, values: Array, *, norm: Any, label: str) -> None:
    """Show ``values`` (x, y) with a colour bar; grey where they are not finite."""
    ax.set_facecolor("0.8")
    mesh = ax.pcolormesh(
        cell_borders(x),
        cell_borders(y),
        np.ma.masked_invalid(values.T),
        norm=norm,
        cmap="viridis",
        rasterized=True,
    )
    ax.set(xscale="log", yscale="log")
    finite = values[np.isfinite(values)]
    below, above = bool(np.any(finite < norm.vmin)), bool(np.any(finite > norm.vmax))
    extend = ("neither", "max", "min", "both")[2 * below + above]
    ax.figure.colorbar(mesh, ax=ax, label=label, extend=extend)
