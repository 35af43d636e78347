"""The controller's polynomials between knee angle and rod extension (Eq. 10, 11).

Table 1 belongs to the paper's linkage. For another linkage the polynomials are fitted to it, as in
Fig. 5.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from kneexo.common.result import Array
from kneexo.geometry.linkage import rod_extension
from kneexo.parameters import TABLE_1_LINKAGES, LinkageParameters, RodPolynomialParameters, Scenario

SAMPLES = 901
"""Number of points of the default fit, one every 0.1° from 0° to 90°."""

_DIGITS = 8
"""Significant digits of fitted coefficients.

Rounding makes the coefficients equal on all processors, although the last digits of a least-squares
solution differ. The rounding changes x by 1e-5 mm.
"""


def rod_points(
    link: LinkageParameters, *, start_deg: float = 0.0, samples: int = SAMPLES
) -> tuple[Array, Array]:
    """Return knee angles in deg and rod extensions in mm of a linkage, each (samples,).

    The knee angles have equal distances from ``start_deg`` to 90°. Raises `LinkageError` when the
    linkage cannot be assembled.
    """
    angle = np.linspace(start_deg, 90.0, samples)
    return angle, 1e3 * rod_extension(link, np.radians(angle))


# Fitted in a shifted and scaled argument (`Polynomial.fit`): powers of 150 mm up to the fifth span
# ten decades.
def quintic(argument: Array, value: Array) -> Array:
    """Fit a quintic of ``argument`` to ``value``, (n,) each; return its 6 coefficients.

    The coefficient of the highest power comes first.
    """
    return np.asarray(Polynomial.fit(argument, value, 5).convert().coef[::-1], dtype=float)


@lru_cache(maxsize=64)
def fitted_polynomial(link: LinkageParameters) -> RodPolynomialParameters:
    """Return the quintics of Eq. 10 and 11, fitted to a linkage by least squares over 0…90°.

    Raises `LinkageError` when the linkage cannot be assembled.
    """
    angle, extension = rod_points(link)
    return RodPolynomialParameters(
        p_mm_deg=_rounded(quintic(angle, extension)), q_deg_mm=_rounded(quintic(extension, angle))
    )


def _rounded(coefficients: Array) -> Any:
    return tuple(float(f"{c:.{_DIGITS}g}") for c in coefficients)


@lru_cache(maxsize=64)
def _default_polynomial(link: LinkageParameters) -> RodPolynomialParameters:
    if link in TABLE_1_LINKAGES.values():
        return RodPolynomialParameters()
    return fitted_polynomial(link)


def controller_polynomial(scenario: Scenario) -> RodPolynomialParameters:
    """Return the polynomials of Eq. 10 and 11 that the controller of a scenario uses.

    Eq. 10 gives the rod extension at a knee angle, and Eq. 11 the knee angle at a rod extension. If
    the scenario has a ``polynomial``, the controller uses ``polynomial``. Otherwise the linkage of
    the plant for which the controller is designed decides. A linkage of `TABLE_1_LINKAGES` has the
    polynomials of Table 1, because it is identified from Table 1. Another linkage has its
    `fitted_polynomial`. Raises `LinkageError` when the linkage cannot be assembled.
    """
    return scenario.polynomial or _default_polynomial(scenario.believed_plant.linkage)


def largest_error_mm(link: LinkageParameters, polynomial: RodPolynomialParameters) -> float:
    """Return the largest |x − p(θ_p)| of Eq. 10 over 0…90° in mm, for the x of a linkage."""
    angle, extension = rod_points(link)
    return float(np.max(np.abs(extension - np.polyval(polynomial.p_mm_deg, angle))))


def completed(scenario: Scenario) -> Scenario:
    """Return the scenario with explicit duration and polynomials.

    The result describes the same run. Raises `LinkageError` as `controller_polynomial` does.
    """
    polynomial = controller_polynomial(scenario)
    return scenario.with_duration().model_copy(update={"polynomial": polynomial})
