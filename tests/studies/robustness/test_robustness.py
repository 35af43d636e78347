"""Robustness: what is visited against hand counts, what is said about it against scipy.

Most tests put a formula in the place of `assess`, so that the worst corner is known beforehand.
"""

import itertools
import json
import math
from concurrent.futures import ThreadPoolExecutor
from functools import partial, reduce

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from robustness_cases import (
    FEW,
    POSITION,
    REAL,
    SAMPLED,
    SMALL,
    expected_summary,
    merits,
    uncertain,
)
from scipy.stats import spearmanr

from kneexo.command_line.output import to_json
from kneexo.errors import LinearizationError, SimulationError
from kneexo.parameters import (
    LINKAGES,
    UNCERTAIN_KNEE,
    UNCERTAINTY,
    FullCylinderParameters,
    Scenario,
)
from kneexo.parameters.paths import changed
from kneexo.parameters.uncertainty import draw
from kneexo.simulation import engines, simulate
from kneexo.studies.assessment import MARGIN_METRICS, assess
from kneexo.studies.markdown import number
from kneexo.studies.robustness import robustness
from kneexo.studies.robustness.report import report
from kneexo.studies.robustness.robustness import (
    MERITS,
    Assessment,
    assess_plant,
    failures,
    quantile,
    rank_correlation,
    robustness_study,
    worst,
)
from kneexo.sweeps import parallel, parallel_map


@pytest.fixture
def without_sensitivities(monkeypatch):
    """Leave out the local sensitivities, which take longer than all else where `assess` is fast."""

    def left_out(*_):
        raise LinearizationError("left out")

    monkeypatch.setattr(robustness, "loop_sensitivities", left_out)


@pytest.fixture
def formula(monkeypatch, without_sensitivities):
    """Replace `assess` by a function of the scenario; returns the scenarios that it saw."""

    def replace(function):
        seen = []

        def stand_in(scenario, *, bandwidth=False):
            seen.append(scenario)
            return function(scenario)

        monkeypatch.setattr(robustness, "assess", stand_in)
        return seen

    return replace


# --------------------------------------------------------------------------- what is visited


def test_all_corners_are_visited_when_they_are_few(formula):
    formula(lambda scenario: merits())
    result = robustness_study(UNCERTAIN_KNEE, SMALL, FEW)
    assert result.corners_possible == 12
    assert result.corners_settled is None
    visited = [tuple(corner.values.values()) for corner in result.corners]
    assert sorted(visited) == sorted(itertools.product((1.4, 1.8), (0.005, 0.02), (0, 1, 2)))
    assert "All 12 corners" in report(result)


def test_one_at_a_time_changes_one_value(formula):
    seen = formula(lambda scenario: merits(max_error_deg=scenario.plant.pump.lag_s))
    result = robustness_study(UNCERTAIN_KNEE, SMALL, FEW)
    assert [dict(assessment.values) for assessment in result.one_at_a_time] == [
        {"plant.cylinder.mass_kg": 1.4},
        {"plant.cylinder.mass_kg": 1.8},
        {"plant.pump.lag_s": 0.005},
        {"plant.pump.lag_s": 0.02},
        {"bus.latency_samples": 0},
        {"bus.latency_samples": 1},
        {"bus.latency_samples": 2},
    ]
    assert result.effects("max_error_deg")["plant.pump.lag_s"] == [0.005, 0.02]
    assert result.effects("max_error_deg")["bus.latency_samples"] == [0.01] * 3
    assert result.spread("max_error_deg", "plant.pump.lag_s") == pytest.approx(0.015)
    assert result.spread("max_error_deg", "plant.cylinder.mass_kg") == 0.0
    assert result.nominal.metrics["max_error_deg"] == 0.01
    # Nominal, one at a time, samples, corners: each once. The option that is nominal runs again.
    assert len(seen) == 1 + 7 + 40 + 12 == len(set(seen)) + 1


def share_of(path, uncertainty, scenario):
    """0 … 1 along the levels of a value, as a plant of a corner has it."""
    value = reduce(getattr, path.split("."), scenario)
    if uncertainty.options:
        known = [LINKAGES.get(o, o) if isinstance(o, str) else o for o in uncertainty.options]
        known = [FullCylinderParameters(**o) if isinstance(o, dict) else o for o in known]
        return known.index(value) / (len(known) - 1)
    if uncertainty.scale == "log":
        return math.log(value / uncertainty.low) / math.log(uncertainty.high / uncertainty.low)
    return (value - uncertainty.low) / (uncertainty.high - uncertainty.low)


@pytest.fixture
def weighted(formula):
    """A figure that is a sum over all values, half of which are bad at their low end."""

    def replace(interaction=0.0, *, margin=True):
        weights = {path: (-1.0) ** n * (1.0 + 0.1 * n) for n, path in enumerate(UNCERTAINTY.values)}

        def value(scenario):
            shares = {p: share_of(p, u, scenario) for p, u in UNCERTAINTY.values.items()}
            total = sum(weights[p] * share for p, share in shares.items())
            mass, lag = shares["plant.cylinder.mass_kg"], shares["plant.pump.lag_s"]
            total += interaction * mass * lag
            metrics = merits(max_error_deg=20.0 + total)
            return metrics | {"disk_margin": 20.0 + total} if margin else metrics

        formula(value)
        signs = np.array(list(weights.values()))
        highest = 20.0 + signs[signs > 0].sum()
        lowest = 20.0 + signs[signs < 0].sum()
        return highest, lowest

    return replace


@pytest.mark.slow
def test_the_worst_of_many_corners_is_found_where_effects_add_up(weighted):
    highest, lowest = weighted()
    result = robustness_study(UNCERTAIN_KNEE, UNCERTAINTY, FEW)
    assert result.corners_possible == 2**10 * 3**3
    assert len(result.corners) == FEW.corners_max
    assert len({json.dumps(to_json(dict(c.values))) for c in result.corners}) == FEW.corners_max
    # More is worse for an error, less for a margin.
    assert worst(result.corners, "max_error_deg").metrics["max_error_deg"] == pytest.approx(highest)
    assert worst(result.corners, "disk_margin").metrics["disk_margin"] == pytest.approx(lowest)
    assert f"{FEW.corners_max} of 27648 corners" in report(result)


def test_the_search_finds_a_corner_that_no_single_effect_points_at(weighted):
    # Mass and lag are each best low alone, but worst high together.
    weighted(interaction=30.0, margin=False)
    budget = FEW.model_copy(update={"corners_max": 400})
    result = robustness_study(UNCERTAIN_KNEE, UNCERTAINTY, budget)
    assert result.corners_settled
    at_worst = worst(result.corners, "max_error_deg")
    assert at_worst.values["plant.cylinder.mass_kg"] == 1.8
    assert at_worst.values["plant.pump.lag_s"] == 0.02
    # Every corner that differs in one value was visited; none is worse.
    visited = {json.dumps(to_json(dict(corner.values))) for corner in result.corners}
    for path, span in UNCERTAINTY.values.items():
        for level in span.levels:
            assert json.dumps(to_json({**at_worst.values, path: level})) in visited
    assert "no single change makes the worst one of any metric worse" in report(result)


def test_a_small_budget_is_kept_and_reported(weighted):
    weighted(interaction=30.0)
    result = robustness_study(
        UNCERTAIN_KNEE, UNCERTAINTY, FEW.model_copy(update={"corners_max": 20})
    )
    assert len(result.corners) == 20
    assert result.corners_settled is False
    assert "ran out of its budget" in report(result)


@pytest.mark.slow
def test_results_do_not_depend_on_the_number_of_samples(formula):
    formula(lambda scenario: merits(rms_error_deg=scenario.plant.cylinder.mass_kg))
    few = robustness_study(UNCERTAIN_KNEE, SMALL, FEW)
    more = robustness_study(UNCERTAIN_KNEE, SMALL, FEW.model_copy(update={"samples": 60}))
    assert more.samples[:40] == few.samples


# ------------------------------------------------------------------------- what is left out


@pytest.mark.slow
def test_values_that_do_not_apply_are_left_out_and_reported(formula):
    formula(lambda scenario: merits())
    result = robustness_study(Scenario(), UNCERTAINTY, FEW.model_copy(update={"corners_max": 40}))
    assert result.left_out == ("plant.load.segment_mass_kg", "plant.load.knee_torque_n_m")
    assert set(result.uncertainty.values) == set(UNCERTAINTY.values) - set(result.left_out)
    assert "left out: segment mass (kg), knee torque (N·m)." in report(result)
    assert result.results()["left_out"] == list(result.left_out)


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
    result = robustness_study(UNCERTAIN_KNEE, SMALL, FEW)
    heavy = sum(v.values["plant.cylinder.mass_kg"] > 1.6 for v in result.samples)
    slow = sum(v.values["plant.pump.lag_s"] > 0.019 for v in result.samples)
    both = sum(
        v.values["plant.cylinder.mass_kg"] > 1.6 and v.values["plant.pump.lag_s"] <= 0.019
        for v in result.samples
    )
    results = result.results()
    assert results["metrics"]["disk_margin"]["failed_samples"] == both
    assert results["metrics"]["max_error_deg"]["failed_samples"] == slow
    assert math.isnan(results["metrics"]["disk_margin"]["worst_sample"]["value"])
    reasons = results["failures"]["samples"]
    assert [entry["count"] for entry in reasons] == sorted([both, slow], reverse=True)
    assert {entry["example"].split(" ")[-1] for entry in reasons} == {"unstable", "range"}
    assert quantile(result.samples, "disk_margin", 0.0) == -math.inf
    assert quantile(result.samples, "max_error_deg", 1.0) == math.inf
    text = report(result)
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
    result = robustness_study(UNCERTAIN_KNEE, rods, FEW)
    (wrong,) = (c for c in result.corners if c.failures)
    assert dict(wrong.values) == {
        "plant.cylinder.bore_m": 0.012,
        "plant.cylinder.rod_diameter_m": 0.015,
    }
    assert "must be below" in wrong.failures[0]
    assert worst(result.corners, "disk_margin") is wrong
    assert "- 1 times: plant.cylinder: rod_diameter_m" in report(result)


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
    correlations = rank_correlation(OPTIONS, visits_of(a, b[:count], value), "disk_margin")
    assert correlations[0] == pytest.approx(spearmanr(a, value).statistic, abs=1e-12)
    assert 0.0 <= correlations[1] <= 1.0


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


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=30), st.floats(0.0, 1.0))
def test_a_quantile_is_one_of_the_values(values, share):
    assessments = [Assessment({}, merits(disk_margin=v)) for v in values]
    level = quantile(assessments, "disk_margin", share)
    assert level in values
    assert sum(v <= level for v in values) >= share * len(values) - 1e-9


# ------------------------------------------------------------------------------- with the loop


def test_every_row_is_that_of_runs_and_margins_of_its_own_plant(small, in_numbers, margins):
    real, _ = small
    assessments = (real.nominal, *real.one_at_a_time, *real.samples, *real.corners)
    assert len(assessments) == 1 + 4 + 4 + 4
    for assessment in assessments[::4]:  # one of each kind
        plant = changed(
            REAL, {"nominal": REAL.plant, **assessment.values}
        )  # only the plant changes
        expected = in_numbers(plant, 0.25) | margins(plant, 40.0)
        row = {name: assessment.metrics[name] for name in expected}
        assert row == pytest.approx(expected, rel=1e-9)
        assert assessment.failures == ()


def test_a_narrow_interval_moves_the_figures_as_the_local_sensitivity_says(small):
    real, _ = small
    for merit in ("phase_margin_deg", "delay_margin_s", "disk_margin"):
        low, high = real.effects(merit)["plant.pump.lag_s"]
        # The third order of a change by 1 % is left.
        linear = real.linear_effect(merit, "plant.pump.lag_s")
        assert linear == pytest.approx(high - low, rel=1e-3)
    assert set(real.local) >= {"rms_error_deg", "largest_eigenvalue", "gain_margin"}
    assert math.isnan(real.linear_effect("max_error_deg", "plant.pump.lag_s"))


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
    metrics = [judge(point) for point in points]
    reasons = [figures["tracking_failure"] for figures in metrics]
    assert sum("left the range of motion" in reason for reason in reasons) >= 3
    assert sum("must be below 0.98 times bore_m" in reason for reason in reasons) >= 1
    assert sum(not reason for reason in reasons) >= 10
    return judge, points, repr(metrics)


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_plants_figures_do_not_depend_on_the_workers(one_by_one, workers):
    judge, points, expected = one_by_one
    assert repr(parallel_map(judge, points, workers=workers)) == expected


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "lot", "batch"),
    [(8, 256, 3), (1, 1, 1), (40, 7, 64)],
)
def test_a_plants_figures_do_not_depend_on_its_company(one_by_one, monkeypatch, first, lot, batch):
    judge, points, expected = one_by_one
    monkeypatch.setattr(parallel, "_first_unit", lambda *_: first)
    monkeypatch.setattr(parallel, "LARGEST_LOT", lot)
    monkeypatch.setattr(engines, "LARGEST_BATCH", batch)
    assert repr(parallel_map(judge, points)) == expected
    with ThreadPoolExecutor(2) as executor:
        assert repr(parallel_map(judge, points, executor=executor)) == expected
    assert repr(parallel_map(judge, points[::-1])[::-1]) == expected


def test_a_reference_that_does_not_move_has_no_bandwidth(formula):
    formula(lambda scenario: merits())
    step = changed(UNCERTAIN_KNEE, {"reference": {"kind": "step"}})
    result = robustness_study(step, SMALL, FEW.model_copy(update={"bandwidth": True}))
    assert "bandwidth_hz" not in result.merits


def test_the_summary_of_each_figure_is_that_of_its_visits(by_hand, flat):
    numbers = by_hand.results()
    assert list(numbers["metrics"]) == POSITION
    for merit, summary in numbers["metrics"].items():
        names = ("nominal", "median", "percentile_5", "percentile_95")
        values = [summary[name] for name in names]
        values += [summary[f"worst_{kind}"]["value"] for kind in ("sample", "corner")]
        expected = expected_summary(merit)
        if merit == "max_error_deg":  # a figure that is missing has no number
            expected[4] = math.nan
        assert values == pytest.approx(expected, nan_ok=True), merit
        assert summary["failed_samples"] == (merit == "max_error_deg")
        assert summary["failed_corners"] == 0
        high = MERITS[merit].sign_of_worse > 0.0
        at_worst = by_hand.samples[3 if merit == "max_error_deg" else 2 if high else 1]
        assert summary["worst_sample"]["values"] == at_worst.values
        assert summary["worst_corner"]["values"] == by_hand.corners[0 if high else 1].values
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
    for merit, by_path in numbers["rank_correlation"].items():
        values = SAMPLED.copy()
        if merit == "max_error_deg":
            values[3] = math.inf
        for n, path in enumerate(("plant.cylinder.mass_kg", "plant.pump.lag_s")):
            x = [(1.50, 1.45, 1.60, 1.75, 1.65), (0.012, 0.007, 0.019, 0.011, 0.009)][n]
            assert by_path[path] == pytest.approx(spearmanr(x, values).statistic)


@pytest.mark.slow
def test_with_torque_control_the_torque_of_the_wearer_is_ranked_and_the_angle_is_not():
    scenario = REAL.changed({"wearer": "leg", "controller": "torque"})
    cuff = uncertain(
        wearer__cuff__stiffness_n_m_per_rad={"low": 750.0, "high": 3000.0},
        plant__pump__lag_s={"low": 0.005, "high": 0.02},
    )
    few = FEW.model_copy(update={"samples": 4, "bandwidth": True, "sensitivity_duration_s": 0.1})
    result = robustness_study(scenario, cuff, few)
    assert {"disk_margin"} <= set(result.local) <= {"largest_eigenvalue", *MARGIN_METRICS}
    assert result.merits[:2] == ("peak_torque_n_m", "rms_torque_n_m")
    assert not {"max_error_deg", "rms_error_deg", "bandwidth_hz"} & set(result.merits)

    def torque(stiffness, lag):
        values = {"wearer.cuff.stiffness_n_m_per_rad": stiffness, "plant.pump.lag_s": lag}
        run = simulate(scenario.changed(values))
        return np.abs(run["interaction_torque_n_m"]).max()

    corners = {(k, lag): torque(k, lag) for k in (750.0, 3000.0) for lag in (0.005, 0.02)}
    largest = max(corners, key=corners.get)
    corner = worst(result.corners, "peak_torque_n_m")
    assert tuple(corner.values.values()) == largest
    assert corner.metrics["peak_torque_n_m"] == pytest.approx(corners[largest], rel=1e-6)
    text = report(result)
    assert f"| largest torque of the wearer (N·m) | {number(torque(1500.0, 0.01))} |" in text
    assert "- What matters most, by rank correlation: rms torque of the wearer (N·m):" in text
    assert "error (deg)" not in text


@pytest.mark.slow
def test_a_study_in_which_every_run_fails_is_a_failure_with_its_reason():
    passing = {
        "kind": "samples",
        "times_s": (0.0, 0.2, 1.2, 1.4),
        "angles_deg": (10, 89.9, 89.9, 10),
    }
    few = FEW.model_copy(update={"samples": 2, "corners_max": 1})
    with pytest.raises(SimulationError, match=r"^all \d+ runs fail; the first: reference = "):
        robustness_study(changed(Scenario(), {"reference": passing}), SMALL, few)
