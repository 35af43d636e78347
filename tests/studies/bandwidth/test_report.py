import math
from dataclasses import replace

import numpy as np
from bandwidth_cases import (
    AMPLITUDES,
    BANDWIDTHS,
)

from kneexo.analysis.bandwidth import (
    rod_limits,
)
from kneexo.parameters import Scenario
from kneexo.studies.bandwidth.report import report


def test_a_map_without_a_sine_to_compare_with_the_linear_loop_says_so(mapped):
    limited = replace(mapped[0], unlimited=np.zeros(3, dtype=bool))
    assert "nothing to compare with the linear loop" in report(limited)
    failed = mapped[0].response.copy()
    failed[0] = math.nan
    for result in (limited, replace(mapped[0], response=failed)):
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


def test_the_screen_has_the_findings(by_hand, check_screen):
    assert check_screen(report(by_hand))[2] == "Bandwidth (−3 dB): 0.3 Hz at 1°, 0.16 Hz at 30°."


def test_every_cell_of_the_report_is_in_the_map(by_hand, tables, check_cells):
    text = report(by_hand)
    (shown,) = tables(text)
    columns = (
        "measured_hz",
        "linear_loop_hz",
        "acceleration_bound_hz",
        "follower_hz",
        "rate_limit_hz",
    )
    lowest = (("linear loop", 0.31), ("speed limit", 0.17))
    check_cells(
        shown,
        [
            [a, *(BANDWIDTHS[c][i] for c in columns), name, BANDWIDTHS["measured_hz"][i] / hertz]
            for i, (a, (name, hertz)) in enumerate(zip(AMPLITUDES, lowest, strict=True))
        ],
    )
    speed, acceleration = rod_limits(Scenario())
    for said in (
        "about 40°, 6 sines",
        "2 sines had not settled after 3 cycles",
        f"at most {100.0 * 0.1 * 0.15 / 0.2:.2g} % of the gain",
        # 0.3 of 0.31 Hz and 0.16 of 0.17 Hz
        "1°: the linear loop sets the bandwidth, 0.3 Hz measured, 0.968 times what",
        "30°: the speed limit sets the bandwidth, 0.16 Hz measured, 0.941 times what",
        "1 of 6 runs failed",
        "\n\nBandwidth (−3 dB): 0.3 Hz at 1°, 0.16 Hz at 30°.\n",
        f"at most {1e3 * speed:.3g} mm/s and {acceleration:.3g} m/s²",
        f"below {1e3 * speed**2 / acceleration:.2g} mm of rod",
        "by at most 9.5 % without quantizers, 12 % with them",
        "- 30 deg, 9 Hz: left the range",
    ):
        assert said in text
