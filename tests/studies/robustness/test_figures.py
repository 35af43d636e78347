import dataclasses
import math

import pytest
from robustness_cases import (
    UNITS,
    assessment,
)

from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.common.plotting import RED
from kneexo.parameters import (
    UNCERTAIN_KNEE,
)
from kneexo.parameters.paths import changed
from kneexo.studies.robustness.figures import distribution, figures, tornado

ROWS = {  # the largest effect on top, with unit, and with the mark of each level
    "latency_samples": "latency (samples)\n● 0  ■ 1  ▲ 2",
    "mass_kg": "mass (kg)\n◀ 1.4  ▶ 1.8",
    "lag_s": "lag (s)\n◀ 0.005  ▶ 0.02",
}


def test_a_figure_over_more_than_a_decade_has_a_logarithmic_axis(by_hand):
    wide = dataclasses.replace(by_hand, corners=(assessment(21.0, 1.4, 0.005, 0),))
    assert distribution(wide).axes[0].get_xscale() == "log"  # from 0.9 to 21


def test_what_fails_is_crossed_beyond_the_worst_end(by_hand):
    nothing = dict.fromkeys(UNITS, math.nan)
    failed = (assessment(1.1, 1.4, None, None, **nothing), *by_hand.one_at_a_time[1:])
    samples = (*by_hand.samples[:4], assessment(1.0, 1.5, 0.01, 0, **nothing))
    study = dataclasses.replace(by_hand, one_at_a_time=failed, samples=samples)
    drawn = tornado(study)
    for ax, merit, sign in zip(
        drawn.axes,
        ("max_error_deg", "bandwidth_hz", "disk_margin"),
        (1.0, -1.0, -1.0),
        strict=True,
    ):
        (cross,) = [line for line in ax.lines if line.get_marker() == "x"]
        # 15 % of the way from 0.7 to 1.6 beyond its worse end, in the row that is on top.
        at = 1.6 + 0.15 * 0.9 if sign > 0.0 else 0.7 - 0.15 * 0.9
        assert cross.get_xdata()[0] == pytest.approx(UNITS[merit] * at)
        assert cross.get_color() == RED
        rows = [tick.get_text() for tick in drawn.axes[0].get_yticklabels()]
        assert rows[round(cross.get_ydata()[0])] == rows[-1] == ROWS["mass_kg"]
    (legend,) = drawn.legends
    shown = [text.get_text() for text in legend.get_texts()]
    assert shown == ["low end", "high end", "options", "fails or is unstable", "nominal"]
    titles = {ax.get_xlabel(): ax.get_title() for ax in distribution(study).axes}
    assert titles["disk margin"] == "1 of 5 fail or are unstable"
    assert titles["chattering (rpm per sample)"] == "1 of 5 fail"


def test_nyquist_names_unstable_loops_in_their_own_colour(by_hand):
    lost = changed(UNCERTAIN_KNEE, {"controller.lambda_per_s": 200.0})
    assert not linearize_loop(lost, knee_angle_deg=40.0).stable
    (ax,) = figures(dataclasses.replace(by_hand, scenario=lost))["robustness_nyquist"].axes
    assert [line.get_color() for line in ax.lines[:3]] == [RED] * 3
    assert ax.lines[0].get_label() == "L of 3 unstable samples"
