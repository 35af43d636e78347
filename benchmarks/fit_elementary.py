"""Constants of `diagramc.native.elementary`; prints them.

python benchmarks/fit_elementary.py

A polynomial interpolates what follows the first terms of a function's series, at Chebyshev's
nodes. Its coefficients become doubles, and each moves by units in the last place while that makes
the largest error smaller. The error is relative to the function. Needs mpmath.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from mpmath import mp, mpf

mp.dps = 60
POINTS = 1000  # where the error is measured
LARGEST_S = (mp.sqrt(2) - 1) / (mp.sqrt(2) + 1)


class Fit(NamedTuple):
    """A polynomial: of x, from ``low`` to ``high``."""

    remainder: Callable[[mpf], mpf]
    factor: Callable[[mpf], mpf]  # of the remainder in the function
    function: Callable[[mpf], mpf]
    low: mpf
    high: mpf
    count: int


def odd(function: Callable[[mpf], mpf], high: mpf, count: int, slope: int = 1) -> Fit:
    """Of x², for slope · x + x³ · polynomial."""
    return Fit(
        lambda z: (function(mp.sqrt(z)) - slope * mp.sqrt(z)) / mp.sqrt(z) ** 3,
        lambda z: mp.sqrt(z) ** 3,
        lambda z: function(mp.sqrt(z)),
        mpf(0),
        high**2,
        count,
    )


FITS = {
    "SIN": odd(mp.sin, mp.pi / 4, 6),
    "COS": Fit(  # of x², for 1 - x²/2 + x⁴ · polynomial
        lambda z: (mp.cos(mp.sqrt(z)) - 1 + z / 2) / z**2,
        lambda z: z**2,
        lambda z: mp.cos(mp.sqrt(z)),
        mpf(0),
        (mp.pi / 4) ** 2,
        6,
    ),
    "ATAN": odd(mp.atan, mpf(1), 20),
    "ASIN": odd(mp.asin, mpf("0.5"), 13),
    "EXP": Fit(  # 1 + x + x² · polynomial
        lambda x: (mp.expm1(x) - x) / x**2,
        lambda x: x**2,
        mp.exp,
        -mp.log(2) / 2,
        mp.log(2) / 2,
        10,
    ),
    "LOG": odd(lambda s: 2 * mp.atanh(s), LARGEST_S, 7, slope=2),
    "LOG_END": Fit(  # of s², for 2 s + 2/3 s³ + s⁵ · polynomial
        lambda z: (2 * mp.atanh(mp.sqrt(z)) - 2 * mp.sqrt(z)) / mp.sqrt(z) ** 5 - mpf(2) / 3 / z,
        lambda z: mp.sqrt(z) ** 5,
        lambda z: 2 * mp.atanh(mp.sqrt(z)),
        mpf(0),
        LARGEST_S**2,
        8,
    ),
}


def polynomial(fit: Fit) -> tuple[list[float], float]:
    """Coefficients, lowest power first, and the relative error."""

    def between(share: mpf) -> mpf:
        return fit.low + (fit.high - fit.low) * share

    angles = [mp.pi * (2 * k + 1) / (2 * fit.count) for k in range(fit.count)]
    nodes = [between((1 + mp.cos(angle)) / 2) for angle in angles]
    powers = mp.matrix([[x**k for k in range(fit.count)] for x in nodes])
    exact = mp.lu_solve(powers, mp.matrix([fit.remainder(x) for x in nodes]))
    coefficients = [float(c) for c in exact]

    def value(x: mpf) -> mpf:
        return mp.fsum(c * x**k for k, c in enumerate(coefficients))

    points = [between((k + mpf("0.5")) / POINTS) for k in range(POINTS)]
    weights = [fit.factor(x) / fit.function(x) for x in points]
    errors = np.array(
        [
            float((value(x) - fit.remainder(x)) * weight)
            for x, weight in zip(points, weights, strict=True)
        ]
    )
    effects = np.array(weights, float)[:, None] * np.vander(
        np.array(points, float), fit.count, increasing=True
    )
    moved = True
    while moved:
        moved = False
        for k, effect in enumerate(effects.T):
            for step in (np.spacing(coefficients[k]), -np.spacing(coefficients[k])):
                changed = errors + step * effect
                if np.abs(changed).max() < np.abs(errors).max():
                    errors, moved = changed, True
                    coefficients[k] = float(coefficients[k] + step)
    return coefficients, float(np.abs(errors).max())


def parts(value: mpf, count: int) -> list[float]:
    """Doubles that add up to the value, the largest first."""
    summands: list[float] = []
    for _ in range(count):
        summands.append(float(value - mp.fsum(summands)))
    return summands


def constants() -> dict[str, tuple[list[float], float]]:
    """All constants, and the relative errors."""
    constants_by_name = {name: polynomial(fit) for name, fit in FITS.items()}
    for name, value, count in (
        ("HALF_PI", mp.pi / 2, 3),
        ("LN_2", mp.log(2), 2),
        ("TWO_THIRDS", mpf(2) / 3, 2),
    ):
        cut = parts(value, count)
        constants_by_name[name] = cut, float(abs(mp.fsum(cut) / value - 1))
    return constants_by_name


if __name__ == "__main__":
    for name, (values, error) in constants().items():
        print(f"{name} = (  # relative error {error:.1e}")
        print("".join(f"    {value!r},\n" for value in values) + ")")
