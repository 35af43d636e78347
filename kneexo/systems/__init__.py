"""Leaf systems of the polycentric knee exoskeleton, one component of the paper a file.

Every system has a default configuration (the paper's), named ports in SI units, numeric Context
parameters, and converts to AutoDiffXd and symbolic Expression. The ``…_`` names are the templates
by scalar type. The encoder is Drake's own `RotaryEncoders`.
"""

from kneexo.systems._leaf import instances_of_float
from kneexo.systems.bldc_pump import BldcPump_
from kneexo.systems.four_bar_knee import FourBarKnee_
from kneexo.systems.full_cylinder import FullCylinder_
from kneexo.systems.knee_coordinates import (
    KneeCoordinates_,
    RodReference_,
)
from kneexo.systems.knee_load import KneeLoad_
from kneexo.systems.knee_reference import (
    RampKneeReference_,
    SineKneeReference_,
    StepKneeReference_,
    make_knee_reference,
)
from kneexo.systems.pid_controller import PidController_
from kneexo.systems.reduced_cylinder import ReducedCylinder_
from kneexo.systems.sliding_mode_controller import (
    SlidingModeController_,
)
from kneexo.systems.state_estimator import (
    BackwardDifference_,
    TrackingObserver_,
)

__all__ = [
    "BackwardDifference",
    "BackwardDifference_",
    "BldcPump",
    "BldcPump_",
    "FourBarKnee",
    "FourBarKnee_",
    "FullCylinder",
    "FullCylinder_",
    "KneeCoordinates",
    "KneeCoordinates_",
    "KneeLoad",
    "KneeLoad_",
    "PidController",
    "PidController_",
    "RampKneeReference",
    "RampKneeReference_",
    "ReducedCylinder",
    "ReducedCylinder_",
    "RodReference",
    "RodReference_",
    "SineKneeReference",
    "SineKneeReference_",
    "SlidingModeController",
    "SlidingModeController_",
    "StepKneeReference",
    "StepKneeReference_",
    "TrackingObserver",
    "TrackingObserver_",
    "make_knee_reference",
]

__getattr__ = instances_of_float(__name__)
