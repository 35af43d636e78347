"""Analyses of one scenario: runs, frequency responses, linear models, margins, sensitivities.

Most functions return a frozen result object, which holds data and has a method ``plot``.
`kneexo.simulation` runs scenarios, and `kneexo.studies` compares many scenarios.
"""

from kneexo.analysis.faults.survival import FaultCase, FaultSurvival, fault_survival
from kneexo.analysis.faults.thresholds import DetectorThresholds, detector_thresholds
from kneexo.analysis.frequency.bandwidth import large_signal_bandwidth_hz
from kneexo.analysis.frequency.frequency_response import (
    FrequencyResponse,
    crossing,
    draw_trials,
    fundamental,
    sinestream,
)
from kneexo.analysis.frequency.rate_limit import rate_limit_bandwidth_hz, rate_limited_gain
from kneexo.analysis.frequency.sine_estimate import SineEstimate, estimate_sine
from kneexo.analysis.linear.margins import Margins
from kneexo.analysis.linear.plant_linearization import (
    OperatingPoint,
    PlantLinearization,
    find_operating_point,
    linearize_plant,
)
from kneexo.analysis.linear.sampled_loop import SampledLoop, linearize_loop
from kneexo.analysis.mechanism.alignment import (
    Alignment,
    CuffForces,
    Placement,
    SlottedStrap,
    align,
)
from kneexo.analysis.mechanism.linkage_design import (
    LinkageDesign,
    TradeOff,
    design_linkage,
    trade_off,
)
from kneexo.analysis.mechanism.polynomial_fit import PolynomialFit, fit_polynomials
from kneexo.analysis.mechanism.prosthetic_leg import (
    LegLength,
    SwingClearance,
    VoluntaryStability,
    leg_length,
    swing_clearance,
    voluntary_stability,
)
from kneexo.analysis.tracking.energy import EnergyBalance, energy_balance
from kneexo.analysis.tracking.interaction import InteractionMetrics, interaction_metrics
from kneexo.analysis.tracking.tracking import (
    StepMetrics,
    TrackingMetrics,
    TrackingResult,
    step_metrics,
    track,
    tracking_metrics,
)
from kneexo.analysis.tracking.verdict import Stability, Verdict
from kneexo.analysis.walking.stride import StrideLoad, stride_load
from kneexo.analysis.wearer.coupling import (
    CoupledStability,
    StiffnessInterval,
    coupled_stability,
    stability_map,
    stable_interval,
    stiffness_interval,
)
from kneexo.analysis.wearer.impedance import (
    MeasuredImpedance,
    OutputImpedance,
    measure_impedance,
    output_impedance,
)
from kneexo.analysis.wearer.passivity import PassivityLimits, passivity_limits
from kneexo.analysis.wearer.torque_bandwidth import TorqueResponse, torque_response
from kneexo.simulation import Run, simulate, simulate_diagram

__all__ = [
    "Alignment",
    "CoupledStability",
    "CuffForces",
    "DetectorThresholds",
    "EnergyBalance",
    "FaultCase",
    "FaultSurvival",
    "FrequencyResponse",
    "InteractionMetrics",
    "LegLength",
    "LinkageDesign",
    "Margins",
    "MeasuredImpedance",
    "OperatingPoint",
    "OutputImpedance",
    "PassivityLimits",
    "Placement",
    "PlantLinearization",
    "PolynomialFit",
    "Run",
    "SampledLoop",
    "SineEstimate",
    "SlottedStrap",
    "Stability",
    "StepMetrics",
    "StiffnessInterval",
    "StrideLoad",
    "SwingClearance",
    "TorqueResponse",
    "TrackingMetrics",
    "TrackingResult",
    "TradeOff",
    "Verdict",
    "VoluntaryStability",
    "align",
    "coupled_stability",
    "crossing",
    "design_linkage",
    "detector_thresholds",
    "draw_trials",
    "energy_balance",
    "estimate_sine",
    "fault_survival",
    "find_operating_point",
    "fit_polynomials",
    "fundamental",
    "interaction_metrics",
    "large_signal_bandwidth_hz",
    "leg_length",
    "linearize_loop",
    "linearize_plant",
    "measure_impedance",
    "output_impedance",
    "passivity_limits",
    "rate_limit_bandwidth_hz",
    "rate_limited_gain",
    "simulate",
    "simulate_diagram",
    "sinestream",
    "stability_map",
    "stable_interval",
    "step_metrics",
    "stiffness_interval",
    "stride_load",
    "swing_clearance",
    "torque_response",
    "track",
    "tracking_metrics",
    "trade_off",
    "voluntary_stability",
]
