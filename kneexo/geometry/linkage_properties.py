"""Kinematic properties of a four-bar knee: mobility, Grashof class, limits, and angles of links.

Rod and encoder stand still at some knee angles, and the links close only at some. Motion is that of
the branch ``link.branch``, from a knee angle of 45° on, which lies within every range of motion.
Sources: McCarthy and Soh, Geometric Design of Linkages, 2011, Chapter 2; Uicker, Pennock and
Shigley, Theory of Machines and Mechanisms, 2017, Chapter 1. All arguments are in SI units.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from kneexo.common.result import Array, Result
from kneexo.geometry.linkage import moment_arm, pose, shank_is_ground, wrap
from kneexo.parameters import LinkageParameters

MOBILITY = 3 * (6 - 1) - 2 * 7
"""Degrees of freedom of the knee, 3(n − 1) − 2j by Grübler's equation.

The n = 6 bodies are ground, link 2, coupler, link 4, rod and cylinder. The j = 7 joints are the
four of the four-bar, the pins of rod and cylinder, and the sliding of the rod in the cylinder.
Without rod and cylinder the four-bar has one degree of freedom too, 3(4 − 1) − 2·4.
"""

CHANGE_POINT_TOLERANCE_M = 1e-6
"""A linkage with a smaller Grashof margin is a change point. The tolerance is below that of any
bearing, and above the rounding of lengths in a file. A shorter ground link makes a hinge."""

_MIDDLE = np.pi / 4.0  # `pose` counts θ_4 from its value at this knee angle


@dataclass(frozen=True, repr=False)
class OverMotion(Result):
    """Values (n,) over a motion, the ``least`` of them, and the knee angle where it is."""

    least: float
    at_deg: float
    values: Array = field(repr=False)


@dataclass(frozen=True, repr=False)
class LinkageProperties(Result):
    """Properties of a linkage over a motion (n,). `linkage_properties` computes them."""

    mobility: int
    """Degrees of freedom, `MOBILITY`."""
    grashof_margin_m: float
    """The value of `grashof_margin`, positive if a link turns fully."""
    thigh_as_ground: str
    """Name of the inversion that is seen from the thigh, such as ``double rocker``."""
    shank_as_ground: str
    """Name of the inversion that is seen from the shank."""
    assembly_limits_deg: tuple[float, ...]
    """Knee angles within −135…225° beyond which the links do not close. Empty if there are none."""
    rod_dead_centres_deg: tuple[float, ...]
    """Knee angles at which the rod stands still, up to the nearest limits of assembly."""
    encoder_reversals_deg: tuple[float, ...]
    """Knee angles at which the encoder's link 4 stands still, up to the nearest limits."""
    branch_defects: tuple[str, ...]
    """A line for each knee angle within the motion at which branches meet.

    There the links, the rod's length or the encoder's angle belong to two motions. If the tuple is
    empty, the whole motion lies on one branch.
    """
    knee_angle_deg: Array
    """Knee angles of the motion."""
    transmission_angle_deg: OverMotion
    """Angle of 0…90° between the lines of links 2 and 4.

    Because the coupler is driven, the links jam where this angle is zero.
    """
    coupler_link_2_deg: OverMotion
    """Angle of 0…90° between the lines of coupler and link 2. At zero the encoder reverses."""
    coupler_link_4_deg: OverMotion
    """Angle of 0…90° between the lines of coupler and link 4. At zero link 2 stands still."""
    rod_arm_m: OverMotion
    """Moment arm of the rod. At zero the rod has a dead centre."""


def linkage_properties(
    link: LinkageParameters, knee_angle: ArrayLike | None = None
) -> LinkageProperties:
    """Compute the kinematic properties of a linkage over a motion.

    Parameters
    ----------
    link
        The linkage. A hinge is a linkage whose ground joints are at one place.
    knee_angle
        Knee angles of the motion in rad, (n,). By default 901 angles of 0…90°.

    Raises
    ------
    LinkageError
        The links do not close at one of the knee angles. The message names the length to change.
    """
    motion = np.radians(np.linspace(0.0, 90.0, 901)) if knee_angle is None else knee_angle
    poses = pose(link, np.atleast_1d(motion))
    knee_angle_deg = np.degrees(poses.knee_angle)

    def over_motion(values: Array) -> OverMotion:
        least = int(np.argmin(values))
        return OverMotion(float(values[least]), float(knee_angle_deg[least]), values)

    def angle_between(angle: Array, other: Array) -> OverMotion:
        return over_motion(np.degrees(np.arcsin(np.abs(np.sin(angle - other)))))

    branch_points = {
        "links 2 and 4 are parallel": _in_degrees(assembly_limits(link)),
        "the rod has a dead centre": _in_degrees(rod_dead_centres(link)),
        "the encoder reverses": _in_degrees(encoder_reversals(link)),
    }
    limits, dead_centres, reversals = branch_points.values()
    seen_from_ground, seen_from_coupler = inversions(link)
    ground_is_shank = shank_is_ground(link)
    return LinkageProperties(
        mobility=MOBILITY,
        grashof_margin_m=grashof_margin(link),
        thigh_as_ground=seen_from_coupler if ground_is_shank else seen_from_ground,
        shank_as_ground=seen_from_ground if ground_is_shank else seen_from_coupler,
        assembly_limits_deg=limits,
        rod_dead_centres_deg=dead_centres,
        encoder_reversals_deg=reversals,
        branch_defects=tuple(
            f"{event} at knee angle {angle:.4g} deg"
            for event, angles in branch_points.items()
            for angle in angles
            if knee_angle_deg.min() <= angle <= knee_angle_deg.max()
        ),
        knee_angle_deg=knee_angle_deg,
        transmission_angle_deg=angle_between(poses.theta_4, poses.theta_2),
        coupler_link_2_deg=angle_between(poses.theta_3, poses.theta_2),
        coupler_link_4_deg=angle_between(poses.theta_3, poses.theta_4),
        rod_arm_m=over_motion(poses.moment_arm),
    )


# --------------------------------------------------------------------------- Grashof class


def _ground(link: LinkageParameters) -> tuple[float, float]:
    """Return length in m and direction in rad of the ground link, from O_A to O_B."""
    vector = complex(link.o_b_x_m - link.o_a_x_m, link.o_b_y_m - link.o_a_y_m)
    return abs(vector), float(np.angle(vector))


def grashof_margin(link: LinkageParameters) -> float:
    """Return by how much a linkage obeys Grashof's condition, p + q − l_max − l_min in m.

    The other two links have the lengths p and q. If the margin is positive, the shortest link turns
    fully relative to all others. If the margin is negative, no link turns fully.
    """
    lengths = sorted((_ground(link)[0], link.a_2_m, link.a_3_m, link.a_4_m))
    return lengths[1] + lengths[2] - lengths[3] - lengths[0]


def inversions(link: LinkageParameters) -> tuple[str, str]:
    """Return the names of a linkage as seen from its ground link, and as seen from its coupler.

    The names are ``double crank`` (drag link, the shortest link is the ground), ``crank rocker``,
    ``double rocker`` (the shortest link is the coupler), ``triple rocker`` (Grashof's condition is
    not met), ``change point``, and ``hinge`` (the ground joints are at one place).
    """
    ground, margin = _ground(link)[0], grashof_margin(link)
    if ground <= CHANGE_POINT_TOLERANCE_M:
        return "hinge", "hinge"
    if abs(margin) <= CHANGE_POINT_TOLERANCE_M:
        return "change point", "change point"
    if margin < 0.0:
        return "triple rocker", "triple rocker"
    shortest = min(ground, link.a_2_m, link.a_3_m, link.a_4_m)
    if shortest == ground:
        return "double crank", "double rocker"
    if shortest == link.a_3_m:
        return "double rocker", "double crank"
    return "crank rocker", "crank rocker"


# ------------------------------------------------- knee angles at which something stands still


def assembly_limits(link: LinkageParameters) -> Array:
    """Return the knee angles in rad beyond which the links do not close, sorted, (0,) to (4,).

    The angles lie within ±180° of 45°, from where `pose` counts θ_4. At a limit links 2 and 4 are
    parallel, so that they span a distance of a_2 + a_4 or |a_2 − a_4|.
    """
    ground, direction = _ground(link)
    diagonals = np.array([link.a_2_m + link.a_4_m, link.a_2_m - link.a_4_m])
    angles = direction + link.phi_rad + _triangle_angles(ground, link.a_3_m, diagonals)
    return _about_middle(angles)


def encoder_reversals(link: LinkageParameters) -> Array:
    """Return the knee angles in rad at which link 4, and so the encoder, stands still, sorted.

    Coupler and link 2 are parallel there, so that joint B is a_2 ± a_3 away from O_A. The angles
    belong to the branch of the linkage and lie between its nearest `assembly_limits`.
    """
    ground, direction = _ground(link)
    reach = np.array([link.a_2_m + link.a_3_m, link.a_2_m - link.a_3_m])
    theta_2 = direction + _triangle_angles(ground, reach, link.a_4_m)
    link_4 = reach * np.exp(1j * theta_2) - ground * np.exp(1j * direction)
    on_branch = link.branch * np.sin(np.angle(link_4) - theta_2) > 0.0
    # The coupler points along link 2 where B is a_2 + a_3 away from O_A, else against link 2.
    angles = _about_middle((theta_2 + np.array([0.0, np.pi]) + link.phi_rad)[on_branch])
    low, high = _motion_interval(link)
    return angles[(angles > low) & (angles < high)]


def rod_dead_centres(link: LinkageParameters) -> Array:
    """Return the knee angles in rad at which the rod's moment arm changes its sign, sorted.

    The angles lie between the `assembly_limits` next to 45°, within ±180° of 45°. A search compares
    the signs at 7200 angles, which are at most 0.08° apart. So the search can miss two dead centres
    that are closer. Raises `LinkageError` if the links do not close at 45°.
    """
    low, high = _motion_interval(link)
    # Steps become short at the limits, where the arm is infinite.
    turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 7202)[1:-1]
    angles = 0.5 * (low + high) + 0.5 * (high - low) * np.sin(turn)
    positive = moment_arm(link, angles) > 0.0
    before = np.flatnonzero(positive[1:] != positive[:-1])
    left, right = angles[before], angles[before + 1]
    for _ in range(30):  # bisection, to 1e-12 rad
        middle = 0.5 * (left + right)
        same = (moment_arm(link, middle) > 0.0) == positive[before]
        left, right = np.where(same, middle, left), np.where(same, right, middle)
    return left


def _triangle_angles(side: float, other: ArrayLike, opposite: ArrayLike) -> Array:
    """Return ± the angle in rad between two sides of triangles, (2, 2); nan without a triangle.

    Columns are the two triangles, rows the two signs.
    """
    other, opposite = np.asarray(other), np.asarray(opposite)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = (side**2 + other**2 - opposite**2) / (2.0 * side * other)
        # Rounding must not hide triangles of no area, which are change points.
        angle = np.arccos(np.where(np.abs(cosine) < 1.0 + 1e-12, np.clip(cosine, -1, 1), np.nan))
    return np.array([-angle, angle])


def _about_middle(angles: Array) -> Array:
    """Return the angles in rad that are not nan, within ±π of `_MIDDLE`, sorted."""
    return np.sort(_MIDDLE + wrap(angles[np.isfinite(angles)] - _MIDDLE))


def _motion_interval(link: LinkageParameters) -> tuple[float, float]:
    """Return the knee angles in rad, below and above 45°, up to which the links close."""
    limits = np.concatenate([[_MIDDLE - np.pi], assembly_limits(link), [_MIDDLE + np.pi]])
    return float(limits[limits < _MIDDLE][-1]), float(limits[limits > _MIDDLE][0])


def _in_degrees(angles: Array) -> tuple[float, ...]:
    return tuple(np.degrees(angles).tolist())
