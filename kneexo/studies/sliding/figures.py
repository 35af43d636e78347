"""Figures of a `kneexo.studies.sliding.study.SlidingResult`, for the full-order plant."""

from __future__ import annotations

import math

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from kneexo.plotting import RED, SERIES, decimal_ticks
from kneexo.studies.plots import legend_below, with_minus
from kneexo.studies.sliding.study import LAWS, SlidingResult

_COLOURS = dict(zip(LAWS, SERIES, strict=False))
_OFF = 40.0
"""Value of |s|/Φ at which a figure draws the mark of a run that left the range of motion."""


def _shown_eta(result: SlidingResult) -> float:
    """Return the η that the figures over time show.

    This is the smallest η at which the run with the paper's gain k does not fail. If all these runs
    fail, the result is the first η of the settings.
    """
    load = result.settings.loads_n[0]
    complete = [
        case.eta_m_s3
        for case in result.of("motion", plant="full", law="paper", load_n=load)
        if not case.measured.failure
    ]
    return min(complete, default=result.settings.etas_m_s3[0])


def condition(result: SlidingResult) -> Figure:
    """Draw sgn(s)·ds/dt over time at the samples outside the boundary layer |s| ≤ Φ.

    The run in the left panel starts outside the layer. The runs in the right panel follow the
    reference.
    """
    figure, ax = plt.subplots(1, 2, figsize=(8.4, 4), layout="constrained")
    load = result.settings.loads_n[0]
    figure.set_label(
        "The rate sgn(s)·ds/dt of the sliding variable outside the boundary layer, with the full "
        "order of the cylinder. The sliding condition holds below the dashed line. "
        f"The force on the rod is {with_minus(load)} N."
    )
    for axis, part, eta, scale in (
        (ax[0], "start", result.settings.start_eta_m_s3, 1e3),
        (ax[1], "motion", _shown_eta(result), 1.0),
    ):
        for case in result.of(part, plant="full", load_n=load, eta_m_s3=eta):
            trace = case.measured.trace
            if trace.outside_time_s:
                axis.plot(
                    scale * np.array(trace.outside_time_s),
                    trace.reaching_rate_m_s3,
                    ".",
                    color=_COLOURS[case.law],
                    ms=3,
                    label=LAWS[case.law],
                )
        axis.axhline(0.0, color="0.6", lw=0.8)
        axis.axhline(-eta, color="k", ls="--", lw=1, label=f"−η, η = {eta:g} m/s³")
        axis.set(ylabel="sgn(s)·ds/dt outside the layer (m/s³)", ylim=(-2.5 * eta, 2.0 * eta))
        axis.legend(loc="upper right")
    ax[0].set(xlabel="time (ms)", title=f"from outside the layer, {with_minus(load)} N")
    ax[1].set(xlabel="time (s)", title=f"along the reference, {with_minus(load)} N")
    return figure


def error_bound(result: SlidingResult) -> Figure:
    """Draw the rod's error |e| over time and its bound Φ/λ². Each load has its own panel.

    A cross marks the end of a run that left the range of motion.
    """
    loads, law = result.settings.loads_n, result.law
    figure, ax = plt.subplots(
        1, len(loads), figsize=(4.2 * len(loads), 4), layout="constrained", squeeze=False
    )
    figure.set_label(
        "Error of the rod and its bound Φ/λ², with the full order of the cylinder. "
        "Each panel has another constant force on the rod."
    )
    eta, bound = _shown_eta(result), 1e3 * law.phi_m_s2 / law.lambda_per_s**2
    for axis, load in zip(ax[0], loads, strict=True):
        for case in result.of("motion", plant="full", load_n=load, eta_m_s3=eta):
            trace, color = case.measured.trace, _COLOURS[case.law]
            error = 1e3 * np.abs(np.array(trace.error_m))
            axis.semilogy(trace.time_s, error, color, lw=1.2, label=LAWS[case.law])
            if case.measured.failure:
                label = f"{LAWS[case.law]}: leaves the range of motion"
                axis.plot(trace.time_s[-1], error[-1], "x", color=color, ms=8, label=label)
        axis.axhline(bound, color=RED, ls="--", lw=1, label=f"Φ/λ² = {bound:g} mm")
        axis.set(
            xlabel="time (s)", ylabel="|e| (mm)", title=f"{with_minus(load)} N, η = {eta:g} m/s³"
        )
        axis.set_ylim(bottom=1e-3)
    legend_below(figure, ax[0], ncols=3)
    return figure


def boundary_layer(result: SlidingResult) -> Figure:
    """Draw the largest |s|/Φ in runs along the reference, over η.

    Marks at the top stand for runs that left the range of motion.
    """
    figure, ax = plt.subplots(figsize=(7.0, 5.6), layout="constrained")
    figure.set_label(
        "Largest sliding variable along the reference, relative to the boundary layer, over η. "
        "Three formulas for the gain k and two forces on the rod. "
        "A mark at the top is a run that left the range of motion."
    )
    for style, load in zip(("-", "--", ":", "-."), result.settings.loads_n, strict=False):
        for name, label in LAWS.items():
            cases = result.of("motion", plant="full", law=name, load_n=load)
            ax.loglog(
                [case.eta_m_s3 for case in cases],
                [math.nan if c.measured.failure else c.measured.largest_s for c in cases],
                f"{style}o",
                color=_COLOURS[name],
                ms=3,
                label=f"{label}, {with_minus(load)} N",
            )
            off = [case.eta_m_s3 for case in cases if case.measured.failure]
            text = f"{label}, {with_minus(load)} N: left the range" if off else None
            marker = "x" if load < 0.0 else "+"
            ax.plot(off, [_OFF] * len(off), marker, color=_COLOURS[name], ms=9, label=text)
    ax.axhline(1.0, color=RED, lw=1, label="edge of the layer")
    for value, name in ((result.needed.speed, "speed"), (result.needed.stability, "stability")):
        ax.axvline(value, color="0.5", ls=":", lw=1)
        text = f" needed for {name}"
        ax.text(value, 0.56, text, rotation=90, transform=ax.get_xaxis_transform())
    ax.set(xlabel="η (m/s³)", ylabel="largest |s|/Φ along the reference")
    decimal_ticks(ax.xaxis)
    decimal_ticks(ax.yaxis)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    return figure


def figures(result: SlidingResult) -> dict[str, Figure]:
    """Draw all figures: ``sliding_condition``, ``error_bound`` and ``boundary_layer``."""
    return {
        "sliding_condition": condition(result),
        "error_bound": error_bound(result),
        "boundary_layer": boundary_layer(result),
    }
