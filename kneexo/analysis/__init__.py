"""Analysis of the closed loop; every function returns a frozen result with data and ``plot``.

The studies are imported from their modules: `robustness`, `controller_study`, `contest`,
`sliding_condition`, `reduction`, `sizing`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kneexo.analysis.amplitude_response import AmplitudeMap, amplitude_map
    from kneexo.analysis.bandwidth import large_signal_bandwidth_hz
    from kneexo.analysis.checkpoint import Checkpoint
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
    from kneexo.analysis.parallel import dask_cluster, parallel_map, process_pool
    from kneexo.analysis.plant_linearization import (
        OperatingPoint,
        PlantLinearization,
        find_operating_point,
        linearize_plant,
    )
    from kneexo.analysis.polynomial_fit import PolynomialFit, fit_polynomials
    from kneexo.analysis.rate_limit import rate_limit_bandwidth_hz, rate_limited_gain
    from kneexo.analysis.sampled_loop import Margins, SampledLoop, linearize_loop
    from kneexo.analysis.simulation import Run, simulate, simulate_diagram
    from kneexo.analysis.tracking import TrackingMetrics, TrackingResult, track, tracking_metrics

_MODULES = (  # in the order in which they are searched: those that import least first
    *("simulation", "tracking", "checkpoint", "parallel", "polynomial_fit"),
    *("plant_linearization", "frequency_response", "rate_limit", "sampled_loop", "bandwidth"),
    "amplitude_response",
)

__all__ = [
    "AmplitudeMap",
    "Checkpoint",
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
    "amplitude_map",
    "crossing",
    "dask_cluster",
    "draw_trials",
    "estimate_sine",
    "find_operating_point",
    "fit_polynomials",
    "fundamental",
    "large_signal_bandwidth_hz",
    "linearize_loop",
    "linearize_plant",
    "nominal_trial",
    "parallel_map",
    "process_pool",
    "rate_limit_bandwidth_hz",
    "rate_limited_gain",
    "simulate",
    "simulate_diagram",
    "sinestream",
    "track",
    "tracking_metrics",
]


def __getattr__(name: str) -> Any:
    """Import what is asked for, and no more: SciPy alone takes 0.2 s."""
    if name in __all__:
        for module in _MODULES:
            home = import_module(f"{__name__}.{module}")
            if hasattr(home, name):
                return getattr(home, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
