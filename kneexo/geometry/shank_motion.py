"""Motion of a shank relative to its thigh, of a linkage or of an anatomical knee.

All coordinates are in the frame of the thigh: x points backwards, y points to the hip, and flexion
is counter-clockwise. The origin of a linkage is its nominal knee axis. The origin of an anatomical
knee lies on the line down from the hip (x = 0 of the femur), as high as the tibia's origin at full
extension. Points are complex numbers x + jy in m, angles are in rad.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kneexo.common.result import Array, Result
from kneexo.errors import ParameterError
from kneexo.geometry.linkage import pose, shank_is_ground
from kneexo.parameters import AnatomicalKneeParameters, LinkageParameters

Points = NDArray[np.complex128]
"""Type of an array of points in m."""


@dataclass(frozen=True, repr=False)
class ShankMotion(Result):
    """Motion of a shank, all arrays (n,): a point z of its frame moves along t(θ) + z e^{jθ}."""

    knee_angle: Array
    """Flexion θ in rad."""
    translation: Points
    """Translation t in m."""
    rate: Points
    """Derivative dt/dθ in m."""

    @property
    def turn(self) -> Points:
        """Rotation e^{jθ} of the shank."""
        return np.asarray(np.exp(1j * self.knee_angle))

    @property
    def fixed_centrode(self) -> Points:
        """Instantaneous centre of rotation in the frame of the thigh, t + j dt/dθ, in m.

        The centre is the point of the shank at rest: dt/dθ + jz e^{jθ} = 0 (McCarthy and Soh,
        Geometric Design of Linkages, 2011).
        """
        return self.translation + 1j * self.rate

    @property
    def moving_centrode(self) -> Points:
        """Instantaneous centre of rotation in the frame of the shank, j dt/dθ e^{−jθ}, in m."""
        return np.asarray(1j * self.rate * np.conj(self.turn))


def linkage_motion(link: LinkageParameters, knee_angle: ArrayLike) -> ShankMotion:
    """Return the motion of the shank that a linkage guides, at knee angles (n,) in rad.

    If the thigh is the ground link, the coupler is fixed to the shank. If the shank is the ground
    link, the coupler is fixed to the thigh. The motion is then the inverse of the motion of the
    coupler, with x mirrored. Raises `LinkageError` as `kneexo.geometry.linkage.pose` does.
    """
    now, straight = pose(link, np.atleast_1d(knee_angle)), pose(link, 0.0)
    turn = np.exp(1j * now.knee_angle)
    joint_b, start = now.joint_b, straight.joint_b
    joint_b_rate = 1j * (joint_b - complex(link.o_b_x_m, link.o_b_y_m)) / now.encoder_sensitivity
    translation, rate = joint_b - start * turn, joint_b_rate - 1j * start * turn
    if shank_is_ground(link):
        # The inverse of z ↦ t + z e^{jθ} turns by −θ; the mirror x → −x makes it +θ again.
        rate = np.conj(rate / turn - 1j * translation / turn)
        translation = np.conj(translation / turn)
    return ShankMotion(now.knee_angle, np.asarray(translation), np.asarray(rate))


@lru_cache(maxsize=64)
def _splines(knee: AnatomicalKneeParameters) -> tuple[Any, Any]:
    from scipy.interpolate import CubicSpline

    return (
        CubicSpline(knee.anterior_angles_rad, knee.anterior_m, bc_type="natural"),
        CubicSpline(knee.up_angles_rad, knee.up_m, bc_type="natural"),
    )


def anatomical_motion(knee: AnatomicalKneeParameters, knee_angle: ArrayLike) -> ShankMotion:
    """Return the motion of the shank of a wearer, at knee angles (n,) in rad.

    The translation (−x, y − y_0) is the motion of the tibia's origin, with x forwards and y up. The
    value y_0 is y at full extension. Raises `ParameterError` for a knee angle without nodes.
    """
    angle = np.atleast_1d(np.asarray(knee_angle, dtype=float))
    low, high = knee.range_rad
    if np.any(bad := ~((angle >= low) & (angle <= high))):
        raise ParameterError(
            f"knee: has nodes over {np.degrees(low):.4g} … {np.degrees(high):.4g} deg of flexion, "
            f"must have them at {np.degrees(angle[bad][0]):.4g} deg; add nodes, or rows to the "
            f"knee's file"
        )
    anterior, up = _splines(knee)
    return ShankMotion(
        knee_angle=angle,
        translation=knee.size * (-anterior(angle) + 1j * (up(angle) - up(0.0))),
        rate=knee.size * (-anterior(angle, 1) + 1j * up(angle, 1)),
    )
