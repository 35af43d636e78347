import math

import pytest

from kneexo.errors import ParameterError
from kneexo.studies.sliding.settings import SLIDING_LAW, SlidingSettings

LAW = SLIDING_LAW.controller


def test_the_default_start_lies_outside_the_layer():
    offset = abs(SlidingSettings().start_offset_m)
    assert LAW.lambda_per_s**2 * offset > LAW.phi_m_s2
    assert LAW.phi_m_s2 / LAW.lambda_per_s**2 == pytest.approx(0.008)


def test_the_default_gain_of_the_sampled_loop_is_below_its_stability_boundary():
    # Unstable with exact states at 2 ms from k/Φ = 1.3e4 1/s on; β = √(1.8 kg/1.4 kg).
    slope = math.sqrt(1.8 / 1.4) * SlidingSettings().sampled_eta_m_s3 / LAW.phi_m_s2
    assert slope == pytest.approx(9.9e3, rel=0.01)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"etas_m_s3": (1e3, 0.0)}, r"etas_m_s3\.1 = 0 m/s³ is out of range"),
        ({"loads_n": (2e4,)}, r"loads_n\.0 = 20000 N is out of range"),
        ({"rated_samples": 9}, "rated_samples = 9 is out of range"),
    ],
)
def test_settings_out_of_range_are_one_line(values, message):
    with pytest.raises(ParameterError, match=message) as caught:
        SlidingSettings(**values)
    assert "\n" not in str(caught.value)
