"""Invariant zeros of a linear system, by reduction to a system with invertible feedthrough."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from ..run_data import Array

_RANK_TOLERANCE = 1e-12
"""Singular values below count as zero, after the system is scaled to magnitudes of order one."""


def invariant_zeros(a: Array, b: Array, c: Array, d: Array) -> NDArray[np.complex128]:
    """Return the finite numbers λ for which [[A − λI, B], [C, D]] has less than its usual rank.

    The algorithm removes the states that the outputs and then the inputs force to zero, until the
    feedthrough is invertible (Emami-Naeini and Van Dooren, Automatica 18, 1982). The infinite zeros
    disappear in exact steps. The generalized eigenvalues of the pencil, which python-control
    computes without slycot, turn infinite zeros into large finite ones, and need a square system.
    """
    if not len(a):  # SciPy 1.13 refuses an empty matrix
        return np.empty(0, dtype=complex)
    balanced, (scale, _) = scipy.linalg.matrix_balance(a, permute=False, separate=True)
    rate = float(np.linalg.norm(balanced)) or 1.0
    system = _scaled(balanced / rate, b / scale[:, None] / rate, c * scale, d)
    a, b, c, d = _reduced(*_transposed(*_reduced(*system)))
    zeros = np.linalg.eigvals(a - b @ np.linalg.pinv(d) @ c)
    return np.asarray(rate * zeros, dtype=complex)


def _scaled(a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array, Array, Array]:
    """Return the system with inputs and outputs scaled to similar magnitudes."""
    columns = np.linalg.norm(np.vstack([b, d]), axis=0)
    columns[columns == 0.0] = 1.0
    b, d = b / columns, d / columns
    rows = np.linalg.norm(np.hstack([c, d]), axis=1)
    rows[rows == 0.0] = 1.0
    return a, b, c / rows[:, None], d / rows[:, None]


def _transposed(a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array, Array, Array]:
    return a.T, c.T, b.T, d.T


def _reduced(a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array, Array, Array]:
    """Return a system with the same zeros whose feedthrough D has full row rank.

    Where a combination of outputs has no feedthrough, C₂ x = 0 confines the state to the null space
    of C₂. The rates out of this null space must be zero, so they become outputs.
    """
    while True:
        left, singular, _ = np.linalg.svd(d)
        rank = int((singular > _RANK_TOLERANCE).sum())
        c, d = left.T @ c, left.T @ d
        free = c[rank:]
        _, singular, right = np.linalg.svd(free)
        confined = int((singular > _RANK_TOLERANCE).sum())
        if not confined:
            return a, b, c[:rank], d[:rank]
        out, within = right[:confined], right[confined:]
        c, d = np.vstack([c[:rank], out @ a]) @ within.T, np.vstack([d[:rank], out @ b])
        a, b = within @ a @ within.T, within @ b
