"""Figures of a `kneexo.studies.bandwidth.study.BandwidthResult`."""

from __future__ import annotations

import math

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from kneexo.analysis.frequency_response import MINUS_3_DB
from kneexo.analysis.rate_limit import (
    rate_limit_bandwidth_hz,
    rate_limited_follower,
    rate_limited_gain,
)
from kneexo.studies.bandwidth.study import BandwidthResult, decibel, unwrapped_deg
from kneexo.studies.plots import heat_map_panels, plain_ticks

_MINUS_3_DB = 20.0 * math.log10(MINUS_3_DB)
_RATIO_AT_MINUS_3_DB = 1.0 / (math.tau * rate_limit_bandwidth_hz(1.0, 1.0))  # ρ = 0.55539
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

    They show gain, phase, and the shares of time at the motor's speed and acceleration limits.
    """
    figure, axes = plt.subplots(
        2, 2, figsize=(11, 7.5), sharex=True, sharey=True, layout="constrained"
    )
    f, amplitudes = result.frequencies_hz, result.amplitudes_deg
    share, phase = Normalize(0.0, 1.0), result.phase_deg
    low, high = np.nanmin(phase, initial=0.0), np.nanmax(phase, initial=0.0)
    speed_limited, acceleration_limited = (
        result.cells[f"{limit}_limited_share"] for limit in ("speed", "acceleration")
    )
    panels = (
        (result.gain_db.T, Normalize(-20.0, 3.0), "gain (dB)"),
        (phase.T, Normalize(low, high), "phase (deg)"),
        (speed_limited.T, share, "share of time at the speed limit"),
        (acceleration_limited.T, share, "share of time at the acceleration limit"),
    )
    heat_map_panels(axes.flat, f, amplitudes, panels)
    for axis in axes[1]:
        measured = result.bandwidths["measured_hz"]
        axis.plot(measured, amplitudes, "wo", mec="k", ms=5, label="−3 dB, measured")
        axis.legend(loc="lower left", fontsize=8, facecolor="0.75")
        axis.set_xlabel("frequency (Hz)")
    for axis in axes[:, 0]:
        axis.set_ylabel("amplitude (deg)")
    _plot_bandwidths(result, axes[0, 0])
    reached = result.bandwidths["speed_limit_reached_hz"]
    axes[1, 0].plot(reached, amplitudes, "C3.-", label="the reference asks for more speed")
    axes[1, 0].legend(loc="lower left", fontsize=8, facecolor="0.75")
    plain_ticks(axes[0, 0].xaxis, _TICKS_HZ)
    plain_ticks(axes[0, 0].yaxis, amplitudes)
    return figure


def _plot_bandwidths(result: BandwidthResult, axis: Axes) -> None:
    """Add the measured and the predicted −3 dB frequencies to a map of frequency and amplitude."""
    if result.amplitudes_deg.size > 1:
        axis.contour(
            result.frequencies_hz,
            result.amplitudes_deg,
            result.gain_db,
            levels=[_MINUS_3_DB],
            colors="w",
            linestyles="-",
        )
    axis.plot([], [], "w-", label="−3 dB, interpolated in the map")
    for name, style, label in (
        ("measured_hz", "wo", "−3 dB, measured"),
        ("rate_limit_hz", "C3.-", "speed limit, closed form"),
        ("follower_hz", "C1x", "speed limit, follower through x(θ)"),
        ("acceleration_bound_hz", "C6.--", "acceleration bound"),
        ("linear_loop_hz", "C9.:", "linear loop"),
    ):
        edge = "k" if name == "measured_hz" else None
        axis.plot(result.bandwidths[name], result.amplitudes_deg, style, label=label, mec=edge)
    axis.legend(loc="lower left", fontsize=8, facecolor="0.75")


def plot_bode(result: BandwidthResult) -> Figure:
    """Draw a Bode plot with a measured curve for each amplitude.

    The plot also shows the linear loop and, for each amplitude, an ideal follower that is limited
    only in speed.
    """
    figure, axes = plt.subplots(2, 1, sharex=True, figsize=(7.5, 7.5), layout="constrained")
    colours = plt.get_cmap("viridis_r")(np.linspace(0.15, 1.0, result.amplitudes_deg.size))
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
    axes[0].set(ylabel="gain (dB)", ylim=(-45.0, 5.0), xscale="log")
    axes[1].set(xlabel="frequency (Hz)", ylabel="phase (deg)")
    plain_ticks(axes[0].xaxis, _TICKS_HZ)
    axes[0].legend(loc="lower left", fontsize=8, ncols=2)
    return figure


def plot_rate_limit(result: BandwidthResult) -> Figure:
    """Draw rate-limited sines over time, and all gains over aω/R beside their closed form.

    aω is the amplitude of the rod speed that the reference requires. R is the rod's speed limit.
    """
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    time = np.linspace(0.0, 4.0, 4001)
    target, shown = np.sin(math.tau * time), slice(2500, None)
    axes[0].plot(time[shown] - 2.5, target[shown], "k", lw=1, label="sine")
    for ratio in (0.8, _RATIO_AT_MINUS_3_DB, 0.3):
        follower = rate_limited_follower(time, target, math.tau * ratio)
        axes[0].plot(time[shown] - 2.5, follower[shown], label=f"ρ = {ratio:.3g}")
    axes[0].set(xlabel="time (periods)", ylabel="position (amplitudes)", ylim=(-1.1, 1.6))
    axes[0].legend(loc="upper center", fontsize=8, ncols=4)
    reached = result.frequencies_hz / result.bandwidths["rate_limit_hz"][:, None]
    demand = reached / _RATIO_AT_MINUS_3_DB
    colours = plt.get_cmap("viridis_r")(np.linspace(0.15, 1.0, result.amplitudes_deg.size))
    for i, amplitude in enumerate(result.amplitudes_deg):
        axes[1].plot(
            demand[i], result.gain_db[i], "o", ms=3, color=colours[i], label=f"{amplitude:g}°"
        )
    grid = np.geomspace(demand.min(), demand.max(), 400)
    closed = decibel(rate_limited_gain(1.0 / grid))
    axes[1].plot(grid, closed, "C3", lw=1.2, label="closed form")
    axes[1].axhline(_MINUS_3_DB, color="0.5", lw=0.8, label="−3 dB")
    axes[1].set(
        xlabel="speed demand aω/R = 1/ρ (1)",
        ylabel="gain (dB)",
        xscale="log",
        ylim=(-45.0, 5.0),
    )
    axes[1].grid(alpha=0.3)
    axes[1].legend(loc="lower left", fontsize=8)
    return figure
