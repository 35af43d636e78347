"""Figures of ``kneexo reproduce``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from kneexo.analysis import FrequencyResponse, Run, TrackingResult
from kneexo.common.plotting import BLUE, PURPLE, SERIES
from kneexo.studies.markdown import number
from kneexo.studies.paper import PAPER_BANDWIDTH_HZ
from kneexo.studies.reproduce.reproduce import FIG_12_TITLES, ReproduceResult, rod_error_mm

if TYPE_CHECKING:
    from kneexo.view.legs import Motion


def figures(reproduction: ReproduceResult) -> dict[str, Figure]:
    """Draw figures in the paper's layout. Return a dictionary of figures. The caller closes all."""
    return {
        "fig05_polynomial_fit": reproduction.fit.plot()[0, 0].figure,
        "fig09_ideal_smc": _plot_fig9(reproduction.fig9),
        "fig12_tracking": _plot_fig12(reproduction.fig12),
        "fig13_frequency_response": _plot_fig13(reproduction.fig13),
        "eq27_at_2ms": _plot_eq27(reproduction),
    }


def motions(reproduction: ReproduceResult) -> dict[str, Motion]:
    """Return a dictionary from title to run of Fig. 12, for sliding mode and the paper's PID."""
    return {
        f"Fig. 12, {FIG_12_TITLES[name]}": (tracked.scenario.plant, tracked.run.columns)
        for name, tracked in reproduction.fig12.items()
        if name in ("smc", "pid")
    }


def _plot_fig9(run: Run) -> Figure:
    figure, ax = plt.subplots(1, 2, figsize=(8.6, 3.8), layout="constrained")
    figure.set_label(
        "Ideal sliding mode from a wrong start, as in Fig. 9. "
        "The rod extension reaches its reference (a), and the error decays exponentially (b)."
    )
    ax[0].plot(run.time_s, 1e3 * run["rod_reference_m"], "k--", lw=1, label="reference")
    ax[0].plot(run.time_s, 1e3 * run["rod_extension_m"], BLUE, lw=1.2, label="rod extension")
    ax[0].set(xlabel="time (s)", ylabel="rod extension $x$ (mm)", title="(a) wrong start")
    ax[0].legend()
    error = rod_error_mm(run)
    ax[1].plot(run.time_s, error, PURPLE, lw=1.2)
    ax[1].set(xlabel="time (s)", ylabel="error $x − x_d$ (mm)", title="(b) exponential decay")
    inset = ax[1].inset_axes((0.45, 0.2, 0.5, 0.5))
    inset.semilogy(run.time_s, np.maximum(np.abs(error), 1e-12), PURPLE, lw=1)
    inset.set(xlabel="time (s)", ylabel="|error| (mm)")
    return figure


def _plot_fig12(cases: Mapping[str, TrackingResult]) -> Figure:
    shown = {name: cases[name] for name in FIG_12_TITLES}
    figure, axes = plt.subplots(
        len(shown), 2, figsize=(8.6, 2.8 * len(shown)), sharex=True, layout="constrained"
    )
    figure.set_label(
        "Tracking of three controllers, as in Fig. 12. "
        "Each row has knee angle and reference, and the tracking error on a scale of its own, with "
        "the largest error after one period."
    )
    for row, (name, tracked) in enumerate(shown.items()):
        tracked.plot_angle(axes[row, 0]).set_title(f"({'ace'[row]}) {FIG_12_TITLES[name]}")
        error = tracked.plot_error(axes[row, 1])
        largest = number(tracked.metrics.max_error_deg)
        error.set_title(f"({'bdf'[row]}) own scale, largest error {largest}°")
        for ax in axes[row] if row < len(shown) - 1 else ():
            ax.set_xlabel("")
    return figure


def _plot_fig13(response: FrequencyResponse) -> Figure:
    ax = response.plot()
    ax[0].axvline(PAPER_BANDWIDTH_HZ, color="0.3", ls=":", label=f"paper {PAPER_BANDWIDTH_HZ} Hz")
    ax[0].legend(loc="lower left")
    figure: Figure = ax[0].figure
    paper = f"The paper measured −3 dB at {PAPER_BANDWIDTH_HZ:g} Hz (Fig. 13)."
    figure.set_label(f"{figure.get_label()} {paper}")
    return figure


def _plot_eq27(reproduction: ReproduceResult) -> Figure:
    figure, ax = plt.subplots(1, 2, figsize=(8.6, 3.8), layout="constrained")
    figure.set_label(
        "Eq. 27 as printed, with a sample time of 2 ms. "
        "With exact states a higher gain excites the hydraulic mode (a). "
        "With differences of the encoder's counts the error is large with either gain (b)."
    )
    for colour, (name, run) in zip(SERIES, reproduction.eq27_exact.items(), strict=False):
        pressure = np.abs(run["load_pressure_pa"])
        ax[0].semilogy(run.time_s, pressure, ".", color=colour, ms=1.5, label=name)
    ax[0].set(
        xlabel="time (s)",
        ylabel="|load pressure| (Pa)",
        ylim=(1e-2, 1e4),
        title="(a) exact states: hydraulic mode",
    )
    for colour, (name, tracked) in zip(SERIES, reproduction.eq27_differences.items(), strict=False):
        ax[1].plot(tracked.run.time_s, tracked.error_deg, colour, lw=0.8, label=name)
    ax[1].set(
        xlabel="time (s)",
        ylabel="tracking error (deg)",
        ylim=(-24, 16),
        title="(b) encoder differences: quantization",
    )
    for axis in ax:
        axis.legend(loc="upper left", title="k/Φ (1/s)", ncols=2, markerscale=6)
    return figure
