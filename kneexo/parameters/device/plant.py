"""Parameters of the plant: motor and pump, cylinder, knee and load."""

from __future__ import annotations

import math
from numbers import Real
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from kneexo.errors import ParameterError
from kneexo.parameters.device.linkages import G1, LINKAGES, LinkageParameters
from kneexo.parameters.fields.messages import shown_value
from kneexo.parameters.fields.quantity import (
    Parameters,
    choice,
    named,
    optional_part,
    ordered_limits,
    quantities,
    quantity,
)

RPM = 2.0 * math.pi / 60.0
"""One revolution per minute in rad/s."""


ATMOSPHERE_PA = 101_325.0
"""Standard atmosphere in Pa. All other pressures in kneexo are relative to this pressure."""

LOWEST_PRESSURE_PA = -0.1e6
"""Relative pressure in Pa below which a warning says that oil would evaporate and release air.

Assumption: 1 % of an atmosphere above vacuum.
"""

AIR_EXPONENT = 1.4
"""Polytropic exponent of entrained air.

Assumption: the air is adiabatic, because the oscillation of the oil column is fast.
"""

SEAL_FRICTION_N = 40.0
"""Coulomb friction of the cylinder's seals in N, where a scenario has friction.

Assumption: the seals take 0.146 MPa on the mean area, 4 % of the rated pressure. The model of the
paper has no friction.
"""


class BldcPumpParameters(Parameters):
    """BLDC motor with gear and axial-piston pump (Eq. 12, 13)."""

    speed_limit_rad_s: float = quantity(
        5000.0 * RPM, "rad/s", "Tables 2 and 3: 5000 rpm at the motor", ge=0.1, le=5000
    )
    lag_s: float = quantity(
        0.010,
        "s",
        "assumption: time constant of the drive's speed loop; not in the paper",
        ge=1e-4,
        le=1,
    )
    acceleration_limit_rad_s2: float = quantity(
        1e4,
        "rad/s²",
        "assumption: torque and inertia are not in the paper, but Section 5 explains its initial "
        "error by the time that the motor needs to accelerate",
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
        "assumption: C_im of Eq. 12 is not in the paper; the pump leaks, the piston seals barely",
        ge=0,
        le=1e-9,
    )
    external_leakage_m3_per_s_pa: float = quantity(
        0.0, "m³/(s·Pa)", "assumption: C_em of Eq. 12 is not in the paper", ge=0, le=1e-9
    )
    rated_power_w: float = quantity(200.0, "W", "Table 3", ge=0.1, le=1e5)

    @property
    def leakage_m3_per_s_pa(self) -> float:
        """Leakage coefficient of the load flow, C_im + C_em/2 (Eq. 13), in m³/(s·Pa)."""
        return self.internal_leakage_m3_per_s_pa + 0.5 * self.external_leakage_m3_per_s_pa


class MotorParameters(Parameters):
    """Torque, current and supply of the BLDC motor.

    The numbers are those of a brushless motor of the paper's supply and power, 24 V and 200 W
    (Table 3), rounded. The paper names the maker, but neither the motor nor its numbers.
    """

    inertia_kg_m2: float = quantity(
        2e-5,
        "kg·m²",
        "assumption: rotor of a 200 W motor, gear and pump included",
        ge=1e-8,
        le=0.1,
    )
    torque_constant_n_m_per_a: float = quantity(
        0.04,
        "N·m/A",
        "assumption: 5730 rpm without load at 24 V, above the 5000 rpm of Tables 2 and 3; also the "
        "constant of the induced voltage in V·s/rad",
        ge=1e-4,
        le=1,
    )
    resistance_ohm: float = quantity(
        0.15, "Ω", "assumption: between two phases at 25 °C, with the leads", ge=1e-4, le=100
    )
    coulomb_torque_n_m: float = quantity(
        0.01,
        "N·m",
        "assumption: friction of motor, gear and pump; 10 or more locks the shaft",
        ge=0,
        le=1000,
    )
    viscous_torque_n_m_s_per_rad: float = quantity(
        1e-5, "N·m·s/rad", "assumption: 0.005 N·m of iron and churning at 5000 rpm", ge=0, le=1
    )
    friction_band_rad_s: float = quantity(
        10.0,
        "rad/s",
        "assumption: 2 % of 5000 rpm rounds the reversal of friction",
        ge=1e-3,
        le=1e3,
    )
    supply_voltage_v: float = quantity(24.0, "V", "Table 3: input voltage", ge=0, le=1000)
    current_limit_a: float = quantity(
        15.0,
        "A",
        "assumption: 0.6 N·m, 1.5 times the torque of 200 W at 5000 rpm; 0 is a dead motor",
        ge=0,
        le=1000,
    )


WINDING_REFERENCE_DEGC = 25.0
"""Temperature in °C at which ``plant.motor.resistance_ohm`` holds."""


class ThermalParameters(Parameters):
    """Temperatures of winding and case of the motor, and the current limit of a hot winding."""

    winding_capacity_j_per_k: float = quantity(
        20.0,
        "J/K",
        "assumption: 50 g of copper; with the resistance to the case, a time constant of 20 s",
        ge=1e-3,
        le=1e5,
    )
    case_capacity_j_per_k: float = quantity(
        400.0,
        "J/K",
        "assumption: 0.9 kg of steel; with the resistance to the air, a time constant of 20 min",
        ge=1e-2,
        le=1e6,
    )
    winding_to_case_k_per_w: float = quantity(
        1.0, "K/W", "assumption: usual in brushless motors of 200 W", ge=1e-3, le=1e3
    )
    case_to_air_k_per_w: float = quantity(
        3.0, "K/W", "assumption: still air, no heat sink", ge=1e-3, le=1e3
    )
    air_degc: float = quantity(25.0, "°C", "assumption: room", ge=-40, le=100)
    start_degc: float = quantity(
        25.0, "°C", "assumption: the motor is cold at the start", ge=-40, le=200
    )
    copper_per_k: float = quantity(
        0.0039, "1/K", "assumption: the rise of the resistance of copper at 25 °C", ge=0, le=0.01
    )
    derating_min_degc: float = quantity(
        120.0,
        "°C",
        "assumption: temperature of the winding from which the drive lowers the current limit",
        ge=0,
        le=500,
    )
    derating_max_degc: float = quantity(
        150.0,
        "°C",
        "assumption: the drive allows no current; just below the 155 °C of insulation class F",
        ge=0,
        le=500,
    )

    _ordered = ordered_limits(strict=True)


_THICKEST_ROD = 0.98  # diameter relative to the bore; the annular area, then 4 %, is a divisor


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
    mass_kg: float = quantity(
        1.6,
        "kg",
        "Table 2: mass m of Eq. 16, which moves with the rod and has no weight; Table 3: shank",
        ge=0.01,
        le=1000,
    )
    damping_n_s_per_m: float = quantity(0.05, "N/(m/s)", "Table 2: B", ge=0, le=1e6)
    stiffness_n_per_m: float = quantity(
        0.0, "N/m", "assumption: K of Eq. 16 is not in the paper", ge=0, le=1e7
    )
    leakage_m3_per_s_pa: float = quantity(
        0.0,
        "m³/(s·Pa)",
        "assumption: C_L of Eq. 15 is not in the paper; piston seals barely leak",
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
    """Chambers, valves and seals of the full-order cylinder (Eq. 14).

    These numbers complete `CylinderParameters`, whose ``leakage_m3_per_s_pa`` is C_im' of Eq. 14. A
    reduced-order cylinder with the same leakage has C_L = C_im' + C_em'/2. Pressures are relative
    to the atmosphere.
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
        "assumption: P_r of Eq. 14 is not in the paper; 2 bar keep the return line from cavitating",
        ge=0,
        le=1e6,
    )
    cap_external_leakage_m3_per_s_pa: float = quantity(
        0.0, "m³/(s·Pa)", "assumption: C_em1' of Eq. 14 is not in the paper", ge=0, le=1e-9
    )
    rod_side_external_leakage_m3_per_s_pa: float = quantity(
        0.0, "m³/(s·Pa)", "assumption: C_em2' of Eq. 14 is not in the paper", ge=0, le=1e-9
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
        0.0, "N", "assumption: additional friction at breakaway", ge=0, le=1e5
    )
    stribeck_speed_m_s: float = quantity(
        0.01, "m/s", "assumption: typical of hydraulic seals", ge=1e-5, le=10
    )
    friction_band_m_s: float = quantity(
        1e-3, "m/s", "assumption: rounds the reversal of the friction", ge=1e-6, le=10
    )


class BypassParameters(Parameters):
    """Solenoid valve that opens both chambers to the reservoir.

    The valve is closed while nobody commands an opening. A fault of kind value makes a valve that
    is stuck: ``minimum_opening`` = 1 is stuck open, ``conductance_m3_per_s_pa`` = 0 is stuck shut.
    """

    conductance_m3_per_s_pa: float = quantity(
        5e-10,
        "m³/(s·Pa)",
        "assumption: of the open valve, for each chamber; 0.2 MPa at the 100 cm³/s that a knee "
        "walking at 0.5 Hz displaces; 0 blocks the valve",
        ge=0,
        le=1e-6,
    )
    time_constant_s: float = quantity(
        0.02,
        "s",
        "assumption: of the opening; solenoid poppets switch in some 50 ms",
        ge=1e-4,
        le=1,
    )
    minimum_opening: float = quantity(
        0.0, "1", "assumption: the valve closes tightly; 1 is stuck open", ge=0, le=1
    )


class EndStopParameters(Parameters):
    """Stops of the rod at both ends of the knee's range of motion, ``plant.knee``."""

    stiffness_n_per_m: float = quantity(
        3e7,
        "N/m",
        "assumption: 0.1 mm at 3 kN, the relief pressures and 75 N·m of the wearer at full "
        "extension; a run still ends plant.knee.overshoot_deg beyond a stop",
        ge=1e3,
        le=1e10,
    )
    dissipation_s_per_m: float = quantity(
        2.0,
        "s/m",
        "assumption: a rod of 1.6 kg at 0.3 m/s rebounds with 0.71 of its speed",
        ge=0,
        le=1e3,
    )


class KneeParameters(Parameters):
    """Range of motion of the knee. A run that leaves it by more than ``overshoot_deg`` fails."""

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

    _ordered = ordered_limits(strict=True)

    def require_posture(self, knee_angle_deg: float, name: str = "knee_angle_deg") -> None:
        """Raise `ParameterError` if a knee angle, the argument ``name``, is no posture."""
        if not isinstance(knee_angle_deg, Real):
            raise ParameterError(f"{name} = {shown_value(knee_angle_deg)}: must be a number in deg")
        if not self.flexion_min_deg <= knee_angle_deg <= self.flexion_max_deg:
            raise ParameterError(
                f"{name} = {knee_angle_deg:g} deg is out of range: must be >= "
                f"{self.flexion_min_deg:g} and <= {self.flexion_max_deg:g} deg"
            )

    def require_in_range(self, low_deg: float, high_deg: float, remedy: str = "reduce it") -> None:
        """Raise `ParameterError` if a reference leaves the range of motion.

        Parameters
        ----------
        low_deg, high_deg
            Smallest and largest knee angle of the reference in deg.
        remedy
            End of the message.
        """
        if low_deg < self.flexion_min_deg or high_deg > self.flexion_max_deg:
            raise ParameterError(
                f"reference = {low_deg:.4g} … {high_deg:.4g} deg leaves the range of motion "
                f"{self.flexion_min_deg:g} … {self.flexion_max_deg:g} deg; {remedy}"
            )


_Six = tuple[float, float, float, float, float, float]


def _coefficients(default: _Six, unit: str, source: str, largest: float) -> Any:
    return quantities(default, unit, source, ge=-largest, le=largest, min_length=None)


class RodPolynomialParameters(Parameters):
    """Coefficients (Table 1) of the polynomials that convert between knee angle and rod extension.

    The controller uses the polynomials. Eq. 10 (p) gives the rod extension in mm from the knee
    angle in deg. Eq. 11 (q) gives the knee angle from the rod extension.
    """

    p_mm_deg: _Six = _coefficients(
        (1.571e-8, -4.164e-6, 0.0004789, -0.03192, -0.6195, 148.0),
        "mm/deg^n",
        "Table 1: p_1 … p_6 of Eq. 10",
        1e4,
    )
    q_deg_mm: _Six = _coefficients(
        (-1.807e-9, 5.788e-7, -7.285e-5, 0.004161, -0.6389, 91.73),
        "deg/mm^n",
        "Table 1: q_1 … q_6 of Eq. 11",
        1e12,
    )

    @property
    def p_si(self) -> tuple[float, ...]:
        """Coefficients of Eq. 10 for θ_p in rad and x in m. The highest power comes first."""
        degree = len(self.p_mm_deg) - 1
        return tuple(
            1e-3 * p * math.degrees(1.0) ** (degree - n) for n, p in enumerate(self.p_mm_deg)
        )


class NoLoad(Parameters):
    """No load, as in the paper's simulation. Only the disturbance input acts on the rod."""

    kind: Literal["none"] = "none"


class KneeLoadParameters(Parameters):
    """Load of the knee: weight and inertia of the shank, disturbance, torque of the wearer."""

    kind: Literal["knee"] = "knee"
    segment_mass_kg: float = quantity(
        1.6,
        "kg",
        "Table 3: shank, whose weight turns the knee; 0 switches the weight off",
        ge=0,
        le=200,
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
    inertia_kg_m2: float | None = quantity(
        None,
        "kg·m²",
        "assumption: none, plant.cylinder.mass_kg moves with the rod; a mass of 1.6 kg, 0.20 m "
        "from the knee, has 0.064 kg·m²",
        ge=1e-4,
        le=10,
    )
    """Inertia I about the knee. The mass that moves with the rod is then I/r²."""


class PlantParameters(Parameters):
    """The plant: motor and pump, cylinder, knee and load, and switches for idealizations."""

    pump: BldcPumpParameters = BldcPumpParameters()
    cylinder: CylinderParameters = CylinderParameters()
    linkage: LinkageParameters = named(Field(default=G1), LINKAGES)
    knee: KneeParameters = KneeParameters()
    load: Annotated[NoLoad | KneeLoadParameters, Field(discriminator="kind")] = NoLoad()
    rod_map: Literal["linkage", "polynomial"] = choice(
        "linkage",
        "the plant's rod follows the exact linkage (Eq. 1–9), or Table 1 as the controller's does",
    )
    ideal_motor: bool = choice(
        False, "Eq. 17: pump speed equals the command, without lag, acceleration or speed limit"
    )
    motor: MotorParameters | None = optional_part(
        "assumption: torque, current and supply of the motor; left out, the torque of the motor is "
        "not limited"
    )
    thermal: ThermalParameters | None = optional_part(
        "assumption: temperatures of the motor, with a lower current limit when hot; needs "
        "plant.motor; left out, the motor stays cold"
    )
    full_order: FullCylinderParameters | None = optional_part(
        "Eq. 14 with its valves; left out, the cylinder is the reduced order of Eq. 15"
    )
    bypass: BypassParameters | None = optional_part(
        "assumption: valve that opens both chambers to the reservoir; needs plant.full_order; left "
        "out, there is no such valve"
    )

    end_stops: EndStopParameters | None = optional_part(
        "assumption: stops at both ends of the knee's range of motion; left out, nothing stops the "
        "rod"
    )

    @model_validator(mode="after")
    def _bypass_has_chambers(self) -> PlantParameters:
        if self.bypass is not None and self.full_order is None:
            raise ValueError(
                "bypass: must be left out of the reduced order, which has no chambers that the "
                "valve could open to the reservoir; add full_order: true"
            )
        return self

    @model_validator(mode="after")
    def _motor_has_its_parts(self) -> PlantParameters:
        if self.ideal_motor and self.motor is not None:
            raise ValueError("motor: must be left out with ideal_motor = true; set it to false")
        if self.thermal is not None and self.motor is None:
            raise ValueError(
                "thermal: must be left out without motor, whose current heats it; add motor: true"
            )
        return self

    def without_temperatures(self) -> PlantParameters:
        """Return the plant for linear analysis, whose motor stays cold."""
        return self.model_copy(update={"thermal": None})

    @property
    def leakage_m3_per_s_pa(self) -> float:
        """Leakage coefficient C_t of pump and cylinder in m³/(s·Pa)."""
        return self.pump.leakage_m3_per_s_pa + self.cylinder.leakage_m3_per_s_pa

    @property
    def speed_gain_rad_per_m(self) -> float:
        """Motor speed per rod speed, G = gear·Ā/D_m, in rad/m."""
        area_m2 = self.pump.gear_ratio * self.cylinder.mean_area_m2
        return area_m2 / self.pump.displacement_m3_per_rad

    @property
    def knee_inertia_kg_m2(self) -> float | None:
        """Inertia of the load about the knee in kg·m², or None for a constant mass at the rod."""
        return None if isinstance(self.load, NoLoad) else self.load.inertia_kg_m2

    def moving_mass_kg(self, moment_arm_m: Any) -> Any:
        """Return the mass in kg that moves with the rod at a moment arm or at an array of them."""
        inertia = self.knee_inertia_kg_m2
        return self.cylinder.mass_kg if inertia is None else inertia / moment_arm_m**2
