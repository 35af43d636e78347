"""The time at which a fault begins."""

import math

import numpy as np
import pytest

from kneexo.parameters import FaultParameters

COUNT = 2000


def begins(mttf_s):
    faults = (FaultParameters(start_s=3.0, mttf_s=mttf_s, seed=seed) for seed in range(COUNT))
    return np.array([fault.begin_s for fault in faults])


def test_times_to_failure_are_exponentially_distributed_after_the_start():
    """The greatest distance of the distributions passes the test of Kolmogorov at 1e-6."""
    times_s = np.sort(begins(40.0) - 3.0)
    expected = -np.expm1(-times_s / 40.0)
    steps = np.arange(COUNT + 1) / COUNT
    distance = max(np.abs(expected - steps[1:]).max(), np.abs(expected - steps[:-1]).max())
    assert distance < math.sqrt(-0.5 * math.log(0.5e-6) / COUNT)
    assert times_s.mean() == pytest.approx(40.0, rel=5.0 / math.sqrt(COUNT))
    np.testing.assert_allclose(begins(80.0) - 3.0, 2.0 * (begins(40.0) - 3.0), rtol=1e-12)


def test_faults_with_one_seed_fail_independently():
    """Place and kind select the number too, so that correlations are those of 2,000 numbers."""
    kinds = ({"place": "encoder"}, {"place": "load_cell"}, {"place": "encoder", "kind": "dropped"})
    faults = [
        [FaultParameters(**{"size": 0.5 * (len(k) > 1)} | k, mttf_s=1.0, seed=s) for k in kinds]
        for s in range(COUNT)
    ]
    times = np.array([[fault.begin_s - 10.0 for fault in row] for row in faults])
    correlations = np.corrcoef(times.T)[np.triu_indices(3, 1)]
    assert np.abs(correlations).max() < 5.0 / math.sqrt(COUNT)
    assert np.ptp(times[0]) > 0.0


def test_a_fault_ends_after_its_duration():
    fault = FaultParameters(start_s=1.0, mttf_s=5.0, seed=7, duration_s=2.0)
    assert fault.begin_s > 1.0
    assert fault.end_s == fault.begin_s + 2.0


def test_a_permanent_fault_begins_at_its_start_and_does_not_end():
    fault = FaultParameters(start_s=1.0, mttf_s=5.0, duration_s=2.0).permanent(4.0)
    assert (fault.begin_s, fault.end_s) == (4.0, math.inf)
