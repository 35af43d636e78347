"""Every physical number of kneexo: value, unit, range and provenance.

The name of a field ends with its unit. Units are SI units, but Table 1, the range of motion and the
knee references keep the paper's units (mm, deg). "Table n", "Eq. n" and "Section n" refer to Lee,
Lee, Song and Baek, "Design and Control of a Polycentric Knee Exoskeleton Using an Electro-Hydraulic
Actuator", Sensors 2020, 20(1), 211. "Assumption" marks a number that the paper does not print, and
gives the reason for this number.

The range of a field covers all values that such hardware and such a task could have, and about a
decade beyond. A field that an equation divides by has a lower limit above zero. So no value within
its range causes an overflow.

All classes are frozen and validated on construction. A bad value raises `ParameterError` with a
message of one line. To change a number, pass it by name: ``CylinderParameters(mass_kg=1.8)``.
"""

from kneexo.parameters.device.bus import Cia402Parameters, NoBus
from kneexo.parameters.device.control import (
    DifferenceParameters,
    EncoderParameters,
    ExactParameters,
    LawParameters,
    ObserverParameters,
    PidParameters,
    SlidingModeParameters,
)
from kneexo.parameters.device.law import LAW_INPUTS, Law
from kneexo.parameters.device.linkages import (
    G1,
    G2,
    G3,
    G4,
    G5,
    HINGE,
    LINKAGES,
    TABLE_1_LINKAGES,
    LinkageParameters,
)
from kneexo.parameters.device.plant import (
    AIR_EXPONENT,
    ATMOSPHERE_PA,
    RPM,
    SEAL_FRICTION_N,
    BldcPumpParameters,
    BypassParameters,
    CylinderParameters,
    EndStopParameters,
    FullCylinderParameters,
    KneeLoadParameters,
    KneeParameters,
    MotorParameters,
    NoLoad,
    PlantParameters,
    RodPolynomialParameters,
    ThermalParameters,
)
from kneexo.parameters.device.protection import ProtectionParameters
from kneexo.parameters.device.torque import LoadCellParameters, TorqueParameters
from kneexo.parameters.scenario import DEFAULT_DURATION_S, Scenario, SimulationParameters
from kneexo.parameters.task.fault import FaultParameters
from kneexo.parameters.task.push import PushParameters
from kneexo.parameters.task.reference import (
    CsvReference,
    GaitReference,
    Interpolation,
    RampReference,
    Reference,
    SampledReference,
    SineReference,
    StepReference,
    gait_reference,
    sit_to_stand_reference,
)
from kneexo.parameters.uncertainty import (
    UNCERTAIN_KNEE,
    UNCERTAINTY,
    WEARER_UNCERTAINTY,
    Uncertainty,
    UncertaintySet,
)
from kneexo.parameters.wearer.anatomical_knee import GAIT2392, AnatomicalKneeParameters
from kneexo.parameters.wearer.design_limits import DesignLimits
from kneexo.parameters.wearer.walking_leg import WalkingLegParameters
from kneexo.parameters.wearer.wearer import (
    BODIES,
    MOMENT_MASS_KG,
    WEARERS,
    CsvMoment,
    CuffParameters,
    GaitMoment,
    LegParameters,
    MomentTable,
    NoWearer,
    StrapParameters,
    Wearer,
    gait_moment,
    leg_of_body,
)

__all__ = [
    "AIR_EXPONENT",
    "ATMOSPHERE_PA",
    "BODIES",
    "DEFAULT_DURATION_S",
    "G1",
    "G2",
    "G3",
    "G4",
    "G5",
    "GAIT2392",
    "HINGE",
    "LAW_INPUTS",
    "LINKAGES",
    "MOMENT_MASS_KG",
    "RPM",
    "SEAL_FRICTION_N",
    "TABLE_1_LINKAGES",
    "UNCERTAINTY",
    "UNCERTAIN_KNEE",
    "WEARERS",
    "WEARER_UNCERTAINTY",
    "AnatomicalKneeParameters",
    "BldcPumpParameters",
    "BypassParameters",
    "Cia402Parameters",
    "CsvMoment",
    "CsvReference",
    "CuffParameters",
    "CylinderParameters",
    "DesignLimits",
    "DifferenceParameters",
    "EncoderParameters",
    "EndStopParameters",
    "ExactParameters",
    "FaultParameters",
    "FullCylinderParameters",
    "GaitMoment",
    "GaitReference",
    "Interpolation",
    "KneeLoadParameters",
    "KneeParameters",
    "Law",
    "LawParameters",
    "LegParameters",
    "LinkageParameters",
    "LoadCellParameters",
    "MomentTable",
    "MotorParameters",
    "NoBus",
    "NoLoad",
    "NoWearer",
    "ObserverParameters",
    "PidParameters",
    "PlantParameters",
    "ProtectionParameters",
    "PushParameters",
    "RampReference",
    "Reference",
    "RodPolynomialParameters",
    "SampledReference",
    "Scenario",
    "SimulationParameters",
    "SineReference",
    "SlidingModeParameters",
    "StepReference",
    "StrapParameters",
    "ThermalParameters",
    "TorqueParameters",
    "Uncertainty",
    "UncertaintySet",
    "WalkingLegParameters",
    "Wearer",
    "gait_moment",
    "gait_reference",
    "leg_of_body",
    "sit_to_stand_reference",
]
