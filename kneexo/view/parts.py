"""Shapes, colours and poses of the drawn parts of a leg, for all views.

In the world, x points forwards, z up and y away from the viewer. Each part is fixed to a frame, and
the frames move with the knee angle. The poses in this module hold at full extension.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Meshcat, Rgba, Shape
from pydrake.math import RigidTransform, RotationMatrix

from kneexo.common.result import Array
from kneexo.parameters import LinkageParameters
from kneexo.view.mechanism import BARS, FRAMES, LIMB_LAYER_M, PINS, Points, points

ICR_COLOUR = Rgba(0.8, 0.0, 0.5)
"""Colour of the instantaneous centre of rotation and of its path."""

REFERENCE = "reference"
"""Name of the shank's frame at the reference. The names of its parts begin with this word."""

WEARER = "wearer"
"""Name of the frame of the limb below the knee. Without a wearer it moves as ``shank``."""

SKIN, GHOST = "skin", "ghost"
"""Roles of parts. Skin is translucent, a ghost shows the reference."""

_SKIN_COLOUR, _GHOST_COLOUR = Rgba(0.86, 0.68, 0.56, 0.5), Rgba(0.35, 0.35, 0.35, 0.35)
_BRACE, _CUFF, _SOLE = Rgba(0.25, 0.28, 0.33), Rgba(0.16, 0.18, 0.22), Rgba(0.20, 0.20, 0.22)
_PIN, _PIN_COLOUR = Cylinder(0.003, 0.056), Rgba(0.15, 0.15, 0.18)
_ICR = Cylinder(0.002, 0.06)
_UPRIGHT_LAYER_M = 0.028  # behind the brackets, in front of the limb
_INSET_M = 0.002  # equal surfaces of skin and ghost would flicker
_SPACING_M = 0.30  # distance of legs beside each other
_ACROSS = RotationMatrix.MakeXRotation(0.5 * np.pi)  # a cylinder lies across the leg


@dataclass(frozen=True)
class Part:
    """One drawn part, fixed to a frame."""

    frame: str
    shape: Shape
    pose: RigidTransform
    """Pose of the shape in its frame."""
    colour: Rgba
    role: str = "solid"


@dataclass(frozen=True)
class Placement:
    """Positions and directions of a frame in the plane of the linkage at n times."""

    origin: Points
    """Origin of the frame at each time, (n,), complex points in m."""
    direction: Points
    """Unit vectors along the x axis of the frame, (n,)."""

    def poses(self) -> Iterator[RigidTransform]:
        """Yield the pose of the frame in the world at each time."""
        for point, angle in zip(self.origin, -np.angle(self.direction), strict=True):
            yield RigidTransform(RotationMatrix.MakeYRotation(angle), in_world(point, 0.0))


def placements(
    linkage: LinkageParameters,
    knee_angle: ArrayLike,
    reference: ArrayLike,
    wearer: ArrayLike | None = None,
) -> dict[str, Placement]:
    """Return a dictionary from the name of a frame to its placement at n times.

    The frames are the frames in `FRAMES`, ``icr``, ``reference`` and ``wearer``. Angles (n,) of the
    knee, the reference and the wearer's knee are in rad. If ``wearer`` is None, the wearer's shank
    moves with the knee angle. Raises `LinkageError` if the linkage cannot be assembled.
    """
    at = points(linkage, knee_angle)
    frames = {name: _placement(at, name) for name in FRAMES}
    frames["icr"] = Placement(at["icr"], np.ones_like(at["icr"]))
    frames[REFERENCE] = _placement(points(linkage, reference), "shank")
    at_wearer = at if wearer is None else points(linkage, wearer)
    frames[WEARER] = _placement(at_wearer, "shank")
    return frames


def _placement(at: dict[str, Points], frame: str) -> Placement:
    origin, other = (at[name] for name in FRAMES[frame])
    return Placement(origin, (other - origin) / np.abs(other - origin))


def parts(linkage: LinkageParameters) -> dict[str, Part]:
    """Return a dictionary from the name of a part to the part.

    Bars and pins have the lengths and places of the linkage. Limbs, brace, pump and motor are
    illustrative. Raises `LinkageError` if the linkage cannot be assembled.
    """
    at = {name: complex(values[0]) for name, values in points(linkage, 0.0).items()}
    result: dict[str, Part] = {}
    for name, bar in BARS.items():
        length = max(abs(at[bar.end] - at[bar.start]), 1e-12)  # the ground link of a hinge has none
        side = 2.0 * bar.radius_m
        shape = Box(side, side, length) if bar.is_flat else Cylinder(bar.radius_m, length)
        pose = _between(at[bar.start], at[bar.end], bar.layer_m)
        frame = WEARER if name in ("shank", "foot") else bar.frame  # the bones
        result[name] = Part(frame, shape, pose, Rgba(*bar.colour))
    for name, frame in PINS.items():
        pose = RigidTransform(_ACROSS, in_world(at[name], 0.0))
        result[f"pin_{name}"] = Part(frame, _PIN, pose, _PIN_COLOUR)
    pose = RigidTransform(_ACROSS, in_world(at["icr"], 0.0))
    result["pin_icr"] = Part("icr", _ICR, pose, ICR_COLOUR)
    result |= _skin() | _brace(at) | _drive(at)
    # The poses so far are in the world at full extension; now they become those in the frames.
    straight = {name: next(p.poses()) for name, p in placements(linkage, 0.0, 0.0).items()}
    result = {
        name: replace(part, pose=straight[part.frame].inverse() @ part.pose)
        for name, part in result.items()
    }
    ghosts = {
        f"{REFERENCE}_{name}": Part(REFERENCE, _shrunk(part.shape), part.pose, _GHOST_COLOUR, GHOST)
        for name, part in result.items()
        if part.role == SKIN and part.frame == WEARER
    }
    return result | ghosts


def _shrunk(shape: Shape) -> Shape:
    """Return a smaller shape, which lies inside the skin if knee angle and reference are equal."""
    if isinstance(shape, Capsule):
        return Capsule(shape.radius() - _INSET_M, shape.length())
    assert isinstance(shape, Ellipsoid)
    return Ellipsoid(shape.a() - _INSET_M, shape.b() - _INSET_M, shape.c() - _INSET_M)


def _between(start: complex, end: complex, layer_m: float) -> RigidTransform:
    """Return the pose in the middle of two points, with z axis from ``start`` to ``end``."""
    way = end - start
    turn = RotationMatrix.MakeYRotation(np.arctan2(way.real, way.imag))
    return RigidTransform(turn, in_world(0.5 * (start + end), layer_m))


def _at(x: float, z: float, layer_m: float = LIMB_LAYER_M) -> RigidTransform:
    """Return the pose at the point (x, z) of a layer, without rotation."""
    return RigidTransform(in_world(complex(x, z), layer_m))


def _skin() -> dict[str, Part]:
    """Return thigh, shank and foot in the pose of full extension."""
    forwards = _between(0.03 - 0.374j, 0.13 - 0.374j, LIMB_LAYER_M)
    limbs = {
        "upper_thigh": ("thigh", Ellipsoid(0.072, 0.070, 0.190), _at(0.004, 0.21)),
        "lower_thigh": ("thigh", Capsule(0.050, 0.14), _at(0.0, 0.10)),
        "knee": ("thigh", Ellipsoid(0.053, 0.050, 0.060), _at(0.004, 0.003)),
        "calf": (WEARER, Ellipsoid(0.050, 0.050, 0.125), _at(-0.014, -0.13)),
        "shin": (WEARER, Capsule(0.036, 0.26), _at(0.0, -0.19)),
        "heel": (WEARER, Ellipsoid(0.075, 0.040, 0.038), _at(0.015, -0.358)),
        "toes": (WEARER, Capsule(0.024, 0.10), forwards),
    }
    return {name: Part(*limb, _SKIN_COLOUR, SKIN) for name, limb in limbs.items()}


def _brace(at: dict[str, complex]) -> dict[str, Part]:
    """Return uprights, cuffs and sole in the pose of full extension."""
    top = max(0.30, at["thigh_axis"].imag)
    bottom = min(-0.27, at["shank_axis"].imag)
    result = {}
    for frame, low, high in (("thigh", 0.0, top), ("shank", bottom, 0.0)):
        pose = _at(0.0, 0.5 * (low + high), _UPRIGHT_LAYER_M)
        result[f"{frame}_upright"] = Part(frame, Box(0.020, 0.006, high - low), pose, _BRACE)
    for name, frame, radius, x, z in (
        ("upper_thigh_cuff", "thigh", 0.075, 0.004, 0.265),
        ("lower_thigh_cuff", "thigh", 0.067, 0.004, 0.115),
        ("upper_shank_cuff", "shank", 0.057, -0.010, -0.115),
        ("lower_shank_cuff", "shank", 0.044, -0.002, -0.235),
    ):
        result[name] = Part(frame, Cylinder(radius, 0.035), _at(x, z), _CUFF)
        near = LIMB_LAYER_M - radius
        mount = Box(0.024, near - _UPRIGHT_LAYER_M + 0.012, 0.03)
        pose = _at(0.0, z, 0.5 * (near + _UPRIGHT_LAYER_M))
        result[f"{name}_mount"] = Part(frame, mount, pose, _BRACE)
    result["sole"] = Part("shank", Box(0.205, 0.085, 0.012), _at(0.045, -0.402), _SOLE)
    return result


def _drive(at: dict[str, complex]) -> dict[str, Part]:
    """Return pump, gear and motor behind the cylinder, in the pose of full extension."""
    way = at["rod_pin"] - at["cylinder_pin"]
    along = way / abs(way)
    behind = 1j * along if (1j * along).real < 0.0 else -1j * along

    def part(start_m: float, end_m: float, radius_m: float, colour: Rgba) -> Part:
        axis = at["cylinder_pin"] + 0.043 * behind
        pose = _between(axis + start_m * along, axis + end_m * along, 0.0)
        return Part("cylinder", Cylinder(radius_m, end_m - start_m), pose, colour)

    block = at["cylinder_pin"] + 0.022 * behind
    pose = _between(block + 0.025 * along, block + 0.065 * along, 0.0)
    return {
        "valve_block": Part("cylinder", Box(0.022, 0.024, 0.04), pose, Rgba(0.55, 0.58, 0.62)),
        "pump": part(0.02, 0.07, 0.019, Rgba(0.42, 0.47, 0.50)),
        "gear": part(0.07, 0.095, 0.015, Rgba(0.70, 0.72, 0.75)),
        "motor": part(0.095, 0.16, 0.017, Rgba(0.20, 0.23, 0.28)),
    }


def icr_path(linkage: LinkageParameters, depth_m: float = 0.0) -> Array:
    """Return the path of the instantaneous centre of rotation at knee angles 0…90°, (3, 91) in m.

    ``depth_m`` is the y coordinate of the plane. Raises `LinkageError` as `parts` does.
    """
    path = points(linkage, np.radians(np.linspace(0.0, 90.0, 91)))["icr"]
    return np.array([in_world(point, depth_m) for point in path]).T


def in_world(point: complex, depth_m: float) -> Array:
    """Return a point of the plane in world coordinates (x, ``depth_m``, z) in m."""
    return np.array([point.real, depth_m, point.imag])


def depths_m(legs: int) -> list[float]:
    """Return the y coordinates in m of ``legs`` legs beside each other, the nearest leg first."""
    return [(number - 0.5 * (legs - 1)) * _SPACING_M for number in range(legs)]


def look_at_legs(meshcat: Meshcat, legs: int) -> None:
    """Let the camera see ``legs`` legs beside each other from the side. Hide grid and axes."""
    for path in ("/Grid", "/Axes"):
        meshcat.SetProperty(path, "visible", False)
    distance = 0.62 + 0.5 * _SPACING_M * (legs - 1)
    meshcat.SetCameraPose([0.5 * distance, -distance, 0.05], [-0.04, 0.0, -0.03])
