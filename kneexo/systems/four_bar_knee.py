"""Four-bar knee driven by the rod (Lee et al. 2020, Eq. 1–9); see `kneexo.geometry.linkage`."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial
from typing import Any

import pydrake.math as drake_math
from pydrake.systems.framework import BasicVector_

from kneexo.errors import SimulationError
from kneexo.geometry.linkage import FIT_RANGE_DEG, icr, polynomial, polynomial_derivative
from kneexo.geometry.rod_inverse import RodInverse, fit_rod_inverse
from kneexo.parameters import KneeParameters, LinkageParameters, RodPolynomialParameters
from kneexo.systems._leaf import NamedLeaf, leaf_template, values_of


def knee_kinematics(p: Any, polynomials: Iterable[Any], extension: Any) -> list[Any]:
    """Return knee angle θ_p, encoder angle θ_4 and moment arm r at a rod extension, in rad and m.

    ``polynomials`` are the polynomials of a `RodInverse` for θ_p, θ_4 and r. ``p`` has the dead
    centre and the scaling of the `RodInverse` as attributes.
    """
    t = _argument(p, extension)
    return [polynomial(coefficients, t) for coefficients in polynomials]


def _argument(p: Any, extension: Any) -> Any:
    """Return the argument of the polynomials, −1 … 1 within `FIT_RANGE_DEG`, at an extension."""
    # No knee angle has an extension beyond the dead centre; the check of the system reports it.
    root = drake_math.sqrt(drake_math.max(p.dead_centre_m - extension, 0.0))
    return (root - p.centre) / p.half_width


def moment_arm_slope(p: Any, coefficients: Any, extension: Any) -> Any:
    """Return the slope dr/dx of the moment arm at a rod extension x in m.

    ``coefficients`` are the coefficients of the polynomial of r in `RodInverse`.
    """
    # The slope divides by the root, which 1e-12 m keep above zero. The dead centres of G1, G2 and
    # G3 lie 12° and more outside the range of motion.
    root = drake_math.sqrt(drake_math.max(p.dead_centre_m - extension, 1e-12))
    t = (root - p.centre) / p.half_width
    return -polynomial(polynomial_derivative(coefficients), t) / (2.0 * p.half_width * root)


def context_values(
    parameters: LinkageParameters, knee: KneeParameters, fit: RodInverse
) -> dict[str, float]:
    """Return a dictionary of the first vector of Context parameters of `FourBarKnee`."""
    return {
        **values_of(
            parameters,
            *("o_a_x_m", "o_a_y_m", "o_b_x_m", "o_b_y_m", "a_3_m", "a_4_m", "phi_rad"),
        ),
        **values_of(fit, "dead_centre_m", "centre", "half_width"),
        "flexion_min_rad": math.radians(knee.flexion_min_deg),
        "flexion_max_rad": math.radians(knee.flexion_max_deg),
        "overshoot_rad": math.radians(knee.overshoot_deg),
    }


class FourBarKnee(NamedLeaf):
    """Four-bar knee: computes the knee angle from the rod extension, without iteration.

    θ_p, θ_4 and r are polynomials of degree 25 in √(x_dc − x), where x_dc is the extension at the
    rod's dead centre. They are fitted to the linkage when the system is made (see
    `kneexo.geometry.rod_inverse.RodInverse`).

    ================  ====  ==========  =================================================
    input port        size  unit
    ================  ====  ==========  =================================================
    rod_extension     1     m           x
    **output port**
    knee_kinematics   3     rad,rad,m   θ_p, θ_4, r; the other ports read its cached value
    knee_angle        1     rad         θ_p, 0 = full extension, positive = flexion
    encoder_angle     1     rad         θ_4, the angle that the encoder measures
    moment_arm        1     m           r = −dx/dθ_p
    moment_arm_slope  1     1           dr/dx
    icr               2     m           instantaneous centre of rotation, ground frame
    ================  ====  ==========  =================================================

    Stateless. Vector 0 of the Context parameters has the links and the scaling of the fit by name;
    vectors 1, 2 and 3 have the coefficients for θ_p, θ_4 and r, highest power first. All four
    belong to one geometry: build another system for another geometry. Source: Lee et al. 2020,
    Eq. 1–9.

    Parameters
    ----------
    parameters
        The links.
    knee
        The range of motion and ``overshoot_deg``.
    rod_polynomial
        Quintics of the paper's controller. The rod then follows Eq. 10 instead of Eq. 8 and 9; θ_4
        always follows the linkage. None: the rod follows the linkage too.

    Raises
    ------
    LinkageError
        The linkage cannot be assembled (on construction).
    SimulationError
        The knee is more than ``overshoot_deg`` outside the range of motion at the end of a step.
    """

    def __init__(
        self,
        parameters: LinkageParameters = LinkageParameters(),
        knee: KneeParameters = KneeParameters(),
        rod_polynomial: RodPolynomialParameters | None = None,
    ) -> None:
        fit = fit_rod_inverse(parameters, rod_polynomial)
        self._declare_parameters(context_values(parameters, knee, fit))
        for coefficients in (fit.knee_angle, fit.encoder_angle, fit.moment_arm):
            self.DeclareNumericParameter(BasicVector_[self._scalar](list(coefficients)))
        self._extension = self.DeclareVectorInputPort("rod_extension", 1)
        declare = self._declare_output
        self._kinematics = declare("knee_kinematics", 3, self._calc_kinematics, self._extension)
        for index, name in enumerate(("knee_angle", "encoder_angle", "moment_arm")):
            declare(name, 1, partial(self._element, index), self._extension)
        declare("moment_arm_slope", 1, self._calc_slope, self._extension)
        declare("icr", 2, self._calc_icr, self._extension)
        self._declare_check(self._require_in_range)

    def _calc_kinematics(self, context: Any) -> list[Any]:
        p = self.parameters(context)
        x = self._extension.Eval(context)[0]
        return knee_kinematics(
            p, (context.get_numeric_parameter(i).CopyToVector().tolist() for i in (1, 2, 3)), x
        )

    def _pose(self, context: Any) -> Any:
        return self._kinematics.Eval(context)

    def _element(self, index: int, context: Any) -> list[Any]:
        return [self._pose(context)[index]]

    def _calc_slope(self, context: Any) -> list[Any]:
        coefficients = context.get_numeric_parameter(3).CopyToVector().tolist()
        x = self._extension.Eval(context)[0]
        return [moment_arm_slope(self.parameters(context), coefficients, x)]

    def _calc_icr(self, context: Any) -> Any:
        p = self.parameters(context)
        theta_p, theta_4, _ = self._pose(context)
        return icr(p, theta_p - p.phi_rad, theta_4, xp=drake_math)

    def margin(self, context: Any) -> Any:
        """Return the distance in rad from the knee angle to the nearer limit plus overshoot.

        A compiled run stops when this distance falls below zero.
        """
        p = self.parameters(context)
        angle = self._pose(context)[0]
        inside = drake_math.min(angle - p.flexion_min_rad, p.flexion_max_rad - angle)
        return inside + p.overshoot_rad

    def _require_in_range(self, context: Any) -> None:
        if not self.margin(context) >= 0.0:
            p = self.parameters(context)
            angle = f"= {math.degrees(self._pose(context)[0]):.6g}"
            # Outside their range the polynomials give no knee angle. A run that ends there has
            # passed one end with a wrong moment arm, which can throw the rod to the other end.
            if abs(_argument(p, self._extension.Eval(context)[0])) > 1.0:
                angle = "outside {:g} … {:g}".format(*FIT_RANGE_DEG)
            raise SimulationError(
                f"t = {context.get_time():.6g} s: {self.get_name()}: knee_angle {angle} deg left "
                f"the range of motion "
                f"{math.degrees(p.flexion_min_rad):g} … {math.degrees(p.flexion_max_rad):g} "
                f"deg; reduce the motion, the load, the push, the fault or the step"
            )


FourBarKnee_ = leaf_template(FourBarKnee)
"""Template of `FourBarKnee` classes by scalar type of Drake."""
