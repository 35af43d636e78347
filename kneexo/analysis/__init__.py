"""Analysis of the closed loop; every function returns a frozen result with data and ``plot``."""

from kneexo.analysis.frequency_response import (
    FrequencyResponse,
    Trial,
    crossing,
    draw_trials,
    fundamental,
    sinestream,
)
from kneexo.analysis.parallel import parallel_map
from kneexo.analysis.polynomial_fit import PolynomialFit, fit_polynomials
from kneexo.analysis.simulation import Run, simulate, simulate_diagram
from kneexo.analysis.tracking import TrackingMetrics, TrackingResult, track, tracking_metrics

__all__ = [
    "FrequencyResponse",
    "PolynomialFit",
    "Run",
    "TrackingMetrics",
    "TrackingResult",
    "Trial",
    "crossing",
    "draw_trials",
    "fit_polynomials",
    "fundamental",
    "parallel_map",
    "simulate",
    "simulate_diagram",
    "sinestream",
    "track",
    "tracking_metrics",
]
