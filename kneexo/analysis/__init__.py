"""Analyses of one scenario: runs, frequency responses, linear models, margins, sensitivities.

Most functions return a frozen result object, which holds data and has a method ``plot``.
`kneexo.simulation` runs scenarios, and `kneexo.studies` compares many scenarios.
"""

from kneexo.analysis.bandwidth import large_signal_bandwidth_hz as large_signal_bandwidth_hz
from kneexo.analysis.frequency_response import (
    FrequencyResponse as FrequencyResponse,
    crossing as crossing,
    draw_trials as draw_trials,
    fundamental as fundamental,
    sinestream as sinestream,
)
from kneexo.analysis.margins import Margins as Margins
from kneexo.analysis.plant_linearization import (
    OperatingPoint as OperatingPoint,
    PlantLinearization as PlantLinearization,
    find_operating_point as find_operating_point,
    linearize_plant as linearize_plant,
)
from kneexo.analysis.polynomial_fit import (
    PolynomialFit as PolynomialFit,
    fit_polynomials as fit_polynomials,
)
from kneexo.analysis.rate_limit import (
    rate_limit_bandwidth_hz as rate_limit_bandwidth_hz,
    rate_limited_gain as rate_limited_gain,
)
from kneexo.analysis.sampled_loop import (
    SampledLoop as SampledLoop,
    linearize_loop as linearize_loop,
)
from kneexo.analysis.sine_estimate import (
    SineEstimate as SineEstimate,
    estimate_sine as estimate_sine,
)
from kneexo.analysis.tracking import (
    TrackingMetrics as TrackingMetrics,
    TrackingResult as TrackingResult,
    track as track,
    tracking_metrics as tracking_metrics,
)
from kneexo.simulation import Run as Run, simulate as simulate, simulate_diagram as simulate_diagram
