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

from kneexo.parameters.bus import Cia402Parameters as Cia402Parameters, NoBus as NoBus
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
