"""Figures of a `kneexo.studies.mechanism.mechanism.MechanismResult`."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from kneexo.analysis import TradeOff
from kneexo.analysis.mechanism.alignment import MM
from kneexo.analysis.mechanism.prosthetic_leg import contacts, voluntary_margin_n_m
from kneexo.common.plotting import BLUE, SERIES
from kneexo.parameters import WalkingLegParameters
from kneexo.studies.mechanism.mechanism import MechanismResult
from kneexo.studies.plots import legend_below

_MARKED_DEG = 15.0  # distance of the marked knee angles
_LARGEST_MISPLACEMENT = 2.0  # where the curves end, relative to the setting ``misplacement_mm``
_KNEE: dict[str, Any] = {"color": "k", "ls": "-", "lw": 1.4}
_STYLES: list[dict[str, Any]] = [
    *({"color": c, "ls": "-", "lw": 1.4} for c in SERIES),
    *({"color": c, "ls": "--", "lw": 1.4} for c in ("0.5", BLUE)),
]
"""Styles of the curves of devices, of which there are seven at most."""


def figures(result: MechanismResult) -> dict[str, Figure]:
    """Draw all figures of the study; return them by name.

    The last one, the trade-off of migration against the error of Table 1, exists only if the study
    searched it.
    """
    drawn = {
        "centres": plot_centres(result),
        "migration": plot_migration(result),
        "misplacement": plot_misplacement(result),
        "slotted_strap": plot_slotted_strap(result),
        "leg_length": plot_leg_length(result),
        "stance": plot_stance(result),
    }
    if result.trade_off is not None:
        drawn["trade_off"] = plot_trade_off(result, result.trade_off)
    return drawn


def plot_centres(result: MechanismResult) -> Figure:
    """Draw the paths of the centres of rotation of the wearer's knee and of all devices."""
    figure, axes = plt.subplots(1, 2, figsize=(8, 6), layout="constrained", width_ratios=(1, 1.2))
    figure.set_label(
        "Centres of rotation in the frame of the thigh, each device at its best place. The square "
        "on the left is enlarged on the right: the wearer's knee and the hinge."
    )
    marks = np.flatnonzero(result.knee_angle_deg % _MARKED_DEG == 0.0)
    paths = {"wearer's knee": result.knee.fixed_centrode}
    paths |= {name: device.alignment.device_centre for name, device in result.devices.items()}
    for (name, path), style in zip(paths.items(), [_KNEE, *_STYLES], strict=False):
        x, y = -MM * path.real, MM * path.imag  # forwards is to the right
        for ax in axes:
            ax.plot(x, y, marker="o", ms=3.5, markevery=marks.tolist(), label=name, **style)
            ax.plot(x[:1], y[:1], "o", ms=8.0, mfc="none", color=style["color"])
    axes[0].plot([], [], "ko", ms=8.0, mfc="none", label="full extension")
    axes[0].plot([], [], "ko", ms=3.5, label=f"every {_MARKED_DEG:g}°")
    axes[0].set(xlabel="forwards (mm)", ylabel="up, towards the hip (mm)")
    middle = MM * np.mean(result.knee.fixed_centrode)
    _enlarge(axes, complex(-middle.real, middle.imag), 10.0)
    _finish(figure, axes)
    return figure


def plot_migration(result: MechanismResult) -> Figure:
    """Draw the migration of the strap across and along the shank over the knee angle."""
    figure, axes = plt.subplots(2, 1, figsize=(7.2, 6.0), layout="constrained", sharex=True)
    figure.set_label(
        "Migration of the strap on the shank, each device at its best place: across the shank (a) "
        "and along it (b)."
    )
    for (name, device), style in zip(result.devices.items(), _STYLES, strict=False):
        axes[0].plot(result.knee_angle_deg, device.alignment.across_mm, label=name, **style)
        axes[1].plot(result.knee_angle_deg, device.alignment.along_mm, **style)
    axes[0].set(ylabel="strap backwards (mm)", title="(a) across the shank")
    axes[1].set(ylabel="strap up (mm)", xlabel="knee angle (deg)", title="(b) along the shank")
    _finish(figure, axes)
    return figure


def plot_misplacement(result: MechanismResult) -> Figure:
    """Draw how far the strap migrates if the device is misplaced, and what is tolerated."""
    figure, axes = plt.subplots(1, 2, figsize=(9.6, 4.8), layout="constrained")
    settings = result.settings
    figure.set_label(
        "Migration of the strap over the error of the device's place (a), and the errors that "
        f"leave at most {settings.tolerance_mm:g} mm rms (b). All directions of the error cost the "
        "same, because the strap is put on anew (circles). If the cuff slides along the shank, "
        "only the migration across it counts, and the direction matters (ellipses)."
    )
    error_mm = np.linspace(0.0, _LARGEST_MISPLACEMENT * settings.misplacement_mm, 101)
    for (name, device), style in zip(result.devices.items(), _STYLES, strict=False):
        axes[0].plot(error_mm, device.alignment.misplaced_rms_mm(error_mm), label=name, **style)
        for alignment in (device.alignment, device.sliding):
            if alignment.rms_mm < settings.tolerance_mm:
                rim = alignment.tolerated_errors_mm(settings.tolerance_mm)
                axes[1].plot(-rim.real, rim.imag, **style)
    words = "circles: strap put on anew\nellipses: cuff that slides"
    axes[1].annotate(words, (0.97, 0.97), xycoords="axes fraction", ha="right", va="top")
    axes[0].axhline(settings.tolerance_mm, color="0.4", ls=":", lw=1.0, label="tolerated")
    axes[0].set(xlabel="error of the place (mm)", ylabel="migration, rms (mm)", ylim=(0.0, None))
    axes[0].set_title("(a) migration of a misplaced device")
    axes[1].set(xlabel="device too far forwards (mm)", ylabel="device too far up (mm)")
    axes[1].set_title(f"(b) errors that leave {settings.tolerance_mm:g} mm rms")
    axes[1].set_aspect("equal", adjustable="datalim")
    _finish(figure, axes)
    return figure


def plot_slotted_strap(result: MechanismResult) -> Figure:
    """Draw angle and torque of devices whose strap slides along the shank."""
    figure, axes = plt.subplots(2, 1, figsize=(7.2, 6.0), layout="constrained", sharex=True)
    figure.set_label(
        "A strap that slides along the shank: knee angle of the device minus the wearer's (a), and "
        "torque on the wearer's knee relative to the device's (b)."
    )
    for (name, device), style in zip(result.devices.items(), _STYLES, strict=False):
        strap = device.strap
        axes[0].plot(result.knee_angle_deg, strap.angle_difference_deg, label=name, **style)
        axes[1].plot(result.knee_angle_deg, strap.torque_ratio, **style)
    axes[0].set(ylabel="angle difference (deg)", title="(a) knee of the device minus wearer's knee")
    title = "(b) torque on the wearer's knee over torque of the device"
    axes[1].set(ylabel="torque ratio (1)", xlabel="knee angle (deg)", title=title)
    _finish(figure, axes)
    return figure


def plot_leg_length(result: MechanismResult) -> Figure:
    """Draw how much shorter the leg is, and how much higher the toe, if a device were the leg."""
    figure, axes = plt.subplots(2, 1, figsize=(7.2, 6.0), layout="constrained")
    figure.set_label(
        "A leg whose knee is the device, as in a prosthesis, beside a leg whose knee is a hinge at "
        "the origin: how much shorter the leg is (a), and how much higher the toe is over the "
        "measured swing (b). A worn device does not shorten the wearer's leg."
    )
    leg = result.leg
    axes[0].plot(leg.knee_angle_deg, MM * leg.shortening_m, label="wearer's own knee", **_KNEE)
    for (name, device), style in zip(result.devices.items(), _STYLES, strict=False):
        swing = device.swing
        axes[0].plot(device.leg.knee_angle_deg, MM * device.leg.shortening_m, label=name, **style)
        axes[1].plot(swing.gait_percent, MM * swing.clearance_gain_m, **style)
    axes[0].set(xlabel="knee angle (deg)", ylabel="leg shorter by (mm)", title="(a) length of leg")
    axes[1].set(xlabel="gait cycle (%)", ylabel="toe higher by (mm)", title="(b) toe in the swing")
    _finish(figure, axes)
    return figure


def plot_stance(result: MechanismResult) -> Figure:
    """Draw Radcliffe's zone of voluntary stability and the centres of all devices in it."""
    leg = WalkingLegParameters()
    figure, axes = plt.subplots(1, 2, figsize=(8, 6), layout="constrained", width_ratios=(1, 1.2))
    figure.set_label(
        "Side view of a straight leg, whose knee is the device. In the shaded zone (Radcliffe) the "
        f"hip is strong enough: {leg.hip_extension_n_m:g} N·m of extension keep the knee straight "
        f"at heel contact, and {leg.hip_flexion_n_m:g} N·m of flexion start knee flexion at "
        "push-off. Marks are the centres of rotation, enlarged on the right."
    )
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, 201), np.linspace(-0.4, leg.thigh_m, 201))
    margin = voluntary_margin_n_m(x + 1j * y, leg)
    for ax in axes:
        ax.contourf(-MM * x, MM * y, margin, levels=[0.0, np.inf], colors=["0.9"])
        for contact in contacts(leg):
            line = MM * np.array([contact, 1j * leg.thigh_m])
            ax.plot(-line.real, line.imag, "k--", lw=0.8, label="heel or ball to the hip")
        for (name, device), style in zip(result.devices.items(), _STYLES, strict=False):
            centre, mark = MM * device.stance.centre, "D" if style["ls"] == "-" else "s"
            ax.plot(-centre.real, centre.imag, mark, color=style["color"], mfc="none", label=name)
    axes[0].fill([], [], "0.9", label="the hip is strong enough")
    axes[0].set(xlabel="forwards (mm)", ylabel="up from the knee, towards the hip (mm)")
    axes[0].set_xlim(-200.0, 200.0)
    _enlarge(axes, 0j, 60.0)
    _finish(figure, axes)
    return figure


def plot_trade_off(result: MechanismResult, trade_off: TradeOff) -> Figure:
    """Draw the migration of designed linkages and of all devices over the error of Table 1."""
    figure, ax = plt.subplots(figsize=(7.2, 4.4), layout="constrained")
    figure.set_label(
        "Migration of the strap over the difference from Table 1: the best linkages that a search "
        "found (line), and the devices (marks)."
    )
    trade_off.plot(ax)
    for (name, device), style in zip(result.devices.items(), _STYLES, strict=False):
        row, mark = device.results(), "D" if style["ls"] == "-" else "s"
        ax.plot(row["rod_rms_mm"], row["rms_mm"], mark, color=style["color"], label=name)
    ax.set(xlim=(0.0, None), ylim=(0.0, None))
    _finish(figure, [ax])
    return figure


def _enlarge(axes: Any, middle: complex, half_mm: float) -> None:
    """Show a square of the left axes, with half the side ``half_mm``, in the right axes."""
    axes[0].set_aspect("equal")
    axes[1].set(xlabel="forwards (mm)", aspect="equal")
    axes[1].set_xlim(middle.real - half_mm, middle.real + half_mm)
    axes[1].set_ylim(middle.imag - half_mm, middle.imag + half_mm)
    axes[0].indicate_inset_zoom(axes[1], edgecolor="k")


def _finish(figure: Figure, axes: Any) -> None:
    for ax in axes:
        ax.grid(alpha=0.3)
    legend_below(figure, axes, ncols=4)
