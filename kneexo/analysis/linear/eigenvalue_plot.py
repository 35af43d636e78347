"""Draws eigenvalues of a sampled system in the z-plane."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from kneexo.common.plotting import BLUE, RED
from kneexo.common.result import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LABELS_OF_DAMPING = {0.1: 0.58, 0.3: 0.54, 0.5: 0.5, 0.7: 0.42, 0.9: 0.3}
"""Damping ratio of each line in the z-plane, and damped frequency (in π/T) at its label."""
_INSET = (-0.82, -0.36, 0.72, 0.72)
"""Left, bottom, width and height of the inset in the z-plane."""
_NEAR_ONE = 0.25
"""Largest distance to z = 1 of an eigenvalue that the inset shows."""


def plot_eigenvalues(ax: Axes, values: Any) -> None:
    """Draw complex ``values`` (n,), the unit circle and labelled lines of constant damping.

    An inset enlarges the neighbourhood of z = 1 if several eigenvalues lie there, and if the
    inset hides no other eigenvalue.
    """
    _draw(ax, values)
    for damping, share in _LABELS_OF_DAMPING.items():
        at = _damping_line(damping, np.array([share * np.pi]))[0]
        text = ax.text(at.real, at.imag, f"ζ = {damping:g}", color="0.35", fontsize=7)
        text.set(ha="center", va="center", bbox={"fc": "w", "lw": 0.0, "pad": 0.6})
    ax.set(xlabel="real part of z", ylabel="imaginary part of z")
    ax.set_aspect("equal")
    ax.legend(loc="upper left")
    _enlarge_slow(ax, values)


def _damping_line(damping: float, angle: Array) -> Any:
    """Return z on the line of constant ``damping``, at damped frequencies times T in rad."""
    return np.exp((1j - damping / math.sqrt(1.0 - damping**2)) * angle)


def _draw(ax: Axes, values: Any) -> None:
    """Draw eigenvalues, the unit circle and the lines of constant damping."""
    angle = np.linspace(0.0, np.pi, 200)  # up to the Nyquist frequency
    for damping in (0.0, *_LABELS_OF_DAMPING):
        line = _damping_line(damping, angle)
        for half in (line, line.conj()):
            grey = "0.4" if damping == 0.0 else "0.75"
            ax.plot(half.real, half.imag, color=grey, lw=0.8, zorder=0)
    inside = np.abs(values) < 1.0
    for chosen, colour, label in ((inside, BLUE, "stable"), (~inside, RED, "unstable")):
        if chosen.any():
            part = values[chosen]
            ax.plot(part.real, part.imag, "x", color=colour, ms=7, mew=1.5, label=label)


def _enlarge_slow(ax: Axes, values: Any) -> None:
    """Add an inset of the eigenvalues near z = 1, unless the inset hides an eigenvalue."""
    slow = values[np.abs(values - 1.0) < _NEAR_ONE]
    left, bottom, width, height = _INSET
    hidden = (np.abs(values.real - left - 0.5 * width) < 0.5 * width + 0.05) & (
        np.abs(values.imag - bottom - 0.5 * height) < 0.5 * height + 0.05
    )
    if slow.size < 2 or hidden.any():
        return
    reach = 1.15 * float(np.max(np.abs(slow - 1.0)))
    inset = ax.inset_axes(_INSET, transform=ax.transData)
    _draw(inset, values)
    inset.set(xlim=(1.0 - reach, 1.0 + 0.2 * reach), ylim=(-0.6 * reach, 0.6 * reach))
    inset.set_title("near z = 1", fontsize=7, pad=2)
    inset.tick_params(labelsize=6)
    ax.indicate_inset_zoom(inset)
