import dataclasses

import numpy as np
import pytest
from bandwidth_cases import (
    AMPLITUDES,
    FREQUENCIES,
)

from kneexo.studies.bandwidth.figures import figures


def falling_and_rising(by_hand, decibels):
    """``by_hand`` with the same gains in dB for every amplitude and for the linear loop."""
    gains = 10.0 ** (np.array(decibels) / 20.0)
    return dataclasses.replace(by_hand, response=np.array([gains, [1.0] * 3]), linear=gains)


def test_a_gain_that_returns_above_3_db_is_marked_and_said(by_hand, curves):
    drawn = figures(falling_and_rising(by_hand, [0.0, -5.0, -1.0]))
    again = curves(drawn["amplitude_map"].axes[0])["gain above −3 dB again"]
    assert (*again[0], *again[1]) == (FREQUENCIES[2], AMPLITUDES[0])
    assert "rises above it again" in drawn["amplitude_map"].get_label()
    gain = drawn["bode_by_amplitude"].axes[0]
    (at,) = [line.get_xdata()[0] for line in gain.lines if line.get_marker() == "^"]
    # −3.0103 dB lies at 0.49742 of the way from −5 dB to −1 dB, over the logarithm.
    assert at == pytest.approx(FREQUENCIES[1] ** 0.50258 * FREQUENCIES[2] ** 0.49742, rel=1e-4)
    (text,) = gain.texts
    assert text.get_text() == f"△ linear gain rises above −3 dB again at {at:.3g} Hz"
    assert f" The linear gain rises above −3 dB again at {at:.3g} Hz." in (
        drawn["bode_by_amplitude"].get_label()
    )


def test_a_gain_that_does_not_return_is_not_marked(by_hand, curves):
    drawn = figures(falling_and_rising(by_hand, [0.0, -4.0, -5.0]))
    assert "gain above −3 dB again" not in curves(drawn["amplitude_map"].axes[0])
    assert list(drawn["bode_by_amplitude"].axes[0].texts) == []
    assert (
        "again" not in drawn["amplitude_map"].get_label() + drawn["bode_by_amplitude"].get_label()
    )
