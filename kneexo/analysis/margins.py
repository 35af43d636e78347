"""Stability margins of a sampled loop: gain, phase, delay and disk margins."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike

from kneexo.analysis.plant_linearization import Complex
from kneexo.result import Array, Result


@dataclass(frozen=True, repr=False)
class Margins(Result):
    """Stability margins of a sampled loop, broken at the motor speed command.

    Each margin is the smallest change of the loop that puts a closed-loop eigenvalue on the unit
    circle. A stable loop stays stable with any smaller change. If ``stable`` is False, the loop is
    already unstable. The numbers are then such changes too, but they are no margins.

    Gain and phase have margins in two directions. The loop can lose stability by more gain
    (``gain_margin``) or less gain (``lower_gain_margin``), and by a phase lag
    (``phase_margin_deg``) or a phase lead (``phase_lead_margin_deg``). No margin is negative.
    python-control returns only the smaller phase margin, and a lead as a negative number.

    Frequencies are in Hz. ``gain_margin`` and ``disk_gain_margin`` are factors. ``disk_margin`` is
    1/max|(S − T)/2| with S = 1/(1 + L) and T = L/(1 + L), the balanced disk margin. If no change
    of a kind destabilizes the loop, the margin is inf and its frequency is nan.
    """

    stable: bool
    gain_margin: float
    gain_margin_frequency_hz: float
    lower_gain_margin: float
    """Largest gain factor below 1 at which the loop loses stability; 0 if no factor does."""
    phase_margin_deg: float
    """Smallest phase lag, 0…360°, at which the loop loses stability."""
    phase_margin_frequency_hz: float
    phase_lead_margin_deg: float
    """Smallest phase lead, 0…360°, at which the loop loses stability."""
    phase_lead_margin_frequency_hz: float
    delay_margin_s: float
    delay_margin_frequency_hz: float
    disk_margin: float
    disk_margin_frequency_hz: float
    disk_gain_margin: float
    disk_phase_margin_deg: float


class LoopTransfer(Protocol):
    """The loop transfer L of a sampled loop with negative feedback, such as a `SampledLoop`."""

    @property
    def sample_time_s(self) -> float:
        """Sample time of the controller in s."""

    @property
    def stable(self) -> bool:
        """Whether the closed loop is stable."""

    def loop_response(self, frequencies_hz: ArrayLike) -> Complex:
        """Return L at frequencies in Hz, (n,)."""

    def loop_slope(self, frequency_hz: float) -> complex:
        """Return the derivative dL/df of L at a frequency f in Hz, in 1/Hz."""

    def loop_on_grid(self, frequencies_hz: Array) -> Complex:
        """Return L at many frequencies in Hz, (n,), with a relative error of at most 1e-9."""


def stability_margins(transfer: LoopTransfer) -> Margins:
    """Return gain, phase, delay and disk margins of a loop up to its Nyquist frequency.

    A grid of 20 000 frequencies, from 1 mHz up, brackets each crossing of L with the real axis and
    with the unit circle. Then a root search refines the crossing.
    """
    nyquist = 0.5 / transfer.sample_time_s
    grid = np.geomspace(1e-3, nyquist, 20_000)
    loop = transfer.loop_on_grid(grid)

    def loop_at(frequency: float) -> complex:
        return complex(transfer.loop_response(frequency)[0])

    def imaginary(frequency: float) -> float:
        return loop_at(frequency).imag

    def level(frequency: float) -> float:
        return abs(loop_at(frequency)) - 1.0

    on_real_axis = [*_crossings(imaginary, grid, loop.imag), nyquist]  # L(nyquist) is real
    gains = [(-1.0 / loop_at(f).real, f) for f in on_real_axis if loop_at(f).real < 0.0]
    lags = [
        (180.0 + math.degrees(cmath.phase(loop_at(f))), f)
        for f in _crossings(level, grid, np.abs(loop) - 1.0)
    ]
    none = (math.inf, math.nan)
    upper = min((c for c in gains if c[0] > 1.0), default=none)
    lower = max((c for c in gains if c[0] < 1.0), default=(0.0, math.nan))
    lag = min(lags, default=none)
    lead = min(((360.0 - p, f) for p, f in lags), default=none)
    delay = min(((p / 360.0 / f, f) for p, f in lags), default=none)
    frequency = _disk_frequency(transfer, grid, loop)
    disk = float(_disk_distance(loop_at(frequency)))
    reach = 0.5 * disk
    return Margins(
        stable=transfer.stable,
        gain_margin=upper[0],
        gain_margin_frequency_hz=upper[1],
        lower_gain_margin=lower[0],
        phase_margin_deg=lag[0],
        phase_margin_frequency_hz=lag[1],
        phase_lead_margin_deg=lead[0],
        phase_lead_margin_frequency_hz=lead[1],
        delay_margin_s=delay[0],
        delay_margin_frequency_hz=delay[1],
        disk_margin=disk,
        disk_margin_frequency_hz=frequency,
        disk_gain_margin=(1.0 + reach) / (1.0 - reach) if reach < 1.0 else math.inf,
        disk_phase_margin_deg=math.degrees(2.0 * math.atan(reach)),
    )


def _disk_frequency(transfer: LoopTransfer, grid: Array, loop: Complex) -> float:
    """Return the frequency in Hz of the smallest disk margin; ``loop`` is L on ``grid`` (Hz)."""

    def slope(frequency: float) -> float:
        at = transfer.loop_response(frequency)[0]
        return float((transfer.loop_slope(frequency) / (1.0 - at * at)).real)

    index = int(np.argmin(_disk_distance(loop)))
    low, high = grid[max(index - 1, 0)], grid[min(index + 1, grid.size - 1)]
    if slope(low) < 0.0 < slope(high):
        return float(scipy.optimize.brentq(slope, low, high, xtol=1e-14))
    return float(grid[index])


def _crossings(function: Callable[[float], float], grid: Array, values: Array) -> list[float]:
    """Return the zeros of ``function``; its ``values`` on ``grid`` change sign around each zero."""
    changes = np.flatnonzero(np.signbit(values[:-1]) != np.signbit(values[1:]))
    brackets = ((grid[i], grid[i + 1]) for i in changes)
    return [
        float(scipy.optimize.brentq(function, low, high, xtol=1e-14))
        for low, high in brackets
        if np.sign(function(low)) * np.sign(function(high)) <= 0.0  # a product could underflow
    ]


def _disk_distance(loop: Any) -> Any:
    """Return 1/|(S − T)/2| with S = 1/(1 + L) and T = L/(1 + L) at values of L."""
    return 2.0 * np.abs((1.0 + loop) / (1.0 - loop))
