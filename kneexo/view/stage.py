"""Describes legs as data for the stage, the drawing of moving legs in web pages.

``stage.js`` has no equation of the linkage. It interpolates the poses of frames in tables over the
knee angle.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Shape
from scipy.spatial import ConvexHull

from kneexo.analysis.mechanism.alignment import align
from kneexo.common.result import Array
from kneexo.geometry.shank_motion import anatomical_motion
from kneexo.parameters import LinkageParameters
from kneexo.view.parts import Part, icr_path, parts, placements
from kneexo.view.pressure_colour import BLUE, GREY, RED

STAGE_STYLES = ("view/web/vendor/uPlot.min.css", "view/web/stage.css")
"""Names of the stage's style sheets for `kneexo.view.web_page.web_text`."""

STAGE_SCRIPTS = (
    "view/web/vendor/three.min.js",
    "view/web/vendor/uPlot.iife.min.js",
    "view/web/stage_model.js",
    "view/web/stage_solid.js",
    "view/web/stage_flat.js",
    "view/web/stage_arrow.js",
    "view/web/stage_elements.js",
    "view/web/stage.js",
)
"""Names of the stage's scripts in order, for `kneexo.view.web_page.web_text`."""

_STEP_RAD = math.radians(1.0)  # linear interpolation is then within 0.1 mm


def stage_leg(
    name: str,
    linkage: LinkageParameters,
    low_rad: float,
    high_rad: float,
    pressure_rating_pa: float,
) -> dict[str, Any]:
    """Return one leg as JSON-able data for ``new Stage(element, {legs: [leg, …]})``.

    Parameters
    ----------
    name
        The title of the leg, plain text.
    linkage
        Geometry of the linkage.
    low_rad, high_rad
        Range of the knee angles that the stage will show, in rad. The range 0…90° is always
        included.
    pressure_rating_pa
        Load pressure in Pa at which the cylinder has its full colour.

    Raises
    ------
    LinkageError
        The linkage cannot be assembled within the range.
    """
    low_rad, high_rad = min(low_rad, 0.0), max(high_rad, 0.5 * math.pi)
    angles = np.linspace(low_rad, high_rad, math.ceil((high_rad - low_rad) / _STEP_RAD) + 1)
    leg_parts = parts(linkage)
    joint = [part for part in leg_parts.values() if part.frame in ("link_2", "link_4", "icr")]
    tables = {}
    for frame, placement in placements(linkage, angles, angles).items():
        x_m, y_m = placement.origin.real, placement.origin.imag
        angle_rad = np.unwrap(np.angle(placement.direction))
        tables[frame] = pack(np.stack([x_m, y_m, angle_rad], axis=1))
    return {
        "name": name,
        "rating_pa": pressure_rating_pa,
        "low_rad": low_rad,
        "high_rad": high_rad,
        "rows": len(angles),
        "frames": tables,
        "parts": [_part(part_name, part) for part_name, part in leg_parts.items()],
        "centre_paths": _centre_paths(linkage),
        "pressure_colours": np.array([BLUE, GREY, RED]).tolist(),
        "hull": _hull(linkage, leg_parts.values(), angles),
        "joint_hull": _hull(linkage, joint, angles),
    }


def _centre_paths(linkage: LinkageParameters) -> list[dict[str, Any]]:
    """Return the paths of the centres of rotation of the linkage and of a wearer's knee, as data.

    The wearer's path is relative to a device at its best place
    (`kneexo.analysis.mechanism.alignment.align`).
    """
    best = align(linkage)
    wearer = anatomical_motion(best.knee, np.radians(best.knee_angle_deg))
    centre = wearer.fixed_centrode - best.placement.position  # x points backwards
    return [
        {
            "colour": "#cc0080",
            "label": "path of the instantaneous centre of rotation, 0…90°",
            "points": np.round(icr_path(linkage)[[0, 2]].T, 6).tolist(),
        },
        {
            "colour": "#1b7a3d",
            "label": "path of the centre of an anatomical knee (gait2392) at its best place: "
            f"the strap migrates by {best.rms_mm:.2g} mm (rms)",
            "points": np.round(np.stack([-centre.real, centre.imag], axis=1), 6).tolist(),
        },
    ]


def pack(values: ArrayLike) -> str:
    """Return numbers as text, which `Stage.unpack` reads: float32, little-endian, in base64."""
    return base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode()


def _part(name: str, part: Part) -> dict[str, Any]:
    rotation = part.pose.rotation().ToQuaternion()
    colour = part.colour
    return {
        "name": name,
        "frame": part.frame,
        "shape": type(part.shape).__name__.lower(),
        "size": _size(part.shape),
        "position": np.round(part.pose.translation(), 9).tolist(),
        "quaternion": [rotation.x(), rotation.y(), rotation.z(), rotation.w()],
        "colour": [colour.r(), colour.g(), colour.b(), colour.a()],
        "role": part.role,
    }


def _size(shape: Shape) -> list[float]:
    """Return radius and length, or the half axes of an ellipsoid, or the sides of a box, in m."""
    if isinstance(shape, Cylinder | Capsule):
        return [shape.radius(), shape.length()]
    if isinstance(shape, Ellipsoid):
        return [shape.a(), shape.b(), shape.c()]
    assert isinstance(shape, Box)
    return list(shape.size())


def _half_sides(shape: Shape) -> Array:
    """Return half the sides of the box around a shape, (3,) in m."""
    size = np.array(_size(shape))
    if isinstance(shape, Cylinder | Capsule):
        radius, length = size
        caps = radius if isinstance(shape, Capsule) else 0.0
        return np.array([radius, radius, 0.5 * length + caps])
    return size if isinstance(shape, Ellipsoid) else 0.5 * size


def _hull(linkage: LinkageParameters, drawn: Iterable[Part], angles: Array) -> list[list[float]]:
    """Return points (n, 3) in m whose convex hull contains the parts at all knee angles."""
    every_few = angles[:: max(1, len(angles) // 12)]  # between them the parts hardly move
    frames = placements(linkage, every_few, every_few)
    poses = {name: list(placement.poses()) for name, placement in frames.items()}
    signs = np.array(list(product((-1, 1), repeat=3)))
    corners = []
    for part in drawn:
        corners_of_part = part.pose.multiply((signs * _half_sides(part.shape)).T)
        corners += [pose.multiply(corners_of_part) for pose in poses[part.frame]]
    points = np.hstack(corners).T
    return np.round(points[ConvexHull(points).vertices], 4).tolist()
