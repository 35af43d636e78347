import math
from dataclasses import replace

import numpy as np

from kneexo.studies.bandwidth.report import report


def test_a_map_without_a_sine_to_compare_with_the_linear_loop_says_so(small):
    limited = replace(small[0], unlimited=np.zeros(3, dtype=bool))
    assert "nothing to compare with the linear loop" in report(limited)
    failed = small[0].response.copy()
    failed[0] = math.nan
    for result in (limited, replace(small[0], response=failed)):
        assert "nan" not in report(result)


def test_the_report_names_the_sine_whose_mean_wanders_most(by_hand):
    means = np.array([[40.0, 41.0, 41.5], [39.1, 32.4, 45.0]])  # about 40°
    text = report(replace(by_hand, cells=by_hand.cells | {"mean_deg": means}))
    assert "At 3 sines the mean" in text
    assert "(7.6°) at 30° and 0.2 Hz" in text


def test_neighbouring_amplitudes_with_the_same_limit_are_one_finding(by_hand):
    linear = by_hand.bandwidths | {"follower_hz": np.array([6.7, 0.4])}
    text = report(replace(by_hand, bandwidths=linear))
    # 0.16 of 0.31 Hz
    assert "- 1…30°: the linear loop sets the bandwidth, 0.3…0.16 Hz measured, 0.968…0.516" in text
