"""Figures of a `kneexo.studies.bandwidth.bandwidth.BandwidthResult`."""

from __future__ import annotations

import math
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from kneexo.analysis.frequency.rate_limit import (
    rate_limit_bandwidth_hz,
    rate_limited_follower,
    rate_limited_gain,
)
from kneexo.analysis.signals import unwrapped_deg
from kneexo.common.plotting import BLUE, RED, SERIES, decimal_ticks, phase_ticks
from kneexo.common.result import Array
from kneexo.parameters.criteria import MINUS_3_DB
from kneexo.studies.bandwidth.bandwidth import BandwidthResult, decibel
from kneexo.studies.plots import (
    OUTLINE,
    Worse,
    heat_map,
    legend_below,
    plain_ticks,
    shades,
)

_MINUS_3_DB = 20.0 * math.log10(MINUS_3_DB)
_RATIO_AT_MINUS_3_DB = 1.0 / (math.tau * rate_limit_bandwidth_hz(1.0, 1.0))  # ρ = 0.55539
_MEASURED: dict[str, Any] = {
    "ls": "",
    "marker": "o",
    "color": "w",
    "mec": "k",
    "ms": 6,
    "zorder": 4,
    "label": "−3 dB, measured",
}
_TICKS_HZ = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)


def figures(result: BandwidthResult) -> dict[str, Figure]:
    """Draw amplitude map, Bode plots and rate-limited sine. Return a dictionary of figures."""
    return {
        "amplitude_map": plot_map(result),
        "bode_by_amplitude": plot_bode(result),
        "rate_limited_sine": plot_rate_limit(result),
    }


def plot_map(result: BandwidthResult) -> Figure:
    """Draw four maps over frequency and amplitude.

    The maps show gain, phase, and the shares of time at the motor's speed and acceleration limits.
    """
    figure, axes = plt.subplots(
        2, 2, figsize=(8.4, 7.8), sharex=True, sharey=True, layout="constrained"
    )
    figure.set_label(
        "Gain, phase lead and the motor's limits over frequency and amplitude of the reference. "
        "Darker is worse." + _gain_returns(result)
    )
    f, amplitudes = result.frequencies_hz, result.amplitudes_deg
    share, phase = Normalize(0.0, 100.0), result.phase_deg
    low, high = np.nanmin(phase, initial=0.0), np.nanmax(phase, initial=0.0)
    speed_limited, acceleration_limited = (
        100.0 * result.cells[f"{limit}_limited_share"].T for limit in ("speed", "acceleration")
    )
    panels: tuple[tuple[Array, Normalize, str, Worse], ...] = (
        (result.gain_db.T, Normalize(-20.0, 3.0), "gain (dB)", "low"),
        (phase.T, Normalize(low, high), "phase (deg)", "low"),
        (speed_limited, share, "time at the speed limit (%)", "high"),
        (acceleration_limited, share, "time at the acceleration limit (%)", "high"),
    )
    for ax, (values, norm, label, worse) in zip(axes.flat, panels, strict=True):
        heat_map(ax, f, amplitudes, values, norm=norm, label=label, worse=worse)
    for axis in axes[1]:
        axis.plot(result.bandwidths["measured_hz"], amplitudes, **_MEASURED)
        axis.set_xlabel("frequency (Hz)")
    for axis in axes[:, 0]:
        axis.set_ylabel("amplitude (deg)")
    _plot_bandwidths(result, axes[0, 0])
    reached = result.bandwidths["speed_limit_reached_hz"]
    label = "sine at the speed limit"
    axes[1, 0].plot(reached, amplitudes, ".:", color=RED, label=label, path_effects=OUTLINE)
    plain_ticks(axes[0, 0].xaxis, _TICKS_HZ)
    plain_ticks(axes[0, 0].yaxis, amplitudes)
    style = {"fontsize": 8, "facecolor": "0.9"}
    for axis in axes[1]:
        axis.legend(loc="lower left", handlelength=1.2, **style)
    legend_below(figure, axes[:1, 0], ncols=3, title="in the map of the gain", **style)
    return figure


def _gain_returns(result: BandwidthResult) -> str:
    """Return a sentence on small sines whose gain rises above −3 dB again, or an empty text."""
    if not _above_again(result).any():
        return ""
    return " The gain of small sines falls below −3 dB and rises above it again."


def _above_again(result: BandwidthResult) -> Array:
    """Return a mask (amplitudes, frequencies) of gains above −3 dB that follow one below −3 dB."""
    gain = np.where(np.isnan(result.gain_db), _MINUS_3_DB, result.gain_db)
    below = np.maximum.accumulate(gain < _MINUS_3_DB, axis=1)
    return np.asarray(below & (gain > _MINUS_3_DB))


def _plot_bandwidths(result: BandwidthResult, axis: Axes) -> None:
    """Add the measured and the predicted −3 dB frequencies to a map of frequency and amplitude."""
    if result.amplitudes_deg.size > 1:
        axis.contour(
            result.frequencies_hz,
            result.amplitudes_deg,
            result.gain_db,
            levels=[_MINUS_3_DB],
            colors="k",
            linewidths=1.2,
            linestyles="-",
        )
    axis.plot([], [], "k-", lw=1.2, label="−3 dB, interpolated in the map")
    axis.plot(result.bandwidths["measured_hz"], result.amplitudes_deg, **_MEASURED)
    row, column = np.nonzero(_above_again(result))
    if row.size:
        at = result.frequencies_hz[column], result.amplitudes_deg[row]
        axis.plot(*at, "k^", mfc="w", ms=6, ls="", label="gain above −3 dB again")
    for name, style, colour, label in (
        ("rate_limit_hz", ".-", RED, "speed limit, closed form"),
        ("follower_hz", "x", "k", "speed limit, follower through x(θ)"),
        ("acceleration_bound_hz", ".--", RED, "acceleration bound"),
        ("linear_loop_hz", ".:", BLUE, "linear loop"),
    ):
        values = result.bandwidths[name]
        axis.plot(
            values,
            result.amplitudes_deg,
            style,
            color=colour,
            ms=5,
            label=label,
            path_effects=OUTLINE,
        )


def plot_bode(result: BandwidthResult) -> Figure:
    """Draw a Bode plot with a measured curve for each amplitude.

    The plot also shows the linear loop and, for each amplitude, an ideal follower that is limited
    only in speed.
    """
    figure, axes = plt.subplots(2, 1, sharex=True, figsize=(7.5, 7.5), layout="constrained")
    returned = _linear_return_hz(result)
    note = f"linear gain rises above −3 dB again at {returned:.3g} Hz" if returned else ""
    figure.set_label(
        "Bode plots of the knee angle relative to its reference. "
        "A darker curve has a larger amplitude." + (f" The {note}." if note else "")
    )
    colours = shades(result.amplitudes_deg.size)
    relative = result.relative_uncertainty
    panels = (
        (result.gain_db, 20.0 * np.log10(1.0 + relative), decibel),
        (result.phase_deg, np.degrees(np.arcsin(np.minimum(relative, 1.0))), unwrapped_deg),
    )
    for axis, (measured, errors, shown) in zip(axes, panels, strict=True):
        for i, amplitude in enumerate(result.amplitudes_deg):
            axis.errorbar(
                result.frequencies_hz,
                measured[i],
                errors[i],
                fmt="o-",
                ms=3,
                lw=1.2,
                color=colours[i],
                label=f"{amplitude:g}°",
            )
            axis.plot(
                result.frequencies_hz, shown(result.follower[i]), ":", lw=1.2, color=colours[i]
            )
        axis.plot(result.frequencies_hz, shown(result.linear), "k--", lw=1.2, label="linear loop")
        axis.plot([], [], ":", color="0.4", label="rate-limited follower")
        axis.grid(alpha=0.3)
    axes[0].axhline(_MINUS_3_DB, color="0.5", lw=0.8, label="−3 dB")
    axes[0].set(ylabel="gain (dB)", ylim=(-45.0, 7.0), xscale="log")
    axes[1].set(xlabel="frequency (Hz)", ylabel="phase (deg)")
    if returned:
        axes[0].plot([returned], [_MINUS_3_DB], "k^", mfc="w", zorder=3)
        axes[0].text(0.99, 0.97, f"△ {note}", transform=axes[0].transAxes, ha="right", va="top")
    plain_ticks(axes[0].xaxis, _TICKS_HZ)
    phase_ticks(axes[1].yaxis)
    legend_below(figure, axes[:1], ncols=5, fontsize=9)
    return figure


def _linear_return_hz(result: BandwidthResult) -> float | None:
    """Return the frequency in Hz at which the linear gain rises through −3 dB, None without one.

    The frequency is interpolated between two frequencies of the map, in dB over its logarithm.
    """
    gain, logs = decibel(result.linear), np.log(result.frequencies_hz)
    (rises,) = np.nonzero((gain[:-1] < _MINUS_3_DB) & (gain[1:] >= _MINUS_3_DB))
    if not rises.size:
        return None
    ends = slice(rises[0], rises[0] + 2)
    return float(np.exp(np.interp(_MINUS_3_DB, gain[ends], logs[ends])))


def plot_rate_limit(result: BandwidthResult) -> Figure:
    """Draw rate-limited sines over time, and all gains over aω/R beside their closed form.

    aω is the amplitude of the rod speed that the reference requires. R is the rod's speed limit.
    """
    figure, axes = plt.subplots(1, 2, figsize=(8.6, 4.0), layout="constrained")
    figure.set_label(
        "A follower with limited speed turns a fast sine into a triangle (left). "
        "ρ is its speed limit over the largest speed of the sine. "
        "The gains of the knee lie on the follower's closed form, or below it where the "
        "acceleration is limited too (right)."
    )
    time = np.linspace(0.0, 4.0, 4001)
    target, shown = np.sin(math.tau * time), slice(2500, None)
    axes[0].plot(time[shown] - 2.5, target[shown], "k", lw=1, label="sine")
    for colour, ratio in zip(SERIES, (0.8, _RATIO_AT_MINUS_3_DB, 0.3), strict=False):
        follower = rate_limited_follower(time, target, math.tau * ratio)
        axes[0].plot(time[shown] - 2.5, follower[shown], colour, label=f"ρ = {ratio:.3g}")
    axes[0].set(xlabel="time (periods)", ylabel="position (amplitudes)", ylim=(-1.1, 1.8))
    axes[0].legend(loc="upper center", fontsize=8, ncols=2)
    reached = result.frequencies_hz / result.bandwidths["rate_limit_hz"][:, None]
    demand = reached / _RATIO_AT_MINUS_3_DB
    colours = shades(result.amplitudes_deg.size)
    for i, amplitude in enumerate(result.amplitudes_deg):
        axes[1].plot(
            demand[i], result.gain_db[i], "o", ms=3, color=colours[i], label=f"{amplitude:g}°"
        )
    grid = np.geomspace(demand.min(), demand.max(), 400)
    closed = decibel(rate_limited_gain(1.0 / grid))
    axes[1].plot(grid, closed, RED, lw=1.2, label="closed form")
    axes[1].axhline(_MINUS_3_DB, color="0.5", lw=0.8, label="−3 dB")
    axes[1].set(
        xlabel="speed demand aω/R = 1/ρ (1)",
        ylabel="gain (dB)",
        xscale="log",
        ylim=(-45.0, 5.0),
    )
    decimal_ticks(axes[1].xaxis)
    axes[1].grid(alpha=0.3)
    axes[1].legend(loc="lower left", fontsize=8)
    return figure
