"""Each line and bar of the figures of the study `wearer` is that of its row."""

import math

import numpy as np
import pytest

from kneexo.studies.wearer.figures import figures

PAPER, SIZED = "paper's pump", "sized pump, higher gains"


@pytest.fixture(scope="module")
def drawn(by_hand):
    return figures(by_hand)


def find(rows, **labels):
    (row,) = (r for r in rows if all(getattr(r, k) == v for k, v in labels.items()))
    return row


def bars(ax):
    """The heights of the bars by the label of their legend."""
    return {group.get_label(): [bar.get_height() for bar in group] for group in ax.containers}


def test_every_figure_has_a_caption(drawn, check_caption):
    assert set(drawn) == {"wearer_torque", "wearer_cadence", "wearer_help"}
    for figure in drawn.values():
        check_caption(figure)


def test_angle_and_torque_over_the_cycle(by_hand, drawn, curves):
    angle, rise_angle, torque, rise_torque = drawn["wearer_torque"].axes
    designs = (PAPER, "sized pump", SIZED)
    walks = [find(by_hand.transparency, design=d, cadence_hz=0.5) for d in designs]
    # Samples at 0, 25, 50 and 75 % of a stride that starts at 41 %. 91 % comes before 116 − 100 %.
    at, order = [16.0, 41.0, 66.0, 91.0], [3, 0, 1, 2]
    lines = curves(torque)
    assert set(lines) == set(designs)
    for row in walks:
        x, y = lines[row.design]
        assert x == pytest.approx(at)
        assert y == pytest.approx(np.array(row.trace.torque_n_m)[order])
    assert curves(angle)["leg"][1] == pytest.approx(np.array(walks[0].trace.leg_deg)[order])
    knees = [line.get_ydata() for line in angle.lines if line.get_label().startswith("_")]
    assert len(knees) == 3
    for knee, row in zip(knees, walks, strict=True):
        assert knee == pytest.approx(np.array(row.trace.knee_deg)[order])
    for row in (find(by_hand.transparency, design=d, rise_time_s=0.8) for d in designs):
        x, y = curves(rise_torque)[row.design]
        assert x == pytest.approx(row.trace.time_s)
        assert y == pytest.approx(row.trace.torque_n_m)
    assert rise_angle.get_title() == "standing up and sitting down, 0.8 s each"
    assert angle.get_title() == "walking, 0.5 strides/s"
    assert (angle.get_ylabel(), torque.get_ylabel()) == (
        "knee angle (deg)",
        "torque of the leg (N·m)",
    )


def test_torque_over_cadence(by_hand, drawn):
    walking, rising = drawn["wearer_cadence"].axes
    for ax, key, speeds in ((walking, "cadence_hz", (0.5, 2.0)), (rising, "rise_time_s", (0.8,))):
        heights = bars(ax)
        assert len(heights) == 6
        for design, values in heights.items():
            rows = [find(by_hand.transparency, design=design, **{key: v}) for v in speeds]
            assert values == pytest.approx([row.rms_torque_n_m for row in rows])
        assert [label.get_text() for label in ax.get_xticklabels()] == [f"{v:g}" for v in speeds]
        (line,) = ax.lines
        assert list(line.get_ydata()) == [2.26, 2.26]
    assert walking.get_ylabel() == "rms torque of the leg (N·m)"


def test_help_of_the_modes(by_hand, drawn, curves):
    over_time, deviation = drawn["wearer_help"].axes
    rows = [r for r in by_hand.help if (r.wearer, r.cadence_hz) == ("average", 0.5)]
    lines = curves(over_time)
    helped = [row for row in rows if row.design == SIZED]
    assert list(lines) == [row.mode for row in helped]
    for row in helped:
        torque = -np.array(row.trace.torque_n_m)[[3, 0, 1, 2]]
        assert lines[row.mode][1] == pytest.approx(torque)
    heights = bars(deviation)
    for design in (PAPER, SIZED):
        expected = [row.deviation_deg for row in rows if row.design == design]
        assert heights[design] == pytest.approx(expected)
    assert not any(math.isnan(value) for values in heights.values() for value in values)
