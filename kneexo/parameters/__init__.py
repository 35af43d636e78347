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

from kneexo.parameters.bus import Cia402Parameters, NoBus
from kneexo.parameters.control import (
    CustomControllerParameters,
    DifferenceParameters,
    EncoderParameters,
    ExactParameters,
    ObserverParameters,
    PidParameters,
    SlidingModeParameters,
)
from kneexo.parameters.linkages import G1, G2, G3, G4, LINKAGES, LinkageParameters
from kneexo.parameters.plant import (
    AIR_EXPONENT,
    ATMOSPHERE_PA,
    RPM,
    BldcPumpParameters,
    CylinderParameters,
    FullCylinderParameters,
    KneeLoadParameters,
    KneeParameters,
    NoLoad,
    PlantParameters,
    RodPolynomialParameters,
)
from kneexo.parameters.reference import (
    CsvReference,
    GaitReference,
    Interpolation,
    RampReference,
    Reference,
    SampledReference,
    SineReference,
    StepReference,
    gait_reference,
)
from kneexo.parameters.scenario import Scenario, SimulationParameters
from kneexo.parameters.uncertainty import UNCERTAIN_KNEE, UNCERTAINTY, Uncertainty, UncertaintySet

__all__ = [
    "AIR_EXPONENT",
    "ATMOSPHERE_PA",
    "G1",
    "G2",
    "G3",
    "G4",
    "LINKAGES",
    "RPM",
    "UNCERTAINTY",
    "UNCERTAIN_KNEE",
    "BldcPumpParameters",
    "Cia402Parameters",
    "CsvReference",
    "CustomControllerParameters",
    "CylinderParameters",
    "DifferenceParameters",
    "EncoderParameters",
    "ExactParameters",
    "FullCylinderParameters",
    "GaitReference",
    "Interpolation",
    "KneeLoadParameters",
    "KneeParameters",
    "LinkageParameters",
    "NoBus",
    "NoLoad",
    "ObserverParameters",
    "PidParameters",
    "PlantParameters",
    "RampReference",
    "Reference",
    "RodPolynomialParameters",
    "SampledReference",
    "Scenario",
    "SimulationParameters",
    "SineReference",
    "SlidingModeParameters",
    "StepReference",
    "Uncertainty",
    "UncertaintySet",
    "gait_reference",
]
