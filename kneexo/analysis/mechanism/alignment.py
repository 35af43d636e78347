"""Misalignment between an exoskeleton's knee and a wearer's (Lee et al. 2020, Section 2).

The device is placed on the thigh, and a cuff straps its shank to the wearer's. Both knees turn, but
about different centres, so that the strap migrates on the leg: across the shank and along it
(pistoning). A rigid cuff makes the angles of both knees equal. A strap that slides along the leg
like a pin in a slot makes the angles differ.

Coordinates are those of `kneexo.geometry.shank_motion`. The frame of the tibia is that of the thigh
at full extension: across is backwards, along is up.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kneexo.common.plotting import BLUE, GOLD, axes_or_new
from kneexo.common.result import Array, Result, data_frame
from kneexo.errors import ParameterError
from kneexo.geometry.shank_motion import Points, ShankMotion, anatomical_motion, linkage_motion
from kneexo.parameters import GAIT2392, AnatomicalKneeParameters, LinkageParameters, StrapParameters

MM = 1e3
"""Millimetres of a metre."""

FLEXION_DEG = tuple(range(91))
"""Default knee angles of an alignment in deg, 0…90°."""

FARTHEST_M = 0.5
"""Largest distance in m of a place that the user gives from the wearer's knee."""


@dataclass(frozen=True, repr=False)
class Placement(Result):
    """Place of a device on the leg: its thigh part on the thigh, its shank part in the cuff."""

    position: complex
    """Place in m of the origin of the device's frame in the frame of the thigh."""
    turn_rad: float
    """Angle in rad by which the device is turned on the thigh, counter-clockwise."""
    strap: complex
    """Place in m of the strap on the device's shank, in the device's frame at full extension."""


@dataclass(frozen=True, repr=False)
class Alignment(Result):
    """Migration of the strap on a wearer's shank, over the knee angle, all arrays (n,)."""

    linkage: LinkageParameters
    knee: AnatomicalKneeParameters
    cuff: StrapParameters
    placement: Placement
    counts: Literal["both", "across"]
    """The direction of migration that counts: both directions, or across the shank alone."""
    is_best: bool
    """Whether the device is at its best place. Only then the effect of a wrong place is known."""
    knee_angle_deg: Array
    across_mm: Array
    """Place of the strap minus place of the cuff, backwards across the shank, in mm."""
    along_mm: Array
    """Place of the strap minus place of the cuff, up along the shank, in mm: the pistoning."""

    @property
    def distance_mm(self) -> Array:
        """Migration that counts, (n,) in mm: the distance between strap and cuff, or |across|."""
        if self.counts == "across":
            return np.abs(self.across_mm)
        return np.hypot(self.across_mm, self.along_mm)

    @property
    def rms_mm(self) -> float:
        """Root of the mean square of ``distance_mm`` in mm."""
        return float(np.sqrt(np.mean(self.distance_mm**2)))

    @property
    def largest_mm(self) -> float:
        """Largest ``distance_mm`` in mm."""
        return float(np.max(self.distance_mm))

    @property
    def device_centre(self) -> Points:
        """Instantaneous centres of rotation (n,) of the device, in m, in the frame of the thigh."""
        device_motion = linkage_motion(self.linkage, np.radians(self.knee_angle_deg))
        turn = np.exp(1j * self.placement.turn_rad)
        return np.asarray(self.placement.position + turn * device_motion.fixed_centrode)

    def misplaced_rms_mm(self, error_mm: ArrayLike) -> Array:
        """Return the rms of the migration in mm if the device is ``error_mm`` off its best place.

        The strap is put on anew, and the error has the worst direction. If both directions of the
        migration count, all directions of the error give √(rms² + error² (1 − |mean e^{jθ}|²)).
        Raises `ParameterError` if this alignment is not at the best place.
        """
        worst = np.sqrt(np.linalg.eigvalsh(self._square_per_error())[1])
        return np.asarray(np.hypot(self.rms_mm, worst * np.asarray(error_mm, dtype=float)))

    def placement_tolerance_mm(self, limit_mm: float = 5.0) -> Array:
        """Return the semi-axes (2,) in mm of the ellipse of position errors that a limit allows.

        Within the ellipse the rms of the migration stays below ``limit_mm``, with the strap put on
        anew. The ellipse is a circle if both directions of the migration count. Raises
        `ParameterError` if the place is not the best one, or if the best place exceeds the limit.
        """
        return self._rest_mm(limit_mm) / np.sqrt(np.linalg.eigvalsh(self._square_per_error()))

    def tolerated_errors_mm(self, limit_mm: float = 5.0) -> Points:
        """Return position errors x + jy in mm (721,) on the ellipse of `placement_tolerance_mm`."""
        direction = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 721))
        parts = np.stack([direction.real, direction.imag])
        square = np.sum(parts * (self._square_per_error() @ parts), axis=0)
        return np.asarray(self._rest_mm(limit_mm) / np.sqrt(square) * direction)

    def _rest_mm(self, limit_mm: float) -> float:
        """Return the rms of the migration in mm that an error of the device's place may add.

        Raises `ParameterError` if the best place exceeds the limit.
        """
        if not self.rms_mm < limit_mm:
            raise ParameterError(
                f"limit_mm = {limit_mm:g} mm: must exceed {self.rms_mm:.4g} mm, which the best "
                f"placement leaves"
            )
        return float(np.sqrt(limit_mm**2 - self.rms_mm**2))

    def _square_per_error(self) -> Array:
        """Return the matrix S (2, 2) by which an error of the device's place adds to the migration.

        An error d (2,) in mm, backwards and up, adds d·S·d in mm² to the mean square. Raises
        `ParameterError` if the place is not the best one.
        """
        if not self.is_best:
            raise ParameterError(
                "placement: is not the best one, so that a wrong place has no known effect; call "
                "align without position and placement"
            )
        # The migration (2, n) of a position error of 1 m backwards, and of 1 m up.
        unit = np.exp(-1j * np.radians(self.knee_angle_deg)) * np.array([[1.0], [1.0j]])
        unit = unit - unit.mean(axis=1, keepdims=True)
        parts = [unit.real] if self.counts == "across" else [unit.real, unit.imag]
        return np.asarray(sum(part @ part.T for part in parts) / unit.shape[1])

    def slotted_strap(self) -> SlottedStrap:
        """Return the motion if the strap is a pin in a slot along the shank, by Newton's method.

        Raises `ParameterError` if no angle of the device puts the pin into the slot.
        """
        knee_motion = anatomical_motion(self.knee, np.radians(self.knee_angle_deg))
        inverse_turn = np.conj(knee_motion.turn)
        angle = knee_motion.knee_angle
        # The strap s of the device at `angle` is in the slot of the shank, whose place is t and
        # whose turn is e^{jθ}, if Re(e^{−jθ} (s − t)) = 0.
        for _ in range(20):
            strap, strap_rate = self._strap(linkage_motion(self.linkage, angle))
            slope = np.real(inverse_turn * strap_rate)
            step = np.real(inverse_turn * (strap - knee_motion.translation)) / slope
            if np.all(np.abs(step) < 1e-12):
                break
            angle = angle - step
        else:
            raise ParameterError(
                "placement: at a knee angle no angle of the device puts the strap into the slot; "
                "choose a place nearer to the best one"
            )
        shank_rate = knee_motion.rate + 1j * (strap - knee_motion.translation)
        knee_slope = -np.real(inverse_turn * shank_rate)
        return SlottedStrap(
            knee_angle_deg=self.knee_angle_deg,
            device_angle_deg=np.degrees(angle),
            torque_ratio=-knee_slope / slope,
        )

    def cuff_forces(self) -> CuffForces:
        """Return forces and moments of the cuff, quasi-static, for equal angles of both knees.

        The strap is a spring across the shank and a spring along it. Along the shank the strap
        slips at the friction μ times the preload. The force acts on the leg where the strap is, so
        its moment on the knee is its power per rate of the knee angle. The moments on both knees
        and the rate of the springs' energy sum to zero while the strap sticks.
        """
        knee_motion = anatomical_motion(self.knee, np.radians(self.knee_angle_deg))
        across_n = self.cuff.normal_stiffness_n_per_m * self.across_mm / MM
        spring_n = self.cuff.shear_stiffness_n_per_m * self.along_mm / MM
        hold_n = self.cuff.friction * self.cuff.preload_n
        along_n = np.clip(spring_n, -hold_n, hold_n)
        force = knee_motion.turn * (across_n + 1j * along_n)
        strap, strap_rate = self._strap(linkage_motion(self.linkage, knee_motion.knee_angle))
        shank_rate = knee_motion.rate + 1j * (strap - knee_motion.translation)
        return CuffForces(
            knee_angle_deg=self.knee_angle_deg,
            across_n=across_n,
            along_n=along_n,
            slips=np.abs(spring_n) > hold_n,
            knee_moment_n_m=np.real(np.conj(force) * shank_rate),
            device_moment_n_m=-np.real(np.conj(force) * strap_rate),
        )

    def to_dataframe(self) -> Any:
        """Return the migration as a `pandas.DataFrame` with the index ``knee_angle_deg``.

        Raises `PackageError` without pandas.
        """
        names = ("knee_angle_deg", "across_mm", "along_mm")
        return data_frame({name: getattr(self, name) for name in names}, "knee_angle_deg")

    def plot(self, ax: Any = None) -> Any:
        """Plot the migration across and along the shank over the knee angle; return the axes."""
        ax = axes_or_new(ax, caption="Migration of the strap on the shank over the knee angle.")
        ax.plot(self.knee_angle_deg, self.across_mm, BLUE, label="across the shank")
        ax.plot(self.knee_angle_deg, self.along_mm, GOLD, label="along the shank (pistoning)")
        ax.axhline(0.0, color="0.7", lw=0.8, zorder=0)
        ax.set(xlabel="knee angle (deg)", ylabel="migration of the strap (mm)")
        ax.legend()
        return ax

    def _strap(self, device_motion: ShankMotion) -> tuple[Points, Points]:
        """Return place (n,) of the strap in the frame of the thigh, and its rate over the angle."""
        turn, strap = np.exp(1j * self.placement.turn_rad), self.placement.strap
        shank_point = device_motion.translation + device_motion.turn * strap
        rate = device_motion.rate + 1j * device_motion.turn * strap
        return self.placement.position + turn * shank_point, turn * rate


@dataclass(frozen=True, repr=False)
class SlottedStrap(Result):
    """Angles and torque of a device whose strap slides along the shank, all arrays (n,)."""

    knee_angle_deg: Array
    device_angle_deg: Array
    """Knee angle of the device in deg at each knee angle of the wearer."""
    torque_ratio: Array
    """Torque on the wearer's knee relative to the device's, dθ_device/dθ_knee, by virtual work."""

    @property
    def angle_difference_deg(self) -> Array:
        """Knee angle of the device minus the wearer's in deg, (n,)."""
        return self.device_angle_deg - self.knee_angle_deg


@dataclass(frozen=True, repr=False)
class CuffForces(Result):
    """Forces of a cuff on the leg, and moments on both knees, all arrays (n,)."""

    knee_angle_deg: Array
    across_n: Array
    """Force on the leg in N, backwards across the shank."""
    along_n: Array
    """Force on the leg in N, up along the shank."""
    slips: NDArray[np.bool_]
    """True where the springs alone would exceed the friction, so that the strap slips."""
    knee_moment_n_m: Array
    """Moment of the forces on the wearer's knee in N·m, positive in flexion."""
    device_moment_n_m: Array
    """Moment of the forces on the device's knee in N·m, positive in flexion."""


def align(
    linkage: LinkageParameters,
    knee: AnatomicalKneeParameters = GAIT2392,
    *,
    knee_angle_deg: ArrayLike = FLEXION_DEG,
    position: complex | None = None,
    turn_rad: float | None = 0.0,
    placement: Placement | None = None,
    cuff: StrapParameters = StrapParameters(),
    counts: Literal["both", "across"] = "both",
) -> Alignment:
    """Return the migration of the strap for a device at its best place, or at a given one.

    The best place has the least mean square of the migration over ``knee_angle_deg``. Linear least
    squares give the best place, because the migration u = e^{−jθ}(p + t_device − t_knee) + q is
    linear in the place p of the device and in the place q of the strap.

    Parameters
    ----------
    linkage
        The device's knee.
    knee
        The wearer's knee.
    knee_angle_deg
        Knee angles in deg over which the strap migrates, (n,), such as those of a stride.
    position
        Place in m of the device's origin on the thigh, x + jy. x points backwards and y to the hip,
        from the origin of the wearer's knee. The strap is then put where it fits best. None stands
        for the best place.
    turn_rad
        Turn in rad of the device on the thigh. None stands for the best turn, to 0.1°.
    placement
        A whole placement, such as one from another alignment, in place of the two arguments above.
    cuff
        Place, stiffness and friction of the cuff.
    counts
        Components of the migration that the fit minimizes: ``"both"``, or ``"across"`` alone for a
        cuff that slides along the shank.

    Raises
    ------
    LinkageError
        The linkage cannot be assembled at one of the knee angles.
    ParameterError
        There is no knee angle, a knee angle is outside the nodes of the anatomical knee, or the
        given place of the device is more than 0.5 m from the wearer's knee.
    """
    angle_deg = np.atleast_1d(np.asarray(knee_angle_deg, dtype=float))
    if not angle_deg.size:
        raise ParameterError("knee_angle_deg: has no knee angle; must have at least one")
    angle = np.radians(angle_deg)
    device_motion, knee_motion = linkage_motion(linkage, angle), anatomical_motion(knee, angle)
    is_best = placement is None and position is None
    if placement is None:
        fit = _Fit(device_motion, knee_motion, position, cuff.distance_m, counts)
        placement = fit.placement(fit.best_turn_rad() if turn_rad is None else turn_rad)
    if not (is_best or abs(placement.position) <= FARTHEST_M):
        raise ParameterError(
            f"position = {placement.position:.4g} m: must be at most {FARTHEST_M:g} m from the "
            f"wearer's knee"
        )
    turn = np.exp(1j * placement.turn_rad)
    gap = placement.position + turn * device_motion.translation - knee_motion.translation
    u = gap / knee_motion.turn + turn * placement.strap + 1j * cuff.distance_m
    return Alignment(
        linkage=linkage,
        knee=knee,
        cuff=cuff,
        placement=placement,
        counts=counts,
        is_best=is_best,
        knee_angle_deg=angle_deg,
        across_mm=MM * u.real,
        along_mm=MM * u.imag,
    )


@dataclass(frozen=True)
class _Fit:
    """Finds the place of a device on the leg with the least mean square of the migration u.

    u = e^{−jθ}(p + e^{jτ} t_device − t_knee) + q for a turn τ of the device. The unknowns are the
    place p of the device, unless ``position`` is this place, and q, the place of the strap beside
    the cuff.
    """

    device_motion: ShankMotion
    knee_motion: ShankMotion
    position: complex | None
    distance_m: float
    counts: str

    def placement(self, turn_rad: float) -> Placement:
        """Return the placement with the least mean square at the turn ``turn_rad``.

        If several places are equally good, the result is the one with the shortest vector.
        """
        turn = np.exp(1j * turn_rad)
        inverse_turn = np.conj(self.knee_motion.turn)
        gap = turn * self.device_motion.translation - self.knee_motion.translation
        if self.position is not None:
            gap = gap + self.position
        gap = gap * inverse_turn
        unknowns = np.linalg.lstsq(self._columns(), -self._rows(gap[:, np.newaxis])[:, 0])[0]
        q = complex(*unknowns[-2:])
        p = complex(*unknowns[:2]) if self.position is None else self.position
        return Placement(p, turn_rad, complex(np.conj(turn) * (q - 1j * self.distance_m)))

    def best_turn_rad(self) -> float:
        """Return the turn of the device with the least mean square, a multiple of 0.1°.

        The result is 0 if the turn has no effect, as for a hinge.
        """
        inverse_turn = np.conj(self.knee_motion.turn)
        device = self.device_motion.translation * inverse_turn
        wanted = (self.knee_motion.translation - (self.position or 0.0)) * inverse_turn
        # At the turn τ the migration without places is a·cos τ + b·sin τ + c, with the columns a, b
        # and c below. The best places remove from each column what they can fit. What they leave
        # is a quadratic form of (cos τ, sin τ, 1), which is computed at all turns.
        parts = self._rows(np.stack([device, 1j * device, -wanted], axis=1))
        columns = self._columns()
        parts = parts - columns @ np.linalg.lstsq(columns, parts)[0]
        turns = np.radians(np.arange(3600) / 10.0)
        weights = np.stack([np.cos(turns), np.sin(turns), np.ones(turns.size)])
        squares = np.sum(weights * (parts.T @ parts @ weights), axis=0)
        # Of the turns that are equal but for rounding errors the first counts: 0 for a hinge.
        equal = squares <= np.min(squares) + 1e-12 * np.sum(np.abs(wanted) ** 2)
        turn = float(turns[np.argmax(equal)])
        return turn - 2.0 * np.pi if turn > np.pi else turn

    def _columns(self) -> Array:
        inverse_turn = np.conj(self.knee_motion.turn)
        one = np.ones(inverse_turn.size)
        places = [] if self.position is not None else [inverse_turn, 1j * inverse_turn]
        return self._rows(np.stack([*places, one, 1j * one], axis=1))

    def _rows(self, columns: Points) -> Array:
        """Return the parts of complex migrations that count, as rows of real equations.

        They are the real parts and, unless only the migration ``across`` counts, the imaginary
        parts.
        """
        if self.counts == "across":
            return np.asarray(columns.real)
        return np.concatenate([columns.real, columns.imag])
