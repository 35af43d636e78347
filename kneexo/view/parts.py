"""Shapes, colours and poses of the drawn parts of a leg, for all views.

In the world, x points forwards, z up and y away from the viewer. In the frame of a bar, the bar
lies along z and the origin is the bar's middle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Cylinder, Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from kneexo.parameters import LinkageParameters
from kneexo.result import Array
from kneexo.view.mechanism import BARS, GHOST, PINS, Bar, Points, points

ICR_COLOUR = Rgba(0.8, 0.0, 0.5)
"""Colour of the instantaneous centre of rotation and of its path."""

REFERENCE = "reference_"
"""Prefix of the names of the parts that show the reference of the knee angle."""

Look = tuple[Cylinder, Rgba]
"""Shape and colour of a part."""

_GHOST_RADIUS = 0.85  # of that of the bar, which hides its ghost where both agree
_GHOST_COLOUR = Rgba(0.35, 0.35, 0.35, 0.35)
_PIN, _PIN_COLOUR = Cylinder(0.004, 0.052), Rgba(0.15, 0.15, 0.18)
_SPACING_M = 0.30  # distance of legs beside each other
_ALONG = RotationMatrix.MakeYRotation(0.5 * np.pi)
_ACROSS = RotationMatrix.MakeXRotation(0.5 * np.pi)
_TOLERANCE = 1e-9  # m and rad


@dataclass(frozen=True)
class Placement:
    """The positions and directions of one part in the knee's plane at n times."""

    middle: Points
    """Middle of the part at each time, (n,), a complex point of the knee's plane in m."""
    direction: Points | None = None
    """Unit vectors along a bar, (n,), or None for a pin, which stands across the plane."""
    layer_m: float = 0.0
    """Distance of the part from the knee's plane in m, along y of the world."""

    def seen_from(self, frame: Placement) -> Placement:
        """Return the placement relative to a frame, whose x axis is the frame's direction."""
        axis = 1.0 if frame.direction is None else frame.direction
        direction = None if self.direction is None else self.direction / axis
        return Placement((self.middle - frame.middle) / axis, direction, self.layer_m)

    @property
    def is_constant(self) -> bool:
        """Whether positions and directions are constant over time, within 1e-9 m and rad."""
        values = [self.middle] if self.direction is None else [self.middle, self.direction]
        return all(bool(np.abs(v - v[0]).max() < _TOLERANCE) for v in values)

    def frames(self) -> Iterator[RigidTransform]:
        """For each time yield the pose of a frame: origin ``middle``, x axis ``direction``."""
        direction = np.ones_like(self.middle) if self.direction is None else self.direction
        for point, angle in zip(self.middle, -np.angle(direction), strict=True):
            yield RigidTransform(RotationMatrix.MakeYRotation(angle), in_world(point, self.layer_m))

    def poses(self) -> Iterator[RigidTransform]:
        """Yield the pose of the part's shape at each time."""
        axis = RigidTransform(_ACROSS if self.direction is None else _ALONG, np.zeros(3))
        yield from (frame @ axis for frame in self.frames())


def placements(
    linkage: LinkageParameters, knee_angle: ArrayLike, reference: ArrayLike
) -> dict[str, Placement]:
    """Return a dictionary from the name of a part to its placement at n times.

    Knee angles and references (n,) are in rad. The parts are the parts of `shapes`.

    Raises `LinkageError` if the linkage cannot be assembled.
    """
    at, at_reference = points(linkage, knee_angle), points(linkage, reference)
    parts = {name: _of_bar(bar, at) for name, bar in BARS.items()}
    parts |= {f"{REFERENCE}{name}": _of_bar(BARS[name], at_reference) for name in GHOST}
    return parts | {f"pin_{name}": Placement(at[name]) for name in (*PINS, "icr")}


def _of_bar(bar: Bar, at: dict[str, Points]) -> Placement:
    start, end = at[bar.start], at[bar.end]
    return Placement(0.5 * (start + end), (end - start) / np.abs(end - start), bar.layer_m)


def shapes(linkage: LinkageParameters) -> dict[str, Look]:
    """Return a dictionary from the name of a part to its shape and colour.

    The parts are bars, pins ``pin_…``, and ghosts ``reference_…`` of bars at the reference.

    Raises `LinkageError` if the linkage cannot be assembled.
    """
    at = points(linkage, 0.0)
    parts: dict[str, Look] = {}
    for name, bar in BARS.items():
        length = float(abs(at[bar.end][0] - at[bar.start][0]))
        parts[name] = Cylinder(bar.radius_m, length), Rgba(*bar.colour)
        if name in GHOST:
            ghost = Cylinder(_GHOST_RADIUS * bar.radius_m, length)
            parts[f"{REFERENCE}{name}"] = ghost, _GHOST_COLOUR
    pins = {f"pin_{name}": (_PIN, _PIN_COLOUR) for name in PINS}
    return parts | pins | {"pin_icr": (_PIN, ICR_COLOUR)}


def icr_path(linkage: LinkageParameters, depth_m: float = 0.0) -> Array:
    """Return the path of the instantaneous centre of rotation at knee angles 0…90°, (3, 91) in m.

    ``depth_m`` is the y coordinate of the knee's plane. Raises `LinkageError` as `shapes` does.
    """
    path = points(linkage, np.radians(np.linspace(0.0, 90.0, 91)))["icr"]
    return np.array([in_world(point, depth_m) for point in path]).T


def in_world(point: complex, depth_m: float) -> Array:
    """Return a point of the knee's plane in world coordinates (x, ``depth_m``, z) in m."""
    return np.array([point.real, depth_m, point.imag])


def depths_m(legs: int) -> list[float]:
    """Return the y coordinates in m of ``legs`` legs beside each other, the nearest leg first."""
    return [(number - 0.5 * (legs - 1)) * _SPACING_M for number in range(legs)]


def look_at_legs(meshcat: Meshcat, legs: int) -> None:
    """Let the camera see ``legs`` legs beside each other from the side. Hide grid and axes."""
    for path in ("/Grid", "/Axes"):
        meshcat.SetProperty(path, "visible", False)
    distance = 0.55 + 0.5 * _SPACING_M * (legs - 1)
    meshcat.SetCameraPose([0.5 * distance, -distance, 0.05], [-0.04, 0.0, -0.03])
