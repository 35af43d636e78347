"""Every physical number of kneexo: value, unit (in the field's name), range and provenance.

Values are SI, except where a field's name says otherwise (Table 1 and the knee references are
in the paper's units). "Table n", "Eq. n" and "Section n" are those of Lee, Lee, Song and Baek,
"Design and Control of a Polycentric Knee Exoskeleton Using an Electro-Hydraulic Actuator",
Sensors 2020, 20(1), 211. "Assumption" marks what the paper does not print, with the reason.

A range is what such hardware and such a task could ever have, with a decade to spare. A quantity
that divides has a lower limit above zero for the same reason: no value within the ranges takes the
arithmetic near an overflow.

All classes are frozen and validated on construction; a bad value raises `ParameterError` with
one line. To vary a number, write ``CylinderParameters(mass_kg=1.8)``.
"""

from __future__ import annotations

import csv
import math
import os
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from kneexo.errors import ParameterError
from kneexo.quantity import Parameters, choice, quantity

RPM = 2.0 * math.pi / 60.0
"""One revolution per minute in rad/s."""


ATMOSPHERE_PA = 101_325.0
"""Standard atmosphere in Pa; pressures are relative to it."""

AIR_EXPONENT = 1.4
"""Polytropic exponent of entrained air: adiabatic, as the hydraulic mode is fast (assumption)."""

# ---------------------------------------------------------------------------------- plant


class BldcPumpParameters(Parameters):
    """BLDC motor with gear and axial-piston pump (Eq. 12, 13)."""

    speed_limit_rad_s: float = quantity(
        5000.0 * RPM, "rad/s", "Tables 2 and 3: 5000 rpm at the motor", ge=0.1, le=5000
    )
    lag_s: float = quantity(
        0.010,
        "s",
        "assumption: time constant of the drive's speed loop; not printed",
        ge=1e-4,
        le=1,
    )
    acceleration_limit_rad_s2: float = quantity(
        1e4,
        "rad/s²",
        "assumption: torque and inertia are not printed, but Section 5 explains its initial error "
        "by the time that the motor needs to accelerate",
        ge=1,
        le=1e7,
    )
    gear_ratio: float = quantity(
        6.0, "1", "Section 5: 6:1; the scale factor s_r of Eq. 17 hides it", ge=0.01, le=1000
    )
    displacement_m3_per_rad: float = quantity(
        0.8e-6 / (2.0 * math.pi), "m³/rad", "Tables 2 and 3: 0.8 cc/rev", ge=1e-10, le=1e-4
    )
    internal_leakage_m3_per_s_pa: float = quantity(
        2e-13,
        "m³/(s·Pa)",
        "assumption: C_im of Eq. 12 is not printed; the pump leaks, the piston seals barely",
        ge=0,
        le=1e-9,
    )
    external_leakage_m3_per_s_pa: float = quantity(
        0.0, "m³/(s·Pa)", "assumption: C_em of Eq. 12 is not printed", ge=0, le=1e-9
    )
    rated_power_w: float = quantity(200.0, "W", "Table 3", ge=0.1, le=1e5)

    @property
    def leakage_m3_per_s_pa(self) -> float:
        """Leakage of the load flow, C_im + C_em/2 (Eq. 13), in m³/(s·Pa)."""
        return self.internal_leakage_m3_per_s_pa + 0.5 * self.external_leakage_m3_per_s_pa


_THICKEST_ROD = 0.98  # of the bore; the annulus that is left, 4 % of the area, is a divisor


class CylinderParameters(Parameters):
    """Single-rod cylinder and the mass that it moves (Eq. 15, 16)."""

    bore_m: float = quantity(0.020, "m", "Table 3", ge=1e-3, le=1)
    rod_diameter_m: float = quantity(0.010, "m", "Table 3", ge=0, le=1)
    stroke_m: float = quantity(0.150, "m", "Tables 2 and 3", ge=1e-3, le=5)
    total_volume_m3: float = quantity(
        41_233e-9,
        "m³",
        "Table 2: V_t = V_1 + V_2, mean area times stroke; does not follow bore and stroke",
        ge=1e-8,
        le=1,
    )
    bulk_modulus_pa: float = quantity(
        17_200e5, "Pa", "Tables 2 and 3: 17 200 bar (ISO VG 46)", ge=1e6, le=1e11
    )
    mass_kg: float = quantity(1.6, "kg", "Tables 2 and 3: shank", ge=0.01, le=1000)
    damping_n_s_per_m: float = quantity(0.05, "N/(m/s)", "Table 2: B", ge=0, le=1e6)
    stiffness_n_per_m: float = quantity(
        0.0, "N/m", "assumption: K of Eq. 16 is not printed", ge=0, le=1e7
    )
    leakage_m3_per_s_pa: float = quantity(
        0.0,
        "m³/(s·Pa)",
        "assumption: C_L of Eq. 15 is not printed; piston seals barely leak",
        ge=0,
        le=1e-9,
    )
    pressure_rating_pa: float = quantity(3.5e6, "Pa", "Table 3: 3.5 MPa", ge=1e3, le=1e9)

    @property
    def cap_area_m2(self) -> float:
        """Piston area of the chamber without rod, A_1, in m²."""
        return math.pi / 4.0 * self.bore_m**2

    @property
    def rod_side_area_m2(self) -> float:
        """Annular area of the chamber with the rod, A_2, in m²."""
        return math.pi / 4.0 * (self.bore_m**2 - self.rod_diameter_m**2)

    @property
    def mean_area_m2(self) -> float:
        """Mean piston area (A_1 + A_2)/2 of Eq. 15, in m²; Table 2 prints 274.8894 mm²."""
        return 0.5 * (self.cap_area_m2 + self.rod_side_area_m2)

    @model_validator(mode="after")
    def _rod_fits_bore(self) -> CylinderParameters:
        if self.rod_diameter_m > _THICKEST_ROD * self.bore_m:
            raise ValueError(
                f"rod_diameter_m = {self.rod_diameter_m:g} m must be below {_THICKEST_ROD:g} times "
                f"bore_m = {self.bore_m:g} m"
            )
        return self


class FullCylinderParameters(Parameters):
    """What the full order adds to `CylinderParameters`: both chambers, valves and seals (Eq. 14).

    C_im' of Eq. 14 is `CylinderParameters.leakage_m3_per_s_pa`; with external leakage C_em' the
    reduced order's C_L is C_im' + C_em'/2. Pressures are relative to the atmosphere.
    """

    dead_volume_m3: float = quantity(
        5e-6,
        "m³",
        "assumption: V_d of each chamber, with its hose; Eq. 14 leaves V_1⁰ and V_2⁰ open, and "
        "0 is singular at the end of the stroke",
        ge=1e-9,
        le=1,
    )
    reservoir_pressure_pa: float = quantity(
        0.2e6,
        "Pa",
        "assumption: P_r of Eq. 14 is not printed; 2 bar keep the return line from cavitating",
        ge=0,
        le=1e6,
    )
    cap_external_leakage_m3_per_s_pa: float = quantity(
        0.0, "m³/(s·Pa)", "assumption: C_em1' of Eq. 14 is not printed", ge=0, le=1e-9
    )
    rod_side_external_leakage_m3_per_s_pa: float = quantity(
        0.0, "m³/(s·Pa)", "assumption: C_em2' of Eq. 14 is not printed", ge=0, le=1e-9
    )
    makeup_conductance_m3_per_s_pa: float = quantity(
        2e-10,
        "m³/(s·Pa)",
        "assumption: 0.02 MPa at the 3.7 cm³/s that A_1 − A_2 asks for at full speed; 0 blocks "
        "the valves",
        ge=0,
        le=1e-6,
    )
    makeup_band_pa: float = quantity(
        0.02e6,
        "Pa",
        "assumption: |P_1 − P_2| that opens one pilot-operated check valve and closes the other; "
        "narrow beside the 0.067 MPa that P_r leaves between the lines without load",
        ge=10,
        le=1e7,
    )
    relief_pressure_pa: float = quantity(
        3.5e6,
        "Pa",
        "assumption: both lines are relieved at the cylinder's rating of Table 3",
        gt=1e6,
        le=1e9,
    )
    relief_conductance_m3_per_s_pa: float = quantity(
        5e-10,
        "m³/(s·Pa)",
        "assumption: the whole flow of the pump, 11 cm³/s, 1 % above the relief pressure",
        ge=0,
        le=1e-6,
    )
    valve_band_pa: float = quantity(
        0.02e6, "Pa", "assumption: rounds the opening of check and relief valves", ge=10, le=1e7
    )
    entrained_air: float = quantity(
        0.0,
        "1",
        "assumption: volume of free air in that of the oil at atmospheric pressure; 1.5 % makes "
        "0.06 GPa of β_e at P_r",
        ge=0,
        le=0.5,
    )
    coulomb_friction_n: float = quantity(
        0.0, "N", "assumption: seal friction in motion; Eq. 16 has none", ge=0, le=1e5
    )
    stribeck_friction_n: float = quantity(
        0.0, "N", "assumption: what breakaway takes beyond it", ge=0, le=1e5
    )
    stribeck_speed_m_s: float = quantity(
        0.01, "m/s", "assumption: typical of hydraulic seals", ge=1e-5, le=10
    )
    friction_band_m_s: float = quantity(
        1e-3, "m/s", "assumption: rounds the reversal of the friction", ge=1e-6, le=10
    )


_IDENTIFIED = (
    "assumption: identified from Table 1 over 0…90° by least squares; the paper prints no link "
    "lengths"
)


def _length(default: float) -> Any:
    return quantity(default, "m", _IDENTIFIED, ge=1e-3, le=2)


def _coordinate(default: float) -> Any:
    return quantity(default, "m", _IDENTIFIED, ge=-2, le=2)


def _angle(default_deg: float) -> Any:
    return quantity(math.radians(default_deg), "rad", _IDENTIFIED, ge=-7, le=7)


class LinkageParameters(Parameters):
    """Four-bar knee (Eq. 1–9), in the frame of the ground link.

    The origin is the nominal knee axis, y points proximally, and flexion is counter-clockwise.
    Link 1 is the ground O_A–O_B, link 2 is O_A–A, link 3 is the coupler A–B, link 4 is O_B–B.
    The defaults are geometry G1: the shank is the ground and the coupler (the shortest link)
    belongs to the thigh.
    """

    o_a_x_m: float = _coordinate(22.2063e-3)
    o_a_y_m: float = _coordinate(-34.732e-3)
    o_b_x_m: float = _coordinate(-6.679e-3)
    o_b_y_m: float = _coordinate(-17.5701e-3)
    a_2_m: float = _length(32.9701e-3)
    a_3_m: float = _length(17.0e-3)
    a_4_m: float = _length(18.2289e-3)
    phi_rad: float = _angle(-167.0801)
    """Knee angle minus coupler angle, φ of Eq. 7."""
    rod_pin_radius_m: float = _length(265.8651e-3)
    """|P'B| of Eq. 8: from the coupler's joint B to the pin of the rod."""
    rod_pin_angle_rad: float = _angle(-62.9916)
    """φ' of Eq. 8."""
    rod_anchor_radius_m: float = _length(118.1887e-3)
    """|P_rod O| of Eq. 9: from the origin to the pin of the cylinder."""
    rod_anchor_angle_rad: float = _angle(-97.3807)
    """θ_rod of Eq. 9."""
    rod_length_m: float = _length(231.3769e-3)
    """L_0: distance of the pins at x = 0; the paper leaves it out."""
    branch: Literal[-1, 1] = choice(
        -1, "assembly branch, the sign of sin(θ_4 − θ_2); the paper never states it"
    )

    def __repr__(self) -> str:
        """The name of one of `LINKAGES`; of others, what differs from G1."""
        names = (name for name, linkage in LINKAGES.items() if linkage == self)
        return next(names, None) or super().__repr__()


G1 = LinkageParameters()
"""Shank as ground, coupler shortest (double rocker): the default."""

G2 = LinkageParameters(
    o_a_x_m=-24.3737e-3,
    o_a_y_m=47.9781e-3,
    o_b_x_m=13.62e-3,
    o_b_y_m=22.1909e-3,
    a_2_m=44.5361e-3,
    a_3_m=23.836e-3,
    a_4_m=25.7183e-3,
    phi_rad=math.radians(18.5041),
    rod_pin_radius_m=93.8743e-3,
    rod_pin_angle_rad=math.radians(-57.3501),
    rod_anchor_radius_m=349.1986e-3,
    rod_anchor_angle_rad=math.radians(77.0024),
    rod_length_m=288.7536e-3,
)
"""Thigh as ground, coupler shortest; its instantaneous centre moves the wrong way."""

G3 = LinkageParameters(
    o_a_x_m=-12.207e-3,
    o_a_y_m=-2.2969e-3,
    o_b_x_m=6.1253e-3,
    o_b_y_m=-14.499e-3,
    a_2_m=26.1508e-3,
    a_3_m=47.9084e-3,
    a_4_m=44.2795e-3,
    phi_rad=math.radians(45.3361),
    rod_pin_radius_m=60.7302e-3,
    rod_pin_angle_rad=math.radians(-37.9753),
    rod_anchor_radius_m=266.6114e-3,
    rod_anchor_angle_rad=math.radians(71.0364),
    rod_length_m=230.0e-3,
    branch=1,
)
"""Thigh as ground, ground shortest (drag link); mechanically the best conditioned."""

G4 = LinkageParameters(
    o_a_x_m=-1.52785e-3,
    o_a_y_m=-3.49263e-3,
    o_b_x_m=3.43876e-3,
    o_b_y_m=-6.31537e-3,
    a_2_m=24.09745e-3,
    a_3_m=11.95039e-3,
    a_4_m=28.96078e-3,
    phi_rad=math.radians(41.92103),
    rod_pin_radius_m=82.79717e-3,
    rod_pin_angle_rad=math.radians(-28.25057),
    rod_anchor_radius_m=961.48141e-3,
    rod_anchor_angle_rad=math.radians(85.54219),
    rod_length_m=924.81905e-3,
    branch=1,
)
"""Thigh as ground, ground shortest (drag link); identified from both polynomials of Table 1 over
5…90°, whose printed errors it meets."""

LINKAGES = {"G1": G1, "G2": G2, "G3": G3, "G4": G4}
"""Geometries that reproduce Table 1; a scenario may name one in place of its numbers."""


class KneeParameters(Parameters):
    """Range of motion of the knee; the end stops are an error, not a force."""

    flexion_min_deg: float = quantity(0.0, "deg", "Section 2: 0…90°", ge=-2, le=90)
    flexion_max_deg: float = quantity(90.0, "deg", "Section 2: 0…90°", ge=0, le=91)
    overshoot_deg: float = quantity(
        0.5,
        "deg",
        "assumption: how far a run may pass the range of motion before it is an error, so that a "
        "reference may touch the stops",
        ge=0,
        le=1,
    )

    def require_in_range(self, low_deg: float, high_deg: float) -> None:
        """`ParameterError` when a reference of that range, in deg, leaves the range of motion."""
        if low_deg < self.flexion_min_deg or high_deg > self.flexion_max_deg:
            raise ParameterError(
                f"reference = {low_deg:.4g} … {high_deg:.4g} deg leaves the range of motion "
                f"{self.flexion_min_deg:g} … {self.flexion_max_deg:g} deg; reduce it"
            )

    @model_validator(mode="after")
    def _ordered(self) -> KneeParameters:
        if self.flexion_min_deg >= self.flexion_max_deg:
            raise ValueError(
                f"flexion_min_deg = {self.flexion_min_deg:g} deg must be below "
                f"flexion_max_deg = {self.flexion_max_deg:g} deg"
            )
        return self


_Coefficient = Annotated[float, Field(ge=-1e4, le=1e4)]


class RodPolynomialParameters(Parameters):
    """Eq. 10 and 11 with Table 1: the controller's map from knee angle (deg) to rod (mm)."""

    p_mm_deg: tuple[
        _Coefficient, _Coefficient, _Coefficient, _Coefficient, _Coefficient, _Coefficient
    ] = Field(
        default=(1.571e-8, -4.164e-6, 0.0004789, -0.03192, -0.6195, 148.0),
        json_schema_extra={"unit": "mm/deg^n", "source": "Table 1: p_1 … p_6 of Eq. 10"},
    )
    q_deg_mm: tuple[
        _Coefficient, _Coefficient, _Coefficient, _Coefficient, _Coefficient, _Coefficient
    ] = Field(
        default=(-1.807e-9, 5.788e-7, -7.285e-5, 0.004161, -0.6389, 91.73),
        json_schema_extra={"unit": "deg/mm^n", "source": "Table 1: q_1 … q_6 of Eq. 11"},
    )

    @property
    def p_si(self) -> tuple[float, ...]:
        """Coefficients of Eq. 10, highest power first, for θ_p in rad and x in m."""
        degree = len(self.p_mm_deg) - 1
        return tuple(
            1e-3 * p * math.degrees(1.0) ** (degree - n) for n, p in enumerate(self.p_mm_deg)
        )


class NoLoad(Parameters):
    """No load, as in the paper's simulation: the disturbance input acts on the rod directly."""

    kind: Literal["none"] = "none"


class KneeLoadParameters(Parameters):
    """What acts on the knee: weight of the shank, disturbance on the rod, torque of the wearer."""

    kind: Literal["knee"] = "knee"
    segment_mass_kg: float = quantity(
        1.6, "kg", "Table 3: shank; 0 switches the weight off", ge=0, le=200
    )
    centre_of_mass_m: float = quantity(
        0.20, "m", "assumption: knee axis to the centre of mass of shank and foot", ge=0, le=2
    )
    thigh_inclination_rad: float = quantity(
        0.0, "rad", "assumption: hanging thigh; positive leans forward", ge=-math.pi, le=math.pi
    )
    gravity_m_s2: float = quantity(9.81, "m/s²", "standard gravity, rounded", ge=0, le=100)
    knee_torque_n_m: float = quantity(
        0.0, "N·m", "assumption: constant torque of the wearer; positive flexes", ge=-500, le=500
    )
    disturbance_n: float = quantity(
        0.0, "N", "assumption: constant force against extension", ge=-1e4, le=1e4
    )
    disturbance_amplitude_n: float = quantity(
        0.0, "N", "assumption: sinusoidal force against extension", ge=0, le=1e4
    )
    disturbance_frequency_hz: float = quantity(
        1.0, "Hz", "assumption: frequency of the sinusoidal force", ge=0, le=1000
    )


class PlantParameters(Parameters):
    """Motor and pump, cylinder, knee and load, and which idealizations hold."""

    pump: BldcPumpParameters = BldcPumpParameters()
    cylinder: CylinderParameters = CylinderParameters()
    linkage: LinkageParameters = G1
    knee: KneeParameters = KneeParameters()
    load: Annotated[NoLoad | KneeLoadParameters, Field(discriminator="kind")] = NoLoad()
    rod_map: Literal["linkage", "polynomial"] = choice(
        "linkage",
        "the plant's rod follows the exact linkage (Eq. 1–9), or Table 1 as the controller's does",
    )
    ideal_motor: bool = choice(
        False, "Eq. 17: pump speed equals the command, without lag, acceleration or speed limit"
    )
    full_order: FullCylinderParameters | None = choice(
        None, "Eq. 14 with its valves; left out, the cylinder is the reduced order of Eq. 15"
    )

    @field_validator("linkage", mode="before")
    @classmethod
    def _named_linkage(cls, linkage: Any) -> Any:
        if not isinstance(linkage, str):
            return linkage
        if linkage not in LINKAGES:
            raise ValueError(f"{linkage!r} must be one of {', '.join(LINKAGES)}, or a mapping")
        return LINKAGES[linkage]


# --------------------------------------------------------------- measurement and control


class EncoderParameters(Parameters):
    """Rotary encoder AMT203-V on link 4."""

    counts_per_revolution: int = Field(
        default=4096,
        ge=2,
        le=2**24,
        json_schema_extra={"unit": "1", "source": "Section 2: AMT203-V, 12 bit"},
    )
    quantized: bool = choice(True, "False bypasses the quantizer, as linearization must")
    mounting_error_rad: float = quantity(
        0.0,
        "rad",
        "assumption: true θ_4 minus what calibration takes it for; not printed",
        ge=-0.2,
        le=0.2,
    )
    phase_rad: float = quantity(
        0.0,
        "rad",
        "assumption: θ_4 at which a count begins, known from calibration; not printed",
        ge=0,
        le=2.0 * math.pi,
    )

    @property
    def resolution_rad(self) -> float:
        """Angle of one count in rad; zero without the quantizer."""
        return 2.0 * math.pi / self.counts_per_revolution if self.quantized else 0.0


class ObserverParameters(Parameters):
    """Third-order tracking observer of rod position, velocity and acceleration."""

    kind: Literal["observer"] = "observer"
    time_constant_s: float = quantity(
        0.020,
        "s",
        "assumption: T_f; the paper does not say how velocity and acceleration are measured",
        ge=1e-5,
        le=10,
    )


class DifferenceParameters(Parameters):
    """Plain backward differences of the measured position, as a first attempt would do."""

    kind: Literal["difference"] = "difference"


class ExactParameters(Parameters):
    """Exact rod position, velocity and acceleration, as in the paper's simulation."""

    kind: Literal["exact"] = "exact"


_SAMPLE_TIME = "Table 3: interrupt time"


class SlidingModeParameters(Parameters):
    """Sliding-mode controller (Eq. 20–27)."""

    kind: Literal["smc"] = "smc"
    sample_time_s: float = quantity(0.002, "s", _SAMPLE_TIME, ge=1e-5, le=1)
    continuous: bool = choice(
        False, "True: continuous time, as in the ideal simulation of Fig. 9; needs exact states"
    )
    switching: Literal["saturation", "signum"] = choice(
        "saturation", "sat of Eq. 27, or sgn of Eq. 24 to show chattering"
    )
    lambda_per_s: float = quantity(20.0, "1/s", "assumption: λ is not printed", ge=1e-3, le=1e4)
    phi_m_s2: float = quantity(
        3.2, "m/s²", "assumption: Φ is not printed; k/Φ = 1e5 1/s", ge=1e-6, le=1e9
    )
    eta_m_s3: float = quantity(
        2.8e5,
        "m/s³",
        "assumption: η is not printed; β·η is the full speed authority",
        ge=0,
        le=1e12,
    )
    mass_min_kg: float = quantity(1.4, "kg", "Table 2", ge=0.01, le=1000)
    mass_max_kg: float = quantity(1.8, "kg", "Table 2", ge=0.01, le=1000)
    stiffness_uncertainty_n_per_m: float = quantity(
        0.0, "N/m", "assumption: ΔK_max of Eq. 27 is not printed", ge=0, le=1e7
    )
    damping_uncertainty_n_s_per_m: float = quantity(
        0.0, "N/(m/s)", "assumption: ΔB_max of Eq. 27 is not printed", ge=0, le=1e6
    )
    load_rate_uncertainty_n_per_s: float = quantity(
        0.0, "N/s", "assumption: bound on dF_L/dt in Eq. 27 is not printed", ge=0, le=1e9
    )
    area_uncertainty: float = quantity(
        0.0,
        "1",
        "Eq. 27 has no such term: bound on |A/Ā − 1|, how far the area that moves the oil may be "
        "from the mean area; 1/7 covers A_1 and A_2 of Table 3",
        ge=0,
        le=1,
    )
    command_limit_rad_s: float = quantity(
        5000.0 * RPM,
        "rad/s",
        "Table 2: u <= 5000 rpm; the motor's own limit holds where it is lower",
        ge=1e-3,
        le=1e12,
    )

    @property
    def mass_estimate_kg(self) -> float:
        """Geometric mean of the mass bounds, m̂ = √(m_min m_max) (Table 2), in kg."""
        return math.sqrt(self.mass_min_kg * self.mass_max_kg)

    @property
    def gain_ratio(self) -> float:
        """β = √(b_max/b_min) = √(m_max/m_min); Eq. 23 prints its inverse."""
        return math.sqrt(self.mass_max_kg / self.mass_min_kg)

    @model_validator(mode="after")
    def _ordered(self) -> SlidingModeParameters:
        if self.mass_min_kg > self.mass_max_kg:
            raise ValueError(
                f"mass_min_kg = {self.mass_min_kg:g} kg must not exceed "
                f"mass_max_kg = {self.mass_max_kg:g} kg"
            )
        return self


class PidParameters(Parameters):
    """PID controller on the knee angle; the output is a motor speed."""

    kind: Literal["pid"] = "pid"
    sample_time_s: float = quantity(0.002, "s", _SAMPLE_TIME, ge=1e-5, le=1)
    proportional_per_s: float = quantity(
        5.0,
        "1/s",
        "assumption: PID gains are not printed; 5 1/s gives the error of Fig. 12",
        ge=0,
        le=1e4,
    )
    integral_per_s2: float = quantity(0.0, "1/s²", "assumption: not printed", ge=0, le=1e6)
    derivative: float = quantity(
        0.0, "1", "assumption: not printed; gain on the error's rate", ge=0, le=1e4
    )
    filter_s: float = quantity(
        0.020,
        "s",
        "assumption: lag of the error's filter, on P and D; as the observer's, because both see "
        "the same encoder",
        ge=1e-4,
        le=10,
    )
    anti_windup_s: float = quantity(
        0.1, "s", "assumption: tracking time constant of back-calculation", ge=1e-5, le=1e3
    )
    velocity_feedforward: float = quantity(
        0.0, "1", "assumption: share of the reference's rate that is fed forward", ge=0, le=2
    )
    moment_arm_m: float = quantity(
        0.1,
        "m",
        "assumption: moment arm that turns a knee rate into a rod speed (mid-range of Table 1)",
        ge=1e-3,
        le=2,
    )
    command_limit_rad_s: float = quantity(
        5000.0 * RPM,
        "rad/s",
        "Table 2: u <= 5000 rpm; the motor's own limit holds where it is lower",
        ge=1e-3,
        le=1e12,
    )

    @model_validator(mode="after")
    def _anti_windup_is_stable(self) -> PidParameters:
        if self.anti_windup_s < self.sample_time_s:
            raise ValueError(
                f"anti_windup_s = {self.anti_windup_s:g} s must be at least sample_time_s = "
                f"{self.sample_time_s:g} s"
            )
        return self


# ----------------------------------------------------------------------------- reference


def _flexion(default: float, source: str) -> Any:
    return quantity(default, "deg", source, ge=-2, le=91)


_SHORTEST_RAMP_S = 1e-3  # its third power divides the jerk


class SineReference(Parameters):
    """Knee angle mean − amplitude·cos(2πft): starts at rest at its smallest value.

    With a ramp it starts at its mean and the amplitude grows smoothly.
    """

    kind: Literal["sine"] = "sine"
    mean_deg: float = _flexion(40.0, "Section 5: 10…70°")
    amplitude_deg: float = quantity(30.0, "deg", "Section 5: 10…70°", ge=0, le=46)
    frequency_hz: float = quantity(0.1, "Hz", "Section 5: 0.1 Hz", ge=1e-5, le=250)
    ramp_s: float = quantity(
        0.0, "s", "assumption: none; time over which the amplitude grows", ge=0, le=1e5
    )

    @property
    def range_deg(self) -> tuple[float, float]:
        """Smallest and largest angle in deg."""
        return self.mean_deg - self.amplitude_deg, self.mean_deg + self.amplitude_deg

    @model_validator(mode="after")
    def _ramp_is_smooth(self) -> SineReference:
        if 0.0 < self.ramp_s < _SHORTEST_RAMP_S:
            raise ValueError(
                f"ramp_s = {self.ramp_s:g} s is out of range: must be 0 or >= {_SHORTEST_RAMP_S:g} "
                f"s and <= 100000 s"
            )
        return self


class StepReference(Parameters):
    """Knee angle that jumps once."""

    kind: Literal["step"] = "step"
    start_deg: float = _flexion(30.0, "assumption: an example")
    end_deg: float = _flexion(50.0, "assumption: an example")
    time_s: float = quantity(1.0, "s", "assumption: an example", ge=0, le=1e6)

    @property
    def range_deg(self) -> tuple[float, float]:
        """Smallest and largest angle in deg."""
        return min(self.start_deg, self.end_deg), max(self.start_deg, self.end_deg)


class RampReference(Parameters):
    """Knee angle that moves from one value to another at a constant rate."""

    kind: Literal["ramp"] = "ramp"
    start_deg: float = _flexion(20.0, "assumption: an example")
    end_deg: float = _flexion(60.0, "assumption: an example")
    time_s: float = quantity(1.0, "s", "assumption: an example", ge=0, le=1e6)
    rate_deg_s: float = quantity(
        15.0, "deg/s", "assumption: below the 23 deg/s that the speed limit allows", ge=1e-3, le=1e4
    )

    @property
    def range_deg(self) -> tuple[float, float]:
        """Smallest and largest angle in deg."""
        return min(self.start_deg, self.end_deg), max(self.start_deg, self.end_deg)


Interpolation = Literal["cubic", "pchip", "linear"]
_INTERPOLATION = (
    "cubic: spline with continuous acceleration, which may pass the samples' range; pchip: "
    "shape-preserving cubic, which stays within neighbouring samples; linear: straight lines"
)


class SampledReference(Parameters):
    """Knee angle from samples, by default joined by a cubic spline with continuous acceleration.

    A sequence of numbers may be a tuple, a list, a NumPy array or a pandas column.
    """

    kind: Literal["samples"] = "samples"
    times_s: tuple[float, ...] = Field(
        min_length=3,
        json_schema_extra={"unit": "s", "source": "given by the user; strictly increasing"},
    )
    angles_deg: tuple[float, ...] = Field(
        min_length=3, json_schema_extra={"unit": "deg", "source": "given by the user"}
    )
    interpolation: Interpolation = choice("cubic", _INTERPOLATION)

    @model_validator(mode="after")
    def _consistent(self) -> SampledReference:
        if len(self.times_s) != len(self.angles_deg):
            raise ValueError(
                f"times_s has {len(self.times_s)} values and angles_deg has "
                f"{len(self.angles_deg)}: must be as many"
            )
        if any(b - a < 1e-6 for a, b in zip(self.times_s, self.times_s[1:], strict=False)):
            raise ValueError("times_s must increase by at least 1e-6 s from sample to sample")
        if max(abs(self.times_s[0]), abs(self.times_s[-1])) > 1e5:
            raise ValueError("times_s must lie within ±100000 s")
        return self

    @property
    def range_deg(self) -> tuple[float, float]:
        """Smallest and largest sample in deg; the spline between them may reach further."""
        return min(self.angles_deg), max(self.angles_deg)


class CsvReference(Parameters):
    """A CSV file with a header line that holds the samples of a reference.

    `samples` reads the file. A scenario that names one keeps the samples, not the file.
    """

    kind: Literal["csv"] = "csv"
    file: str = Field(
        min_length=1,
        json_schema_extra={
            "unit": "",
            "source": "given by the user; relative to the scenario file, else to the working "
            "directory",
        },
    )
    time: str = choice("time_s", "name of the column of times in s")
    angle: str = choice("knee_angle_deg", "name of the column of knee angles in deg")
    interpolation: Interpolation = choice("cubic", _INTERPOLATION)

    def samples(self, directory: str | os.PathLike[str] = ".") -> SampledReference:
        """The samples; ``directory`` is what a relative path starts from.

        Lines that are empty or start with ``#`` are left out. Raises `ParameterError` when the
        file cannot be read, or a column or number is missing.
        """
        path = Path(directory, self.file)
        try:
            with path.open(encoding="utf-8-sig", newline="") as stream:
                lines = [
                    (number, line)
                    for number, line in enumerate(stream, 1)
                    if line.strip() and not line.startswith("#")
                ]
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "is not UTF-8"
            raise ParameterError(f"{path}: cannot be read: {reason}") from None
        if not lines:
            raise ParameterError(f"{path}: is empty")
        header, *rows = csv.reader(line for _, line in lines)
        names = [name.strip() for name in header]
        columns: dict[str, list[float]] = {}
        for name in (self.time, self.angle):
            if name not in names:
                raise ParameterError(f"{path}: has no column {name!r}; it has {', '.join(names)}")
            columns[name] = []
            place = names.index(name)
            for (number, _), row in zip(lines[1:], rows, strict=False):
                try:
                    columns[name].append(float(row[place]))
                except (IndexError, ValueError):
                    value = repr(row[place]) if place < len(row) else "no value"
                    raise ParameterError(
                        f"{path}:{number}: {name}: {value}; must be a number"
                    ) from None
        try:
            return SampledReference(
                times_s=tuple(columns[self.time]),
                angles_deg=tuple(columns[self.angle]),
                interpolation=self.interpolation,
            )
        except ParameterError as error:
            raise ParameterError(
                f"{path}: {str(error).removeprefix('SampledReference: ')}"
            ) from None


class GaitReference(Parameters):
    """The built-in gait curve by name: see `kneexo.gait.gait_reference`."""

    kind: Literal["gait"] = "gait"
    frequency_hz: float = quantity(1.0, "Hz", "assumption: strides per second", gt=0, le=10)
    cycles: int = Field(
        default=30,
        ge=1,
        le=1000,
        json_schema_extra={
            "unit": "1",
            "source": "assumption: 30 s at 1 Hz, a default run",
        },
    )


def _read_reference(value: Any, directory: Any) -> Any:
    """References that are named, as the samples that they stand for."""
    if isinstance(value, str):
        if value != "gait":
            raise ValueError(f"{value!r} must be gait, or a mapping")
        value = GaitReference()
    if isinstance(value, dict) and value.get("kind") in ("csv", "gait"):
        given = CsvReference if value["kind"] == "csv" else GaitReference
        try:
            value = given(**value)
        except ParameterError as error:
            raise ParameterError(str(error).removeprefix(f"{given.__name__}: ")) from None
    if isinstance(value, CsvReference):
        return value.samples(directory)
    if isinstance(value, GaitReference):
        from kneexo.gait import gait_reference  # which needs SampledReference

        return gait_reference(value.frequency_hz, value.cycles)
    return value


Reference = Annotated[
    SineReference | StepReference | RampReference | SampledReference, Field(discriminator="kind")
]


# ------------------------------------------------------------------------------ scenario


class SimulationParameters(Parameters):
    """How a closed loop is run: by the compiled engine, or by Drake's Simulator."""

    duration_s: float = quantity(
        30.0, "s", "three periods of 0.1 Hz, as in Fig. 12", ge=1e-3, le=1e5
    )
    integrator: Literal[
        "exact_hold", "rk4", "radau3", "radau1", "runge_kutta3", "implicit_euler"
    ] = choice(
        "exact_hold",
        "exact_hold and rk4 are those of the compiled engine, the others Drake's; implicit or "
        "exponential, because the hydraulic mode lies at 447 Hz",
    )
    step_s: float = quantity(
        0.002, "s", "the control period; exact_hold controls its error instead", ge=1e-7, le=1
    )
    error_controlled: bool = choice(False, "of Drake's: step_s is only the largest step")
    accuracy: float = quantity(
        1e-4, "1", "accuracy of Drake's error-controlled integrators", ge=1e-12, le=0.1
    )
    tolerance: float = quantity(
        1e-8,
        "1",
        "accuracy of exact_hold: local error of each state, relative to one plus the state",
        ge=1e-14,
        le=0.01,
    )

    @property
    def compiled(self) -> bool:
        """Whether the compiled engine runs it."""
        return self.integrator in ("exact_hold", "rk4")

    def with_drake(self) -> SimulationParameters:
        """The same for Drake's Simulator: with radau3 if the integrator is not one of Drake's."""
        return self.model_copy(update={"integrator": "radau3"}) if self.compiled else self


class Scenario(Parameters):
    """One closed-loop run: plant, measurement, controller, reference and simulation.

    ``nominal`` is the plant that the controller believes in; left out, it is ``plant``.
    """

    plant: PlantParameters = PlantParameters()
    nominal: PlantParameters | None = None
    polynomial: RodPolynomialParameters = RodPolynomialParameters()
    encoder: EncoderParameters = EncoderParameters()
    estimator: Annotated[
        ObserverParameters | DifferenceParameters | ExactParameters, Field(discriminator="kind")
    ] = ObserverParameters()
    controller: Annotated[SlidingModeParameters | PidParameters, Field(discriminator="kind")] = (
        SlidingModeParameters()
    )
    can_delay_samples: int = Field(
        default=0,
        ge=0,
        le=10,
        json_schema_extra={
            "unit": "samples",
            "source": "assumption: latency of the CAN bus from controller to motor",
        },
    )
    reference: Reference = SineReference()
    initial_offset_m: float = quantity(
        0.0, "m", "rod position minus reference at the start (Fig. 9: 89 mm off)", ge=-0.15, le=0.15
    )
    simulation: SimulationParameters = SimulationParameters()

    def with_engine(self, engine: Literal["compiled", "drake"] | None) -> Scenario:
        """The same run by the compiled engine or Drake's Simulator; None: by what it asks for."""
        if engine is None or (engine == "compiled") == self.simulation.compiled:
            return self
        integrator = "exact_hold" if engine == "compiled" else "radau3"
        simulation = self.simulation.model_copy(update={"integrator": integrator})
        return self.model_copy(update={"simulation": simulation})

    def with_steps(self, step_s: float) -> Scenario:
        """The same run by explicit Runge–Kutta steps: rk4, or with Drake its runge_kutta3."""
        integrator = "rk4" if self.simulation.compiled else "runge_kutta3"
        steps = {"integrator": integrator, "step_s": step_s, "error_controlled": False}
        return self.model_copy(update={"simulation": self.simulation.model_copy(update=steps)})

    @property
    def command_limit_rad_s(self) -> float:
        """Limit of the command: the controller's, or the believed motor's where that is lower."""
        pump = self.believed_plant
        own = self.controller.command_limit_rad_s
        return own if pump.ideal_motor else min(own, pump.pump.speed_limit_rad_s)

    @property
    def believed_plant(self) -> PlantParameters:
        """The plant that the controller is designed for."""
        return self.plant if self.nominal is None else self.nominal

    @field_validator("reference", mode="before")
    @classmethod
    def _named_reference(cls, reference: Any, info: ValidationInfo) -> Any:
        return _read_reference(reference, (info.context or {}).get("directory", "."))

    @model_validator(mode="after")
    def _compatible(self) -> Scenario:
        self.plant.knee.require_in_range(*self.reference.range_deg)
        continuous = self.controller.kind == "smc" and self.controller.continuous
        if continuous and self.estimator.kind != "exact":
            raise ValueError(
                f"controller.continuous = true needs estimator.kind = exact, "
                f"not {self.estimator.kind}"
            )
        if continuous and self.can_delay_samples:
            raise ValueError(
                f"can_delay_samples = {self.can_delay_samples} needs a discrete controller"
            )
        return self


# --------------------------------------------------------------- studies of the paper

_TRIALS = "assumption: spread of the five repetitions of Fig. 13, which the paper does not describe"


class SinestreamParameters(Parameters):
    """Frequency response with one sine after another, and what differs between repetitions."""

    frequencies_hz: tuple[Annotated[float, Field(ge=1e-5, le=250)], ...] = Field(
        default=(
            *(0.05, 0.07, 0.1, 0.12, 0.14, 0.16, 0.18, 0.2),
            *(0.21, 0.22, 0.23, 0.24, 0.27, 0.31, 0.38, 0.5),
        ),
        min_length=3,
        json_schema_extra={
            "unit": "Hz",
            "source": "assumption: Fig. 13 spans the neighbourhood of its 0.21 Hz",
        },
    )
    transient_cycles: int = Field(
        default=1,
        ge=0,
        le=1000,
        json_schema_extra={"unit": "cycles", "source": "assumption: discarded before measuring"},
    )
    measured_cycles: int = Field(
        default=3,
        ge=1,
        le=1000,
        json_schema_extra={"unit": "cycles", "source": "Section 5: more than three cycles"},
    )
    trials: int = Field(
        default=5,
        ge=1,
        le=10_000,
        json_schema_extra={"unit": "1", "source": "Section 5: five times for each frequency"},
    )
    seed: int = Field(
        default=2020, ge=0, json_schema_extra={"unit": "1", "source": "assumption: any number"}
    )
    internal_leakage_min_m3_per_s_pa: float = quantity(
        2e-14, "m³/(s·Pa)", _TRIALS, ge=1e-18, le=1e-9
    )
    internal_leakage_max_m3_per_s_pa: float = quantity(
        2e-12, "m³/(s·Pa)", _TRIALS, ge=1e-18, le=1e-9
    )
    acceleration_limit_min_rad_s2: float = quantity(2e3, "rad/s²", _TRIALS, ge=1, le=1e7)
    acceleration_limit_max_rad_s2: float = quantity(1e4, "rad/s²", _TRIALS, ge=1, le=1e7)
    bulk_modulus_min_pa: float = quantity(0.2e9, "Pa", _TRIALS + "; entrained air", ge=1e6, le=1e11)
    bulk_modulus_max_pa: float = quantity(17_200e5, "Pa", _TRIALS, ge=1e6, le=1e11)
    mass_min_kg: float = quantity(1.4, "kg", "Table 2", ge=0.01, le=1000)
    mass_max_kg: float = quantity(1.8, "kg", "Table 2", ge=0.01, le=1000)

    @model_validator(mode="after")
    def _ordered(self) -> SinestreamParameters:
        for name in type(self).model_fields:
            if "_min_" in name:
                low, high = getattr(self, name), getattr(self, name.replace("_min_", "_max_"))
                if low > high:
                    raise ValueError(
                        f"{name} = {low:g} must not exceed "
                        f"{name.replace('_min_', '_max_')} = {high:g}"
                    )
        if len(set(self.frequencies_hz)) < len(self.frequencies_hz):
            raise ValueError("frequencies_hz must not repeat a value")
        return self


# ------------------------------------------------- frequency response, small to large signal


class SineEstimateParameters(Parameters):
    """How the response to one sine is estimated: ramp, settling, averaging."""

    ramp_cycles: float = quantity(
        1.0, "cycles", "assumption: over which the amplitude grows from zero", ge=0, le=1000
    )
    ramp_min_s: float = quantity(
        0.5,
        "s",
        "assumption: five times the slowest time constant of the default loop, so that short "
        "cycles do not start its transients",
        ge=0,
        le=1e3,
    )
    tolerance: float = quantity(
        2e-3,
        "1",
        "assumption: change of the response from one cycle to the next, relative to it, below "
        "which the loop has settled",
        ge=1e-6,
        le=0.5,
    )
    averaged_cycles: int = Field(
        default=3,
        ge=2,
        le=1000,
        json_schema_extra={
            "unit": "cycles",
            "source": "Section 5: more than three cycles, of which the ramp is the first",
        },
    )
    largest_cycles: int = Field(
        default=24,
        ge=3,
        le=10_000,
        json_schema_extra={"unit": "cycles", "source": "assumption: then it has not settled"},
    )

    @model_validator(mode="after")
    def _enough_cycles(self) -> SineEstimateParameters:
        if self.largest_cycles <= self.averaged_cycles:
            raise ValueError(
                f"largest_cycles = {self.largest_cycles}: too few cycles, must be more than "
                f"averaged_cycles = {self.averaged_cycles}"
            )
        return self


class AmplitudeMapParameters(Parameters):
    """Frequency response over amplitude and frequency: ``kneexo bandwidth``."""

    amplitudes_deg: tuple[Annotated[float, Field(ge=1e-6, le=46)], ...] = Field(
        default=(0.1, 0.3, 1.0, 3.0, 10.0, 30.0),
        min_length=1,
        json_schema_extra={
            "unit": "deg",
            "source": "assumption: from about one count of the encoder to Section 5's 10…70°",
        },
    )
    frequencies_hz: tuple[Annotated[float, Field(ge=1e-5, le=250)], ...] = Field(
        default=(
            *(0.05, 0.063, 0.08, 0.1, 0.125, 0.16, 0.2, 0.25, 0.315, 0.4, 0.5, 0.63, 0.8),
            *(1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0, 10.0, 12.5, 16.0, 20.0),
        ),
        min_length=3,
        json_schema_extra={
            "unit": "Hz",
            "source": "assumption: preferred numbers (R 10) about the bandwidths of all amplitudes",
        },
    )
    estimate: SineEstimateParameters = SineEstimateParameters()

    @model_validator(mode="after")
    def _increasing(self) -> AmplitudeMapParameters:
        for name in ("amplitudes_deg", "frequencies_hz"):
            values = getattr(self, name)
            if any(b <= a for a, b in zip((0.0, *values), values, strict=False)):
                raise ValueError(f"{name} must be above zero and increase")
        return self


# ------------------------------------------------------------------------------- sizing

GAIT_STRIDE_S = 0.890
"""Median stride time of the measured gait, as the head of ``data/gait_knee_flexion.csv`` says."""


def _tried(default: tuple[float, ...], unit: str, source: str) -> Any:
    return Field(default=default, min_length=1, json_schema_extra={"unit": unit, "source": source})


_Positive = tuple[Annotated[float, Field(ge=1e-6, le=1e9)], ...]


class SizingParameters(Parameters):
    """Hardware and gains that `kneexo.analysis.sizing` tries, and what walking must reach."""

    factors: _Positive = _tried(
        (0.125, 0.25, 0.5, 0.707, 1.0, 1.414, 2.0, 4.0, 8.0),
        "1",
        "assumption: what each value of the scenario's hardware is multiplied by",
    )
    walking_factors: _Positive = _tried(
        (0.5, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0),
        "1",
        "assumption: the same for the hardware that was sized for walking",
    )
    stride_frequencies_hz: tuple[Annotated[float, Field(ge=1e-5, le=10)], ...] = _tried(
        (1.0, 1.0 / GAIT_STRIDE_S), "Hz", "assumption: walking at 1 Hz; the measured stride"
    )
    cycles: int = Field(
        default=3,
        ge=2,
        le=1000,
        json_schema_extra={"unit": "1", "source": "assumption: strides; the first is discarded"},
    )
    error_bound_deg: float = quantity(
        2.0, "deg", "Section 5: the error was less than 2° with the SMC", ge=1e-3, le=90
    )
    largest_flow_factor: float = quantity(
        25.0,
        "1",
        "assumption: the search for the smallest flow begins here, 40 % above what the measured "
        "stride asks for",
        gt=1,
        le=100,
    )
    acceleration_limit_min_rad_s2: float = quantity(
        1e3, "rad/s²", "assumption: a tenth of the default", ge=1, le=1e7
    )
    acceleration_limit_max_rad_s2: float = quantity(
        1e5, "rad/s²", "assumption: ten times the default, without effect on walking", ge=1, le=1e7
    )
    search_tolerance: float = quantity(
        0.005, "1", "assumption: relative accuracy of the smallest values", ge=1e-4, le=0.5
    )
    margin: float = quantity(
        1.1, "1", "assumption: sized flow and acceleration limit over the smallest", ge=1, le=10
    )
    lambda_per_s: _Positive = _tried(
        (20.0, 40.0, 60.0, 80.0, 100.0, 120.0), "1/s", "assumption: λ to try"
    )
    slope_per_s: _Positive = _tried(
        (2.5e4, 3.5e4, 5e4, 7e4, 1e5, 1.4e5), "1/s", "assumption: k/Φ to try, with k = β·η"
    )
    observer_s: _Positive = _tried((0.010, 0.020), "s", "assumption: T_f to try")
    disk_margin_min: float = quantity(
        0.5, "1", "assumption: 28° of phase and a gain of 1.67 at the same time", ge=1e-3, le=2
    )
    command_change_ratio_max: float = quantity(
        1.5,
        "1",
        "assumption: mean change of the command over what the motion itself asks for; beyond it "
        "is chattering",
        gt=1,
        le=1000,
    )
    check_step_s: float = quantity(
        1e-4,
        "s",
        "assumption: step of RK4 for pressure and power; half of it too",
        ge=1e-6,
        le=2e-3,
    )
    seal_friction_n: float = quantity(
        40.0, "N", "assumption: as in UNCERTAINTY; a sized design must bear it", ge=0, le=1e5
    )
    wearer_torques_n_m: tuple[Annotated[float, Field(ge=-500, le=500)], ...] = _tried(
        (-20.0, -10.0, 0.0, 10.0, 20.0), "N·m", "assumption: constant torques of a wearer"
    )

    @model_validator(mode="after")
    def _ordered(self) -> SizingParameters:
        for name in ("factors", "walking_factors"):
            values = getattr(self, name)
            if any(b <= a for a, b in pairwise(values)):
                raise ValueError(f"{name} must increase")
        low, high = self.acceleration_limit_min_rad_s2, self.acceleration_limit_max_rad_s2
        if low >= high:
            raise ValueError(
                f"acceleration_limit_min_rad_s2 = {low:g} rad/s² must be below "
                f"acceleration_limit_max_rad_s2 = {high:g} rad/s²"
            )
        return self


# --------------------------------------------------------------------------- uncertainty


class Uncertainty(Parameters):
    """What one value of a scenario may be: an interval ``low`` … ``high``, or one of ``options``.

    ``scale`` log draws the logarithm uniformly (values known by their order of magnitude). With
    ``known`` the controller knows the value: its nominal plant changes too.
    """

    low: float | None = None
    high: float | None = None
    scale: Literal["linear", "log"] = "linear"
    options: tuple[Any, ...] = ()
    known: bool = False
    source: str = "given by the user"

    @model_validator(mode="after")
    def _one_kind(self) -> Uncertainty:
        interval = self.low is not None and self.high is not None
        if interval == bool(self.options) or (self.options and self.low != self.high):
            raise ValueError("must have either low and high, or options")
        if self.low is not None and self.high is not None:
            if not self.low < self.high:
                raise ValueError(f"low = {self.low:g} must be below high = {self.high:g}")
            if self.scale == "log" and self.low <= 0.0:
                raise ValueError(f"low = {self.low:g} must be > 0 with scale: log")
        return self

    def at(self, share: float) -> Any:
        """The value at ``share`` of the interval (0 … 1), or the option that holds that share."""
        if self.low is None or self.high is None:
            return self.options[min(int(share * len(self.options)), len(self.options) - 1)]
        if share in (0.0, 1.0):
            return (self.low, self.high)[int(share)]
        if self.scale == "log":
            return self.low * (self.high / self.low) ** share
        return self.low + share * (self.high - self.low)


class UncertaintySet(Parameters):
    """Uncertain values of a scenario, by dotted path (``plant.cylinder.mass_kg``)."""

    values: dict[str, Uncertainty] = Field(min_length=1)

    def __repr__(self) -> str:
        """How many values are uncertain."""
        return f"UncertaintySet({len(self.values)} values)"


UNCERTAINTY = UncertaintySet(
    values={
        "plant.cylinder.mass_kg": Uncertainty(low=1.4, high=1.8, source="Table 2"),
        "plant.cylinder.bulk_modulus_pa": Uncertainty(
            low=0.2e9, high=17_200e5, scale="log", source="assumption: entrained air; Table 2"
        ),
        "plant.pump.internal_leakage_m3_per_s_pa": Uncertainty(
            low=2e-14, high=2e-12, scale="log", source="assumption: a decade about the default"
        ),
        "plant.cylinder.damping_n_s_per_m": Uncertainty(
            low=0.05, high=1000.0, source="Table 2; assumption: 40 N of seal friction at 40 mm/s"
        ),
        "plant.cylinder.bore_m": Uncertainty(
            low=19.95e-3, high=20.05e-3, source="assumption: 0.5 % of the piston areas"
        ),
        "plant.load.segment_mass_kg": Uncertainty(
            low=0.0, high=3.2, source="assumption: from no weight to twice that of Table 3"
        ),
        "plant.load.knee_torque_n_m": Uncertainty(
            low=-5.0, high=5.0, source="assumption: a wearer who helps or resists a little"
        ),
        "plant.pump.lag_s": Uncertainty(
            low=0.005, high=0.020, scale="log", source="assumption: half and twice the default"
        ),
        "plant.pump.acceleration_limit_rad_s2": Uncertainty(
            low=2e3, high=1e4, scale="log", source="assumption: as in the trials of Fig. 13"
        ),
        "encoder.mounting_error_rad": Uncertainty(
            low=-2.0 * math.pi / 4096, high=2.0 * math.pi / 4096, source="assumption: one count"
        ),
        "can_delay_samples": Uncertainty(
            options=(0, 1, 2), source="assumption: latency of the CAN bus"
        ),
        "plant.linkage": Uncertainty(
            options=("G1", "G2", "G3"), known=True, source="three geometries reproduce Table 1"
        ),
        "plant.full_order": Uncertainty(
            options=(None, {}, {"coulomb_friction_n": 40.0}),
            source="the reduction of Eq. 14 to Eq. 15; assumption: 40 N of seal friction",
        ),
    }
)
"""The uncertainty that a controller of this knee must survive: ``kneexo robustness``."""

UNCERTAIN_KNEE = Scenario(plant=PlantParameters(load=KneeLoadParameters()))
"""The paper's setup under the weight of the shank: what `UNCERTAINTY` varies."""


class RobustnessParameters(Parameters):
    """How uncertainty is explored: ``kneexo robustness``."""

    samples: int = Field(
        default=500,
        ge=2,
        le=1_000_000,
        json_schema_extra={
            "unit": "1",
            "source": "assumption: the worst of 500 leaves out 0.6 % of all plants at most, with "
            "95 % confidence",
        },
    )
    seed: int = Field(
        default=2020, ge=0, json_schema_extra={"unit": "1", "source": "assumption: any number"}
    )
    corners_max: int = Field(
        default=1000,
        ge=1,
        le=10_000_000,
        json_schema_extra={"unit": "1", "source": "assumption: as many minutes as the samples"},
    )
    bandwidth: bool = choice(True, "False leaves out the large-signal bandwidth, which costs most")
    sensitivity_duration_s: float = quantity(
        20.0,
        "s",
        "assumption: two periods of 0.1 Hz, of which the second counts; 0 leaves AutoDiff through "
        "the run out",
        ge=0,
        le=1e5,
    )
    nyquist_loops: int = Field(
        default=60,
        ge=0,
        le=10_000,
        json_schema_extra={"unit": "1", "source": "assumption: lines that a plot can carry"},
    )


IDEAL_SMC = Scenario(
    plant=PlantParameters(
        pump=BldcPumpParameters(internal_leakage_m3_per_s_pa=0.0),
        rod_map="polynomial",
        ideal_motor=True,
    ),
    encoder=EncoderParameters(quantized=False),
    estimator=ExactParameters(),
    controller=SlidingModeParameters(continuous=True, lambda_per_s=10.0, command_limit_rad_s=1e12),
    initial_offset_m=-0.089,
    simulation=SimulationParameters(
        duration_s=10.0, tolerance=1e-13, error_controlled=True, accuracy=1e-6
    ),
)
"""Fig. 9: continuous sliding mode, exact states, no speed limit, no leakage, 89 mm off."""

PID_PAPER = PidParameters()
"""A PID tuned as poorly as Fig. 12 shows: proportional action alone, 5 1/s."""

PID_TUNED = PidParameters(proportional_per_s=14.0, integral_per_s2=400.0, filter_s=0.015)
"""The best PID found for Fig. 12 within the chattering of the SMC: ``benchmarks/tune_pid.py``.

The largest error depends on where single counts of the encoder fall, so neighbouring gains differ
by some hundredths of a degree in no order.
"""

PID_FEEDFORWARD = PidParameters(
    proportional_per_s=1.25,
    integral_per_s2=40.0,
    derivative=0.02,
    filter_s=0.010,
    velocity_feedforward=1.0,
)
"""The same with the reference's velocity: ``benchmarks/tune_pid.py --feedforward``."""

FIG_12 = {
    "smc": Scenario(),
    "pid": Scenario(controller=PID_PAPER),
    "pid_tuned": Scenario(controller=PID_TUNED),
    "pid_feedforward": Scenario(controller=PID_FEEDFORWARD),
}
"""Fig. 12: 10…70° at 0.1 Hz with the sliding-mode controller and with PIDs."""

_BASE_HZ = (0.20, 0.21, 0.22, 0.23, 0.24)

FIG_13_SCALING = {
    "nominal": (Scenario(), SinestreamParameters(frequencies_hz=_BASE_HZ)),
    "gear_3": (
        Scenario(plant=PlantParameters(pump=BldcPumpParameters(gear_ratio=3.0))),
        SinestreamParameters(frequencies_hz=tuple(2.0 * f for f in _BASE_HZ)),
    ),
    "half_amplitude": (
        Scenario(reference=SineReference(amplitude_deg=15.0)),
        SinestreamParameters(frequencies_hz=tuple(2.0 * f for f in _BASE_HZ)),
    ),
}
"""What should double the bandwidth of Fig. 13: twice the flow, or half the way."""


def _eq_27(slope_per_s: float) -> SlidingModeParameters:
    """The default controller with another k/Φ, taking k = β·η (1/s)."""
    default = SlidingModeParameters()
    return SlidingModeParameters(phi_m_s2=default.gain_ratio * default.eta_m_s3 / slope_per_s)


EQ_27_EXACT_STATES = {
    f"{slope:g}": Scenario(
        encoder=EncoderParameters(quantized=False),
        estimator=ExactParameters(),
        controller=_eq_27(slope),
        reference=StepReference(start_deg=30.0, end_deg=30.0),
        initial_offset_m=5e-5,
        simulation=SimulationParameters(duration_s=3.0, integrator="rk4", step_s=4e-5),
    )
    for slope in (1.0e4, 1.3e4)
}
"""Eq. 27 at 2 ms with exact states, by k/Φ in 1/s: below and above the stability boundary of the
sampled hydraulic mode. At this step rk4 is exact to 2e-4 1/s; Drake's radau3 damps the mode by 0.06
1/s and its RK3 by 0.17 1/s, at 0.2 ms more than the oil does."""

EQ_27_DIFFERENCES = {
    f"{slope:g}": Scenario(
        estimator=DifferenceParameters(),
        controller=_eq_27(slope),
        simulation=SimulationParameters(duration_s=20.0),
    )
    for slope in (1.0e4, 4.0e4)
}
"""Eq. 27 at 2 ms with plain differences of the quantized encoder, by k/Φ in 1/s."""


# ------------------------------------------------------------------------ controller study


class ControllerStudyParameters(Parameters):
    """Grid over λ, Φ and η, and the experiments made at each of its points: ``kneexo study``."""

    lambdas_per_s: _Positive = _tried(
        (5.0, 7.1, 10.0, 14.1, 20.0, 28.3, 40.0, 56.6, 80.0),
        "1/s",
        "assumption: the default times powers of √2",
    )
    phis_m_s2: _Positive = _tried(
        (0.32, 0.57, 1.0, 1.8, 3.2, 5.7, 10.0, 18.0, 32.0, 57.0, 100.0),
        "m/s²",
        "assumption: the default times powers of 10^(1/4)",
    )
    etas_m_s3: _Positive = _tried(
        (8.9e3, 2.8e4, 8.9e4, 2.8e5, 8.9e5, 2.8e6),
        "m/s³",
        "assumption: the default times powers of √10",
    )
    step_deg: float = quantity(
        2.0,
        "deg",
        "assumption: twenty counts of the encoder, and within the speed limit up to λ = 60 1/s",
        ge=1e-3,
        le=45,
    )
    large_step_deg: float = quantity(
        20.0, "deg", "assumption: one that the speed limit governs", ge=1e-3, le=45
    )
    step_duration_s: float = quantity(
        4.0, "s", "assumption: four times what the large step takes", ge=0.01, le=1e3
    )
    settled_share: float = quantity(
        0.1, "1", "assumption: of the small step; two counts of the encoder", ge=1e-3, le=0.9
    )
    fast_amplitude_deg: float = quantity(
        2.5, "deg", "assumption: at 1 Hz it stays below the speed limit", ge=1e-3, le=45
    )
    fast_frequency_hz: float = quantity(
        1.0, "Hz", "assumption: ten times the reference of Section 5", ge=1e-3, le=250
    )
    fast_duration_s: float = quantity(4.0, "s", "assumption: four periods", ge=0.01, le=1e4)
    chattering_factor: float = quantity(
        2.0,
        "1",
        "assumption: a value chatters whose command changes by so much more than at the best one",
        gt=1,
        le=100,
    )
    wrong_factor: float = quantity(
        3.0, "1", "assumption: a value is wrong that is so much too large or small", gt=1, le=100
    )
    sound_disk_margin: float = quantity(
        0.5,
        "1",
        "assumption: gain by a factor of 0.6…1.67 and phase by 28°, alone; a loop below it is "
        "counted apart",
        ge=1e-3,
        le=2,
    )
    trap_time_constant_s: float = quantity(
        0.008,
        "s",
        "assumption: T_f of a loop that is linearly stable and errs by degrees",
        ge=1e-5,
        le=1,
    )
    trap_slope_per_s: float = quantity(1e4, "1/s", "assumption: k/Φ of the same", ge=1e-3, le=1e12)
    trap_lambdas_per_s: _Positive = _tried((20.0, 10.0), "1/s", "assumption: λ of the same")
    hold_duration_s: float = quantity(
        20.0, "s", "assumption: long enough for an oscillation at rest to settle", ge=0.01, le=1e4
    )
    unlimited_acceleration_rad_s2: float = quantity(
        1e7, "rad/s²", "assumption: a thousand times the default limit", ge=1, le=1e7
    )
    map_time_constants_s: _Positive = _tried(
        (0.003, 0.004, 0.006, 0.008, 0.012, 0.016, 0.020, 0.028, 0.040),
        "s",
        "assumption: T_f about its default",
    )
    map_slopes_per_s: _Positive = _tried(
        (5.6e3, 1e4, 1.8e4, 3.2e4, 5.6e4, 1e5, 1.8e5, 3.2e5, 5.6e5, 1e6),
        "1/s",
        "assumption: k/Φ about its default",
    )

    @field_validator(
        "lambdas_per_s", "phis_m_s2", "etas_m_s3", "map_time_constants_s", "map_slopes_per_s"
    )
    @classmethod
    def _increasing(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        if any(b <= a for a, b in pairwise(values)):
            raise ValueError("must increase")
        return values


# ------------------------------------------------- sliding condition, reduced and full order


class SlidingStudyParameters(Parameters):
    """Which η, loads and gains the check of the sliding condition runs through."""

    etas_m_s3: tuple[Annotated[float, Field(ge=1e-3, le=1e12)], ...] = Field(
        default=(1e3, 1e4, 3e4, 3.6e4, 7e4, 9e4, 2.8e5),
        min_length=1,
        json_schema_extra={
            "unit": "m/s³",
            "source": "assumption: from 1/300 of the speed authority to all of it, with two each "
            "about 3.3e4 and 8.0e4, what the closed forms ask for with P_1 and P_2 loaded",
        },
    )
    loads_n: tuple[Annotated[float, Field(ge=-1e4, le=1e4)], ...] = Field(
        default=(60.0, -60.0),
        min_length=1,
        json_schema_extra={
            "unit": "N",
            "source": "assumption: four times the switching force, so that one chamber carries "
            "the load throughout, P_1 or P_2",
        },
    )
    start_eta_m_s3: float = quantity(
        1e3,
        "m/s³",
        "assumption: so small that reaching the layer takes a time worth looking at",
        ge=1e-3,
        le=1e12,
    )
    start_offset_m: float = quantity(
        -0.010, "m", "assumption: λ² times it lies outside the layer", ge=-0.15, le=0.15
    )
    start_duration_s: float = quantity(
        0.010, "s", "assumption: ten times what reaching takes", ge=1e-3, le=1e3
    )
    start_sample_time_s: float = quantity(
        2e-5, "s", "assumption: of the log; fifty before the layer is reached", ge=1e-5, le=1
    )
    sampled_eta_m_s3: float = quantity(
        2.8e4,
        "m/s³",
        "assumption: k/Φ = 9.9e3 1/s, below the stability boundary of exact states at 2 ms",
        ge=1e-3,
        le=1e12,
    )
    sampled_offset_m: float = quantity(
        -0.020, "m", "assumption: half a second at the speed limit", ge=-0.15, le=0.15
    )
    settling_factor: float = quantity(
        8.0,
        "1",
        "assumption: times 1/λ after which what is left of the start does not count, 0.3 %",
        ge=0,
        le=1e3,
    )
    rated_samples: int = Field(
        default=2000,
        ge=10,
        le=1_000_000,
        json_schema_extra={
            "unit": "1",
            "source": "assumption: samples outside the layer at which ds/dt is evaluated, at most",
        },
    )


class OrderComparisonParameters(Parameters):
    """What the full order is compared with the reduced one in."""

    disturbances_n: tuple[Annotated[float, Field(ge=-1e4, le=1e4)], ...] = Field(
        default=(0.0, 60.0, -60.0),
        min_length=1,
        json_schema_extra={
            "unit": "N",
            "source": "assumption: none, and enough for P_1 or P_2 to carry the load throughout",
        },
    )
    postures_deg: tuple[Annotated[float, Field(ge=0, le=90)], ...] = Field(
        default=(10.0, 40.0, 70.0),
        min_length=1,
        json_schema_extra={"unit": "deg", "source": "Section 5: ends and middle of 10…70°"},
    )
    speed_rate_deg_s: float = quantity(
        60.0, "deg/s", "assumption: beyond the speed limit at every posture", ge=1e-3, le=1e4
    )
    switching_forces_n: tuple[Annotated[float, Field(ge=-1e4, le=1e4)], ...] = Field(
        default=tuple(float(force) for force in range(0, 41, 2)),
        min_length=1,
        json_schema_extra={
            "unit": "N",
            "source": "assumption: about the switching force P_r (A_1 − A_2) = 15.7 N",
        },
    )
    switching_rate_deg_s: float = quantity(
        15.0, "deg/s", "assumption: two thirds of what the speed limit allows", ge=1e-3, le=1e4
    )
    switching_step_s: float = quantity(
        2e-5,
        "s",
        "assumption: step of rk4, which takes the many openings of the valves better than an "
        "exact hold; a third of the make-up valve's time constant",
        ge=1e-7,
        le=1e-3,
    )
    oscillation_m_s: float = quantity(
        0.010,
        "m/s",
        "assumption: peak to peak of the rod's velocity about its reference that counts as "
        "oscillation; without, a tenth of it is left",
        ge=1e-6,
        le=10,
    )


SLIDING_LAW = Scenario(
    plant=PlantParameters(
        load=KneeLoadParameters(segment_mass_kg=0.0), rod_map="polynomial", ideal_motor=True
    ),
    encoder=EncoderParameters(quantized=False),
    estimator=ExactParameters(),
    controller=SlidingModeParameters(
        continuous=True,
        sample_time_s=2e-4,
        load_rate_uncertainty_n_per_s=2.5e3,
        command_limit_rad_s=1e12,
    ),
    simulation=SimulationParameters(duration_s=10.0),
)
"""The setting of the sliding condition: continuous time, exact states, an ideal motor.

The sample time is that of the log. Eq. 27 drops the leakage, 4 β_e C_t/V_t = 33 N/s per newton of
load; here its bound on dF_L/dt holds it, for 75 N."""


# --------------------------------------------------------------------------------- contest

_WIDE = "assumption: wide enough that the optimum lies inside"


def _gain(low: float, high: float, source: str = _WIDE) -> Uncertainty:
    return Uncertainty(low=low, high=high, scale="log", source=source)


class Contestant(Parameters):
    """A controller, and which of a scenario's values the optimizer may set, by dotted path."""

    controller: Annotated[SlidingModeParameters | PidParameters, Field(discriminator="kind")]
    gains: dict[str, Uncertainty] = Field(min_length=1)


_PID_GAINS = {
    "controller.proportional_per_s": _gain(0.1, 100.0),
    "controller.integral_per_s2": _gain(0.1, 2000.0),
    "controller.derivative": _gain(1e-4, 1.0, _WIDE + "; the lowest is none"),
    "controller.filter_s": _gain(0.002, 0.1, _WIDE + "; not below one sample"),
}

CONTESTANTS = {
    "SMC": Contestant(
        controller=SlidingModeParameters(),
        gains={
            "controller.lambda_per_s": _gain(2.0, 200.0),
            "controller.phi_m_s2": _gain(0.1, 100.0),
            "controller.eta_m_s3": _gain(1e4, 1e7),
            "estimator.time_constant_s": _gain(0.002, 0.1, _WIDE + "; not below one sample"),
        },
    ),
    "PID": Contestant(controller=PidParameters(), gains=_PID_GAINS),
    "PID with reference velocity": Contestant(
        controller=PidParameters(velocity_feedforward=1.0), gains=_PID_GAINS
    ),
}
"""Who is tuned in `kneexo.analysis.contest`: four gains each."""

UNTUNED = {
    "SMC, default": SlidingModeParameters(),
    "PID as in the paper": PID_PAPER,
    "PID, error only": PID_TUNED,
    "PID with reference velocity, error only": PID_FEEDFORWARD,
}
"""Who runs beside them: the default, the paper's, and those tuned for the error of Fig. 12 alone
(``benchmarks/tune_pid.py``)."""


class ContestParameters(Parameters):
    """Tuning under one budget, and the test of what it finds."""

    contestants: dict[str, Contestant] = Field(default=CONTESTANTS, min_length=1)
    training_samples: int = Field(
        default=6,
        ge=1,
        le=10_000,
        json_schema_extra={
            "unit": "1",
            "source": "assumption: of the uncertainty, beside the nominal plant; each costs a run "
            "in every evaluation",
        },
    )
    training_seed: int = Field(
        default=1, ge=0, json_schema_extra={"unit": "1", "source": "assumption: any number"}
    )
    test_samples: int = Field(
        default=200,
        ge=1,
        le=100_000,
        json_schema_extra={
            "unit": "1",
            "source": "assumption: the 95 % level then stands on ten samples",
        },
    )
    test_seed: int = Field(
        default=2, ge=0, json_schema_extra={"unit": "1", "source": "assumption: any other number"}
    )
    optimizer_seeds: tuple[Annotated[int, Field(ge=0)], ...] = Field(
        default=(1, 2),
        min_length=1,
        json_schema_extra={
            "unit": "1",
            "source": "assumption: two searches that end alike have converged",
        },
    )
    population: int = Field(
        default=32,
        ge=5,
        le=10_000,
        json_schema_extra={"unit": "1", "source": "assumption: eight for each gain"},
    )
    generations: int = Field(
        default=60,
        ge=1,
        le=100_000,
        json_schema_extra={"unit": "1", "source": "assumption: the most; the budget of each"},
    )
    tolerance: float = quantity(
        0.05,
        "1",
        "assumption: spread of the population's objectives, relative to their mean, at which a "
        "search has converged",
        ge=1e-6,
        le=1,
    )
    least_disk_margin: float = quantity(
        0.5,
        "1",
        "assumption: gain by a factor of 0.6…1.67 and phase by 28°, alone, on every training plant",
        ge=1e-3,
        le=2,
    )
    duration_s: float = quantity(
        20.0, "s", "assumption: two periods of 0.1 Hz, of which the second counts", ge=1e-3, le=1e5
    )
    other_reference: SineReference = SineReference(amplitude_deg=2.5, frequency_hz=1.0)
    """A task that nobody is tuned for, below the speed limit."""
    other_duration_s: float = quantity(5.0, "s", "assumption: five of its periods", ge=0.01, le=1e5)
