"""Analyses of one scenario: runs, frequency responses, linear models, margins, sensitivities.

Most functions return a frozen result object, which holds data and has a method ``plot``.
`kneexo.simulation` runs scenarios, and `kneexo.studies` compares many scenarios.
"""

from kneexo.alignment import (
    Alignment,
    CuffForces,
    Placement,
    SlottedStrap,
    align,
)
from kneexo.analysis.bandwidth import large_signal_bandwidth_hz
from kneexo.analysis.coupling import (
    CoupledStability,
    StiffnessInterval,
    coupled_stability,
    stability_map,
    stable_interval,
    stiffness_interval,
)
from kneexo.analysis.energy import EnergyBalance, energy_balance
from kneexo.analysis.frequency_response import (
    FrequencyResponse,
    crossing,
    draw_trials,
    fundamental,
    sinestream,
)
from kneexo.analysis.impedance import (
    MeasuredImpedance,
    OutputImpedance,
    measure_impedance,
    output_impedance,
)
from kneexo.analysis.interaction import InteractionMetrics, interaction_metrics
from kneexo.analysis.linkage_design import LinkageDesign, TradeOff, design_linkage, trade_off
from kneexo.analysis.margins import Margins
from kneexo.analysis.passivity import PassivityLimits, passivity_limits
from kneexo.analysis.plant_linearization import (
    OperatingPoint,
    PlantLinearization,
    find_operating_point,
    linearize_plant,
)
from kneexo.analysis.polynomial_fit import PolynomialFit, fit_polynomials
from kneexo.analysis.prosthetic_leg import (
    LegLength,
    SwingClearance,
    VoluntaryStability,
    leg_length,
    swing_clearance,
    voluntary_stability,
)
from kneexo.analysis.rate_limit import rate_limit_bandwidth_hz, rate_limited_gain
from kneexo.analysis.sampled_loop import SampledLoop, linearize_loop
from kneexo.analysis.sine_estimate import SineEstimate, estimate_sine
from kneexo.analysis.stride import StrideLoad, stride_load
from kneexo.analysis.survival import FaultCase, FaultSurvival, fault_survival
from kneexo.analysis.thresholds import DetectorThresholds, detector_thresholds
from kneexo.analysis.torque_bandwidth import TorqueResponse, torque_response
from kneexo.analysis.tracking import (
    StepMetrics,
    TrackingMetrics,
    TrackingResult,
    step_metrics,
    track,
    tracking_metrics,
)
from kneexo.analysis.verdict import Stability, Verdict
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
