"""Where the parts of leg and linkage are, and how they look, for recorded and for live views.

Parts are straight bars between points of the knee's plane, and pins across it. The thigh stands
still, x points forward, y up. Points are complex numbers x + jy in m. Lengths of thigh, shank and
foot and the thickness of parts are for the eye alone; no result depends on them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Cylinder, Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from kneexo.linkage import icr, pose, rod_anchor
from kneexo.parameters import LinkageParameters
from kneexo.result import Array

Points = NDArray[np.complex128]
"""Points of the knee's plane in m: the real part points forwards, the imaginary part up."""

THIGH_M, SHANK_M, FOOT_M = 0.34, 0.34, 0.14
"""Lengths of the parts of the leg in m, for the eye alone."""

HEAD = 0.9
"""Length of the cylinder, where the rod comes out, as a part of the distance of its pins at x = 0.

The rod reaches back by that distance, so that it stays in the cylinder while x is below 0.9 of it,
and shows a stub at x = 0.
"""

_SPACING_M = 0.30  # of legs that stand beside each other


@dataclass(frozen=True)
class Bar:
    """A straight part from one point to another."""

    start: str
    end: str
    radius_m: float
    colour: tuple[float, float, float]
    layer_m: float = 0.0
    """Distance from the knee's plane."""


_BONE, _STEEL = (0.93, 0.89, 0.80), (0.60, 0.62, 0.66)

BARS = {
    "thigh": Bar("hip", "thigh_end", 0.012, _BONE),
    "thigh_plate": Bar("thigh_a", "thigh_b", 0.006, _STEEL),
    "thigh_bracket": Bar("thigh_axis", "thigh_pin", 0.004, _STEEL),
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
"""Bars that are drawn again where the reference has them."""

ICR_COLOUR = Rgba(0.8, 0.0, 0.5)
"""Colour of the instantaneous centre of rotation and of its path."""

Look = tuple[Cylinder, Rgba]
"""Shape and colour of a part."""

_GHOST_RADIUS = 0.85  # of that of the bar: hidden within what it agrees with
_GHOST_COLOUR = Rgba(0.35, 0.35, 0.35, 0.35)
_PIN, _PIN_COLOUR = Cylinder(0.004, 0.052), Rgba(0.15, 0.15, 0.18)
_ACROSS = RotationMatrix.MakeXRotation(0.5 * np.pi)
_LOW, _HIGH, _NONE = np.array([0.1, 0.3, 0.9]), np.array([0.9, 0.15, 0.1]), np.array([0.85] * 3)


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
    result["cylinder_end"] = result["cylinder_pin"] + HEAD * along
    result["rod_start"] = result["rod_pin"] - along
    result["icr"] = seen(np.asarray(centre_x + 1j * centre_y))
    return result


def shapes(linkage: LinkageParameters) -> dict[str, Look]:
    """Shape and colour of each part: the bars, their ghosts ``reference_…``, and ``pin_…``.

    Raises `LinkageError` where the linkage cannot be assembled.
    """
    at = points(linkage, 0.0)
    parts: dict[str, Look] = {}
    for name, bar in BARS.items():
        length = float(abs(at[bar.end][0] - at[bar.start][0]))
        parts[name] = Cylinder(bar.radius_m, length), Rgba(*bar.colour)
        if name in GHOST:
            ghost = Cylinder(_GHOST_RADIUS * bar.radius_m, length)
            parts[f"reference_{name}"] = ghost, _GHOST_COLOUR
    pins = {f"pin_{name}": (_PIN, _PIN_COLOUR) for name in PINS}
    return parts | pins | {"pin_icr": (_PIN, ICR_COLOUR)}


def icr_path(link: LinkageParameters, depth_m: float = 0.0) -> Array:
    """Path of the instantaneous centre of rotation over 0…90°, in the world, (3, 91) in m."""
    path = points(link, np.radians(np.linspace(0.0, 90.0, 91)))["icr"]
    return np.array([in_world(point, depth_m) for point in path]).T


def in_world(point: complex, depth_m: float) -> Array:
    """A point of the knee's plane in the world, (3,) in m: z up, y away from who looks."""
    return np.array([point.real, depth_m, point.imag])


def depths_m(legs: int) -> list[float]:
    """Depth in m of each of some legs that stand beside each other, the first one nearest."""
    return [(number - 0.5 * (legs - 1)) * _SPACING_M for number in range(legs)]


def look_at_legs(meshcat: Meshcat, legs: int) -> None:
    """Look from the side at legs beside each other, without grid and axes."""
    for path in ("/Grid", "/Axes"):
        meshcat.SetProperty(path, "visible", False)
    distance = 0.55 + 0.5 * _SPACING_M * (legs - 1)
    meshcat.SetCameraPose([0.5 * distance, -distance, 0.05], [-0.04, 0.0, -0.03])


def bar_pose(start: complex, end: complex, depth_m: float) -> RigidTransform:
    """Pose in the world of a bar whose axis is z and whose origin is its middle."""
    rotation = RotationMatrix.MakeFromOneVector(in_world(end - start, 0.0), 2)
    return RigidTransform(rotation, in_world(0.5 * (start + end), depth_m))


def pin_pose(point: complex, depth_m: float) -> RigidTransform:
    """Pose in the world of a pin, whose axis is z, across the knee's plane."""
    return RigidTransform(_ACROSS, in_world(point, depth_m))


def pressure_colours(pressure_pa: Array, largest_pa: float) -> Array:
    """Red, green, blue (n, 3) of pressures (n,): blue at -largest, grey at 0, red at largest."""
    share = np.clip(pressure_pa / (largest_pa or 1.0), -1.0, 1.0)[:, None]
    return np.asarray(_NONE + np.abs(share) * (np.where(share > 0.0, _HIGH, _LOW) - _NONE))
