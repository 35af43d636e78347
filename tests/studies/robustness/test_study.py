"""Robustness: what is visited against hand counts, what is said about it against scipy.

Most tests put a formula in the place of `assess`, so that the worst corner is known beforehand.
"""

import dataclasses
import itertools
import json
import math
import re
from concurrent.futures import ThreadPoolExecutor
from functools import partial, reduce

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.stats import spearmanr

from kneexo.analysis.assessment import assess
from kneexo.analysis.sampled_loop import linearize_loop
from kneexo.command_line.output import to_json
from kneexo.errors import ParameterError
from kneexo.parameters import (
    LINKAGES,
    UNCERTAIN_KNEE,
    UNCERTAINTY,
    FullCylinderParameters,
    PlantParameters,
    Scenario,
    Uncertainty,
    UncertaintySet,
)
from kneexo.parameters.paths import changed
from kneexo.parameters.uncertainty import draw, realize
from kneexo.simulation import engines
from kneexo.studies.robustness import study as module
from kneexo.studies.robustness.figures import distribution, figures, tornado
from kneexo.studies.robustness.report import report
from kneexo.studies.robustness.study import (
    MERITS,
    Assessment,
    RobustnessResult,
    RobustnessSettings,
    assess_plant,
    failures,
    quantile,
    rank_correlation,
    robustness_study,
    short_names,
    worst,
)
from kneexo.sweeps import parallel, parallel_map
from kneexo.sweeps.checkpoint import Checkpoint

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


def merits(**found):
    """What `assess` returns, all well unless said otherwise."""
    return {
        **{name: 1.0 for name in MERITS if name != "bandwidth_hz"},
        "stable": True,
        "tracking_failure": "",
        "margins_failure": "",
        **found,
    }


@pytest.fixture
def formula(monkeypatch):
    """Replace `assess` by a function of the scenario; returns the scenarios that it saw."""

    def replace(function):
        seen = []

        def stand_in(scenario, *, bandwidth=False):
            seen.append(scenario)
            return function(scenario)

        monkeypatch.setattr(module, "assess", stand_in)
        return seen

    return replace


# -------------------------------------------------------------------------------- one plant


def test_the_controller_keeps_its_beliefs_but_for_what_it_knows():
    values = {
        "plant.cylinder.mass_kg": 1.8,
        "plant.linkage": "G3",
        "plant.full_order": {"coulomb_friction_n": 40.0},
        "bus.latency_samples": 2,
    }
    found = realize(UNCERTAIN_KNEE, UNCERTAINTY, values)
    assert found.plant.cylinder.mass_kg == 1.8
    assert found.plant.linkage == LINKAGES["G3"]
    assert found.plant.full_order == FullCylinderParameters(coulomb_friction_n=40.0)
    assert found.bus.latency_samples == 2
    believed = UNCERTAIN_KNEE.plant.model_copy(update={"linkage": LINKAGES["G3"]})
    assert found.believed_plant == believed


def test_nothing_changed_is_the_scenario_itself():
    found = realize(UNCERTAIN_KNEE, UNCERTAINTY, {})
    assert found == UNCERTAIN_KNEE.model_copy(update={"nominal": UNCERTAIN_KNEE.plant})


def test_a_controller_that_believes_something_else_goes_on_doing_so():
    wrong = UNCERTAIN_KNEE.model_copy(update={"nominal": PlantParameters(ideal_motor=True)})
    values = {"plant.cylinder.mass_kg": 1.7, "plant.linkage": "G2"}
    found = realize(wrong, UNCERTAINTY, values)
    assert found.nominal == PlantParameters(ideal_motor=True, linkage=LINKAGES["G2"])


@given(st.integers(0, 30), st.integers(0, 30), st.integers(0, 2**32))
def test_a_sample_does_not_depend_on_how_many_are_drawn(few, more, seed):
    few, more = sorted((few, more))
    assert draw(UNCERTAINTY, more, seed)[:few] == draw(UNCERTAINTY, few, seed)


def test_samples_fill_their_ranges_evenly():
    drawn = draw(UNCERTAINTY, 4000, 1)
    assert drawn != draw(UNCERTAINTY, 4000, 2)
    for path, one in UNCERTAINTY.values.items():
        own = [values[path] for values in drawn]
        if one.options:
            counts = [own.count(option) / 4000 for option in one.options]
            # Six standard deviations of a binomial share.
            assert counts == pytest.approx([1 / 3] * 3, abs=6.0 * math.sqrt(2 / 9 / 4000))
            continue
        x, low, high = np.array(own), one.low, one.high
        if one.scale == "log":
            x, low, high = np.log(x), math.log(low), math.log(high)
        share = (x - low) / (high - low)
        assert share.min() >= 0.0
        assert share.max() <= 1.0
        assert share.mean() == pytest.approx(0.5, abs=6.0 / math.sqrt(12 * 4000))


# --------------------------------------------------------------------------- what is visited


def test_all_corners_are_visited_when_they_are_few(formula):
    formula(lambda scenario: merits())
    found = robustness_study(UNCERTAIN_KNEE, SMALL, FEW)
    assert found.corners_possible == 12
    assert found.corners_settled is None
    visited = [tuple(corner.values.values()) for corner in found.corners]
    assert sorted(visited) == sorted(itertools.product((1.4, 1.8), (0.005, 0.02), (0, 1, 2)))
    assert "All 12 corners" in report(found)


def test_one_at_a_time_changes_one_value(formula):
    seen = formula(lambda scenario: merits(max_error_deg=scenario.plant.pump.lag_s))
    found = robustness_study(UNCERTAIN_KNEE, SMALL, FEW)
    assert [dict(assessment.values) for assessment in found.one_at_a_time] == [
        {"plant.cylinder.mass_kg": 1.4},
        {"plant.cylinder.mass_kg": 1.8},
        {"plant.pump.lag_s": 0.005},
        {"plant.pump.lag_s": 0.02},
        {"bus.latency_samples": 0},
        {"bus.latency_samples": 1},
        {"bus.latency_samples": 2},
    ]
    assert found.effects("max_error_deg")["plant.pump.lag_s"] == [0.005, 0.02]
    assert found.effects("max_error_deg")["bus.latency_samples"] == [0.01] * 3
    assert found.spread("max_error_deg", "plant.pump.lag_s") == pytest.approx(0.015)
    assert found.spread("max_error_deg", "plant.cylinder.mass_kg") == 0.0
    assert found.nominal.metrics["max_error_deg"] == 0.01
    # Nominal, one at a time, samples, corners: each once. The option that is nominal runs again.
    assert len(seen) == 1 + 7 + 40 + 12 == len(set(seen)) + 1


def levels_of(one):
    return one.options or (one.low, one.high)


def share_of(path, one, scenario):
    """0 … 1 along the levels of a value, as a plant of a corner has it."""
    value = reduce(getattr, path.split("."), scenario)
    if one.options:
        known = [LINKAGES.get(o, o) if isinstance(o, str) else o for o in one.options]
        known = [FullCylinderParameters(**o) if isinstance(o, dict) else o for o in known]
        return known.index(value) / (len(known) - 1)
    if one.scale == "log":
        return math.log(value / one.low) / math.log(one.high / one.low)
    return (value - one.low) / (one.high - one.low)


@pytest.fixture
def weighted(formula):
    """A figure that is a sum over all values, half of which are bad at their low end."""

    def replace(interaction=0.0, *, margin=True):
        weights = {path: (-1.0) ** n * (1.0 + 0.1 * n) for n, path in enumerate(UNCERTAINTY.values)}

        def value(scenario):
            shares = {p: share_of(p, one, scenario) for p, one in UNCERTAINTY.values.items()}
            total = sum(weights[p] * share for p, share in shares.items())
            mass, lag = shares["plant.cylinder.mass_kg"], shares["plant.pump.lag_s"]
            total += interaction * mass * lag
            found = merits(max_error_deg=20.0 + total)
            return found | {"disk_margin": 20.0 + total} if margin else found

        formula(value)
        signs = np.array(list(weights.values()))
        highest = 20.0 + signs[signs > 0].sum()
        lowest = 20.0 + signs[signs < 0].sum()
        return highest, lowest

    return replace


def test_the_worst_of_many_corners_is_found_where_effects_add_up(weighted):
    highest, lowest = weighted()
    found = robustness_study(UNCERTAIN_KNEE, UNCERTAINTY, FEW)
    assert found.corners_possible == 2**10 * 3**3
    assert len(found.corners) == FEW.corners_max
    assert len({json.dumps(to_json(dict(c.values))) for c in found.corners}) == FEW.corners_max
    # More is worse for an error, less for a margin.
    assert worst(found.corners, "max_error_deg").metrics["max_error_deg"] == pytest.approx(highest)
    assert worst(found.corners, "disk_margin").metrics["disk_margin"] == pytest.approx(lowest)
    assert f"{FEW.corners_max} of 27648 corners" in report(found)


def test_the_search_finds_a_corner_that_no_single_effect_points_at(weighted):
    # Mass and lag are each best low alone, but worst high together.
    weighted(interaction=30.0, margin=False)
    budget = FEW.model_copy(update={"corners_max": 400})
    found = robustness_study(UNCERTAIN_KNEE, UNCERTAINTY, budget)
    assert found.corners_settled
    at_worst = worst(found.corners, "max_error_deg")
    assert at_worst.values["plant.cylinder.mass_kg"] == 1.8
    assert at_worst.values["plant.pump.lag_s"] == 0.02
    # Every corner that differs in one value was visited; none is worse.
    visited = {json.dumps(to_json(dict(corner.values))) for corner in found.corners}
    for path, span in UNCERTAINTY.values.items():
        for level in span.levels:
            assert json.dumps(to_json({**at_worst.values, path: level})) in visited
    assert "no single change makes the worst one of any metric worse" in report(found)


def test_a_small_budget_is_kept_and_told(weighted):
    weighted(interaction=30.0)
    found = robustness_study(
        UNCERTAIN_KNEE, UNCERTAINTY, FEW.model_copy(update={"corners_max": 60})
    )
    assert len(found.corners) == 60
    assert found.corners_settled is False
    assert "ran out of its budget" in report(found)


def test_results_do_not_depend_on_the_number_of_samples(formula):
    formula(lambda scenario: merits(rms_error_deg=scenario.plant.cylinder.mass_kg))
    few = robustness_study(UNCERTAIN_KNEE, SMALL, FEW)
    more = robustness_study(UNCERTAIN_KNEE, SMALL, FEW.model_copy(update={"samples": 60}))
    assert more.samples[:40] == few.samples


# ------------------------------------------------------------------------- what is left out


def test_values_that_do_not_apply_are_left_out_and_reported(formula):
    formula(lambda scenario: merits())
    found = robustness_study(Scenario(), UNCERTAINTY, FEW.model_copy(update={"corners_max": 40}))
    assert found.left_out == ("plant.load.segment_mass_kg", "plant.load.knee_torque_n_m")
    assert set(found.uncertainty.values) == set(UNCERTAINTY.values) - set(found.left_out)
    assert "left out: plant.load.segment_mass_kg, plant.load.knee_torque_n_m." in report(found)
    assert found.results()["left_out"] == list(found.left_out)


def raises_one_line(match):
    return pytest.raises(ParameterError, match=rf"\A{match}\Z")


REFUSED = {
    "plant.cylinder.mas_kg": ({"low": 1.0, "high": 2.0}, ": unknown name; .*'mass_kg'.*"),
    "nonsense": ({"low": 1.0, "high": 2.0}, ": unknown name; .*"),
    "plant.cylinder.mass_kg": ({"low": -1.0, "high": 2.0}, " = -1 kg is out of range: .*"),
    "plant.linkage": ({"options": ("G1", "G9")}, ": 'G9' must be one of .*"),
    "bus.latency_samples": ({"options": (1,), "known": True}, ": known is for values of the plant"),
    "plant.pump.lag_s": ({"low": 0.01, "high": 0.02}, ": lies within plant.pump, .*"),
}


@pytest.mark.parametrize("path", REFUSED)
def test_wrong_values_are_refused_before_anything_runs(formula, path):
    seen = formula(lambda scenario: merits())
    one, message = REFUSED[path]
    values = {"plant.pump": {"options": ({},)}} if path == "plant.pump.lag_s" else {}
    with raises_one_line(re.escape(path) + message):
        robustness_study(Scenario(), UncertaintySet(values={**values, path: one}), FEW)
    assert seen == []


def test_a_set_of_which_nothing_applies_is_refused():
    load = UncertaintySet(values={"plant.load.segment_mass_kg": {"low": 1.0, "high": 2.0}})
    with raises_one_line("none of the uncertain values is in this scenario: .*segment_mass_kg"):
        robustness_study(Scenario(), load, FEW)


# ----------------------------------------------------------------------------------- failures


def unstable_above_1_6_kg(scenario):
    if scenario.plant.pump.lag_s > 0.019:
        return merits(
            max_error_deg=math.nan,
            rms_error_deg=math.nan,
            tracking_failure=f"t = {scenario.plant.cylinder.mass_kg} s: out of range",
        )
    if scenario.plant.cylinder.mass_kg > 1.6:
        margins = dict.fromkeys(("phase_margin_deg", "delay_margin_s", "disk_margin"), math.nan)
        return merits(stable=False, **margins)
    return merits(disk_margin=scenario.plant.cylinder.mass_kg)


def test_failures_are_counted_and_worse_than_any_number(formula):
    formula(unstable_above_1_6_kg)
    found = robustness_study(UNCERTAIN_KNEE, SMALL, FEW)
    heavy = sum(v.values["plant.cylinder.mass_kg"] > 1.6 for v in found.samples)
    slow = sum(v.values["plant.pump.lag_s"] > 0.019 for v in found.samples)
    both = sum(
        v.values["plant.cylinder.mass_kg"] > 1.6 and v.values["plant.pump.lag_s"] <= 0.019
        for v in found.samples
    )
    results = found.results()
    assert results["metrics"]["disk_margin"]["failed_samples"] == both
    assert results["metrics"]["max_error_deg"]["failed_samples"] == slow
    assert math.isnan(results["metrics"]["disk_margin"]["worst_sample"]["value"])
    reasons = results["failures"]["samples"]
    assert [entry["count"] for entry in reasons] == sorted([both, slow], reverse=True)
    assert {entry["example"].split(" ")[-1] for entry in reasons} == {"unstable", "range"}
    assert quantile(found.samples, "disk_margin", 0.0) == -math.inf
    assert quantile(found.samples, "max_error_deg", 1.0) == math.inf
    text = report(found)
    assert f"{both + slow} of the 40 samples" in text
    assert f"- {both} times: the sampled loop, linearized in the middle of" in text
    assert heavy >= both > 0 < slow
    assert json.loads(to_json(results))["metrics"]["disk_margin"]["worst_corner"]["value"] is None


def test_values_that_do_not_go_together_are_failures(formula):
    formula(lambda scenario: merits())
    rods = uncertain(
        plant__cylinder__bore_m={"low": 0.012, "high": 0.022},
        plant__cylinder__rod_diameter_m={"low": 0.008, "high": 0.015},
    )
    found = robustness_study(UNCERTAIN_KNEE, rods, FEW)
    (wrong,) = (c for c in found.corners if c.failures)
    assert dict(wrong.values) == {
        "plant.cylinder.bore_m": 0.012,
        "plant.cylinder.rod_diameter_m": 0.015,
    }
    assert "must be below" in wrong.failures[0]
    assert worst(found.corners, "disk_margin") is wrong
    assert "- 1 times: plant.cylinder: rod_diameter_m" in report(found)


def test_reasons_that_differ_in_numbers_are_one():
    texts = ["t = 1.5 s: x = -2e-5 m left", "t = 0.25 s: x = 3 m left", "no rest at 4 deg"]
    assessments = [
        Assessment({"n": n}, merits(tracking_failure=text)) for n, text in enumerate(texts)
    ]
    assert failures(assessments) == [
        {"count": 2, "example": texts[0], "values": {"n": 0}},
        {"count": 1, "example": texts[2], "values": {"n": 2}},
    ]


# --------------------------------------------------------------------------------- statistics

OPTIONS = uncertain(a={"low": 0.0, "high": 1.0}, b={"options": ("x", "y", "z")})


def visits_of(a, b, value):
    return [
        Assessment({"a": x, "b": o}, merits(disk_margin=v))
        for x, o, v in zip(a, b, value, strict=True)
    ]


@given(st.integers(0, 2**32), st.integers(3, 40))
@settings(max_examples=30)
def test_rank_correlation_is_that_of_scipy(seed, count):
    random = np.random.default_rng(seed)
    a = np.round(random.random(count), 1)  # with ties
    value = np.round(a + random.random(count), 1)
    if np.ptp(a) == 0.0 or np.ptp(value) == 0.0:
        return
    b = ["x", "y", "z"] * count
    found = rank_correlation(OPTIONS, visits_of(a, b[:count], value), "disk_margin")
    assert found[0] == pytest.approx(spearmanr(a, value).statistic, abs=1e-12)
    assert 0.0 <= found[1] <= 1.0


def test_the_correlation_ratio_tells_options_apart():
    a = np.linspace(0.0, 1.0, 9)
    by_option = visits_of(a, "xxxyyyzzz", [1, 2, 3, 7, 8, 9, 4, 5, 6])
    # Ranks 1…9: between groups 3·(2−5)² + 3·(8−5)² + 0 = 54 of 60.
    assert rank_correlation(OPTIONS, by_option, "disk_margin")[1] == pytest.approx(
        math.sqrt(54 / 60)
    )
    same = visits_of(a, "xyzxyzxyz", [1, 1, 1, 2, 2, 2, 3, 3, 3])
    assert rank_correlation(OPTIONS, same, "disk_margin")[1] == pytest.approx(0.0, abs=1e-12)


def test_a_failure_has_the_worst_rank():
    fails_high = visits_of([0.1, 0.2, 0.3, 0.9], "xyzx", [3.0, 2.0, 1.0, math.nan])
    assert rank_correlation(OPTIONS, fails_high, "disk_margin")[0] == pytest.approx(-1.0)


def test_a_figure_that_never_changes_has_no_correlation():
    assert np.isnan(rank_correlation(OPTIONS, visits_of([0, 1], "xy", [1, 1]), "disk_margin")).all()


def test_what_the_worst_sample_covers(formula):
    formula(lambda scenario: merits())
    found = robustness_study(UNCERTAIN_KNEE, SMALL, FEW)
    # That all of n draws lie within a share p of all plants has the probability pⁿ = 5 %.
    assert found.covered**40 == pytest.approx(0.05)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=30), st.floats(0.0, 1.0))
def test_a_quantile_is_one_of_the_values(values, share):
    assessments = [Assessment({}, merits(disk_margin=v)) for v in values]
    found = quantile(assessments, "disk_margin", share)
    assert found in values
    assert sum(v <= found for v in values) >= share * len(values) - 1e-9


def test_short_names_stay_apart():
    assert short_names(["plant.a.x", "plant.b.x", "plant.c.y"]) == {
        "plant.a.x": "plant.a.x",
        "plant.b.x": "plant.b.x",
        "plant.c.y": "y",
    }


# ----------------------------------------------- results, report and figures of assessments by hand

UNITS = dict(zip(MERITS, (1.0, 0.5, 20.0, 0.3, 60.0, 0.2, 0.7), strict=True))
"""Size of each figure of merit; an assessment has a number of its own times it."""


def assessment(number, mass, lag, delay, **changes):
    values = {
        "plant.cylinder.mass_kg": mass,
        "plant.pump.lag_s": lag,
        "bus.latency_samples": delay,
    }
    kept = {path: value for path, value in values.items() if value is not None}
    found = {name: round(number * size, 6) for name, size in UNITS.items()}
    return Assessment(kept, merits(**found, bandwidth_failure="") | changes)


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
    found = [1.0, ordered[2], ordered[0], ordered[4]]
    found += [ordered[4] if more_is_worse else ordered[0], 2.3 if more_is_worse else 0.6]
    return [size * value for value in found]


def test_the_summary_of_each_figure_is_that_of_its_visits(by_hand, flat, check_rules):
    found = by_hand.results()
    check_rules(found)
    assert list(found["metrics"]) == list(MERITS)
    for merit, own in found["metrics"].items():
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
    assert found["share_within_worst_sample_at_95_percent_confidence"] == pytest.approx(
        0.05 ** (1 / 5)
    )
    assert found["failures"]["samples"] == [
        {"count": 1, "example": "t = 1 s: out of range", "values": by_hand.samples[3].values}
    ]
    assert found["failures"]["corners"] == found["failures"]["one_at_a_time"] == []
    assert (found["corners_visited"], found["corners_possible"]) == (3, 12)
    for kind in ("samples", "corners", "one_at_a_time"):
        assessments = getattr(by_hand, kind)
        expected = [{"values": dict(v.values)} | v.metrics for v in assessments]
        assert flat(found[kind]) == pytest.approx(flat(expected), nan_ok=True)
    assert found["nominal"] == by_hand.nominal.metrics
    assert found["local_sensitivity"] == by_hand.local
    for merit, own in found["rank_correlation"].items():
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


# ------------------------------------------------------------------------------- with the loop

REAL = changed(
    UNCERTAIN_KNEE,
    {
        "reference": {"kind": "sine", "amplitude_deg": 2.0, "frequency_hz": 4.0},
        "simulation.duration_s": 0.3,
    },
)


@pytest.fixture(scope="module")
def real():
    budget = FEW.model_copy(update={"samples": 4, "corners_max": 4, "sensitivity_duration_s": 0.1})
    wide = uncertain(
        plant__cylinder__mass_kg={"low": 1.4, "high": 1.8},
        plant__pump__lag_s={"low": 0.0099, "high": 0.0101, "scale": "log"},
    )
    return robustness_study(REAL, wide, budget)


def test_every_row_is_that_of_runs_and_margins_of_its_own_plant(real, in_numbers, margins):
    assessments = (real.nominal, *real.one_at_a_time, *real.samples, *real.corners)
    assert len(assessments) == 1 + 4 + 4 + 4
    for assessment in assessments:
        plant = changed(
            REAL, {"nominal": REAL.plant, **assessment.values}
        )  # only the plant changes
        expected = in_numbers(plant, 0.25) | margins(plant, 40.0)
        row = {name: assessment.metrics[name] for name in expected}
        assert row == pytest.approx(expected, rel=1e-9)
        assert assessment.failures == ()


def test_a_narrow_interval_moves_the_figures_as_the_local_sensitivity_says(real):
    for merit in ("phase_margin_deg", "delay_margin_s", "disk_margin"):
        low, high = real.effects(merit)["plant.pump.lag_s"]
        # The third order of a change by 1 % is left.
        linear = real.linear_effect(merit, "plant.pump.lag_s")
        assert linear == pytest.approx(high - low, rel=1e-3)
    assert set(real.local) >= {"rms_error_deg", "largest_eigenvalue", "gain_margin"}
    assert math.isnan(real.linear_effect("max_error_deg", "plant.pump.lag_s"))


@pytest.mark.slow
def test_every_figure_can_be_drawn(real):
    drawn = figures(real)
    for figure in drawn.values():
        figure.canvas.draw()
    key = [text.get_text() for text in drawn["robustness_importance"].legends[0].get_texts()]
    assert key[:2] == ["more of the value is worse", "more of the value is better"]
    marks = [text.get_text() for text in drawn["robustness_tornado"].legends[0].get_texts()]
    assert marks == ["low end", "high end", "nominal"]
    assert "None of the 4 samples fails or is unstable." in report(real)


def test_an_interrupted_study_goes_on_where_it_stopped(tmp_path, monkeypatch):
    budget = FEW.model_copy(update={"samples": 4, "corners_max": 2})
    run = partial(robustness_study, REAL, SMALL, budget)
    calls = []

    def stops(scenario, **options):
        calls.append(scenario)
        if len(calls) > 5:
            raise KeyboardInterrupt
        return merits(max_error_deg=scenario.plant.pump.lag_s)

    def goes_on(scenario, **options):
        calls.append(scenario)
        return merits(max_error_deg=scenario.plant.pump.lag_s)

    # A piece of work is known by the name of its function.
    stops.__qualname__ = goes_on.__qualname__ = "assess"
    monkeypatch.setattr(module, "assess", goes_on)
    whole = run()
    total = len(calls)
    calls.clear()
    path = tmp_path / "checkpoint.jsonl"
    monkeypatch.setattr(module, "assess", stops)
    with pytest.raises(KeyboardInterrupt):
        run(checkpoint=Checkpoint(path))
    calls.clear()
    monkeypatch.setattr(module, "assess", goes_on)
    resumed = run(checkpoint=Checkpoint(path, resume=True))
    assert len(calls) == total - 5
    assert to_json(resumed.results()) == to_json(whole.results())


# ------------------------------------------------------------- the same, however it is run

BLIND = changed(Scenario(), {"plant.knee.flexion_max_deg": 70.0, "simulation.duration_s": 6.0})
MISMOUNTED = uncertain(
    plant__cylinder__mass_kg={"low": 1.4, "high": 1.8},
    encoder__mounting_error_rad={"low": -0.02, "high": 0.02},
    bus__latency_samples={"options": (0, 1)},
    plant__cylinder__rod_diameter_m={"low": 0.010, "high": 0.0205},
)


@pytest.fixture(scope="module")
def one_by_one():
    """Some plants, how to judge them, and the figures of each alone; some fail."""
    judge = partial(assess_plant, BLIND, MISMOUNTED, partial(assess, margins=False))
    points = draw(MISMOUNTED, 40, 3)
    found = [judge(point) for point in points]
    reasons = [figures["tracking_failure"] for figures in found]
    assert sum("left the range of motion" in reason for reason in reasons) >= 3
    assert sum("must be below 0.98 times bore_m" in reason for reason in reasons) >= 1
    assert sum(not reason for reason in reasons) >= 10
    return judge, points, repr(found)


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_plants_figures_do_not_depend_on_the_workers(one_by_one, workers):
    judge, points, expected = one_by_one
    assert repr(parallel_map(judge, points, workers=workers)) == expected


@pytest.mark.parametrize(("first", "lot", "batch"), [(1, 1, 1), (8, 256, 3), (40, 7, 64)])
def test_a_plants_figures_do_not_depend_on_its_company(one_by_one, monkeypatch, first, lot, batch):
    judge, points, expected = one_by_one
    monkeypatch.setattr(parallel, "_first_unit", lambda *_: first)
    monkeypatch.setattr(parallel, "LARGEST_LOT", lot)
    monkeypatch.setattr(engines, "LARGEST_BATCH", batch)
    assert repr(parallel_map(judge, points)) == expected
    with ThreadPoolExecutor(2) as executor:
        assert repr(parallel_map(judge, points, executor=executor)) == expected
    assert repr(parallel_map(judge, points[::-1])[::-1]) == expected


def test_a_plants_figures_do_not_depend_on_where_the_study_went_on(one_by_one, tmp_path):
    judge, points, expected = one_by_one
    path = tmp_path / "checkpoint.jsonl"
    parallel_map(judge, points[5:18], checkpoint=Checkpoint(path))
    resumed = Checkpoint(path, resume=True)
    assert len(resumed) == 13
    assert repr(parallel_map(judge, points, checkpoint=resumed)) == expected


def test_a_reference_that_does_not_move_has_no_bandwidth(formula):
    formula(lambda scenario: merits())
    step = changed(UNCERTAIN_KNEE, {"reference": {"kind": "step"}})
    found = robustness_study(step, SMALL, FEW.model_copy(update={"bandwidth": True}))
    assert "bandwidth_hz" not in found.merits
