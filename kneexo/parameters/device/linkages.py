"""Lengths of the knee's four-bar linkage, identified from Table 1 (the paper prints none)."""

from __future__ import annotations

import math
from typing import Any, Literal

from kneexo.parameters.fields.quantity import Parameters, choice, quantity

_IDENTIFIED = (
    "assumption: identified from Table 1 over 0…90° by least squares; the paper prints no link "
    "lengths"
)


def _length(default: float) -> Any:
    return quantity(default, "m", _IDENTIFIED, ge=1e-3, le=2)


def _coordinate(default: float) -> Any:
    return quantity(default, "m", _IDENTIFIED, ge=-2, le=2)


def _angle(default_deg: float) -> Any:
    return quantity(math.radians(default_deg), "rad", _IDENTIFIED, ge=-7, le=7)


class LinkageParameters(Parameters):
    """Four-bar knee (Eq. 1–9), in the frame of the ground link.

    The origin is the nominal knee axis, y points proximally, and flexion is counter-clockwise.
    Link 1 is the ground O_A–O_B, link 2 is O_A–A, link 3 is the coupler A–B, link 4 is O_B–B.
    The defaults are geometry G1: the shank is the ground, and the coupler, the shortest link, is
    fixed to the thigh.
    """

    o_a_x_m: float = _coordinate(22.2063e-3)
    o_a_y_m: float = _coordinate(-34.732e-3)
    o_b_x_m: float = _coordinate(-6.679e-3)
    o_b_y_m: float = _coordinate(-17.5701e-3)
    a_2_m: float = _length(32.9701e-3)
    a_3_m: float = _length(17.0e-3)
    a_4_m: float = _length(18.2289e-3)
    phi_rad: float = _angle(-167.0801)
    """φ of Eq. 7, the knee angle minus the coupler angle."""
    rod_pin_radius_m: float = _length(265.8651e-3)
    """|P'B| of Eq. 8, the distance from the coupler's joint B to the pin of the rod."""
    rod_pin_angle_rad: float = _angle(-62.9916)
    """φ' of Eq. 8, the direction from B to the rod's pin, relative to the coupler's angle θ_3."""
    rod_anchor_radius_m: float = _length(118.1887e-3)
    """|P_rod O| of Eq. 9, the distance from the origin to the pin of the cylinder."""
    rod_anchor_angle_rad: float = _angle(-97.3807)
    """θ_rod of Eq. 9, the direction from the origin to the cylinder's pin."""
    rod_length_m: float = _length(231.3769e-3)
    """L_0, the distance between the pins of rod and cylinder at x = 0 (the paper prints none)."""
    branch: Literal[-1, 1] = choice(
        -1, "assembly branch, the sign of sin(θ_4 − θ_2); the paper never states it"
    )

    def __repr__(self) -> str:
        """Return the linkage's name in `LINKAGES`, or code with the values that differ from G1."""
        names = (name for name, linkage in LINKAGES.items() if linkage == self)
        return next(names, None) or super().__repr__()


G1 = LinkageParameters()
"""Default linkage. The shank is the ground, and the coupler is the shortest link.

Such a linkage is a double rocker.
"""

G2 = LinkageParameters(
    o_a_x_m=-24.3737e-3,
    o_a_y_m=47.9781e-3,
    o_b_x_m=13.62e-3,
    o_b_y_m=22.1909e-3,
    a_2_m=44.5361e-3,
    a_3_m=23.836e-3,
    a_4_m=25.7183e-3,
    phi_rad=math.radians(18.5041),
    rod_pin_radius_m=93.8743e-3,
    rod_pin_angle_rad=math.radians(-57.3501),
    rod_anchor_radius_m=349.1986e-3,
    rod_anchor_angle_rad=math.radians(77.0024),
    rod_length_m=288.7536e-3,
)
"""The thigh is the ground, and the coupler is the shortest link.

The instantaneous centre of rotation moves in the wrong direction.
"""

G3 = LinkageParameters(
    o_a_x_m=-12.207e-3,
    o_a_y_m=-2.2969e-3,
    o_b_x_m=6.1253e-3,
    o_b_y_m=-14.499e-3,
    a_2_m=26.1508e-3,
    a_3_m=47.9084e-3,
    a_4_m=44.2795e-3,
    phi_rad=math.radians(45.3361),
    rod_pin_radius_m=60.7302e-3,
    rod_pin_angle_rad=math.radians(-37.9753),
    rod_anchor_radius_m=266.6114e-3,
    rod_anchor_angle_rad=math.radians(71.0364),
    rod_length_m=230.0e-3,
    branch=1,
)
"""The thigh is the ground and the shortest link (drag link). The best conditioned linkage."""

G4 = LinkageParameters(
    o_a_x_m=-1.52785e-3,
    o_a_y_m=-3.49263e-3,
    o_b_x_m=3.43876e-3,
    o_b_y_m=-6.31537e-3,
    a_2_m=24.09745e-3,
    a_3_m=11.95039e-3,
    a_4_m=28.96078e-3,
    phi_rad=math.radians(41.92103),
    rod_pin_radius_m=82.79717e-3,
    rod_pin_angle_rad=math.radians(-28.25057),
    rod_anchor_radius_m=961.48141e-3,
    rod_anchor_angle_rad=math.radians(85.54219),
    rod_length_m=924.81905e-3,
    branch=1,
)
"""The thigh is the ground and the shortest link (drag link).

The linkage is identified from the two polynomials of Table 1 over 5…90°. Polynomials that are
fitted to this linkage have the errors that the paper prints.
"""

G5 = LinkageParameters(
    o_a_x_m=10.9475e-3,
    o_a_y_m=-13.9814e-3,
    o_b_x_m=15.0588e-3,
    o_b_y_m=-7.0655e-3,
    a_2_m=8.8159e-3,
    a_3_m=12.542e-3,
    a_4_m=8.5224e-3,
    phi_rad=math.radians(-48.4358),
    rod_pin_radius_m=104.4985e-3,
    rod_pin_angle_rad=math.radians(-93.0771),
    rod_anchor_radius_m=450.0e-3,
    rod_anchor_angle_rad=math.radians(109.4712),
    rod_length_m=418.6181e-3,
    branch=1,
)
"""The thigh is the ground and the shortest link. No link turns fully (triple rocker).

Of the linkages that obey Table 1 to 0.03 mm rms over 0…90°, the RMSE that the paper prints, it
follows gait2392's knee best (`kneexo.analysis.trade_off`).
"""

HINGE = LinkageParameters(
    o_a_x_m=0.0,
    o_a_y_m=0.0,
    o_b_x_m=0.0,
    o_b_y_m=0.0,
    a_2_m=30e-3,
    a_3_m=30e-3,
    a_4_m=30e-3,
    phi_rad=0.0,
    rod_pin_radius_m=78.3158e-3,
    rod_pin_angle_rad=math.radians(-62.0783),
    rod_anchor_radius_m=450e-3,
    rod_anchor_angle_rad=math.radians(80.0),
    rod_length_m=389.3675e-3,
    branch=1,
)
"""A hinge, as a linkage whose ground joints O_A and O_B are one point, the axis.

The links 2 to 4 are a rigid triangle that turns about the axis, so that every equation of a
four-bar linkage holds. The pins of the rod are identified from Table 1 over 0…90° by least squares.
Both pins are at most 0.45 m from the axis, and the pin of the cylinder is on this limit.
"""

TABLE_1_LINKAGES = {"G1": G1, "G2": G2, "G3": G3, "G4": G4, "G5": G5}
"""Linkages that reproduce Table 1, so that the controller has the polynomials of Table 1."""

LINKAGES = {**TABLE_1_LINKAGES, "hinge": HINGE}
"""Linkages that a scenario file accepts by name."""
