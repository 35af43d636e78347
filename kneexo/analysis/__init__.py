"""Measures of one scenario; every function returns a frozen result with data and ``plot``.

`kneexo.studies` compares many scenarios. Runs themselves are in `kneexo.simulation`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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

_MODULE_OF = {
    "FrequencyResponse": "kneexo.analysis.frequency_response",
    "Margins": "kneexo.analysis.sampled_loop",
    "OperatingPoint": "kneexo.analysis.plant_linearization",
    "PlantLinearization": "kneexo.analysis.plant_linearization",
    "PolynomialFit": "kneexo.analysis.polynomial_fit",
    "Run": "kneexo.simulation.run",
    "SampledLoop": "kneexo.analysis.sampled_loop",
    "SineEstimate": "kneexo.analysis.frequency_response",
    "TrackingMetrics": "kneexo.analysis.tracking",
    "TrackingResult": "kneexo.analysis.tracking",
    "Trial": "kneexo.analysis.frequency_response",
    "crossing": "kneexo.analysis.frequency_response",
    "draw_trials": "kneexo.analysis.frequency_response",
    "estimate_sine": "kneexo.analysis.frequency_response",
    "find_operating_point": "kneexo.analysis.plant_linearization",
    "fit_polynomials": "kneexo.analysis.polynomial_fit",
    "fundamental": "kneexo.analysis.frequency_response",
    "large_signal_bandwidth_hz": "kneexo.analysis.bandwidth",
    "linearize_loop": "kneexo.analysis.sampled_loop",
    "linearize_plant": "kneexo.analysis.plant_linearization",
    "nominal_trial": "kneexo.analysis.frequency_response",
    "rate_limit_bandwidth_hz": "kneexo.analysis.rate_limit",
    "rate_limited_gain": "kneexo.analysis.rate_limit",
    "simulate": "kneexo.simulation.engines",
    "simulate_diagram": "kneexo.simulation.drake",
    "sinestream": "kneexo.analysis.frequency_response",
    "track": "kneexo.analysis.tracking",
    "tracking_metrics": "kneexo.analysis.tracking",
}

if not TYPE_CHECKING:  # mypy accepts every name of a module with a visible __getattr__

    def __getattr__(name: str) -> Any:
        """Import a public name at its first use: SciPy alone takes 0.2 s."""
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
