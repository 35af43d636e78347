"""Compares the linkage of a scenario, a hinge and the paper's linkages on a wearer's leg."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np

from kneexo.analysis import TradeOff, fit_polynomials, trade_off
from kneexo.analysis.mechanism.alignment import MM, Alignment, CuffForces, SlottedStrap, align
from kneexo.analysis.mechanism.prosthetic_leg import (
    LegLength,
    SwingClearance,
    VoluntaryStability,
    leg_length,
    swing_clearance,
    voluntary_stability,
)
from kneexo.common.progress import progress_bar
from kneexo.common.result import Array, Result
from kneexo.geometry.linkage_properties import LinkageProperties, linkage_properties
from kneexo.geometry.shank_motion import ShankMotion, anatomical_motion
from kneexo.parameters import (
    GAIT2392,
    HINGE,
    TABLE_1_LINKAGES,
    LinkageParameters,
    Scenario,
    StrapParameters,
)
from kneexo.parameters.fields.quantity import Parameters, choice, quantity
from kneexo.parameters.task.gait import gait_knee_flexion
from kneexo.parameters.wearer.anatomical_knee import KneeChoice
from kneexo.sweeps import SweepOptions


class MechanismSettings(Parameters):
    """Settings of ``kneexo study mechanism``: knee, cuff, flexion, wrong place, tolerance."""

    knee: KneeChoice = GAIT2392
    cuff: StrapParameters = StrapParameters()
    flexion_max_deg: float = quantity(
        90.0,
        "deg",
        "Section 2: the range of motion is 0…90°; G5 closes up to 123°",
        ge=10,
        le=115,
    )
    misplacement_mm: float = quantity(
        10.0, "mm", "assumption: error of putting a device on", gt=0, le=200
    )
    tolerance_mm: float = quantity(
        5.0, "mm", "assumption: migration of the strap that a wearer tolerates, rms", gt=0, le=200
    )
    trade_off: bool = choice(False, "assumption: the search takes longer than all other numbers")
    """Whether linkages are searched from close to Table 1 to close to the knee."""


@dataclass(frozen=True, repr=False)
class Device(Result):
    """What a device does to the leg of the wearer.

    Unless a field says otherwise, the device is at its best place and not turned.
    """

    alignment: Alignment
    turned: Alignment
    """Alignment at the best place and turn."""
    misplaced_rms_mm: float
    """Root of the mean square of the migration at a place that is wrong by ``misplacement_mm``."""
    placement_tolerance_mm: float
    """Error of the place in mm at which the migration reaches ``tolerance_mm``; nan if none."""
    sliding: Alignment
    """Alignment at the best place for a cuff that slides along the shank."""
    strap: SlottedStrap
    """Motion if the strap slides along the shank."""
    forces: CuffForces
    properties: LinkageProperties
    leg: LegLength
    """Distance from hip to ankle if the device were the leg."""
    swing: SwingClearance
    """Height of the toe in swing if the device were the leg."""
    stance: VoluntaryStability
    """Moments of the hip on a straight leg whose knee is the device."""
    rod_error_mm: Array
    """Rod extension minus that of Table 1, over 0…90°."""

    def results(self) -> dict[str, Any]:
        """Return the numbers as plain data."""
        place, own = self.alignment.placement, self.properties
        at_60_deg = leg_length(self.alignment.linkage, 60.0)  # a motion may end before
        transmission = own.transmission_angle_deg
        has_links = own.thigh_as_ground != "hinge"  # which has one rigid triangle
        return {
            "rms_mm": self.alignment.rms_mm,
            "largest_mm": self.alignment.largest_mm,
            "rod_rms_mm": float(np.sqrt(np.mean(self.rod_error_mm**2))),
            "across_range_mm": float(np.ptp(self.alignment.across_mm)),
            "along_range_mm": float(np.ptp(self.alignment.along_mm)),
            "backwards_mm": MM * place.position.real,
            "up_mm": MM * place.position.imag,
            "turned_rms_mm": self.turned.rms_mm,
            "turn_deg": math.degrees(self.turned.placement.turn_rad),
            "misplaced_rms_mm": self.misplaced_rms_mm,
            "placement_tolerance_mm": self.placement_tolerance_mm,
            "angle_difference_range_deg": float(np.ptp(self.strap.angle_difference_deg)),
            "least_torque_ratio": float(np.min(self.strap.torque_ratio)),
            "largest_torque_ratio": float(np.max(self.strap.torque_ratio)),
            "largest_across_n": float(np.max(np.abs(self.forces.across_n))),
            "largest_along_n": float(np.max(np.abs(self.forces.along_n))),
            "largest_knee_moment_n_m": float(np.max(np.abs(self.forces.knee_moment_n_m))),
            "thigh_as_ground": own.thigh_as_ground,
            "shank_as_ground": own.shank_as_ground,
            "grashof_margin_mm": MM * own.grashof_margin_m if has_links else math.nan,
            "assembly_limits_deg": list(own.assembly_limits_deg),
            "rod_dead_centres_deg": list(own.rod_dead_centres_deg),
            "encoder_reversals_deg": list(own.encoder_reversals_deg),
            "least_transmission_angle_deg": transmission.least if has_links else math.nan,
            "least_transmission_at_deg": transmission.at_deg if has_links else math.nan,
            "shortening_at_60_deg_mm": MM * float(at_60_deg.shortening_m[0]),
            "toe_clearance_gain_mm": MM * self.swing.least_clearance_gain_m,
            "hip_extension_n_m": self.stance.hip_extension_n_m,
            "hip_flexion_n_m": self.stance.hip_flexion_n_m,
        }


@dataclass(frozen=True, repr=False)
class MechanismResult(Result):
    """Devices by name, on one wearer's knee. The first one is the linkage of the scenario."""

    scenario: Scenario
    settings: MechanismSettings
    devices: dict[str, Device]
    trade_off: TradeOff | None
    """Designed linkages from close to Table 1 to close to the knee, or None if not asked for."""

    @property
    def knee_angle_deg(self) -> Array:
        """Knee angles (n,) in deg of all arrays."""
        return next(iter(self.devices.values())).alignment.knee_angle_deg

    @property
    def knee(self) -> ShankMotion:
        """Motion of the wearer's shank."""
        return anatomical_motion(self.settings.knee, np.radians(self.knee_angle_deg))

    @property
    def leg(self) -> LegLength:
        """Distance from hip to ankle of the wearer's own leg."""
        return leg_length(self.settings.knee, self.knee_angle_deg)

    def results(self) -> dict[str, Any]:
        """Return the numbers of all devices, and the centres of the knee, as plain data."""
        centre = MM * self.knee.fixed_centrode
        names = ("rod_rms_mm", "rod_largest_mm", "rms_mm", "largest_mm")
        designs = () if self.trade_off is None else self.trade_off.designs
        return {
            "devices": {name: device.results() for name, device in self.devices.items()},
            "knee": {
                "knee_angle_deg": self.knee_angle_deg,
                "centre_backwards_mm": centre.real,
                "centre_up_mm": centre.imag,
            },
            "stride": _stride(),
            "trade_off": [{name: getattr(design, name) for name in names} for design in designs],
        }


def mechanism_study(
    scenario: Scenario = Scenario(),
    *,
    settings: MechanismSettings = MechanismSettings(),
    **options: Unpack[SweepOptions],
) -> MechanismResult:
    """Compare the linkage of a scenario, a hinge and the paper's linkages on a wearer's leg.

    The study makes no runs. The comparison takes a fraction of a second, in this process. The
    trade-off takes some 15 s more.

    Parameters
    ----------
    scenario
        The scenario whose linkage is the first device.
    settings
        The wearer's knee, the cuff, the range of the knee angle, what counts as a wrong place, and
        whether the trade-off is searched.
    **options
        Those of `kneexo.sweeps.SweepOptions`. Only ``progress`` has an effect.

    Raises
    ------
    LinkageError
        A linkage cannot be assembled.
    ParameterError
        The wearer's knee has no nodes at a knee angle.
    """
    linkages = {repr(scenario.plant.linkage): scenario.plant.linkage}
    if scenario.plant.linkage not in (HINGE, *TABLE_1_LINKAGES.values()):
        linkages = {"the scenario's": scenario.plant.linkage}
    linkages |= {"hinge": HINGE, **TABLE_1_LINKAGES}
    with progress_bar(1.0, "devices" if options.get("progress") else None):
        devices = {name: _device(linkage, settings) for name, linkage in linkages.items()}
        designs = trade_off(motion=settings.knee) if settings.trade_off else None
    return MechanismResult(scenario, settings, devices, designs)


def _stride() -> dict[str, float]:
    """Return the range of the knee angle in a measured stride, and its shares in ranges."""
    flexion_deg = gait_knee_flexion()[1]
    return {
        "least_deg": float(flexion_deg.min()),
        "largest_deg": float(flexion_deg.max()),
        "share_0_to_90": float(np.mean((flexion_deg >= 0.0) & (flexion_deg <= 90.0))),
        "share_0_to_135": float(np.mean((flexion_deg >= 0.0) & (flexion_deg <= 135.0))),
        "share_hyperextended": float(np.mean(flexion_deg < 0.0)),
    }


def _device(linkage: LinkageParameters, settings: MechanismSettings) -> Device:
    angles_deg = np.linspace(0.0, settings.flexion_max_deg, round(settings.flexion_max_deg) + 1)

    def aligned(**place: Any) -> Alignment:
        return align(linkage, settings.knee, knee_angle_deg=angles_deg, cuff=settings.cuff, **place)

    best = aligned()
    tolerance_mm = math.nan
    if best.rms_mm < settings.tolerance_mm:
        tolerance_mm = float(best.placement_tolerance_mm(settings.tolerance_mm)[0])
    return Device(
        alignment=best,
        turned=aligned(turn_rad=None),
        misplaced_rms_mm=float(best.misplaced_rms_mm(settings.misplacement_mm)),
        placement_tolerance_mm=tolerance_mm,
        sliding=aligned(counts="across"),
        strap=best.slotted_strap(),
        forces=best.cuff_forces(),
        properties=linkage_properties(linkage, np.radians(angles_deg)),
        leg=leg_length(linkage, angles_deg),
        swing=swing_clearance(linkage),
        stance=voluntary_stability(linkage),
        rod_error_mm=fit_polynomials(linkage, samples=91).table_p_error_mm,
    )
