"""Encoder and controllers have the numbers that the paper prints, or that its figures show."""

import math

import pytest

from kneexo.parameters import EncoderParameters, PidParameters, SlidingModeParameters


def test_the_encoder_has_12_bits_unless_its_quantizer_is_bypassed() -> None:
    assert EncoderParameters().resolution_rad == pytest.approx(2 * math.pi / 4096, rel=1e-14)
    assert EncoderParameters(quantized=False).resolution_rad == 0.0


def test_proportional_action_alone_errs_as_fig_12_shows() -> None:
    # The error feeds the speed: 30° at 0.1 Hz is at most 18.8 deg/s; Fig. 12 shows some 4°.
    pid = PidParameters()
    assert 30.0 * math.tau * 0.1 / pid.proportional_per_s == pytest.approx(4.0, abs=0.5)


def test_the_masses_of_table_2_give_its_mean_and_ratio() -> None:
    controller = SlidingModeParameters()
    assert controller.mass_estimate_kg == pytest.approx(1.587, abs=5e-4)
    assert controller.gain_ratio == pytest.approx(1.134, abs=5e-4)
