"""Figures of a `kneexo.studies.controller.controller.ControllerResult`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from kneexo.common.plotting import BLUE, GOLD, RED, SERIES
from kneexo.common.result import Array
from kneexo.studies.controller.result import ControllerResult, ideal_settling_time_s, observed_smc
from kneexo.studies.controller.settings import ControllerSettings
from kneexo.studies.plots import (
    OUTLINE,
    Worse,
    heat_map,
    legend_below,
    plain_ticks,
    shades,
)

_ERROR = "largest error (deg)"
_CHANGE = "mean command change (rpm/sample)"
_MAPPED: dict[str, tuple[Normalize, str, Worse]] = {
    "max_error_deg": (LogNorm(0.03, 10.0), _ERROR, "high"),
    "mean_command_change_rpm": (LogNorm(3.0, 600.0), _CHANGE, "high"),
    "settling_s": (
        LogNorm(0.1, 1.0),
        "{grid.step_deg:g}° step, settling to ±{grid.settling_band_deg:g}° (s)",
        "high",
    ),
    "saturated_percent": (Normalize(0.0, 100.0), "samples at the speed limit (%)", "high"),
    "disk_margin": (Normalize(0.0, 1.0), "disk margin", "low"),
}
"""Dictionary from a metric of the maps to its colour norm, its label and the end that is worse."""
_STAR: dict[str, Any] = {"marker": "*", "color": "w", "ms": 15, "mec": "k", "ls": "none"}


def _maps(
    axes: Sequence[Axes],
    x: Any,
    y: Any,
    values: Mapping[str, Array],
    names: Iterable[str],
    default: tuple[Any, Any],
    grid: ControllerSettings,
) -> None:
    """Draw a heat map of each metric in ``names``, from its ``values`` (len(x), len(y)).

    A cross marks each unstable loop, a star the ``default``.
    """
    column, row = np.nonzero(values["stable"] == 0.0)
    for ax, name in zip(axes, names, strict=True):
        norm, label, worse = _MAPPED[name]
        heat_map(ax, x, y, values[name], norm=norm, label=label.format(grid=grid), worse=worse)
        unstable = np.asarray(x)[column], np.asarray(y)[row]
        label = "linearly unstable"
        ax.plot(*unstable, "x", color=RED, ms=5, mew=1.4, path_effects=OUTLINE, label=label)
        ax.plot(*default, zorder=3, label="default", **_STAR)
        plain_ticks(ax.xaxis, x[::2])


def lambda_and_slope(result: ControllerResult) -> Figure:
    """Draw error, chattering, settling time and disk margin over λ and k/Φ.

    η has its value at the centre of the grid.
    """
    lambda_, phi, eta = result.centre
    lambdas, slope = result.settings.lambdas_per_s, result.slope_per_s[::-1, eta]
    default = (lambdas[lambda_], result.slope_per_s[phi, eta])
    at = {name: values[:, ::-1, eta] for name, values in result.values.items()}
    figure, axes = plt.subplots(2, 2, figsize=(8.4, 7.4), layout="constrained", sharex=True)
    names = ("max_error_deg", "mean_command_change_rpm", "settling_s", "disk_margin")
    _maps(list(axes.flat), lambdas, slope, at, names, default, result.settings)
    plt.setp(axes[1], xlabel="λ (1/s)")
    plt.setp(axes[:, 0], ylabel="k/Φ (1/s)")
    figure.suptitle(f"η = {result.settings.etas_m_s3[eta]:g} m/s³", fontsize=10)
    figure.set_label(
        "Tracking error, chattering, settling and disk margin over λ and k/Φ. Darker is worse. "
        "A cell has no result if its run failed or did not settle, or if its loop has no margin."
    )
    legend_below(figure, axes.flat, ncols=3, facecolor="0.9")
    return figure


def phi_and_eta(result: ControllerResult) -> Figure:
    """Draw error, chattering, saturation and disk margin over Φ and η.

    λ has its value at the centre of the grid.
    """
    lambda_, phi, eta = result.centre
    phis, etas = result.settings.phis_m_s2, result.settings.etas_m_s3
    beta = result.slope_per_s[phi, eta] * phis[phi] / etas[eta]
    figure, axes = plt.subplots(
        2, 2, figsize=(8.4, 7.4), layout="constrained", sharex=True, sharey=True
    )
    at = {name: values[lambda_] for name, values in result.values.items()}
    at["saturated_percent"] = 100.0 * at["saturated_share"]
    names = ("max_error_deg", "mean_command_change_rpm", "saturated_percent", "disk_margin")
    _maps(list(axes.flat), phis, etas, at, names, (phis[phi], etas[eta]), result.settings)
    for ax in axes.flat:
        ends = np.array(ax.get_xlim())
        for power in (4, 5, 6):
            ratio = 10.0**power / beta
            label = "k/Φ (1/s), as labelled"
            ax.plot(ends, ratio * ends, "k--", lw=1, path_effects=OUTLINE, label=label)
            x = max(ends[0] * 1.1, ax.get_ylim()[0] * 1.7 / ratio)
            text = ax.text(x, ratio * x, f"10$^{power}$", fontsize=9, ha="left", va="top")
            text.set_path_effects(OUTLINE)
    plt.setp(axes[1], xlabel="Φ (m/s²)")
    plt.setp(axes[:, 0], ylabel="η (m/s³)")
    figure.suptitle(f"λ = {result.settings.lambdas_per_s[lambda_]:g} 1/s", fontsize=10)
    figure.set_label(
        "Tracking error, chattering, saturation and disk margin over Φ and η. Darker is worse. "
        "A cell has no result if its run failed or its loop has no margin."
    )
    legend_below(figure, axes.flat, ncols=4, facecolor="0.9")
    return figure


def _spread(count: int, centre: int) -> Iterable[tuple[int, Any]]:
    """Return up to five indices with colours, from 0 to count − 1, and ``centre`` among them."""
    indices = sorted({0, centre // 2, centre, (centre + count) // 2, count - 1})
    return zip(indices, shades(len(indices)), strict=True)


def claims(result: ControllerResult) -> Figure:
    """Draw the metrics for the paper's three statements on λ, Φ and η, and the error over k/Φ."""
    lambda_, phi, eta = result.centre
    grid, values = result.settings, result.values
    lambdas, phis, etas = grid.lambdas_per_s, grid.phis_m_s2, grid.etas_m_s3
    error, change = values["max_error_deg"], values["mean_command_change_rpm"]
    figure, axes = plt.subplots(2, 2, figsize=(8.4, 7.2), layout="constrained")
    (faster, chattering), (adherent, collapse) = axes

    figure.set_label(
        "The paper's three statements. "
        "The loop settles faster with larger λ (a), and chatters least with a proper Φ (b). The "
        "errors over η (c) lie on a single curve over k/Φ (d). A darker curve has a larger value."
    )
    for name, size, style, colour in (
        ("large_settling_s", grid.large_step_deg, "s-", GOLD),
        ("settling_s", grid.step_deg, "o-", BLUE),
    ):
        settling = values[name][:, phi, eta]
        faster.loglog(lambdas, settling, style, color=colour, ms=5, label=f"step of {size:g}°")
    band = grid.settling_band_deg
    ideal = ideal_settling_time_s(np.array(lambdas), band / grid.step_deg)
    faster.loglog(lambdas, ideal, "k--", lw=1, label="s = 0 alone")
    faster.set(xlabel="λ (1/s)", ylabel=f"settling time to ±{band:g}° (s)", title="(a) larger λ")
    plain_ticks(faster.xaxis, lambdas[::2])
    plain_ticks(faster.yaxis, (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0))
    for n, colour in _spread(len(lambdas), lambda_):
        label = f"{lambdas[n]:g}"
        chattering.loglog(phis, change[n, :, eta], ".-", color=colour, label=label)
    chattering.set(xlabel="Φ (m/s²)", ylabel=_CHANGE, title="(b) proper Φ")
    for n, colour in _spread(len(phis), phi):
        adherent.loglog(etas, error[lambda_, n], ".-", color=colour, label=f"{phis[n]:g}")
    adherent.set(xlabel="η (m/s³)", ylabel=_ERROR, title="(c) larger η")
    for n, (value, colour) in enumerate(zip(etas, shades(len(etas)), strict=True)):
        slope, label = result.slope_per_s[:, n], f"{1e-3 * value:g}"
        collapse.loglog(slope, error[lambda_, :, n], ".-", color=colour, label=label)
    collapse.set(xlabel="k/Φ (1/s)", ylabel=_ERROR, title="(d) the same over k/Φ")
    for ax, title in (
        (faster, None),
        (chattering, "λ (1/s)"),
        (adherent, "Φ (m/s²)"),
        (collapse, "η (10³ m/s³)"),
    ):
        ax.grid(alpha=0.3)
        low, high = ax.get_ylim()
        ax.set_ylim(low, high * (high / low) ** 0.25)  # room for the legend
        ax.legend(title=title, fontsize=8, title_fontsize=8, loc="upper right", ncols=3)
    return figure


def limit_cycle(result: ControllerResult) -> Figure:
    """Draw the error of the limit cycle over time, and mark its place on the map of T_f and k/Φ."""
    grid = result.settings
    law, observer = observed_smc(result.scenario)
    figure = plt.figure(figsize=(8.4, 7.2), layout="constrained")
    axes = figure.subplot_mosaic([["error", "error"], ["map", "margin"]], height_ratios=(1.0, 1.2))
    error = axes["error"]
    figure.set_label(
        "Limit cycle at a small k/Φ. "
        "The error oscillates (a), although the linear loop is stable at the circle in (b) and "
        "(c). T_f is the time constant of the observer. Darker is worse."
    )
    shown = grid.limit_cycle_lambdas_per_s[0]
    cases = [case for case in result.limit_cycle if case.lambda_per_s == shown]
    for case, colour in zip(cases, SERIES, strict=False):
        error.plot(case.time_s, case.error_deg, colour, lw=0.9, label=case.variant)
    low, high = error.get_ylim()
    error.set(
        xlabel="time (s)",
        ylabel="tracking error (deg)",
        ylim=(low, high + 0.25 * (high - low)),
        title=f"(a) circle in (b), (c); λ = {shown:g} 1/s",
    )
    error.legend(fontsize=8, loc="upper right", ncols=len(cases))
    times, slopes = 1e3 * np.array(grid.map_time_constants_s), grid.map_slopes_per_s
    default = (1e3 * observer.time_constant_s, law.gain_ratio * law.eta_m_s3 / law.phi_m_s2)
    maps, names = [axes["map"], axes["margin"]], ("max_error_deg", "disk_margin")
    _maps(maps, times, slopes, result.map_values, names, default, grid)
    at = 1e3 * grid.limit_cycle_time_constant_s, grid.limit_cycle_slope_per_s
    for ax, title in zip(maps, ("(b)", "(c)"), strict=True):
        ax.plot(*at, "o", color=BLUE, mec="w", ms=10, ls="", label="limit cycle of (a)")
        ax.set(xlabel="T_f (ms)", ylabel="k/Φ (1/s)")
        ax.set_title(title, loc="left", fontsize=10)
    legend_below(figure, maps, ncols=4, facecolor="0.9")
    return figure


def figures(result: ControllerResult) -> dict[str, Figure]:
    """Draw all figures of the study. Return a dictionary of figures, which the caller closes."""
    return {
        "study_lambda_slope": lambda_and_slope(result),
        "study_phi_eta": phi_and_eta(result),
        "study_claims": claims(result),
        "study_limit_cycle": limit_cycle(result),
    }
