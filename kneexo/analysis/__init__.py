"""Measures of one scenario; every function returns a frozen result with data and ``plot``.

`kneexo.studies` compares many scenarios. Runs themselves are in `kneexo.simulation`.
"""

from kneexo.analysis.bandwidth import large_signal_bandwidth_hz
from kneexo.analysis.frequency_response import (
    FrequencyResponse,
    SineEstimate,
    Trial,
    crossing,
    draw_trials,
    estimate_sine,
    fundamental,
    nominal_trial,
    sinestream,
)
from kneexo.analysis.plant_linearization import (
    OperatingPoint,
    PlantLinearization,
    find_operating_point,
    linearize_plant,
)
from kneexo.analysis.polynomial_fit import PolynomialFit, fit_polynomials
from kneexo.analysis.rate_limit import rate_limit_bandwidth_hz, rate_limited_gain
from kneexo.analysis.sampled_loop import Margins, SampledLoop, linearize_loop
from kneexo.analysis.tracking import TrackingMetrics, TrackingResult, track, tracking_metrics
from kneexo.simulation.drake import simulate_diagram
from kneexo.simulation.engines import simulate
from kneexo.simulation.run import Run

__all__ = [
    "FrequencyResponse",
    "Margins",
    "OperatingPoint",
    "PlantLinearization",
    "PolynomialFit",
    "Run",
    "SampledLoop",
    "SineEstimate",
    "TrackingMetrics",
    "TrackingResult",
    "Trial",
    "crossing",
    "draw_trials",
    "estimate_sine",
    "find_operating_point",
    "fit_polynomials",
    "fundamental",
    "large_signal_bandwidth_hz",
    "linearize_loop",
    "linearize_plant",
    "nominal_trial",
    "rate_limit_bandwidth_hz",
    "rate_limited_gain",
    "simulate",
    "simulate_diagram",
    "sinestream",
    "track",
    "tracking_metrics",
]
