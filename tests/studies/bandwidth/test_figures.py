import dataclasses

import numpy as np
import pytest
from bandwidth_cases import (
    AMPLITUDES,
    FREQUENCIES,
)

from kneexo.studies.bandwidth.figures import figures


def test_a_gain_that_returns_above_3_db_is_marked_and_said(by_hand, curves):
    gains = 10.0 ** (np.array([0.0, -5.0, -1.0]) / 20.0)
    response = np.array([gains, [1.0] * 3])
    drawn = figures(dataclasses.replace(by_hand, response=response, linear=gains))
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
