"""Computes gain, phase, delay and disk margins of loops with one input and one output."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from ..errors import ParameterError
from ..run_data import Array
from .loops import LARGEST, Transfer, as_transfer
from .model import BOUNDARY_TOLERANCE, Complex, distance_inside
from .periodic import PeriodicLoop

_NO_FACTOR = 1e-6  # a smaller gain margin is the rounding error of a pole at zero frequency
_AT_MINUS_ONE = 1e-6  # |1 + L| below this at a marginal closed eigenvalue shows that L moves it
_ON_CIRCLE = 1e-12  # rounding of |L| at zero and the highest frequency
# About this number of points of the grid are examined for rounding errors. 100 is a choice: more
# points cost time, and fewer points could miss a narrow range with large rounding errors.
_EXACT_POINTS = 100
# Share of L or T that rounding may change. Of 400 random loops, the loops below this share have
# margins that are right to 0.11 %. A transfer function whose coefficients are rounding errors had
# gain margins such as 2e15.
_RUINED = 1e-3
_WHOLE_PLANE = 1.0 - 1e-12  # a disk of this size or more is a half plane


@dataclass(frozen=True)
class LoopMargins:
    """Stability margins of a loop with negative feedback.

    Each margin is the smallest change of the loop that puts a closed-loop eigenvalue on the
    boundary of stability, the imaginary axis or the unit circle. A stable loop stays stable with
    any smaller change. If ``stable`` is False, the numbers are the changes that move the first
    eigenvalue onto the boundary, not a reserve.

    ``stable`` follows the rule of `LinearModel.stable`, for all closed-loop eigenvalues. So it is
    False if a mode that the loop does not move is free, such as the angle of a motor in its speed
    loop. The numbers leave such modes out. If L = −1 at a frequency, an eigenvalue that the loop
    moves is on the boundary already, to 1e-12. Then ``stable`` is False, the factors are 1 and all
    other margins are 0.

    Gain and phase have margins in two directions. The loop can lose stability by more gain
    (``gain_margin``) or less gain (``lower_gain_margin``), and by a phase lag
    (``phase_margin_deg``) or a phase lead (``phase_lead_margin_deg``). No margin is negative.
    python-control returns only the smaller phase margin, and a lead as a negative number.

    Frequencies are in Hz. ``gain_margin`` and ``disk_gain_margin`` are factors. ``disk_margin`` is
    1/max|(S − T)/2| with S = 1/(1 + L) and T = L/(1 + L), the balanced disk margin (Seiler,
    Packard, Gahinet, *An introduction to disk margins*, IEEE Control Systems 2020).

    If no change of a kind destabilizes the loop, the margin is inf and its frequency is nan. The
    lower gain margin is then 0. The disk margin is at most 2, which means that no gain and no phase
    up to 90° destabilize the loop. A loop that is periodic in time has no delay margin (nan).
    """

    stable: bool
    gain_margin: float
    gain_margin_frequency_hz: float
    lower_gain_margin: float
    """Largest gain factor below 1 at which the loop loses stability, or 0."""
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


def margins(loop: Any) -> LoopMargins:
    """Return gain, phase, delay and disk margins of a loop with one input and one output.

    A grid of frequencies, dense around each resonance, brackets each crossing of L with the real
    axis and with the unit circle. Then a root search refines the crossing. Frequency zero and the
    Nyquist frequency, or infinity, count too.

    python-control's ``stability_margins`` expands state spaces into polynomials. Polynomials are
    exact enough for a continuous loop of a few states, but lose the margins of a sampled loop with
    many states, such as a delay of 60 samples. python-control's ``disk_margins`` returns the
    smallest value on the frequencies that it gets. python-control has no delay margin.

    Parameters
    ----------
    loop
        The loop transfer L for negative feedback, in one of the forms that `as_transfer` describes,
        or a `PeriodicLoop`. A `PeriodicLoop` has no L, so its signal is multiplied by a complex
        factor k, and the loop of the diagram has k = 1. The margins are the smallest changes of k
        that move an eigenvalue of the motion over a period across the unit circle. Both phase
        margins are the smaller of lag and lead, and the delay margin is nan. For a loop with a
        transfer function both definitions give the same gain margins and the same smaller phase
        margin.

    Raises
    ------
    ParameterError
        The argument is no such loop. Also if L = −1 at infinite frequency, or if rounding the
        numbers of the loop changes its response by more than 0.1 %.
    """
    if isinstance(loop, PeriodicLoop):
        return _periodic_margins(loop)
    return _transfer_margins(as_transfer(loop))


def _transfer_margins(system: Transfer) -> LoopMargins:
    """Return the margins of a loop transfer by a search on a grid of frequencies."""
    marginal = _marginal_frequency(system)
    if marginal is not None:
        return _no_margins(marginal)
    grid = system.frequency_grid()
    values = system.response_on_grid(grid)
    finite = np.isfinite(values)
    grid, values = grid[finite], values[finite]
    ends = [(f, _limit(system, f)) for f in (0.0, system.highest_hz)]

    def loop_at(f: float) -> complex:
        value = system.response(f)[0]
        return complex(value if np.abs(value) <= LARGEST else LARGEST)  # at a pole it is not finite

    # Pairs of a frequency f in Hz and L(f), at which L is real or has the magnitude 1.
    real_at = _crossings(lambda f: loop_at(f).imag, grid, values.imag)
    on_real_axis = [(f, loop_at(f)) for f in real_at]
    on_real_axis += [(f, complex(end.real)) for f, end in ends if cmath.isfinite(end)]
    unit_at = _crossings(lambda f: abs(loop_at(f)) - 1.0, grid, np.abs(values) - 1.0)
    on_circle = [(f, loop_at(f)) for f in unit_at]
    on_circle += [(f, end) for f, end in ends if abs(abs(end) - 1.0) <= _ON_CIRCLE]
    # Pairs of a change that moves L to −1, and the frequency.
    factors = [(-1.0 / v.real, f) for f, v in on_real_axis if -1.0 / _NO_FACTOR < v.real < 0.0]
    lags_deg = [(180.0 + math.degrees(cmath.phase(value)), f) for f, value in on_circle]
    none = (math.inf, math.nan)
    upper = min(((factor, f) for factor, f in factors if factor >= 1.0), default=none)
    lower = max(((factor, f) for factor, f in factors if factor <= 1.0), default=(0.0, math.nan))
    lag = min(lags_deg, default=none)
    lead = min(((360.0 - lag_deg, f) for lag_deg, f in lags_deg), default=none)
    delay = min(((lag_deg / 360.0 / f, f) for lag_deg, f in lags_deg if f > 0.0), default=none)
    if system.period_s is None and abs(system.d) >= 1.0:
        delay = (0.0, math.inf)  # the delayed loop has crossings at all high frequencies
    disk, frequency = _disk(system, grid, values, ends)
    _require_exact(system, grid, [f for _, f in (upper, lower) if 0.0 < f < math.inf])
    stable = system.closed_is_stable()
    return _loop_margins(stable, upper, lower[0], lag, lead, delay, (0.5 * disk, frequency))


def _loop_margins(
    stable: bool,
    upper: tuple[float, float],
    lower: float,
    lag_deg: tuple[float, float],
    lead_deg: tuple[float, float],
    delay_s: tuple[float, float],
    disk: tuple[float, float],
) -> LoopMargins:
    """Return the margins from pairs of a change and its frequency in Hz.

    The change of ``disk`` is half the disk margin.
    """
    reach, frequency = disk
    whole = reach >= _WHOLE_PLANE
    factor = math.inf if whole else (1.0 + reach) / (1.0 - reach)
    phase_deg = math.degrees(2.0 * math.atan(reach))
    # In the order of the fields.
    changes = (*upper, lower, *lag_deg, *lead_deg, *delay_s, 2.0 * reach, frequency)
    return LoopMargins(stable, *changes, factor, phase_deg)


def _require_exact(system: Transfer, grid: Array, gain_frequencies: list[float]) -> None:
    """Raise `ParameterError` if rounding errors of a loop L make its margins meaningless.

    At the frequencies ``grid`` the relative change of T = L/(1 + L) must be small. Where L is
    large, as near an integrator, a change of L hardly changes T. At ``gain_frequencies`` the
    relative change of L itself must be small.
    """
    every_few = grid[:: max(grid.size // _EXACT_POINTS, 1)]
    from_minus_1 = np.abs(1.0 + system.response(every_few))
    with np.errstate(over="ignore", invalid="ignore"):
        change_of_t = system.rounding_change(every_few) / from_minus_1
        change_of_t /= np.maximum(from_minus_1, 1.0)
    change_of_l = system.rounding_change(gain_frequencies)
    change_of_l = change_of_l / np.abs(system.response(gain_frequencies))
    changes = np.concatenate([change_of_t, change_of_l])
    changes[~np.isfinite(changes)] = 0.0  # at a pole
    worst = int(np.argmax(changes))
    if changes[worst] > _RUINED:
        at_hz = [*every_few, *gain_frequencies][worst]
        raise ParameterError(
            f"loop: rounding its numbers changes L at {at_hz:.3g} Hz by up to "
            f"{100.0 * min(changes[worst], 1.0):.3g} %, so it has no margins; a transfer function "
            f"with poles close to each other loses its digits: if the loop was one, make it from "
            f"state spaces, such as control.c2d(control.ss(A, B, C, D), T)"
        )


def _marginal_frequency(system: Transfer) -> float | None:
    """Return a frequency in Hz at which L = −1, a closed eigenvalue on the boundary, or None."""
    values = system.closed_eigenvalues()
    marginal = values[np.abs(distance_inside(values, system.period_s)) <= BOUNDARY_TOLERANCE]
    if system.period_s is None:
        rates_rad_s = np.abs(marginal.imag)
    else:
        rates_rad_s = np.abs(np.angle(marginal) / system.period_s)
    for frequency in map(float, rates_rad_s / (2.0 * math.pi)):
        if abs(1.0 + system.response(frequency)[0]) <= _AT_MINUS_ONE:
            return frequency
    return None


def _no_margins(frequency: float) -> LoopMargins:
    """Return the margins of a loop with L = −1 at a frequency in Hz."""
    none, unchanged = (0.0, frequency), (1.0, frequency)
    return _loop_margins(False, unchanged, 1.0, none, none, none, none)


def _periodic_margins(loop: PeriodicLoop) -> LoopMargins:
    """Return the margins of a loop without transfer function, by factors on its signal."""
    more, less, turn = loop.gain_change(1.0), loop.gain_change(-1.0), loop.turn_change()
    turn_deg = math.degrees(turn[0]), turn[1]
    none = (math.nan, math.nan)
    return _loop_margins(loop.stable(), more, less[0], turn_deg, turn_deg, none, loop.disk_change())


def _limit(system: Transfer, frequency: float) -> complex:
    """Return L at zero frequency, the Nyquist frequency or infinity, or inf at a pole.

    L is real there. At a pole that rounding has moved, L is finite and its real part has no
    meaning: 7e12 + 3e12j with one BLAS, −0.6 − 3e13j with another.
    """
    if math.isinf(frequency):
        return complex(system.d)
    value = complex(system.response(frequency)[0])
    largest = max(abs(value.real), abs(value.imag))
    return value if largest < 1.0 / _NO_FACTOR else complex(math.inf)


def _disk(
    system: Transfer, grid: Array, values: Complex, ends: list[tuple[float, complex]]
) -> tuple[float, float]:
    """Return the smallest disk margin and its frequency in Hz from ``values``, L on ``grid``."""

    def slope(frequency: float) -> float:
        """Return a number with the sign of the slope of the disk margin over frequency."""
        value = system.response(frequency)[0]
        if value * value == 1.0:
            return 0.0
        return float((system.slope(frequency) / (1.0 - value * value)).real)

    index = int(np.argmin(_disk_distance(values)))
    frequency = float(grid[index])
    low, high = grid[max(index - 1, 0)], grid[min(index + 1, grid.size - 1)]
    if slope(low) < 0.0 < slope(high):
        frequency = float(scipy.optimize.brentq(slope, low, high, xtol=1e-14))
    distances = [(float(_disk_distance(end)), f) for f, end in ends if cmath.isfinite(end)]
    distances.append((float(_disk_distance(system.response(frequency)[0])), frequency))
    return min(distances)


def _crossings(function: Callable[[float], float], grid: Array, values: Array) -> list[float]:
    """Return the zeros of ``function``, around which its ``values`` on ``grid`` change sign."""
    changes = np.flatnonzero(np.signbit(values[:-1]) != np.signbit(values[1:]))
    brackets = ((grid[i], grid[i + 1]) for i in changes)
    return [
        float(scipy.optimize.brentq(function, low, high, xtol=1e-14 * low))
        for low, high in brackets
        if np.sign(function(low)) * np.sign(function(high)) <= 0.0  # a product could underflow
    ]


def _disk_distance(loop: Any) -> Any:
    """Return 1/|(S − T)/2| with S = 1/(1 + L) and T = L/(1 + L) at values of L."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return 2.0 * np.abs(np.divide(1.0 + loop, 1.0 - loop))
