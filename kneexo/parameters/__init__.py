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

from kneexo.parameters.control import (
    CustomControllerParameters as CustomControllerParameters,
    DifferenceParameters as DifferenceParameters,
    EncoderParameters as EncoderParameters,
    ExactParameters as ExactParameters,
    ObserverParameters as ObserverParameters,
    PidParameters as PidParameters,
    SlidingModeParameters as SlidingModeParameters,
)
from kneexo.parameters.linkages import (
    G1 as G1,
    G2 as G2,
    G3 as G3,
    G4 as G4,
    LINKAGES as LINKAGES,
    LinkageParameters as LinkageParameters,
)
from kneexo.parameters.plant import (
    AIR_EXPONENT as AIR_EXPONENT,
    ATMOSPHERE_PA as ATMOSPHERE_PA,
    RPM as RPM,
    BldcPumpParameters as BldcPumpParameters,
    CylinderParameters as CylinderParameters,
    FullCylinderParameters as FullCylinderParameters,
    KneeLoadParameters as KneeLoadParameters,
    KneeParameters as KneeParameters,
    NoLoad as NoLoad,
    PlantParameters as PlantParameters,
    RodPolynomialParameters as RodPolynomialParameters,
)
from kneexo.parameters.reference import (
    CsvReference as CsvReference,
    GaitReference as GaitReference,
    Interpolation as Interpolation,
    RampReference as RampReference,
    Reference as Reference,
    SampledReference as SampledReference,
    SineReference as SineReference,
    StepReference as StepReference,
    gait_reference as gait_reference,
)
from kneexo.parameters.scenario import (
    Scenario as Scenario,
    SimulationParameters as SimulationParameters,
)
from kneexo.parameters.uncertainty import (
    UNCERTAIN_KNEE as UNCERTAIN_KNEE,
    UNCERTAINTY as UNCERTAINTY,
    Uncertainty as Uncertainty,
    UncertaintySet as UncertaintySet,
)
