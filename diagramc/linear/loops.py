"""Transfer functions of loops with one input and one output, and their sensitivities."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..errors import ParameterError
from ..run_data import Array
from .model import BOUNDARY_TOLERANCE, Complex, distance_inside
from .periodic import PeriodicLoop
from .zeros import invariant_zeros

# More than usual loops need, because the points around resonances are dense: 20 random loops had
# the same margins with 60 points, in about the same time.
_POINTS = 4_000  # of a grid of frequencies, without the points around resonances
_SLOWEST = 1e-12  # a frequency below this share of the fastest one is a rounding error
_ROUNDING = 1e-12  # points closer than this share of their frequency are one point
_UNDAMPED = 1e-6  # half width, relative to its frequency, of a resonance without damping
_REACH = 100.0  # factor by which a grid exceeds the slowest and the fastest frequency
LARGEST = 1e100
"""Largest magnitude of an element. Products of three must not overflow."""
_WIDTHS = np.geomspace(1e-2, 1e3, 41)  # distances from a resonance, in units of its half width
_NO_NUMBERS = (
    "loop: has elements that are no real numbers; must be arrays of real numbers, and a period in "
    "s or None"
)


@dataclass(frozen=True)
class Transfer:
    """Transfer function L(z) = c (zI − A)⁻¹ b + d from one input to one output.

    A has the shape (n, n), b (n, 1) and c (1, n). ``period_s`` is the sample time T in s, and
    z = e^{j2πfT} at a frequency f in Hz. A continuous transfer function has no period, and its z
    is j2πf. The methods that begin with ``closed`` belong to the loop that negative feedback
    around L closes.

    Raises `ParameterError` for arrays of other shapes, for an element that is no real number or
    exceeds 1e100, and for a period that is not positive.
    """

    a: Array
    b: Array
    c: Array
    d: float
    period_s: float | None

    def __post_init__(self) -> None:
        """Check the arrays, and convert sequences to arrays."""
        try:
            if any(np.iscomplexobj(matrix) for matrix in (self.a, self.b, self.c, self.d)):
                raise TypeError("complex")
            a, b, c = (np.asarray(matrix, dtype=float) for matrix in (self.a, self.b, self.c))
            d = float(self.d)
            period_s = None if self.period_s is None else float(self.period_s)
        except (TypeError, ValueError):
            raise ParameterError(_NO_NUMBERS) from None
        n = len(a) if a.ndim else 0
        if (a.shape, b.shape, c.shape) != ((n, n), (n, 1), (1, n)):
            raise ParameterError(
                f"loop: A {a.shape}, B {b.shape} and C {c.shape} do not fit; must be (n, n), "
                f"(n, 1) and (1, n)"
            )
        if not all((np.abs(matrix) <= LARGEST).all() for matrix in (a, b, c, d)):
            raise ParameterError(
                f"loop: a matrix has an element that is not finite or exceeds {LARGEST:g} in "
                f"magnitude; choose other units"
            )
        if period_s is not None and not 0.0 < period_s < math.inf:
            raise ParameterError(
                f"loop: period_s = {period_s:g} s: must be > 0 and finite, or None"
            )
        for name, value in zip("abcd", (a, b, c, d), strict=True):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "period_s", period_s)

    @cached_property
    def _triangular(self) -> tuple[Complex, Complex, Complex]:
        """A, b and c with other states, in which A is upper triangular.

        The states are scaled and then rotated. Both steps are stable in floating point. Multiple
        eigenvalues, such as the eigenvalues of a delay, therefore cost no digits.
        """
        if not self.a.size:
            return (np.zeros((0, 0), complex), np.zeros((0, 1), complex), np.zeros((1, 0), complex))
        balanced, (scale, _) = scipy.linalg.matrix_balance(self.a, permute=False, separate=True)
        upper, basis = scipy.linalg.schur(balanced, output="complex")
        return upper, basis.conj().T @ (self.b / scale[:, None]), (self.c * scale) @ basis

    def point(self, frequencies_hz: ArrayLike) -> Complex:
        """Return z at frequencies f in Hz: e^{j2πfT}, or j2πf for a continuous loop."""
        frequencies = np.asarray(frequencies_hz, dtype=float)
        s = 2j * np.pi * frequencies
        if self.period_s is None:
            return s
        # Exactly −1 at the Nyquist frequency: L is real there, or has a pole and is not finite. A
        # rounded z made L = 1e12 j at a pole, and rounding then seemed to ruin the loop.
        return np.where(frequencies == self.highest_hz, -1.0, np.exp(s * self.period_s))

    @np.errstate(divide="ignore", invalid="ignore", over="ignore")
    def response_on_grid(self, frequencies_hz: ArrayLike) -> Complex:
        """Return L at many frequencies in Hz, (n,), by a Schur form. A pole gives no finite value.

        Near frequency zero, the pole of an integrator, `response` has a smaller error, because the
        Schur form moves the poles by rounding errors.
        """
        _, b, c = self._triangular
        z = self.point(np.atleast_1d(frequencies_hz))
        states = self._solved(z, np.repeat(b, z.size, axis=1))
        return np.asarray(np.einsum("i,ij->j", c[0], states) + self.d, dtype=complex)

    def response(self, frequencies_hz: ArrayLike) -> Complex:
        """Return L at frequencies in Hz, (n,). At a pole on the imaginary axis L is not finite."""
        # A Schur form has errors of 1e-10 near the poles at zero frequency of the knee's loop.
        z = self.point(np.atleast_1d(frequencies_hz))
        shifted = z[:, None, None] * np.eye(len(self.a)) - self.a
        try:
            states = np.linalg.solve(shifted, self.b[None])
        except np.linalg.LinAlgError:
            return self.response_on_grid(frequencies_hz)
        return np.asarray((self.c @ states)[:, 0, 0] + self.d, dtype=complex)

    def rounding_change(self, frequencies_hz: ArrayLike) -> Array:
        """Return the largest change of |L| by rounding A, b and c, (n,), at frequencies in Hz.

        Rounding changes an element by at most 2⁻⁵³ of the element. The change at a pole is inf.
        """
        z = self.point(np.atleast_1d(frequencies_hz))
        shifted = z[:, None, None] * np.eye(len(self.a)) - self.a
        try:
            states = np.abs(np.linalg.solve(shifted, self.b[None]))
            row = np.abs(np.linalg.solve(shifted.swapaxes(1, 2), self.c.T[None])).swapaxes(1, 2)
        except np.linalg.LinAlgError:
            return np.full(z.shape, np.inf)
        change = row @ (np.abs(self.a) @ states + np.abs(self.b)) + np.abs(self.c) @ states
        return np.asarray(2.0**-53 * change[:, 0, 0])

    def slope(self, frequency_hz: float) -> complex:
        """Return the derivative dL/df of L at a frequency f in Hz, in 1/Hz."""
        _, b, c = self._triangular
        z = self.point([frequency_hz])
        rate = 2j * np.pi if self.period_s is None else 2j * np.pi * self.period_s * z[0]
        return complex((-rate * c @ self._solved(z, self._solved(z, b)))[0, 0])

    def _solved(self, z: Complex, right: Complex) -> Complex:
        """Return (zI − A)⁻¹ r for each z (m,) and column r of ``right`` (n, m), by substitution."""
        upper = self._triangular[0]
        states = np.zeros_like(right)
        for row in reversed(range(len(upper))):
            # einsum runs in this thread. Threads of BLAS cost ten times their use here.
            known = np.einsum("i,ij->j", upper[row, row + 1 :], states[row + 1 :])
            states[row] = (right[row] + known) / (z - upper[row, row])
        return states

    def closed_matrix(self) -> Array:
        """Return A − b c/(1 + d), the matrix of the closed loop with negative feedback."""
        return np.asarray(self.a - self.b @ self.c / _return_difference(self))

    def closed_eigenvalues(self) -> Complex:
        """Return the eigenvalues of the closed loop, (n,)."""
        return np.linalg.eigvals(self.closed_matrix()).astype(complex)

    def closed_is_stable(self) -> bool:
        """Return whether the closed loop is asymptotically stable, hidden states included.

        `LinearModel.stable` describes the rule.
        """
        distances = distance_inside(self.closed_eigenvalues(), self.period_s)
        return bool(np.all(distances > BOUNDARY_TOLERANCE))

    @property
    def highest_hz(self) -> float:
        """The Nyquist frequency in Hz, or inf for a continuous loop."""
        return math.inf if self.period_s is None else 0.5 / self.period_s

    def frequency_grid(self) -> Array:
        """Return frequencies in Hz that resolve all poles and zeros of L, S and T, (n,), ascending.

        The grid is logarithmic, and dense around each lightly damped pole or zero. At the first
        frequency L has its limit for low frequencies. At the last frequency L has its limit for
        high frequencies, or the last frequency is the Nyquist frequency.
        """
        s = self._singularities()
        magnitudes_hz = np.abs(s) / (2.0 * math.pi)
        # A pole at zero, such as an integrator's, has no frequency of its own.
        nonzero_hz = magnitudes_hz[magnitudes_hz > _SLOWEST * np.max(magnitudes_hz, initial=0.0)]
        without_any_hz = 1.0 if self.period_s is None else self.highest_hz
        high_hz = min(_REACH * np.max(nonzero_hz, initial=without_any_hz), self.highest_hz)
        low_hz = min(np.min(nonzero_hz, initial=without_any_hz), high_hz) / _REACH
        centres, widths = np.abs(s.imag) / (2.0 * math.pi), np.abs(s.real) / (2.0 * math.pi)
        widths = np.where(widths > _SLOWEST * centres, widths, _UNDAMPED * centres)
        offsets = np.outer(widths, np.concatenate([-_WIDTHS, _WIDTHS]))
        around = (centres[:, None] + offsets).ravel()
        around = around[(around > low_hz) & (around < high_hz)]
        grid = np.unique(np.concatenate([np.geomspace(low_hz, high_hz, _POINTS), around]))
        # Equal but for rounding, as around two equal poles, two points would bracket no minimum.
        return grid[np.append(True, np.diff(grid) > _ROUNDING * grid[1:])]

    def to_control(self) -> Any:
        """Return the transfer function as a `control.StateSpace`."""
        import control

        return control.ss(self.a, self.b, self.c, self.d, self.period_s or 0)

    def _singularities(self) -> Complex:
        """Return poles of the open and closed loop and zeros of L, in one array, in 1/s.

        A frequency grid is dense around them. Left out are zeros 1e6 times faster than every pole,
        and sampled modes at z ≈ 0, whose log z is infinite.
        """
        if not self.a.size:
            return np.empty(0, dtype=complex)
        zeros = invariant_zeros(self.a, self.b, self.c, np.array([[self.d]]))
        poles = np.concatenate([np.linalg.eigvals(self.a), self.closed_eigenvalues()])
        fastest = np.max(np.abs(poles))
        values = np.concatenate([poles, zeros[np.abs(zeros) <= 1e6 * fastest]])
        if self.period_s is not None:
            values = np.log(values[np.abs(values) > _SLOWEST]) / self.period_s
        return np.asarray(values, dtype=complex)


def as_transfer(loop: Any) -> Transfer:
    """Return a loop transfer L with one input and one output as a `Transfer`.

    Parameters
    ----------
    loop
        One of

        - a linear model with the attributes a, b, c, d and period_s;
        - a `control.StateSpace` or ``control.TransferFunction``;
        - a tuple (A, B, C, D) of arrays, or (A, B, C, D, period_s). The period is None for a
          continuous loop.

    Raises
    ------
    ParameterError
        The argument has none of these forms, or more than one input or output. Also if a number is
        not finite or exceeds 1e100, the period is not positive, or a ``control.TransferFunction``
        has a numerator of higher degree than the denominator.
    """
    if isinstance(loop, Transfer):
        return loop
    if isinstance(loop, PeriodicLoop):
        raise ParameterError(
            f"loop: its signal changes several times within the period of {loop.period_s:g} s: it "
            f"has no transfer function; use margins(loop), or break the loop at another port"
        )
    if isinstance(loop, tuple) and len(loop) in (4, 5):
        *matrices, period_s = loop if len(loop) == 5 else (*loop, None)
    elif hasattr(loop, "period_s"):
        matrices, period_s = [loop.a, loop.b, loop.c, loop.d], loop.period_s
    else:
        matrices, period_s = _control_matrices(loop)
    try:
        a, b, c, d = (np.atleast_2d(np.asarray(matrix)) for matrix in matrices)
    except ValueError:  # rows of unequal length
        raise ParameterError(_NO_NUMBERS) from None
    n = a.shape[0] if a.size else 0
    if d.shape != (1, 1):
        raise ParameterError(
            f"loop: has {d.shape[1]} inputs and {d.shape[0]} outputs; must have one of each; "
            f"select them, for example by inputs=[…] and outputs=[…] of linearize"
        )
    if (a.size, b.size, c.size) == (n * n, n, n):
        a, b, c = a.reshape(n, n), b.reshape(n, 1), c.reshape(1, n)
    return Transfer(a, b, c, d[0, 0], period_s)


def _control_matrices(system: Any) -> tuple[list[Any], float | None]:
    """Return A, B, C, D and the period in s of a system of python-control."""
    import control

    if isinstance(system, control.TransferFunction) and (system.ninputs, system.noutputs) == (1, 1):
        try:
            system = control.tf2ss(system)
        except ValueError:
            raise ParameterError(
                "loop: the transfer function has no state space; the degree of its numerator must "
                "not exceed that of its denominator"
            ) from None
    if not isinstance(system, control.StateSpace):
        raise ParameterError(
            f"loop = {type(system).__name__}: must be a linear model, a control.StateSpace or "
            f"TransferFunction, or a tuple (A, B, C, D, period_s)"
        )
    if system.dt is True:
        raise ParameterError("loop: dt = True: the margins need the sample time in s")
    return [system.A, system.B, system.C, system.D], system.dt or None


def sensitivity(loop: Any) -> Transfer:
    """Return the sensitivity S = 1/(1 + L) of a loop transfer L for negative feedback.

    A disturbance that is added where the loop is broken appears in the sum multiplied by S.
    `as_transfer` describes the forms of ``loop`` and the errors. Also raises `ParameterError` if L
    = −1 at infinite frequency.
    """
    transfer = as_transfer(loop)
    through = 1.0 / _return_difference(transfer)
    return replace(
        transfer,
        a=transfer.closed_matrix(),
        b=through * transfer.b,
        c=-through * transfer.c,
        d=through,
    )


def complementary_sensitivity(loop: Any) -> Transfer:
    """Return the complementary sensitivity T = L/(1 + L) = 1 − S of a loop transfer L.

    `sensitivity` describes the argument and the errors.
    """
    s = sensitivity(loop)
    return replace(s, c=-s.c, d=1.0 - s.d)


def _return_difference(transfer: Transfer) -> float:
    """Return 1 + L at infinite frequency. Raise `ParameterError` if 1 + L is zero there."""
    if transfer.d == -1.0:
        raise ParameterError(
            "loop: L = -1 at infinite frequency: the closed loop has no solution; check the sign "
            "of L, or break the loop at another port"
        )
    return 1.0 + transfer.d
