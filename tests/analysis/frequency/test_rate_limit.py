import math

import numpy as np
import pytest

from kneexo.analysis import fundamental
from kneexo.analysis.frequency.rate_limit import (
    TRIANGLE_RATIO,
    rate_limit_bandwidth_hz,
    rate_limited_follower,
    rate_limited_gain,
)
from kneexo.errors import ParameterError
from kneexo.parameters.criteria import MINUS_3_DB


def simulated_gain(ratio):
    time = np.linspace(0.0, 6.0, 60_001)  # six periods of 1 Hz
    target = np.sin(2 * np.pi * time)
    last = slice(50_000, 60_000)
    follower = rate_limited_follower(time, target, 2 * np.pi * ratio)
    return fundamental(time[last], follower[last], 1.0) / fundamental(time[last], target[last], 1.0)


@pytest.mark.parametrize("ratio", [0.3, 0.55, 0.7, 0.9, 1.1])
def test_the_closed_form_is_what_a_follower_does(ratio):
    # 10 000 steps a period: the follower turns within one step, 1e-4 of a period.
    assert rate_limited_gain(ratio) == pytest.approx(simulated_gain(ratio), abs=1e-3)


@pytest.mark.parametrize("ratio", [TRIANGLE_RATIO, 1.0])
def test_the_branches_join(ratio):
    below, above = rate_limited_gain([ratio - 1e-9, ratio + 1e-9])
    assert above == pytest.approx(below, abs=1e-6)


def test_minus_3_db_lies_at_a_ratio_of_0_55539():
    assert abs(rate_limited_gain(0.55539)) == pytest.approx(MINUS_3_DB, abs=1e-5)
    assert rate_limit_bandwidth_hz(1.0, 1.0) == pytest.approx(0.28656, abs=5e-6)


def test_gain_rises_with_the_speed_limit_and_never_leads():
    gains = rate_limited_gain(np.linspace(0.05, 1.5, 400))
    assert np.all(np.diff(np.abs(gains)) > -1e-12)
    assert np.all(np.angle(gains) <= 1e-12)


@pytest.mark.parametrize("ratio", [0.0, -1.0, math.nan])
def test_a_ratio_that_is_not_positive_is_refused(ratio):
    with pytest.raises(ParameterError, match="must be > 0"):
        rate_limited_gain(ratio)
    with pytest.raises(ParameterError, match="amplitude"):
        rate_limit_bandwidth_hz(1.0, ratio)
