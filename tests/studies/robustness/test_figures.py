import dataclasses
import math

import numpy as np
import pytest
from robustness_cases import (
    FEW,
    LINEAR,
    POSITION,
    SAMPLED,
    SMALL,
    UNITS,
    assessment,
    expected_summary,
)

from kneexo.analysis.sampled_loop import linearize_loop
from kneexo.parameters import (
    UNCERTAIN_KNEE,
)
from kneexo.parameters.paths import changed
from kneexo.parameters.uncertainty import realize
from kneexo.plotting import RED
from kneexo.studies.robustness.figures import distribution, figures, tornado
from kneexo.studies.robustness.report import report
from kneexo.studies.robustness.study import (
    MERITS,
)


@pytest.mark.slow
def test_every_figure_can_be_drawn(real):
    drawn = figures(real)
    for figure in drawn.values():
        figure.canvas.draw()
    key = [text.get_text() for text in drawn["robustness_importance"].legends[0].get_texts()]
    assert key[:2] == ["a larger value is worse", "a larger value is better"]
    marks = [text.get_text() for text in drawn["robustness_tornado"].legends[0].get_texts()]
    assert marks == ["low end", "high end", "nominal"]
    assert "None of the 4 samples fails or is unstable." in report(real)


def test_distributions_rise_by_one_share_for_each_sample(by_hand, curves):
    axes = figures(by_hand)["robustness_distribution"].axes
    shown = {ax.get_xlabel(): ax for ax in axes if ax.get_visible()}
    assert set(shown) == {MERITS[m].label for m in POSITION if m != "rms_error_deg"}
    for merit in set(POSITION) - {"rms_error_deg"}:
        lines = curves(shown[MERITS[merit].label])
        values = np.sort(SAMPLED if merit != "max_error_deg" else SAMPLED[[0, 1, 2, 4]])
        assert lines["samples"][0] == pytest.approx(UNITS[merit] * values)
        shares = np.arange(1, values.size + 1) / 5.0
        assert lines["samples"][1] == pytest.approx(shares)
        expected = expected_summary(merit)
        assert lines["nominal"][0] == pytest.approx(expected[0])
        assert lines["worst corner"][0] == pytest.approx(expected[5])
    assert shown["largest error (deg)"].get_title() == "1 of 5 fail"


def test_each_figure_has_a_caption(by_hand, check_caption):
    for figure in figures(by_hand).values():
        check_caption(figure)


ROWS = {  # the largest effect on top, with unit, and with the mark of each level
    "latency_samples": "latency (samples)\n● 0  ■ 1  ▲ 2",
    "mass_kg": "mass (kg)\n◀ 1.4  ▶ 1.8",
    "lag_s": "lag (s)\n◀ 0.005  ▶ 0.02",
}


def test_the_tornado_has_each_level_at_its_figure(by_hand):
    axes = figures(by_hand)["robustness_tornado"].axes
    merits = ("max_error_deg", "bandwidth_hz", "disk_margin")
    alone = {
        "mass_kg": ((1.1, "<"), (0.8, ">")),
        "lag_s": ((0.7, "<"), (1.6, ">")),
        "latency_samples": ((1.0, "o"), (1.2, "s"), (1.25, "^")),
    }
    for ax, merit in zip(axes, merits, strict=True):
        assert ax.get_xlabel() == MERITS[merit].label
        assert [tick.get_text() for tick in axes[0].get_yticklabels()] == list(ROWS.values())
        assert axes[0].get_shared_y_axes().joined(axes[0], ax)
        rows = list(ROWS)
        marks = {
            (rows[round(line.get_ydata()[0])], line.get_marker()): line.get_xdata()[0]
            for line in ax.lines
            if line.get_marker() not in ("None", "")
        }
        expected = {
            (name, marker): UNITS[merit] * value
            for name, levels in alone.items()
            for value, marker in levels
        }
        assert marks == pytest.approx(expected)
        bars = {
            round(line.get_ydata()[0]): list(line.get_xdata())
            for line in ax.lines
            if line.get_linewidth() == 7
        }
        for row, name in enumerate(rows):
            values = [1.0, *(value for value, _ in alone[name])]
            assert bars[row] == pytest.approx([UNITS[merit] * f(values) for f in (min, max)])


def test_a_figure_over_more_than_a_decade_has_a_logarithmic_axis(by_hand):
    wide = dataclasses.replace(by_hand, corners=(assessment(21.0, 1.4, 0.005, 0),))
    for study, expected in ((by_hand, "linear"), (wide, "log")):
        axes = distribution(study).axes
        assert axes[0].get_xlabel() == "largest error (deg)"
        assert axes[0].get_xscale() == expected  # from 0.9 to 2.3 or 21
        assert [ax.get_ylabel() for ax in axes[::3]] == ["share of the samples"] * 2
        (legend,) = axes[0].figure.legends
        shown = [text.get_text() for text in legend.get_texts()]
        assert shown == ["samples", "nominal", "worst corner"]


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


def test_importance_has_correlations_beside_linear_effects(by_hand):
    ranks, linear = figures(by_hand)["robustness_importance"].axes
    correlations = by_hand.results()["rank_correlation"]
    rows, local = list(correlations["disk_margin"]), list(LINEAR)

    def cell(value):
        text = f"{value:.0f}" if abs(value) >= 10.0 else f"{value:.2f}"
        return text.replace("-", "−")

    assert {t.get_position(): t.get_text() for t in ranks.texts} == {
        (column, row): cell(by_path[path])
        for column, by_path in enumerate(correlations.values())
        for row, path in enumerate(rows)
    }
    assert {t.get_position(): t.get_text() for t in linear.texts} == {
        (column, row): cell(100.0 * value / UNITS[merit])
        for column, merit in enumerate(local)
        for row, value in enumerate(LINEAR[merit])
    }
    assert [t.get_text() for t in linear.get_xticklabels()] == ["rms error", "disk margin"]
    shown_ranks, shown_linear = (axes.images[0].get_array() for axes in (ranks, linear))
    # Red, above zero, where a larger value is worse: more error, less margin.
    for column, (merit, sign) in enumerate((("rms_error_deg", 1.0), ("disk_margin", -1.0))):
        percents = [100.0 * value / UNITS[merit] for value in LINEAR[merit]]
        assert np.asarray(shown_linear[:2, column]) == pytest.approx(sign * np.array(percents))
    for column, merit in enumerate(correlations):
        more_is_worse = merit in ("max_error_deg", "rms_error_deg", "mean_command_change_rpm")
        sign = 1.0 if more_is_worse else -1.0
        sampled = np.array([correlations[merit][path] for path in rows[:2]])
        assert np.asarray(shown_ranks[:2, column]) == pytest.approx(sign * sampled)
    assert len(ranks.get_xticklabels()) == len(POSITION)


def test_nyquist_draws_the_loops_of_the_samples(by_hand):
    unstable = assessment(1.2, 1.7, None, None, stable=False, disk_margin=math.nan)
    one_at_a_time = (*by_hand.one_at_a_time[:-1], unstable)
    study = dataclasses.replace(by_hand, one_at_a_time=one_at_a_time)
    (ax,) = figures(study)["robustness_nyquist"].axes
    for line, sample in zip(ax.lines, by_hand.samples[: FEW.nyquist_loops], strict=False):
        loop = linearize_loop(realize(UNCERTAIN_KNEE, SMALL, sample.values), knee_angle_deg=40.0)
        expected = loop.loop_response(np.geomspace(0.02, 250.0, 2000))
        assert line.get_xdata() == pytest.approx(expected.real)
        assert line.get_ydata() == pytest.approx(expected.imag)
    assert [line.get_label() for line in ax.lines[:2]] == ["L of 3 samples", "_child1"]
    assert ax.get_title().endswith(" of 15 stable plants\n1 of 16 plants are unstable")
    # The disk is that of the stable plant with the least disk margin.
    least = linearize_loop(
        realize(UNCERTAIN_KNEE, SMALL, by_hand.corners[1].values), knee_angle_deg=40.0
    )
    assert ax.patches[0].get_label() == f"disk margin {least.margins().disk_margin:.3g}"


def test_nyquist_names_unstable_loops_in_their_own_colour(by_hand):
    lost = changed(UNCERTAIN_KNEE, {"controller.lambda_per_s": 200.0})
    assert not linearize_loop(lost, knee_angle_deg=40.0).stable
    (ax,) = figures(dataclasses.replace(by_hand, scenario=lost))["robustness_nyquist"].axes
    assert [line.get_color() for line in ax.lines[:3]] == [RED] * 3
    assert ax.lines[0].get_label() == "L of 3 unstable samples"
