"""How far to trust a fit: covariance, combinations of unknowns, and tests of the residuals."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import scipy.linalg
import scipy.stats

from ..run_data import Array
from .log import Unknown

SCORES: dict[str, Callable[[Array], Array]] = {
    "linear": lambda r: r,
    "huber": lambda r: np.clip(r, -1.0, 1.0),
    "soft_l1": lambda r: r / np.sqrt(1.0 + r * r),
    "cauchy": lambda r: r / (1.0 + r * r),
}
"""Half the derivative of each loss of SciPy's ``least_squares`` by the weighted residual r."""
_SAME = 1e-3
"""Singular value, relative to the largest, below which a combination has no effect of its own.

The differences of the Jacobian are right to about 1e-5.
"""
_NOTHING = 1e-6
"""Change of the outputs over the whole range, in their spreads, that counts as no effect.

The runs keep a relative tolerance of 1e-8, so differences over 2e-3 of the range show 5e-6 of
noise in the worst row and less in the mean of many.
"""
_NAMED = 0.1  # share of the largest part of a direction; smaller parts are not named
_MOST_TERMS = 30  # of an autoregression; the criterion by Schwarz chooses how many
_PASSES = 2  # of the correction for the fit; in a test passes 2 and 3 changed intervals by 1 %


def stacked(pieces: Sequence[Array]) -> Array:
    """Return the rows and elements of all segments as the rows of one matrix (rows, columns)."""
    return np.concatenate([piece.reshape(-1, piece.shape[-1]) for piece in pieces])


def without_effect(matrix: Array, names: Sequence[str]) -> list[str]:
    """Return the unknowns whose whole range changes no output, by a Jacobian in spreads."""
    change = np.sqrt(np.mean(matrix**2, axis=0))
    return [name for name, size in zip(names, change, strict=True) if size < _NOTHING]


def combinations(matrix: Array, names: Sequence[str], unknowns: Sequence[Unknown]) -> list[str]:
    """Name the directions without an effect of their own, and for each the unknown to fix.

    A direction has a small singular value of the Jacobian (rows, columns) whose columns are scaled
    to length one. The pivoted QR decomposition orders the columns by what those before leave of
    each. So its last columns are the unknowns that the others compensate (Golub and Van Loan 2013,
    5.4 and 5.5).
    """
    length = np.linalg.norm(matrix, axis=0)
    _, values, rows = np.linalg.svd(matrix / length, full_matrices=False)
    pivots = scipy.linalg.qr(matrix / length, mode="r", pivoting=True)[1]
    texts = []
    for rank in np.flatnonzero(values < _SAME * values[0]):
        direction = rows[rank] / length
        moves = direction * [math.log(u.high / u.low) if u.low > 0 else 1.0 for u in unknowns]
        moves *= math.log(1.1) / moves[np.argmax(np.abs(direction))]  # 10 % of the largest part
        order = np.argsort(-np.abs(direction), kind="stable")
        least = min(_NAMED * abs(direction[order[0]]), abs(direction[order[1]]))  # two at least
        large = [c for c in order if abs(direction[c]) >= least]
        parts = [_moved(names[c], unknowns[c], moves[c]) for c in large]
        texts.append(
            f"at the start, {parts[0]} with {' and '.join(parts[1:])} hardly changes an output: "
            f"fix {names[pivots[rank]]}, or measure more"
        )
    return texts


def _moved(name: str, unknown: Unknown, move: float) -> str:
    """Return the text of a move: of the logarithm, or in ranges."""
    if unknown.logarithmic:
        return f"{name} {'up' if move > 0.0 else 'down'} {100.0 * abs(math.expm1(move)):.2g} %"
    size = abs(move) * (unknown.high - unknown.low)
    return f"{name} {'up' if move > 0.0 else 'down'} {size:.2g}"


def covariance_of(
    jacobian: Sequence[Array], residuals: Sequence[Array], loss: str
) -> tuple[Array, Array, Array]:
    """Return the covariance of a fit, that with white noise, and each output's correlation time.

    Let r be the weighted residuals, ρ the loss and ψ = ρ'/2. The covariance is A⁻¹ B A⁻¹ with
    A = E[ψ'] JᵀJ and B = Jᵀ R J (Huber 1967). R has the autocovariance of ψ in each output; outputs
    count as independent of each other. With white noise B is JᵀJ. A correlation time is
    1 + 2 Σ ρ_l, in rows.

    R comes from an autoregression: see ``_spectrum``. The fit takes from the residuals what the
    columns of J can follow: r = (1 − P) noise with the projection P on J. The autocovariance of the
    residuals is therefore too small by that of P R + R P − P R P. Two passes add this part.

    ``jacobian`` has an array (rows, elements, columns) for each segment, and ``residuals`` an array
    (rows, elements), both weighted. A missing residual is nan, and its row of ``jacobian`` is zero.
    """
    score = SCORES[loss]
    every = np.concatenate(residuals)
    curvature = float(np.nanmean(score(every + 1e-6) - score(every - 1e-6))) / 2e-6
    left, values, right = np.linalg.svd(stacked(jacobian), full_matrices=False)
    inverse = right.T / (np.maximum(values, 1e-12 * values[0]) * curvature)
    ends = np.cumsum([r.size for r in residuals])[:-1]
    basis = [
        part.reshape(piece.shape)
        for part, piece in zip(np.split(left, ends), jacobian, strict=True)
    ]
    present = [np.isfinite(r) for r in residuals]
    scores = [score(np.nan_to_num(r)) for r in residuals]
    lags = min(_MOST_TERMS, max(map(len, residuals)) // 4) + 1
    total = sum(_correlated(s, s, lags) for s in scores)
    pairs = sum(_correlated(p.astype(float), p.astype(float), lags) for p in present)
    pairs = np.maximum(np.rint(pairs), 1.0)
    gamma = total / pairs
    for _ in range(_PASSES + 1):
        models = [_autoregression(g, n) for g, n in zip(gamma.T, pairs[0], strict=True)]
        coloured = [_coloured(piece, models) for piece in basis]
        inner = sum(np.einsum("rej,rek->jk", q, g) for q, g in zip(basis, coloured, strict=True))
        taken = np.zeros_like(total)
        for q, g in zip(basis, coloured, strict=True):
            taken += _correlated(q, 2.0 * g - q @ inner, lags)
        gamma = (total + taken) / pairs
    times = np.array([_spectrum(model, 1)[0] for model in models]) / gamma[0]
    white = np.mean(np.concatenate(scores)[np.concatenate(present)] ** 2)
    return inverse @ inner @ inverse.T, white * inverse @ inverse.T, times


def _correlated(a: Array, b: Array, lags: int) -> Array:
    """Return Σ_t (a_t b_(t+l) + b_t a_(t+l))/2 for the lags l, (lags, elements).

    a and b have the shape (rows, elements) or (rows, elements, columns), and columns are summed.
    """
    a, b = (np.reshape(each, (*each.shape[:2], -1)) for each in (a, b))
    result = np.zeros((lags, a.shape[1]))
    for lag in range(min(lags, len(a))):
        late, early = slice(lag, None), slice(len(a) - lag)
        for first, second in ((a, b), (b, a)):
            result[lag] += 0.5 * np.einsum("tek,tek->e", first[early], second[late])
    return result


def _autoregression(gamma: Array, count: float) -> tuple[Array, float]:
    """Return the autoregression x_t = Σ a_l x_(t−l) + e_t of an autocovariance: a, variance of e.

    The equations of Yule and Walker give a. The criterion of Schwarz (1978) for ``count`` samples
    chooses the number of terms.
    """
    best, result = math.inf, (np.zeros(0), float(gamma[0]))
    for terms in range(gamma.size):
        past = gamma[1 : terms + 1]
        a = scipy.linalg.solve_toeplitz(gamma[:terms], past) if terms else past
        variance = float(gamma[0] - a @ past)
        if variance <= 0.0:  # not an autocovariance: too few pairs without a missing value
            break
        criterion = count * math.log(variance) + terms * math.log(count)
        if criterion < best:
            best, result = criterion, (a, variance)
    return result


def _spectrum(model: tuple[Array, float], size: int) -> Array:
    """Return Σ_l γ_l e^(−iωl) of an autoregression at the frequencies of a real FFT (Berk 1974)."""
    a, variance = model
    transfer = (
        1.0
        - np.exp(-2j * np.pi / size * np.outer(np.arange(size // 2 + 1), np.arange(1, a.size + 1)))
        @ a
    )
    return variance / np.abs(transfer) ** 2


def _coloured(basis: Array, models: Sequence[tuple[Array, float]]) -> Array:
    """Return R times the columns of ``basis`` (rows, elements, columns)."""
    size = 2 * len(basis)
    spectra = np.stack([_spectrum(model, size) for model in models], axis=1)
    waves = np.fft.rfft(basis, size, axis=0) * spectra[:, :, None]
    return np.fft.irfft(waves, size, axis=0)[: len(basis)]


def whiteness(residuals: Array) -> tuple[float, int, float]:
    """Return how white residuals (n,) are: largest autocorrelation, its lag, p-value of all.

    95 % of the autocorrelations of white residuals are within ±1.96/√n. The p-value is that of the
    statistic by Ljung and Box (1978), n(n + 2) Σ ρ_l²/(n − l), over 40 lags or n/4.
    """
    n = residuals.size
    lags = min(40, n // 4)
    r = residuals - residuals.mean()
    rho = _correlated(r[:, None], r[:, None], lags + 1)[1:, 0] / (r @ r)
    statistic = n * (n + 2) * np.sum(rho**2 / (n - np.arange(1, lags + 1)))
    largest = int(np.argmax(np.abs(rho)))
    return float(rho[largest]), largest + 1, float(scipy.stats.chi2.sf(statistic, lags))


def input_correlation(residuals: Array, inputs: Array) -> float:
    """Return the share of correlations of residuals with earlier inputs (n,) beyond 1.96 σ.

    Without an error of the structure 5 % are expected. For independent series σ² is
    Σ_l ρ_rr(l) ρ_uu(l)/n (Bartlett 1946).
    """
    n = residuals.size
    r, u = residuals - residuals.mean(), inputs - inputs.mean()
    if not (r @ r) * (u @ u):
        return 0.0
    lags = min(40, n // 4)
    auto = [_correlated(s[:, None], s[:, None], lags)[:, 0] / (s @ s) for s in (r, u)]
    both = auto[0] * auto[1]
    sigma = math.sqrt(max(2.0 * both.sum() - both[0], 1.0) / n)
    cross = np.array([r[lag:] @ u[: n - lag] for lag in range(lags)])
    return float(np.mean(np.abs(cross) > 1.96 * sigma * math.sqrt((r @ r) * (u @ u))))
