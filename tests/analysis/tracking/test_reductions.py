"""Reductions of logged signals, and the metrics that they declare."""

import math

import numpy as np
import pytest

from diagramc import Reduction
from kneexo.analysis.tracking.reductions import (
    basic_metrics,
    reduce_signals,
)
from kneexo.errors import ParameterError

TIME_S = np.array([0.0, 0.5, 1.0, 1.5])
SIGNALS = {
    "knee_reference_rad": np.array([9.0, 1.0, 2.0, -4.0]),
    "knee_angle_rad": np.array([0.0, 3.0, 1.0, 0.0]),
}


@pytest.mark.parametrize(
    ("kind", "magnitude", "value", "without_samples"),
    [
        ("maximum", False, 1.0, math.nan),
        ("maximum", True, 4.0, math.nan),
        ("rms", False, math.sqrt(7.0), math.nan),
        ("variation", False, 3.0 + 5.0, 0.0),
        ("variation", True, 1.0 + 3.0, 0.0),
        ("integral", False, 0.5 * (-0.5 - 1.5), 0.0),
        ("integral", True, 0.5 * (1.5 + 2.5), 0.0),
        ("count", False, 1.0, 0.0),
        ("count", True, 3.0, 0.0),
    ],
)
def test_a_reduction_of_a_log_is_as_defined(kind, magnitude, value, without_samples):
    """The differences after 0.5 s are −2, 1 and −4; a count has the bound 1."""
    for after_s, expected in ((0.5 + 1e-10, value), (2.0, without_samples)):
        reduction = Reduction(kind, "knee_reference[0]", "knee_angle", magnitude, after_s, 1.0)
        (reduced,) = reduce_signals([reduction], TIME_S, SIGNALS)
        assert reduced == pytest.approx(expected, rel=1e-14, nan_ok=True)


def test_a_reduction_that_no_metric_has_is_refused():
    with pytest.raises(NotImplementedError, match="kind minimum"):
        reduce_signals([Reduction("minimum", "knee_angle")], TIME_S, SIGNALS)


def test_two_samples_are_the_fewest():
    values = [2.0, 3e6, 1.0, 0.1, 0.1, 5.0, 1.0]
    metrics = basic_metrics(values)
    assert metrics.pop("peak_pressure_mpa") == pytest.approx(3.0)
    assert metrics.pop("saturated_share") == 0.5  # of all samples
    assert all(math.isnan(value) for value in metrics.values())  # one sample after the first period
    with pytest.raises(ParameterError, match="1 samples are too few for metrics"):
        basic_metrics([1.0, *values[1:]])
