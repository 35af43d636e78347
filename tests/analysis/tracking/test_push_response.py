"""How far a push moves the knee and how long the knee needs, by hand and in a run."""

import math

import numpy as np
import pytest

from kneexo.analysis import track
from kneexo.analysis.tracking.push_response import push_response
from kneexo.parameters import Scenario
from kneexo.parameters.criteria import RECOVERY_BAND_DEG

TIME = np.arange(8) * 0.5


@pytest.mark.parametrize(
    ("deviation", "largest", "recovery_s"),
    [
        ([0, 0, 2, 3, 0, -4, 0.05, 0], 4.0, 2.0),
        ([0, 0, 0.05, 0, 0, 0, 0, 0], 0.05, 0.0),
        ([0, 0, 1, 0, 0, 0, 0, -0.2], 1.0, math.nan),
    ],
)
def test_recovery_counts_from_the_start_to_the_last_sample_outside(deviation, largest, recovery_s):
    free = np.sin(TIME)
    response = push_response(TIME, free + deviation, free, start_s=1.0)
    assert response.largest_deviation_deg == pytest.approx(largest)
    assert response.recovery_time_s == pytest.approx(recovery_s, nan_ok=True)
    assert ("is not back" in response.line) == math.isnan(recovery_s)
    assert ("The knee stays within 0.1°" in response.line) == (recovery_s == 0.0)


@pytest.mark.slow
def test_the_response_of_a_run_is_measured_from_the_run_without_the_push():
    push = {"torque_n_m": 100.0, "start_s": 2.0}
    scenario = Scenario.preset("leg").changed({"push": push, "simulation.duration_s": 4.0})
    result, free = track(scenario), track(scenario.changed({"push": None}))
    deviation = np.degrees(np.abs(result["knee_angle_rad"] - free["knee_angle_rad"]))
    assert result.push.largest_deviation_deg == pytest.approx(deviation.max(), rel=1e-12)
    after = result.run.time_s >= 2.0 + result.push.recovery_time_s - 1e-9
    assert deviation[after].max() <= RECOVERY_BAND_DEG < deviation[np.argmax(after) - 1]
    assert free.push is None
    assert result.verdict.stability == free.verdict.stability
