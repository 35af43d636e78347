"""Where the parts of leg and linkage are: straight bars between points of the knee's plane.

The thigh stands still, x points forward, y up. Points are complex numbers x + jy in m. Lengths of
thigh, shank and foot and the thickness of bars are for the eye alone; no result depends on them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kneexo.linkage import icr, pose, rod_anchor
from kneexo.parameters import LinkageParameters

Points = NDArray[np.complex128]

THIGH_M, SHANK_M, FOOT_M = 0.34, 0.34, 0.14


@dataclass(frozen=True)
class Bar:
    """A straight part from one point to another."""

    start: str
    end: str
    radius_m: float
    colour: tuple[float, float, float]
    layer_m: float = 0.0
    """Distance from the knee's plane."""
    fixed: bool = False
    """It does not move with the knee."""


_BONE, _STEEL = (0.93, 0.89, 0.80), (0.60, 0.62, 0.66)

BARS = {
    "thigh": Bar("hip", "thigh_end", 0.012, _BONE, fixed=True),
    "thigh_plate": Bar("thigh_a", "thigh_b", 0.006, _STEEL, fixed=True),
    "thigh_bracket": Bar("thigh_axis", "thigh_pin", 0.004, _STEEL, fixed=True),
    "link_2": Bar("o_a", "a", 0.004, (0.1, 0.5, 0.8), 0.02),
    "link_4": Bar("o_b", "b", 0.004, (0.9, 0.5, 0.1), -0.02),
    "shank": Bar("shank_start", "ankle", 0.011, _BONE),
    "foot": Bar("ankle", "toe", 0.009, _BONE),
    "shank_plate": Bar("shank_a", "shank_b", 0.006, _STEEL),
    "shank_bracket": Bar("shank_axis", "shank_pin", 0.004, _STEEL),
    "cylinder": Bar("cylinder_pin", "cylinder_end", 0.010, (0.5, 0.5, 0.5)),
    "rod": Bar("rod_start", "rod_pin", 0.005, (0.85, 0.87, 0.9)),
}
"""Parts by name."""

PINS = ("o_a", "o_b", "a", "b", "cylinder_pin", "rod_pin")
"""Points that are drawn as pins."""

GHOST = ("shank", "foot")
"""Parts that are drawn again where the reference has them."""


def points(link: LinkageParameters, knee_angle: ArrayLike) -> dict[str, Points]:
    """All points at knee angles (n,) in rad, each (n,): joints by Eq. 3–9, seen from the thigh.

    Where the cylinder's pin lies below the knee the ground link belongs to the shank (G1), else to
    the thigh (G2 to G4). All legs are seen from the side on which the foot goes back as the knee
    flexes. Raises `LinkageError` where the linkage cannot be assembled.
    """
    angle = np.atleast_1d(np.asarray(knee_angle, dtype=float))
    now, straight = pose(link, angle), pose(link, 0.0)
    o_a, o_b = complex(link.o_a_x_m, link.o_a_y_m), complex(link.o_b_x_m, link.o_b_y_m)
    anchor = rod_anchor(link)
    turn = np.exp(1j * angle)
    centre_x, centre_y = icr(link, now.theta_3, now.theta_4)
    shank_is_ground = anchor.imag < 0.0

    def moved(point: complex) -> Points:
        """Where a point of the coupler goes, which is at ``point`` when the knee is straight."""
        return np.asarray(turn * (point - straight.joint_b) + now.joint_b)

    def seen(point: Points | complex) -> Points:
        """A point of the ground's frame as seen from the thigh."""
        values = point * np.ones(angle.size, dtype=complex)
        if shank_is_ground:
            return np.asarray((values - now.joint_b) / turn + straight.joint_b)
        return -np.conj(values)

    pin = complex(straight.rod_pin)
    ground = {"a": o_a, "b": o_b, "pin": anchor, "axis": 1j * anchor.imag}
    coupler = {
        "a": complex(straight.joint_a),
        "b": complex(straight.joint_b),
        "pin": pin,
        "axis": 1j * pin.imag,
    }
    forward = 1.0 if shank_is_ground else -1.0
    shank = {"start": 0j, "ankle": -1j * SHANK_M, "toe": -1j * SHANK_M + forward * FOOT_M}
    thigh = {"end": 0j, "hip": 1j * THIGH_M}
    result: dict[str, Points] = {}
    for limb, leg, of_linkage, on_ground in (
        ("shank", shank, ground if shank_is_ground else coupler, shank_is_ground),
        ("thigh", thigh, coupler if shank_is_ground else ground, not shank_is_ground),
    ):
        for name, point in (leg | of_linkage).items():
            key = name if name in ("ankle", "toe", "hip") else f"{limb}_{name}"
            result[key] = seen(point if on_ground else moved(point))
    result |= {"o_a": seen(o_a), "o_b": seen(o_b), "a": seen(now.joint_a), "b": seen(now.joint_b)}
    result |= {"cylinder_pin": seen(anchor), "rod_pin": seen(now.rod_pin)}
    along = result["rod_pin"] - result["cylinder_pin"]
    along = along / np.abs(along) * link.rod_length_m
    result["cylinder_end"] = result["cylinder_pin"] + along
    result["rod_start"] = result["rod_pin"] - along
    result["icr"] = seen(np.asarray(centre_x + 1j * centre_y))
    return result
