"""Leaf systems of the polycentric knee exoskeleton, one component of the paper in each file.

The paper's configuration is the default of every system. Every system has named ports in SI units
and numeric Context parameters, and converts to AutoDiffXd and to symbolic Expression.
``BldcPump(…)`` is a system of floats, and ``BldcPump_[T](…)`` is a system of the scalar type T, as
in Drake. The encoder is Drake's own `RotaryEncoders`.
"""

from kneexo.systems.bldc_pump import BldcPump, BldcPump_
from kneexo.systems.bypass_valve import BypassValve, BypassValve_
from kneexo.systems.cuff import Cuff, Cuff_
from kneexo.systems.drive import Cia402Drive, Cia402Drive_
from kneexo.systems.drive_watchdog import DriveWatchdog, DriveWatchdog_
from kneexo.systems.encoder_count import EncoderCount, EncoderCount_
from kneexo.systems.energy_meter import EnergyMeter, EnergyMeter_
from kneexo.systems.fault import FaultySignal, FaultySignal_, ParameterFault, ParameterFault_
from kneexo.systems.fault_detectors import FaultDetectors, FaultDetectors_
from kneexo.systems.four_bar_knee import FourBarKnee, FourBarKnee_
from kneexo.systems.full_cylinder import FullCylinder, FullCylinder_
from kneexo.systems.input_guard import InputGuard, InputGuard_
from kneexo.systems.knee_coordinates import (
    KneeCoordinates,
    KneeCoordinates_,
    RodReference,
    RodReference_,
)
from kneexo.systems.knee_load import KneeLoad, KneeLoad_
from kneexo.systems.knee_reference import (
    IntervalReference,
    IntervalReference_,
    RampKneeReference,
    RampKneeReference_,
    SineKneeReference,
    SineKneeReference_,
    StepKneeReference,
    StepKneeReference_,
    make_knee_reference,
)
from kneexo.systems.load_cell import LoadCell, LoadCell_
from kneexo.systems.motor_temperature import MotorTemperature, MotorTemperature_
from kneexo.systems.pid_controller import PidController, PidController_
from kneexo.systems.push import Push, Push_
from kneexo.systems.reduced_cylinder import ReducedCylinder, ReducedCylinder_
from kneexo.systems.safety_supervisor import SafetySupervisor, SafetySupervisor_
from kneexo.systems.sliding_mode_controller import SlidingModeController, SlidingModeController_
from kneexo.systems.state_estimator import (
    BackwardDifference,
    BackwardDifference_,
    TrackingObserver,
    TrackingObserver_,
)
from kneexo.systems.state_variable import StateVariable
from kneexo.systems.torque_controller import TorqueController, TorqueController_
from kneexo.systems.torque_limited_pump import TorqueLimitedPump, TorqueLimitedPump_
from kneexo.systems.wearer_knee import WearerKnee, WearerKnee_

__all__ = [
    "BackwardDifference",
    "BackwardDifference_",
    "BldcPump",
    "BldcPump_",
    "BypassValve",
    "BypassValve_",
    "Cia402Drive",
    "Cia402Drive_",
    "Cuff",
    "Cuff_",
    "DriveWatchdog",
    "DriveWatchdog_",
    "EncoderCount",
    "EncoderCount_",
    "EnergyMeter",
    "EnergyMeter_",
    "FaultDetectors",
    "FaultDetectors_",
    "FaultySignal",
    "FaultySignal_",
    "FourBarKnee",
    "FourBarKnee_",
    "FullCylinder",
    "FullCylinder_",
    "InputGuard",
    "InputGuard_",
    "IntervalReference",
    "IntervalReference_",
    "KneeCoordinates",
    "KneeCoordinates_",
    "KneeLoad",
    "KneeLoad_",
    "LoadCell",
    "LoadCell_",
    "MotorTemperature",
    "MotorTemperature_",
    "ParameterFault",
    "ParameterFault_",
    "PidController",
    "PidController_",
    "Push",
    "Push_",
    "RampKneeReference",
    "RampKneeReference_",
    "ReducedCylinder",
    "ReducedCylinder_",
    "RodReference",
    "RodReference_",
    "SafetySupervisor",
    "SafetySupervisor_",
    "SineKneeReference",
    "SineKneeReference_",
    "SlidingModeController",
    "SlidingModeController_",
    "StateVariable",
    "StepKneeReference",
    "StepKneeReference_",
    "TorqueController",
    "TorqueController_",
    "TorqueLimitedPump",
    "TorqueLimitedPump_",
    "TrackingObserver",
    "TrackingObserver_",
    "WearerKnee",
    "WearerKnee_",
    "make_knee_reference",
]
