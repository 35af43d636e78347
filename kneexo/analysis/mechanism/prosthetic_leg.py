"""Length, toe clearance and stance of a leg whose knee is a linkage, as a prosthesis has it.

A worn exoskeleton does not shorten the wearer's leg: the wearer's own knee sets its length. The
numbers for a linkage hold if the linkage were the leg. For the wearer they hold with an
`AnatomicalKneeParameters`. Coordinates are those of `kneexo.geometry.shank_motion`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kneexo.common.result import Array, Result
from kneexo.geometry.shank_motion import Points, ShankMotion, anatomical_motion, linkage_motion
from kneexo.parameters import AnatomicalKneeParameters, LinkageParameters, WalkingLegParameters
from kneexo.parameters.task.gait import gait_knee_flexion

Knee = LinkageParameters | AnatomicalKneeParameters
"""Type of the knee of a leg: a linkage, if it were the leg, or a wearer's own."""


@dataclass(frozen=True, repr=False)
class LegLength(Result):
    """Distance from hip to ankle over the knee angle, all arrays (n,)."""

    knee_angle_deg: Array
    distance_m: Array
    hinge_distance_m: Array
    """Distance of a leg whose knee is a hinge at the origin."""

    @property
    def shortening_m(self) -> Array:
        """Length of the leg with a hinge as knee, minus the length of the leg with the linkage."""
        return self.hinge_distance_m - self.distance_m


@dataclass(frozen=True, repr=False)
class SwingClearance(Result):
    """Height of the toe in swing if the linkage were the knee of a prosthesis. Arrays are (n,)."""

    gait_percent: Array
    """Time after heel contact in % of the gait cycle."""
    knee_angle_deg: Array
    """Measured flexion of the knee, of `kneexo.parameters.task.gait.gait_knee_flexion`."""
    thigh_flexion_deg: Array
    """Flexion of the thigh from the vertical, an assumption of `WalkingLegParameters`."""
    toe_depth_m: Array
    """How far the toe is below the hip."""
    hinge_toe_depth_m: Array
    """How far the toe is below the hip if the knee is a hinge at the origin."""

    @property
    def clearance_gain_m(self) -> Array:
        """Height of the toe above its place with a hinge as knee, for equal heights of the hip."""
        return self.hinge_toe_depth_m - self.toe_depth_m

    @property
    def least_clearance_gain_m(self) -> float:
        """Height of the lowest point of the toe's path above that point with a hinge as knee."""
        return float(self.hinge_toe_depth_m.max() - self.toe_depth_m.max())


@dataclass(frozen=True, repr=False)
class VoluntaryStability(Result):
    """Hip moments that keep a loaded knee straight without knee muscles, or start its flexion."""

    knee_angle_deg: float
    centre: complex
    """Instantaneous centre of the knee in m, x backwards and y up."""
    hip_extension_n_m: float
    """Extension moment that keeps the knee from flexing at heel contact.

    If the number is negative, the knee stays straight even under a flexion moment of the hip of
    this magnitude.
    """
    hip_flexion_n_m: float
    """Flexion moment that starts flexion at push-off, with the load on the ball of the foot.

    If the number is negative, the knee flexes without a moment of the hip.
    """


def leg_length(
    knee: Knee,
    knee_angle_deg: ArrayLike = tuple(range(91)),
    leg: WalkingLegParameters = WalkingLegParameters(),
) -> LegLength:
    """Compute the distance from hip to ankle, with a linkage and with a hinge as knee.

    Parameters
    ----------
    knee
        A linkage, if it were the leg's knee, or a wearer's own knee.
    knee_angle_deg
        Knee angles in deg, (n,).
    leg
        Lengths of thigh and shank.

    Raises
    ------
    LinkageError
        The linkage cannot be assembled at a knee angle.
    ParameterError
        The wearer's knee has no nodes at a knee angle.
    """
    motion = _motion(knee, knee_angle_deg)
    ankle = -1j * leg.shank_m
    return LegLength(
        knee_angle_deg=np.degrees(motion.knee_angle),
        distance_m=np.abs(_place(motion, ankle) - _hip(leg)),
        hinge_distance_m=np.abs(ankle * motion.turn - _hip(leg)),
    )


def swing_clearance(
    knee: Knee, leg: WalkingLegParameters = WalkingLegParameters()
) -> SwingClearance:
    """Compute the height of the toe over the measured swing, if ``knee`` were the leg's knee.

    The knee flexes as measured. The thigh swings as ``leg`` assumes, and the foot keeps a right
    angle to the shank. The heights are relative to the hip, whose own height has no measurement.

    Raises `LinkageError` and `ParameterError` as `leg_length` does.
    """
    percent, flexion, _ = gait_knee_flexion()
    swing = (percent >= leg.swing_percent[0]) & (percent <= leg.swing_percent[-1])
    percent = percent[swing]
    thigh_deg = np.interp(percent, leg.swing_percent, leg.thigh_flexion_deg)
    motion = _motion(knee, flexion[swing])
    toe = -leg.toe_m - 1j * (leg.shank_m + leg.ankle_height_m)

    def depth(place: Points) -> Array:
        # The thigh flexes forwards, which is clockwise.
        return np.asarray(-np.imag((place - _hip(leg)) * np.exp(-1j * np.radians(thigh_deg))))

    return SwingClearance(
        gait_percent=percent,
        knee_angle_deg=flexion[swing],
        thigh_flexion_deg=thigh_deg,
        toe_depth_m=depth(_place(motion, toe)),
        hinge_toe_depth_m=depth(toe * motion.turn),
    )


def voluntary_stability(
    knee: Knee,
    knee_angle_deg: float = 0.0,
    leg: WalkingLegParameters = WalkingLegParameters(),
) -> VoluntaryStability:
    """Compute the hip moments that keep a loaded knee straight, and that start its flexion.

    The moment is (L/y)(P d − M_K) for small angles, by statics of the leg about the instantaneous
    centre (Radcliffe, Prosthetics and Orthotics International 18, 1994, 159–173). L is the distance
    from the contact on the ground to the hip. The centre lies d in front of this line, and y along
    it from the contact. P is the load along the line, and M_K the extension moment of the knee.

    Parameters
    ----------
    knee
        A linkage, if it were the leg's knee, or a wearer's own knee.
    knee_angle_deg
        Knee angle in deg of the loaded leg.
    leg
        Lengths of leg and foot, load, and moment of the knee.

    Raises
    ------
    LinkageError, ParameterError
        As `leg_length`.
    """
    motion = _motion(knee, knee_angle_deg)
    centre, (heel, ball) = complex(motion.fixed_centrode[0]), contacts(leg)
    return VoluntaryStability(
        knee_angle_deg=float(knee_angle_deg),
        centre=centre,
        hip_extension_n_m=float(_hip_extension_n_m(centre, complex(_place(motion, heel)[0]), leg)),
        hip_flexion_n_m=-float(_hip_extension_n_m(centre, complex(_place(motion, ball)[0]), leg)),
    )


def voluntary_margin_n_m(centre: Points, leg: WalkingLegParameters) -> Array:
    """Return the smaller spare moment of the hip: extension at heel contact, flexion at push-off.

    ``centre`` (…) are places of the centre of rotation of a straight knee in m, from the knee's
    origin, x backwards and y up. They must be above the ground. The result (…) in N·m is positive
    in Radcliffe's zone of voluntary stability. There the hip is strong enough to keep the knee
    straight at heel contact, and to start knee flexion at push-off.
    """
    heel, ball = contacts(leg)
    return np.minimum(
        leg.hip_extension_n_m - _hip_extension_n_m(centre, heel, leg),
        leg.hip_flexion_n_m + _hip_extension_n_m(centre, ball, leg),
    )


def contacts(leg: WalkingLegParameters) -> tuple[complex, complex]:
    """Return the places in m of heel and ball of the foot on the shank, with the knee straight."""
    sole = -1j * (leg.shank_m + leg.ankle_height_m)
    return sole + leg.heel_m, sole - leg.forefoot_m


def _hip_extension_n_m(centre: Any, contact: complex, leg: WalkingLegParameters) -> Any:
    """Return the extension moment of the hip that balances the knee about its centre."""
    line = _hip(leg) - contact
    along = np.conj(line / abs(line)) * (centre - contact)
    y, d = along.real, along.imag
    return abs(line) / y * (leg.load_n * d - leg.knee_moment_n_m)


def _motion(knee: Knee, knee_angle_deg: ArrayLike) -> ShankMotion:
    angle = np.radians(knee_angle_deg)
    if isinstance(knee, LinkageParameters):
        return linkage_motion(knee, angle)
    return anatomical_motion(knee, angle)


def _hip(leg: WalkingLegParameters) -> complex:
    return 1j * leg.thigh_m


def _place(motion: ShankMotion, point: complex) -> Points:
    """Return the places (n,) of a point of the shank in the frame of the thigh."""
    return np.asarray(motion.translation + point * motion.turn)
