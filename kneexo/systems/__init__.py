"""Leaf systems of the polycentric knee exoskeleton, one component of the paper in each file.

The paper's configuration is the default of every system. Every system has named ports in SI units
and numeric Context parameters, and converts to AutoDiffXd and to symbolic Expression.
``BldcPump(…)`` is a system of floats, and ``BldcPump_[T](…)`` is a system of the scalar type T, as
in Drake. The encoder is Drake's own `RotaryEncoders`.
"""

from kneexo.systems.bldc_pump import BldcPump as BldcPump, BldcPump_ as BldcPump_
from kneexo.systems.drive import Cia402Drive as Cia402Drive, Cia402Drive_ as Cia402Drive_
from kneexo.systems.four_bar_knee import FourBarKnee as FourBarKnee, FourBarKnee_ as FourBarKnee_
from kneexo.systems.full_cylinder import (
    FullCylinder as FullCylinder,
    FullCylinder_ as FullCylinder_,
)
from kneexo.systems.knee_coordinates import (
    KneeCoordinates as KneeCoordinates,
    KneeCoordinates_ as KneeCoordinates_,
    RodReference as RodReference,
    RodReference_ as RodReference_,
)
from kneexo.systems.knee_load import KneeLoad as KneeLoad, KneeLoad_ as KneeLoad_
from kneexo.systems.knee_reference import (
    RampKneeReference as RampKneeReference,
    RampKneeReference_ as RampKneeReference_,
    SineKneeReference as SineKneeReference,
    SineKneeReference_ as SineKneeReference_,
    StepKneeReference as StepKneeReference,
    StepKneeReference_ as StepKneeReference_,
    make_knee_reference as make_knee_reference,
)
from kneexo.systems.pid_controller import (
    PidController as PidController,
    PidController_ as PidController_,
)
from kneexo.systems.reduced_cylinder import (
    ReducedCylinder as ReducedCylinder,
    ReducedCylinder_ as ReducedCylinder_,
)
from kneexo.systems.sliding_mode_controller import (
    SlidingModeController as SlidingModeController,
    SlidingModeController_ as SlidingModeController_,
)
from kneexo.systems.state_estimator import (
    BackwardDifference as BackwardDifference,
    BackwardDifference_ as BackwardDifference_,
    TrackingObserver as TrackingObserver,
    TrackingObserver_ as TrackingObserver_,
)
from kneexo.systems.state_variable import StateVariable as StateVariable
