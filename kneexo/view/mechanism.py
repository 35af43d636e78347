"""Defines the bars and pins of leg and linkage, and computes their points in the knee's plane.

Points are complex numbers x + jy in m, seen from the thigh, with x forwards and y up. The lengths
of thigh, shank and foot and the thickness of all parts are only for the eye; no result depends on
them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kneexo.geometry.linkage import icr, pose, rod_anchor, shank_is_ground
from kneexo.parameters import LinkageParameters

Points = NDArray[np.complex128]
"""Points of the knee's plane in m: the real part points forwards, the imaginary part up."""

THIGH_M, SHANK_M, FOOT_M, TOE_M = 0.34, 0.34, 0.14, 0.035
"""Lengths of thigh, shank and foot in m, and height of the ankle over the toes."""

HEAD = 0.9
"""Length of the drawn cylinder, divided by the length of the drawn rod.

The length of the rod is the distance between the pin of the cylinder and the pin of the rod at the
rod extension x = 0. The inner end of the rod stays in the cylinder while x is below 0.9 of the
length of the rod. A stub of 0.1 of the length is visible at x = 0.
"""


LIMB_LAYER_M = 0.105
"""Distance in m of thigh, shank and foot from the linkage, which is at the side of the leg."""


@dataclass(frozen=True)
class Bar:
    """A straight part between two of the `points`."""

    frame: str
    """Name of the frame in `FRAMES` to which the bar is fixed."""
    start: str
    end: str
    radius_m: float
    colour: tuple[float, float, float]
    """Red, green and blue, each from 0 to 1."""
    layer_m: float = 0.0
    """Distance of the bar from the plane of the linkage in m, positive towards the limb."""
    is_flat: bool = False
    """Whether the section is a square. Otherwise it is a circle."""


FRAMES = {
    "thigh": ("thigh_end", "hip"),
    "shank": ("shank_start", "ankle"),
    "link_2": ("o_a", "a"),
    "link_4": ("o_b", "b"),
    "cylinder": ("cylinder_pin", "cylinder_end"),
    "rod": ("rod_start", "rod_pin"),
}
"""Dictionary from a rigid body to the points on its x axis: its origin and another point."""

_BONE, _STEEL, _LIGHT = (0.93, 0.89, 0.80), (0.38, 0.41, 0.46), (0.66, 0.69, 0.73)

BARS = {
    "thigh": Bar("thigh", "hip", "thigh_end", 0.012, _BONE, LIMB_LAYER_M),
    "thigh_plate": Bar("thigh", "thigh_a", "thigh_b", 0.006, _STEEL),
    "thigh_bracket": Bar("thigh", "thigh_axis", "thigh_pin", 0.004, _STEEL, 0.02),
    "link_2": Bar("link_2", "o_a", "a", 0.004, (0.0, 0.45, 0.70), 0.02, is_flat=True),
    "link_4": Bar("link_4", "o_b", "b", 0.004, (0.90, 0.62, 0.0), -0.02),
    "shank": Bar("shank", "shank_start", "ankle", 0.011, _BONE, LIMB_LAYER_M),
    "foot": Bar("shank", "ankle", "toe", 0.009, _BONE, LIMB_LAYER_M),
    "shank_plate": Bar("shank", "shank_a", "shank_b", 0.006, _LIGHT),
    "shank_bracket": Bar("shank", "shank_axis", "shank_pin", 0.004, _LIGHT, 0.02),
    "rod": Bar("rod", "rod_start", "rod_pin", 0.005, (0.85, 0.87, 0.9)),
    "cylinder": Bar("cylinder", "cylinder_pin", "cylinder_end", 0.013, (0.5, 0.5, 0.5)),
}
"""The bars of leg and linkage by name."""

PINS = {
    "o_a": "link_2",
    "a": "link_2",
    "o_b": "link_4",
    "b": "link_4",
    "cylinder_pin": "cylinder",
    "rod_pin": "rod",
}
"""Dictionary from each point with a pin to the frame of this pin in `FRAMES`."""


def points(link: LinkageParameters, knee_angle: ArrayLike) -> dict[str, Points]:
    """Return all points by name, (n,) each, at knee angles (n,) in rad.

    The joints follow Lee et al. 2020, Eq. 3–9. The view is from the side on which the foot moves
    back when the knee flexes. Raises `LinkageError` if the linkage cannot be assembled.
    """
    angle = np.atleast_1d(np.asarray(knee_angle, dtype=float))
    now, straight = pose(link, angle), pose(link, 0.0)
    o_a, o_b = complex(link.o_a_x_m, link.o_a_y_m), complex(link.o_b_x_m, link.o_b_y_m)
    anchor = rod_anchor(link)
    turn = np.exp(1j * angle)
    centre_x, centre_y = icr(link, now.theta_3, now.theta_4)
    on_shank = shank_is_ground(link)

    def moved(point: complex) -> Points:
        """Return the positions of a point of the coupler. ``point``: position at full extension."""
        return np.asarray(turn * (point - straight.joint_b) + now.joint_b)

    def from_thigh(point: Points | complex) -> Points:
        """Transform points from the frame of the ground link to the frame of the thigh."""
        values = point * np.ones(angle.size, dtype=complex)
        if on_shank:
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
    forward = 1.0 if on_shank else -1.0
    shank = {"start": 0j, "ankle": -1j * SHANK_M, "toe": -1j * (SHANK_M + TOE_M) + forward * FOOT_M}
    thigh = {"end": 0j, "hip": 1j * THIGH_M}
    result: dict[str, Points] = {}
    for limb, leg, of_linkage, on_ground in (
        ("shank", shank, ground if on_shank else coupler, on_shank),
        ("thigh", thigh, coupler if on_shank else ground, not on_shank),
    ):
        for name, point in (leg | of_linkage).items():
            key = name if name in ("ankle", "toe", "hip") else f"{limb}_{name}"
            result[key] = from_thigh(point if on_ground else moved(point))
    result |= {
        "o_a": from_thigh(o_a),
        "o_b": from_thigh(o_b),
        "a": from_thigh(now.joint_a),
        "b": from_thigh(now.joint_b),
    }
    result |= {"cylinder_pin": from_thigh(anchor), "rod_pin": from_thigh(now.rod_pin)}
    along = result["rod_pin"] - result["cylinder_pin"]
    along = along / np.abs(along) * link.rod_length_m
    result["cylinder_end"] = result["cylinder_pin"] + HEAD * along
    result["rod_start"] = result["rod_pin"] - along
    result["icr"] = from_thigh(np.asarray(centre_x + 1j * centre_y))
    return result
