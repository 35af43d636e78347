"""Coordinates of the controller: encoder, knee and rod (Lee et al. 2020, Eq. 3–7, 10)."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import pydrake.math as drake_math

from kneexo.geometry.linkage import (
    eq6_sign,
    knee_angle_from_encoder,
    polynomial,
    polynomial_derivative,
)
from kneexo.parameters import LinkageParameters, RodPolynomialParameters
from kneexo.systems._leaf import NamedLeaf, leaf_template, values_of


def rod_derivatives(coefficients: Any, knee: Any) -> list[Any]:
    """Return rod extension x and its three time derivatives in m and s, by Eq. 10.

    ``coefficients`` are p_1 … p_6 of Eq. 10 in SI units. ``knee`` has θ_p and its three time
    derivatives in rad and s.
    """
    angle, rate, acceleration, jerk = knee
    x_1, x_2, x_3 = (
        polynomial(polynomial_derivative(coefficients, order), angle) for order in (1, 2, 3)
    )
    return [
        polynomial(coefficients, angle),
        x_1 * rate,
        x_2 * rate * rate + x_1 * acceleration,
        x_3 * rate * rate * rate + 3.0 * x_2 * rate * acceleration + x_1 * jerk,
    ]


_COEFFICIENTS = ("p_1", "p_2", "p_3", "p_4", "p_5", "p_6")


@lru_cache(maxsize=64)
def rod_polynomial_values(rod_polynomial: RodPolynomialParameters) -> dict[str, float]:
    """Return a dictionary of the parameters of `RodReference`, p_1 … p_6 of Eq. 10 in SI units."""
    return dict(zip(_COEFFICIENTS, rod_polynomial.p_si, strict=True))


def context_values(
    parameters: LinkageParameters, rod_polynomial: RodPolynomialParameters, offset_rad: float
) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `KneeCoordinates`.

    Raises `LinkageError` when the linkage is not one-to-one.
    """
    return {
        **values_of(
            parameters,
            *("o_a_x_m", "o_a_y_m", "o_b_x_m", "o_b_y_m", "a_2_m", "a_3_m", "a_4_m", "phi_rad"),
        ),
        "eq6_sign": eq6_sign(parameters),
        "offset_rad": offset_rad,
        **rod_polynomial_values(rod_polynomial),
    }


class KneeCoordinates(NamedLeaf):
    """Computes the measured knee angle and rod extension from the reading of the encoder.

    θ_4 = reading + offset. θ_p follows from Eq. 3–7. x = p_1 θ_p⁵ + … + p_6 (Eq. 10, Table 1). In
    the real device the microcontroller computes these equations.

    ===============  ====  ====  =========================================================
    input port       size  unit
    ===============  ====  ====  =========================================================
    encoder_reading  1     rad   θ_4 as the encoder reports it
    **output port**
    knee_angle       1     rad   measured θ_p
    rod_extension    1     m     measured x
    ===============  ====  ====  =========================================================

    Stateless. Context parameters by name: the links, ``eq6_sign``, ``offset_rad`` and p_1 … p_6 of
    Eq. 10 in SI units.

    Parameters
    ----------
    parameters
        The links.
    rod_polynomial
        Coefficients of Eq. 10.
    offset_rad
        Angle in rad that is added to the reading: the zero of the encoder plus half a count,
        because the encoder rounds down.

    Raises
    ------
    LinkageError
        The linkage is not one-to-one (on construction).
    """

    def __init__(
        self,
        parameters: LinkageParameters = LinkageParameters(),
        rod_polynomial: RodPolynomialParameters = RodPolynomialParameters(),
        offset_rad: float = 0.0,
    ) -> None:
        self._declare_parameters(context_values(parameters, rod_polynomial, offset_rad))
        self._reading = self.DeclareVectorInputPort("encoder_reading", 1)
        declare = self._declare_output
        self._knee_angle = declare("knee_angle", 1, self._calc_knee_angle, self._reading)
        declare("rod_extension", 1, self._calc_rod_extension, self._reading)

    def _calc_knee_angle(self, context: Any) -> list[Any]:
        p = self.parameters(context)
        theta_4 = self._reading.Eval(context)[0] + p.offset_rad
        return [knee_angle_from_encoder(p, theta_4, p.eq6_sign, xp=drake_math)]

    def _calc_rod_extension(self, context: Any) -> list[Any]:
        # Table 1, not the linkage, because the paper's controller computes it. The difference, at
        # most 0.15 mm on G1, is a part of the model.
        coefficients = self.parameters(context)[-len(_COEFFICIENTS) :]
        return [polynomial(coefficients, self._knee_angle.Eval(context)[0])]


KneeCoordinates_ = leaf_template(KneeCoordinates)
"""Template of `KneeCoordinates` classes by scalar type of Drake."""


class RodReference(NamedLeaf):
    """Computes the reference of the rod from the knee's reference, by Eq. 10 and the chain rule.

    ===============  ====  ===========================  ===================================
    input port       size  unit
    ===============  ====  ===========================  ===================================
    knee_reference   4     rad, rad/s, rad/s², rad/s³   θ_d and derivatives to the third
    **output port**
    rod_reference    4     m, m/s, m/s², m/s³           x_d and derivatives to the third
    ===============  ====  ===========================  ===================================

    Stateless. Context parameters by name: ``p_1`` … ``p_6`` of Eq. 10 in SI units.
    """

    def __init__(self, rod_polynomial: RodPolynomialParameters = RodPolynomialParameters()) -> None:
        self._declare_parameters(rod_polynomial_values(rod_polynomial))
        self._knee = self.DeclareVectorInputPort("knee_reference", 4)
        self._declare_output("rod_reference", 4, self._calc, self._knee)

    def _calc(self, context: Any) -> list[Any]:
        return rod_derivatives(self.parameters(context), self._knee.Eval(context))


RodReference_ = leaf_template(RodReference)
"""Template of `RodReference` classes by scalar type of Drake."""
