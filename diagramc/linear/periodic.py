"""Finds factors that destabilize a loop whose signal changes several times within a period."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..run_data import Array
from .model import BOUNDARY_TOLERANCE, Complex, TickModel, distance_inside

_GAINS = np.linspace(0.0, math.log(1e6), 601)  # logarithms of factors, 100 a decade
_TURNS = np.linspace(0.0, math.pi, 361)  # angles in rad, each half degree
_DIRECTIONS = np.linspace(0.0, math.pi, 37)  # angles in rad, each 5°; the best one is refined
_OVERFLOW = 1e6
_PROBES = (0.0, 2.0, 1.0 + 1.0j)  # factors that show which modes move
_NO_MOVE = 1e-9  # a smaller share of the change of the matrix is a rounding error
_NEARLY_OUTSIDE = 1e-6  # rounding moves a multiple eigenvalue by more than a simple one
_PARALLEL = 1e-4  # eigenvectors of a multiple eigenvalue, closer than this, count once
_REACHES = np.linspace(0.0, 0.999, 81)  # at 1 the factor of the disk is infinite


@dataclass(frozen=True, repr=False)
class PeriodicLoop:
    """A loop that is broken at a signal y, which changes several times within the period P.

    All systems that read y get another signal v. ``ticks`` are the linear models between and at the
    updates, with v as their only input. ``row`` (1, n) is c in y = c z, with the state z. In the
    closed loop v = y. The loop has no transfer function with one input and one output, because a
    sine in v gives y components at several frequencies.
    """

    ticks: tuple[TickModel, ...]
    row: Array
    period_s: float

    def __repr__(self) -> str:
        """Return a text with the period and the numbers of states and updates."""
        return (
            f"PeriodicLoop(period_s={self.period_s:g}, {self.row.size} states, "
            f"{len(self.ticks)} times of updates)"
        )

    def closed_matrices(self, factors: ArrayLike = 1.0) -> Complex:
        """Return the matrices of the motion over a period with v = k y, for factors k (f,).

        The result has the shape (f, n, n). The factor 1 gives the loop of the diagram.
        """
        k = np.atleast_1d(np.asarray(factors, dtype=complex))[:, None, None]
        moved: Any = np.eye(self.row.size)
        flows: dict[tuple[float, int], Complex] = {}
        for tick in self.ticks:
            moved = (tick.jump_state + k * (tick.jump_input @ self.row)) @ moved
            # Ticks share the arrays of equal dynamics, so the same array means the same dynamics.
            key = (tick.duration_s, id(tick.rate_state))
            if key not in flows:
                gain = k if tick.rate_input.any() else k[:1]  # else the same for all factors
                rate = tick.rate_state + gain * (tick.rate_input @ self.row)
                flows[key] = scipy.linalg.expm(rate * tick.duration_s)
            moved = flows[key] @ moved
        return np.asarray(moved, dtype=complex)

    def closed_eigenvalues(self, factors: ArrayLike = 1.0) -> Complex:
        """Return the eigenvalues (f, n) of `closed_matrices`."""
        return np.asarray(np.linalg.eigvals(self.closed_matrices(factors)), dtype=complex)

    def stable(self) -> bool:
        """Return whether the loop of the diagram is asymptotically stable."""
        values = self.closed_eigenvalues()
        return bool((distance_inside(values, self.period_s) > BOUNDARY_TOLERANCE).all())

    def gain_change(self, sign: float) -> tuple[float, float]:
        """Return the first factor above 1 (sign 1) or below 1 (−1) that is critical.

        A factor is critical if it makes a stable loop unstable or an unstable loop stable. The
        second value is the frequency of the critical eigenvalue in Hz, at most 1/(2P). If no factor
        from 1e-6 to 1e6 is critical, the result is (inf or 0, nan).
        """
        logarithm, frequency = self._first_critical(lambda t: np.exp(sign * t), _GAINS)
        return math.exp(sign * logarithm), frequency

    def turn_change(self) -> tuple[float, float]:
        """Return the smallest angle φ in rad, up to π, at which a factor e^{±jφ} is critical.

        A factor is critical if it makes a stable loop unstable or an unstable loop stable. The
        second value is the frequency of the critical eigenvalue in Hz. Without such an angle the
        result is (inf, nan). A factor e^{−jφ} is a lag at positive frequencies and a lead at
        negative frequencies. The eigenvalues of a period do not tell lag from lead, so the result
        is the smaller of both.
        """
        return self._first_critical(lambda t: np.exp(-1j * t), _TURNS)

    def disk_change(self) -> tuple[float, float]:
        """Return the smallest ε at which a factor (1 + εe^{jθ})/(1 − εe^{jθ}) is critical.

        A factor is critical if it makes a stable loop unstable or an unstable loop stable. A single
        angle θ is enough. The second value is the frequency of the critical eigenvalue in Hz.
        Without such an ε below 0.999 the result is (1, nan).
        """

        def along(angle: float) -> tuple[float, float]:
            turn = np.exp(1j * angle)
            return self._first_critical(lambda t: (1.0 + t * turn) / (1.0 - t * turn), _REACHES)

        reaches = [along(angle)[0] for angle in _DIRECTIONS]
        best = int(np.argmin(reaches))
        if math.isinf(reaches[best]):
            return 1.0, math.nan
        bounds = (_DIRECTIONS[max(best - 1, 0)], _DIRECTIONS[min(best + 1, len(reaches) - 1)])
        search = scipy.optimize.minimize_scalar(
            lambda angle: along(angle)[0], bounds=bounds, options={"xatol": 1e-9}
        )
        return min(along(float(search.x)), along(float(_DIRECTIONS[best])))

    def _excess(self, factors: ArrayLike) -> Array:
        """Return the largest magnitude of an eigenvalue minus 1, at most 1e6, for factors (f,).

        Eigenvalues that no factor moves do not count.
        """
        with np.errstate(all="ignore"):
            matrices = self._moving(factors)
        finite = np.isfinite(matrices).all(axis=(1, 2))
        excess = np.full(finite.size, _OVERFLOW)
        values = np.linalg.eigvals(matrices[finite])
        excess[finite] = np.minimum(np.abs(values).max(axis=1, initial=0.0) - 1.0, _OVERFLOW)
        return excess

    def _moving(self, factors: ArrayLike) -> Complex:
        """Return `closed_matrices` without modes that no factor moves, such as a free angle."""
        left, right = self._projections
        return np.asarray(left @ self.closed_matrices(factors) @ right, dtype=complex)

    @cached_property
    def _projections(self) -> tuple[Complex, Complex]:
        """Matrices X (r, n) and Y (n, r) that remove free modes: X M Y has those that factors move.

        No factor moves a mode that the signal does not show. Such a mode has an eigenvector v with
        M(k) v = λ v for all factors k. No factor moves a mode that the signal does not excite. Such
        a mode has an eigenvector of this kind for the transpose of M. X and Y remove modes of both
        kinds on or outside the unit circle. Modes inside the unit circle can stay.
        """
        at_one, *others = self.closed_matrices((1.0, *_PROBES))
        _, (scale, _) = scipy.linalg.matrix_balance(at_one, permute=False, separate=True)
        first = at_one * scale / scale[:, None]
        differences = [other - at_one for other in others if np.isfinite(other).all()]
        changes = [change * scale / scale[:, None] for change in differences]
        basis = np.eye(len(first), dtype=complex)
        for transposed in (False, True):
            while changes:
                within = _moved_within(basis, first, changes, transposed)
                if within is None:
                    break
                basis = basis @ within
        return basis.conj().T / scale, scale[:, None] * basis

    def _first_critical(self, path: Callable[[Any], Any], grid: Array) -> tuple[float, float]:
        """Return the first t > 0 at which the factor path(t) is critical, and the frequency in Hz.

        ``grid`` are values of t from 0. Without such a t the result is (inf, nan). If an eigenvalue
        is on the unit circle at t = 0, the first number is 0.
        """
        excess = self._excess(path(grid))
        if abs(excess[0]) <= BOUNDARY_TOLERANCE:
            return 0.0, self._frequency(path(0.0))
        changes = np.flatnonzero(np.sign(excess[1:]) != np.sign(excess[0]))
        if not changes.size:
            return math.inf, math.nan
        low, high = grid[changes[0]], grid[changes[0] + 1]
        t = float(scipy.optimize.brentq(lambda t: self._excess(path(t))[0], low, high, xtol=1e-14))
        return t, self._frequency(path(t))

    def _frequency(self, factor: complex) -> float:
        """Return the frequency in Hz of the largest eigenvalue that the factor moves."""
        values = np.linalg.eigvals(self._moving(factor)[0])
        critical = values[np.argmax(np.abs(values))]
        return abs(float(np.angle(critical))) / (2.0 * math.pi * self.period_s)


def _moved_within(
    basis: Complex, first: Complex, changes: Sequence[Complex], transposed: bool
) -> Complex | None:
    """Remove from ``basis`` unstable and marginal modes that no change of the loop influences.

    They are the modes that the signal of the loop does not show (unobservable) or, if
    ``transposed``, does not excite (uncontrollable). Returns a smaller basis in coordinates of
    ``basis``, or None if there is no such mode.

    The vectors of the smaller basis are normal to the eigenvectors of these modes. The eigenvectors
    are those of ``first``, the matrix of the unchanged loop or, if ``transposed``, of its conjugate
    transpose. ``changes`` are differences from ``first``. A chain of integrators has several modes
    but a single eigenvector, so the caller repeats the call with the smaller basis until the result
    is None.
    """
    inner = [basis.conj().T @ matrix @ basis for matrix in (first, *changes)]
    if transposed:
        inner = [matrix.conj().T for matrix in inner]
    values, vectors = np.linalg.eig(inner[0])
    change = np.vstack(inner[1:])
    still = np.linalg.norm(change @ vectors, axis=0) <= _NO_MOVE * np.linalg.norm(change)
    fixed = vectors[:, still & (np.abs(values) > 1.0 - _NEARLY_OUTSIDE)]
    if not fixed.size:
        return None
    unitary, singular, _ = np.linalg.svd(fixed)
    return np.asarray(unitary[:, int((singular > _PARALLEL).sum()) :], dtype=complex)


def opened(ticks: Sequence[TickModel], column: int, row: Array) -> tuple[TickModel, ...]:
    """Open a loop at a signal: return its ticks with this signal as their only input.

    In ``ticks`` the signal is v = u + c z, with the state z and the input u, which has the index
    ``column``. ``row`` is c. The substitution u = v − c z makes v the input, and so opens the loop.
    """
    rates: dict[int, tuple[Array, Array]] = {}
    for tick in ticks:
        rate = tick.rate_input[:, column : column + 1]
        rates.setdefault(id(tick.rate_state), (tick.rate_state - rate @ row, rate))
    result = []
    for tick in ticks:
        jump, (state, rate) = tick.jump_input[:, column : column + 1], rates[id(tick.rate_state)]
        result.append(
            replace(
                tick,
                jump_state=tick.jump_state - jump @ row,
                jump_input=jump,
                rate_state=state,
                rate_input=rate,
            )
        )
    return tuple(result)


def updates_last(ticks: Sequence[TickModel]) -> tuple[TickModel, ...]:
    """Return the ticks of a period that begins after the first updates and ends with them."""
    first, *others = ticks
    n, m = first.jump_input.shape
    flow = replace(first, jump_state=np.eye(n), jump_input=np.zeros((n, m)))
    return flow, *others, replace(first, duration_s=0.0)
