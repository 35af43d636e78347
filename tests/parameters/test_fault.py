"""The time at which a fault begins."""

import math

import numpy as np
import pytest

from kneexo.parameters import FaultParameters
from kneexo.parameters.torque import AS_183

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


def test_the_time_to_failure_is_that_of_the_seeds_by_hand():
    fault = FaultParameters(start_s=1.0, mttf_s=5.0, seed=7, duration_s=2.0)
    shares = (seed / m for seed, (m, _) in zip(fault.generator_seeds, AS_183, strict=True))
    expected = 1.0 - 5.0 * math.log(1.0 - sum(shares) % 1.0)
    assert fault.begin_s == pytest.approx(expected, rel=1e-12)
    assert fault.end_s == fault.begin_s + 2.0


def test_a_permanent_fault_begins_at_its_start_and_does_not_end():
    fault = FaultParameters(start_s=1.0, mttf_s=5.0, duration_s=2.0).permanent(4.0)
    assert (fault.begin_s, fault.end_s) == (4.0, math.inf)
