"""Results, report and figures of a robustness study made by hand, whose numbers are all known."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import spearmanr

from kneexo.analysis.sampled_loop import linearize_loop
from kneexo.parameters import (
    UNCERTAIN_KNEE,
    Uncertainty,
    UncertaintySet,
)
from kneexo.parameters.paths import changed
from kneexo.parameters.uncertainty import realize
from kneexo.studies.robustness.figures import distribution, figures, tornado
from kneexo.studies.robustness.report import report
from kneexo.studies.robustness.study import (
    MERITS,
    Assessment,
    RobustnessResult,
    RobustnessSettings,
)

FEW = RobustnessSettings(
    samples=40, corners_max=200, bandwidth=False, sensitivity_duration_s=0.0, nyquist_loops=3
)


def uncertain(**values):
    """An uncertainty set; names with __ for the dots."""
    return UncertaintySet(
        values={path.replace("__", "."): Uncertainty(**one) for path, one in values.items()}
    )


SMALL = uncertain(
    plant__cylinder__mass_kg={"low": 1.4, "high": 1.8},
    plant__pump__lag_s={"low": 0.005, "high": 0.02, "scale": "log"},
    bus__latency_samples={"options": (0, 1, 2)},
)


def merits(**changes):
    """What `assess` returns, all well unless said otherwise."""
    return {
        **{name: 1.0 for name in MERITS if name != "bandwidth_hz"},
        "stable": True,
        "tracking_failure": "",
        "margins_failure": "",
        **changes,
    }


UNITS = dict(zip(MERITS, (1.0, 0.5, 20.0, 0.3, 60.0, 0.2, 0.7), strict=True))
"""Size of each figure of merit; an assessment has a number of its own times it."""


def assessment(number, mass, lag, delay, **changes):
    values = {
        "plant.cylinder.mass_kg": mass,
        "plant.pump.lag_s": lag,
        "bus.latency_samples": delay,
    }
    kept = {path: value for path, value in values.items() if value is not None}
    numbers = {name: round(number * size, 6) for name, size in UNITS.items()}
    return Assessment(kept, merits(**numbers, bandwidth_failure="") | changes)


@pytest.fixture(scope="module")
def by_hand():
    """Visits out of order, one of which fails; its corners have other numbers than its samples."""
    stopped = {"max_error_deg": math.nan, "tracking_failure": "t = 1 s: out of range"}
    return RobustnessResult(
        scenario=UNCERTAIN_KNEE,
        uncertainty=SMALL,
        left_out=("plant.load.knee_torque_n_m",),
        settings=FEW,
        nominal=assessment(1.0, None, None, None),
        one_at_a_time=(
            assessment(1.1, 1.4, None, None),
            assessment(0.8, 1.8, None, None),
            assessment(0.7, None, 0.005, None),
            assessment(1.6, None, 0.02, None),
            assessment(1.0, None, None, 0),
            assessment(1.2, None, None, 1),
            assessment(1.25, None, None, 2),
        ),
        samples=(
            assessment(1.5, 1.50, 0.012, 1),
            assessment(0.9, 1.45, 0.007, 2),
            assessment(1.9, 1.60, 0.019, 0),
            assessment(1.2, 1.75, 0.011, 2, **stopped),
            assessment(1.1, 1.65, 0.009, 1),
        ),
        corners=(
            assessment(2.3, 1.4, 0.005, 0),
            assessment(0.6, 1.8, 0.02, 1),
            assessment(2.1, 1.4, 0.02, 2),
        ),
        corners_possible=12,
        corners_settled=True,
        local={
            "rms_error_deg": {"plant.cylinder.mass_kg": 0.3, "plant.pump.lag_s": 0.05},
            "disk_margin": {"plant.cylinder.mass_kg": -0.2, "plant.pump.lag_s": -0.07},
        },
        local_failures=("tracking: too long",),
    )


SAMPLED = np.array([1.5, 0.9, 1.9, 1.2, 1.1])
LINEAR = {  # by slope: over 0.4 kg; over a factor of four, by the logarithm, at 10 ms
    "rms_error_deg": [0.3 * 0.4, 0.05 * 0.010 * math.log(4.0)],
    "disk_margin": [-0.2 * 0.4, -0.07 * 0.010 * math.log(4.0)],
}


def expected_summary(merit):
    """Nominal, median, 5 %, 95 %, worst sample, worst corner; inf where it fails."""
    size, values = UNITS[merit], SAMPLED.copy()
    if merit == "max_error_deg":
        values[3] = math.inf
    ordered = np.sort(values)
    more_is_worse = merit in ("max_error_deg", "rms_error_deg", "mean_command_change_rpm")
    numbers = [1.0, ordered[2], ordered[0], ordered[4]]
    numbers += [ordered[4] if more_is_worse else ordered[0], 2.3 if more_is_worse else 0.6]
    return [size * value for value in numbers]


def test_the_summary_of_each_figure_is_that_of_its_visits(by_hand, flat, check_rules):
    numbers = by_hand.results()
    check_rules(numbers)
    assert list(numbers["metrics"]) == list(MERITS)
    for merit, own in numbers["metrics"].items():
        names = ("nominal", "median", "percentile_5", "percentile_95")
        values = [own[name] for name in names]
        values += [own[f"worst_{kind}"]["value"] for kind in ("sample", "corner")]
        expected = expected_summary(merit)
        if merit == "max_error_deg":  # a figure that is missing has no number
            expected[4] = math.nan
        assert values == pytest.approx(expected, nan_ok=True), merit
        assert own["failed_samples"] == (merit == "max_error_deg")
        assert own["failed_corners"] == 0
        high = MERITS[merit].sign_of_worse > 0.0
        at_worst = by_hand.samples[3 if merit == "max_error_deg" else 2 if high else 1]
        assert own["worst_sample"]["values"] == at_worst.values
        assert own["worst_corner"]["values"] == by_hand.corners[0 if high else 1].values
    assert numbers["share_within_worst_sample_at_95_percent_confidence"] == pytest.approx(
        0.05 ** (1 / 5)
    )
    assert numbers["failures"]["samples"] == [
        {"count": 1, "example": "t = 1 s: out of range", "values": by_hand.samples[3].values}
    ]
    assert numbers["failures"]["corners"] == numbers["failures"]["one_at_a_time"] == []
    assert (numbers["corners_visited"], numbers["corners_possible"]) == (3, 12)
    for kind in ("samples", "corners", "one_at_a_time"):
        assessments = getattr(by_hand, kind)
        expected = [{"values": dict(v.values)} | v.metrics for v in assessments]
        assert flat(numbers[kind]) == pytest.approx(flat(expected), nan_ok=True)
    assert numbers["nominal"] == by_hand.nominal.metrics
    assert numbers["local_sensitivity"] == by_hand.local
    for merit, own in numbers["rank_correlation"].items():
        values = SAMPLED.copy()
        if merit == "max_error_deg":
            values[3] = math.inf
        for n, path in enumerate(("plant.cylinder.mass_kg", "plant.pump.lag_s")):
            x = [(1.50, 1.45, 1.60, 1.75, 1.65), (0.012, 0.007, 0.019, 0.011, 0.009)][n]
            assert own[path] == pytest.approx(spearmanr(x, values).statistic)


def test_every_cell_of_the_report_is_in_the_visits(by_hand, tables, check_cells):
    summary, corners, *effects = tables(report(by_hand))
    fails = {math.inf: "fails", -math.inf: "fails"}
    check_cells(
        summary,
        [
            [MERITS[merit].label, *(fails.get(v, v) for v in expected_summary(merit))]
            for merit in MERITS
        ],
    )
    merits = ("max_error_deg", "bandwidth_hz", "disk_margin")
    assert corners[0] == ["value", *(MERITS[merit].label for merit in merits)]
    check_cells(
        corners,
        [
            ["mass_kg", 1.4, 1.8, 1.8],
            ["lag_s", 0.005, 0.02, 0.02],
            ["latency_samples", 0.0, 1.0, 1.0],
            ["**the metric there**", 2.3, 0.6 * 0.3, 0.6 * 0.7],
        ],
    )
    assert len(effects) == 3
    alone = {
        "mass_kg": (1.1, 0.8),
        "lag_s": (0.7, 1.6),
        "latency_samples": (1.0, 1.2, 1.25),
    }
    correlations = by_hand.results()["rank_correlation"]
    for table, merit in zip(effects, ("rms_error_deg", *merits[1:]), strict=True):
        assert table[0][0] == MERITS[merit].label
        assert [*table[0][1:]] == ["ρ", "alone", *(["linear"] if merit in LINEAR else [])]
        by_name = {row[0]: row[1:] for row in table[1:]}
        strengths = [abs(float(row[1].removesuffix("*"))) for row in table[1:]]
        assert strengths == sorted(strengths, reverse=True)
        for n, (path, values) in enumerate(correlations[merit].items()):
            name = path.rpartition(".")[2]
            rank, ends, *linear = by_name[name]
            assert rank == f"{values:.2f}" + ("*" if n == 2 else "")
            shown = [float(value) for value in ends.split(" / ")]
            assert shown == pytest.approx([UNITS[merit] * v for v in alone[name]], rel=1e-3)
            if merit in LINEAR:
                (cell,) = linear
                assert cell == "" if n == 2 else f"{LINEAR[merit][n]:+.3g}"


def test_the_words_count_as_the_results_do(by_hand):
    text = report(by_hand)
    assert "Controller smc, reference sine 10 … 70 deg, 30 s. 3 uncertain values; the" in text
    assert "believes in the nominal plant. Not in this scenario" in text
    assert "With 95 % confidence at least" in text
    assert "of the 5 samples (seed 2020)" in text
    assert "No local sensitivity: tracking: too long." in text
    assert "1 of the 5 samples (20 %) fail in part" in text
    assert "- 1 times: t = 1 s: out of range" in text
    assert "None of the 3 corners fails" in text
    assert f"at least {100.0 * 0.05 ** (1 / 5):.4g} % of all plants" in text
    assert "worse than every corner visited in: largest error (deg)." in text
    assert "3 of 12 corners" in text
    assert "left out: plant.load.knee_torque_n_m." in text


def test_values_above_chance_and_those_that_the_controller_knows_are_told(by_hand):
    known = SMALL.values["plant.pump.lag_s"].model_copy(update={"known": True})
    samples = tuple(assessment(n, 1.5, 0.01 + 1e-3 * n, n % 3) for n in range(1, 8))
    text = report(
        dataclasses.replace(
            by_hand,
            uncertainty=UncertaintySet(values=SMALL.values | {"plant.pump.lag_s": known}),
            samples=(*samples, assessment(8.0, 1.6, 0.02, 0)),
            local_failures=(),
        )
    )
    assert "believes in the nominal plant, but knows lag_s." in text
    # Of eight samples √(3.84/7) = 0.74 may be chance: ρ is 1 of the lag, 0.58 of the mass.
    idle = "Not above chance (95 %): mass_kg, latency_samples."
    assert text.count(idle) == 3
    assert "No local sensitivity" not in text


def test_unstable_loops_whose_runs_end_are_counted_with_their_errors(by_hand):
    lost = {"stable": False, "disk_margin": math.nan}
    unstable = [assessment(n, 1.5, 0.01, 0, **lost) for n in (3.0, 7.0, 5.0)]
    stopped = assessment(1.0, 1.5, 0.01, 0, **lost, max_error_deg=math.nan)
    text = report(dataclasses.replace(by_hand, corners=(*unstable, stopped)))
    assert "4 of the 4 corners (100 %) fail in part or are unstable" in text
    assert "- 3 runs of those 4 unstable loops go to their end all the same, with" in text
    assert "largest errors of 3 … 7 deg" in text


def test_failures_are_told_as_a_share(by_hand):
    two = tuple(
        dataclasses.replace(one, metrics=by_hand.samples[3].metrics) for one in by_hand.samples[:2]
    )
    text = report(dataclasses.replace(by_hand, samples=two + by_hand.samples[2:3] * 8))
    assert "2 of the 10 samples (20 %) fail in part" in text


def test_distributions_rise_by_one_share_for_each_sample(by_hand, curves):
    axes = figures(by_hand)["robustness_distribution"].axes
    shown = {ax.get_xlabel(): ax for ax in axes if ax.get_visible()}
    assert set(shown) == {MERITS[m].label for m in MERITS if m != "rms_error_deg"}
    for merit in set(MERITS) - {"rms_error_deg"}:
        lines = curves(shown[MERITS[merit].label])
        values = np.sort(SAMPLED if merit != "max_error_deg" else SAMPLED[[0, 1, 2, 4]])
        assert lines["samples"][0] == pytest.approx(UNITS[merit] * values)
        shares = np.arange(1, values.size + 1) / 5.0
        assert lines["samples"][1] == pytest.approx(shares)
        expected = expected_summary(merit)
        assert lines["nominal"][0] == pytest.approx(expected[0])
        assert lines["worst corner"][0] == pytest.approx(expected[5])
    assert shown["largest error (deg)"].get_title() == "1 of 5 fail"


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
        rows = [tick.get_text() for tick in ax.get_yticklabels()]
        assert rows == ["latency_samples", "mass_kg", "lag_s"]  # the largest effect on top
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
        assert cross.get_color() == "C3"
        rows = [tick.get_text() for tick in ax.get_yticklabels()]
        assert rows[round(cross.get_ydata()[0])] == rows[-1] == "mass_kg"
    (legend,) = drawn.legends
    shown = [text.get_text() for text in legend.get_texts()]
    options = [f"option {n}" for n in (1, 2, 3)]
    assert shown == ["low end", "high end", *options, "fails or is unstable", "nominal"]
    titles = {ax.get_xlabel(): ax.get_title() for ax in distribution(study).axes}
    assert titles["disk margin"] == "1 of 5 fail or are unstable"
    assert titles["chattering (rpm per sample)"] == "1 of 5 fail"


def test_importance_has_correlations_beside_linear_effects(by_hand):
    ranks, linear = figures(by_hand)["robustness_importance"].axes
    correlations = by_hand.results()["rank_correlation"]
    rows, local = list(correlations["disk_margin"]), list(LINEAR)

    def cell(value):
        return f"{value:.0f}" if abs(value) >= 10.0 else f"{value:.2f}"

    assert {t.get_position(): t.get_text() for t in ranks.texts} == {
        (column, row): cell(own[path])
        for column, own in enumerate(correlations.values())
        for row, path in enumerate(rows)
    }
    assert {t.get_position(): t.get_text() for t in linear.texts} == {
        (column, row): cell(100.0 * value / UNITS[merit])
        for column, merit in enumerate(local)
        for row, value in enumerate(LINEAR[merit])
    }
    assert [t.get_text() for t in linear.get_xticklabels()] == ["rms error", "disk margin"]
    shown_ranks, shown_linear = (axes.images[0].get_array() for axes in (ranks, linear))
    # Red, above zero, where more of the value is worse: more error, less margin.
    for column, (merit, sign) in enumerate((("rms_error_deg", 1.0), ("disk_margin", -1.0))):
        percents = [100.0 * value / UNITS[merit] for value in LINEAR[merit]]
        assert np.asarray(shown_linear[:2, column]) == pytest.approx(sign * np.array(percents))
    for column, merit in enumerate(correlations):
        more_is_worse = merit in ("max_error_deg", "rms_error_deg", "mean_command_change_rpm")
        sign = 1.0 if more_is_worse else -1.0
        own = np.array([correlations[merit][path] for path in rows[:2]])
        assert np.asarray(shown_ranks[:2, column]) == pytest.approx(sign * own)
    assert len(ranks.get_xticklabels()) == len(MERITS)


def test_nyquist_draws_the_loops_of_the_samples(by_hand):
    unstable = assessment(1.2, 1.7, None, None, stable=False, disk_margin=math.nan)
    one_at_a_time = (*by_hand.one_at_a_time[:-1], unstable)
    done = dataclasses.replace(by_hand, one_at_a_time=one_at_a_time)
    (ax,) = figures(done)["robustness_nyquist"].axes
    for line, sample in zip(ax.lines, by_hand.samples[: FEW.nyquist_loops], strict=False):
        loop = linearize_loop(realize(UNCERTAIN_KNEE, SMALL, sample.values), 40.0)
        expected = loop.loop_response(np.geomspace(0.02, 250.0, 2000))
        assert line.get_xdata() == pytest.approx(expected.real)
        assert line.get_ydata() == pytest.approx(expected.imag)
    assert [line.get_label() for line in ax.lines[:2]] == ["L of 3 samples", "_child1"]
    assert ax.get_title().endswith(" of 15 stable plants\n1 of 16 plants are unstable")
    # The disk is that of the stable plant with the least disk margin.
    least = linearize_loop(realize(UNCERTAIN_KNEE, SMALL, by_hand.corners[1].values), 40.0)
    assert ax.patches[0].get_label() == f"disk margin {least.margins().disk_margin:.3g}"


def test_nyquist_names_unstable_loops_in_their_own_colour(by_hand):
    lost = changed(UNCERTAIN_KNEE, {"controller.lambda_per_s": 200.0})
    assert not linearize_loop(lost, 40.0).stable
    (ax,) = figures(dataclasses.replace(by_hand, scenario=lost))["robustness_nyquist"].axes
    assert [line.get_color() for line in ax.lines[:3]] == ["C3"] * 3
    assert ax.lines[0].get_label() == "L of 3 unstable samples"
