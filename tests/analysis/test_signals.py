"""Period, root mean square, shares and unit of signals."""

import math

import numpy as np
import pytest

from kneexo.analysis.signals import period_s, rms, saturated_share, share_above, to_rpm
from kneexo.parameters import Scenario


def test_the_period_is_that_of_a_sine():
    sine = Scenario(reference={"kind": "sine", "frequency_hz": 0.4})
    assert period_s(sine) == pytest.approx(2.5, rel=1e-15)


@pytest.mark.parametrize("kind", ["step", "ramp"])
def test_other_references_have_no_period(kind):
    assert period_s(Scenario(reference={"kind": kind})) == 0.0


def test_rms_of_a_sine_is_its_amplitude_over_root_two():
    angles = 2.0 * np.pi * np.arange(1000) / 1000
    assert rms(3.0 * np.sin(angles)) == pytest.approx(3.0 / math.sqrt(2.0), rel=1e-12)


def test_rms_of_a_constant_has_no_sign():
    assert rms(np.array([-2.0, -2.0])) == 2.0


def test_a_turn_a_second_is_60_rpm():
    np.testing.assert_allclose(to_rpm(np.array([2.0 * math.pi, -math.pi])), [60.0, -30.0])


def test_saturated_share_counts_both_limits():
    assert saturated_share(np.array([100.0, -100.0, 99.0, 0.0]), 100.0) == 0.5


def test_the_share_above_a_bound_counts_both_signs():
    assert share_above(np.array([3.0, -5.0, 4.0, 4.1]), 4.0) == 0.5
