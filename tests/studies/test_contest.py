import dataclasses
import math
from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np
import pytest

from kneexo.analysis.assessment import assess
from kneexo.errors import ParameterError, SimulationError
from kneexo.output import to_json
from kneexo.parameters import (
    UNCERTAIN_KNEE,
    UNCERTAINTY,
    PidParameters,
    Scenario,
    SineReference,
    SlidingModeParameters,
    Uncertainty,
    UncertaintySet,
)
from kneexo.parameters.paths import changed
from kneexo.studies import contest as module
from kneexo.studies.contest import (
    COLUMNS,
    CONTESTANTS,
    INFEASIBLE_DEG,
    Contestant,
    ContestSettings,
    ContestStudy,
    Tuning,
    contest_study,
    search,
)
from kneexo.studies.contest_figures import figures
from kneexo.studies.contest_report import report
from kneexo.studies.paper import PID_FEEDFORWARD, PID_PAPER, PID_TUNED
from kneexo.studies.robustness import draw, realize
from kneexo.sweeps.checkpoint import Checkpoint

# ------------------------------------------------------------------------------ the search


def bowl(candidates):
    """Smallest, and 1, at (0.3, 0.6)."""
    return 1.0 + np.sum((candidates - [0.3, 0.6]) ** 2, axis=1)


def test_the_search_finds_the_bottom_of_a_bowl_and_says_so():
    found, history = search(bowl, 2, ContestSettings(population=20, tolerance=1e-3), seed=1)
    assert found.success
    # Objectives that spread by 1e-3 are within about √1e-3 of the bottom; it is closer.
    assert found.x == pytest.approx([0.3, 0.6], abs=0.03)
    assert all(a >= b for a, b in pairwise(history))
    assert history[-1] == found.fun


def test_a_search_that_ends_too_early_has_not_converged():
    found, history = search(bowl, 2, ContestSettings(population=20, generations=1), seed=1)
    assert not found.success
    assert len(history) == 1


def test_the_search_evaluates_whole_generations_and_repeats_itself():
    seen = []

    def objective(candidates):
        seen.append(candidates.copy())
        return bowl(candidates)

    settings = ContestSettings(population=7, generations=3, tolerance=1e-6)
    first = search(objective, 2, settings, seed=5)[0]
    assert [batch.shape for batch in seen] == [(7, 2)] * 4
    assert all(batch.min() >= 0.0 and batch.max() <= 1.0 for batch in seen)
    again = search(bowl, 2, settings, seed=5)[0]
    assert np.array_equal(first.x, again.x)
    assert not np.array_equal(first.x, search(bowl, 2, settings, seed=6)[0].x)


# --------------------------------------------------------------------------- the objective

BUDGET, LEAST = 15.0, 0.5


def judged(monkeypatch, *plants):
    """`_judge` of plants given as (error, command change, disk margin); nan fails."""

    def given_figures(plant, *, tracking=True, margins=True):
        error, change, margin = plant
        found = {}
        if tracking:
            found |= {"max_error_deg": error, "mean_command_change_rpm": change}
            found |= {"tracking_failure": "t = 1 s: gone" if math.isnan(error) else ""}
        if margins:
            found |= {"disk_margin": margin}
        return found

    monkeypatch.setattr(module, "assess", given_figures)
    return module._judge(BUDGET, LEAST, plants)


def test_a_feasible_candidate_is_judged_by_its_mean_error(monkeypatch):
    assert judged(monkeypatch, (0.1, 15.0, 0.5), (0.3, 14.0, 2.0)) == pytest.approx(0.2)
    # The budget holds for the mean over the plants, the margin for each.
    assert judged(monkeypatch, (0.1, 20.0, 0.5), (0.3, 9.0, 2.0)) == pytest.approx(0.2)
    assert judged(monkeypatch, (0.1, 15.0, 0.4), (0.3, 14.0, 2.0)) > INFEASIBLE_DEG


def test_violations_are_ordered(monkeypatch):
    feasible = judged(monkeypatch, (80.0, 15.0, 0.5))
    little = judged(monkeypatch, (0.1, 15.0, 0.49))
    unstable = judged(monkeypatch, (0.1, 15.0, math.nan))
    chattering = judged(monkeypatch, (0.1, 15.1, 2.0))
    wild = judged(monkeypatch, (0.1, 1e6, 2.0))
    one_failed = judged(monkeypatch, (0.1, 1.0, 2.0), (math.nan, math.nan, 2.0))
    both_failed = judged(monkeypatch, (math.nan, math.nan, 2.0), (math.nan, math.nan, 2.0))
    values = [feasible, little, unstable, chattering, wild, one_failed, both_failed]
    assert values == sorted(values)
    assert len(set(values)) == len(values)
    assert feasible < INFEASIBLE_DEG < little


def test_the_ends_of_the_cube_are_the_bounds_of_the_gains():
    smc = CONTESTANTS["SMC"]
    low, high = (module._gains(smc, np.full(4, end)) for end in (0.0, 1.0))
    assert list(low.values()) == [one.low for one in smc.gains.values()]
    assert list(high.values()) == [one.high for one in smc.gains.values()]
    middle = module._gains(smc, np.full(4, 0.5))
    assert middle["controller.lambda_per_s"] == pytest.approx(math.sqrt(2.0 * 200.0))


def test_contestants_have_as_many_gains():
    assert {len(contestant.gains) for contestant in CONTESTANTS.values()} == {4}


# ---------------------------------------------------------------------------- the outcome


def figures_of(error, change=10.0, margin=0.8, stable=True):
    failed = math.isnan(error)
    return {
        "max_error_deg": error,
        "mean_command_change_rpm": math.nan if failed else change,
        "tracking_failure": "gone" if failed else "",
        "stable": stable,
        "disk_margin": margin if stable else math.nan,
        "margins_failure": "",
    }


def made_up():
    settings = ContestSettings(
        contestants={name: CONTESTANTS[name] for name in ("SMC", "PID")}, optimizer_seeds=(1, 2)
    )
    tunings = tuple(
        Tuning(
            name,
            seed,
            dict.fromkeys(CONTESTANTS[name].gains, 0.11),
            objective,
            64,
            converged,
            0.01,
            (95.0, 0.5),
        )
        for name, seed, objective, converged in (
            ("SMC", 1, 0.3, True),
            ("SMC", 2, 0.2, False),
            ("PID", 1, 95.0, False),
            ("PID", 2, 0.4, True),
        )
    )
    tested = {
        "SMC": [figures_of(e, 10.0 + 10.0 * e, 0.8 - 0.1 * e) for e in (0.1, 0.2, 0.3, 0.4)],
        "PID": [figures_of(e, 12.0, 0.9) for e in (0.05, 0.3, 0.5)] + [figures_of(math.nan)],
        "SMC, default": [figures_of(0.6, stable=False)] * 4,
    }
    elsewhere = {
        name: [figures_of(1.0 + n + 0.1 * k) for k in range(4)] for n, name in enumerate(tested)
    }
    entrants = {name: {"controller": {"kind": "smc"}} for name in tested}
    samples = tuple({"plant.cylinder.mass_kg": 1.5} for _ in range(4))
    return ContestStudy(
        Scenario(),
        UNCERTAINTY,
        ("plant.load.knee_torque_n_m",),
        settings,
        12.0,
        tunings,
        entrants,
        samples,
        tested,
        elsewhere,
    )


SUMMARY = {
    # of four: the second is the median, the last 95 %; a run that failed errs infinitely
    "SMC": (0.2, 0.4, 0.4, 12.5, 14.0, 0.77, 0.76, 0, 0, 0, 1.1, 1.3),
    "PID": (0.3, math.inf, math.inf, 12.0, math.inf, 0.9, 0.8, 0, 0, 1, 2.1, 2.3),
    "SMC, default": (0.6, 0.6, 0.6, 10.0, 10.0, 0.0, 0.0, 4, 0, 0, 3.1, 3.3),
}
"""In the order of `COLUMNS`."""


def test_levels_count_failed_runs_as_infinite_errors(flat, check_rules):
    found = made_up().results()
    check_rules(found)
    expected = {name: dict(zip(COLUMNS, row, strict=True)) for name, row in SUMMARY.items()}
    assert flat(found["summary"]) == pytest.approx(flat(expected))


def test_results_hold_what_was_tuned_and_tested(flat):
    done = made_up()
    found = done.results()
    for own, tuning in zip(found["tunings"], done.tunings, strict=True):
        assert own == vars(tuning) | {"feasible": tuning.objective_deg < 90.0}
    assert found["better_share"] == {
        "SMC": {"SMC": 0.0, "PID": 0.75},
        "PID": {"SMC": 0.25, "PID": 0.0},
    }
    assert found["budget_rpm"] == 12.0
    for name in ("tested", "elsewhere", "entrants"):
        assert flat(dict(found[name])) == pytest.approx(
            flat(dict(getattr(done, name))), nan_ok=True
        )


def test_every_cell_of_the_report_is_in_the_summary(tables, check_cells):
    outcome, tunings = tables(report(made_up()))
    assert outcome[0][1:] == list(SUMMARY)
    check_cells(
        outcome,
        [
            [label, *(row[n] for row in SUMMARY.values())]
            for n, label in enumerate(COLUMNS.values())
        ],
    )
    for name, unit in (("_deg", "(deg)"), ("_rpm", "(rpm/sample)")):
        assert all(label.endswith(unit) for key, label in COLUMNS.items() if key.endswith(name))
    # The gains, last, have a test of their own.
    check_cells(
        [row[:-1] for row in tunings],
        [
            ["SMC", 1.0, 0.3, 64.0, "yes", 0.01],
            ["SMC", 2.0, 0.2, 64.0, "**no**", 0.01],
            ["PID", 1.0, "no feasible gains found", 64.0, "**no**", 0.01],
            ["PID", 2.0, 0.4, 64.0, "yes", 0.01],
        ],
    )


def test_the_outcome_shows_each_entrant_at_its_errors_and_margins(curves):
    done = made_up()
    here, there, margins = figures(done)["contest"].axes
    share = [0.25, 0.5, 0.75, 1.0]
    sorted_errors = {
        "SMC": [0.1, 0.2, 0.3, 0.4],
        "PID": [0.05, 0.3, 0.5, math.nan],
        "SMC, default": [0.6] * 4,
    }
    for n, (name, errors) in enumerate(sorted_errors.items()):
        x, y = curves(here)[name]
        assert x == pytest.approx(errors, nan_ok=True)
        assert y == pytest.approx(share)
        assert there.lines[n].get_xdata() == pytest.approx([1.0 + n + 0.1 * k for k in range(4)])
        assert there.lines[n].get_ydata() == pytest.approx(share)
        x, y = margins.lines[n].get_data()
        assert x == pytest.approx(errors, nan_ok=True)
        expected = [one["disk_margin"] for one in done.tested[name]]
        assert y == pytest.approx(expected, nan_ok=True)
    least = done.settings.least_disk_margin
    (shown,) = (y for label, (_, y) in curves(margins).items() if f"{least:g}" in label)
    assert list(shown) == [least, least]


def test_the_search_shows_the_best_of_each_generation():
    done = made_up()
    (ax,) = figures(done)["contest_search"].axes
    size = done.settings.population
    for line, tuning in zip(ax.lines, done.tunings, strict=True):
        assert line.get_label().startswith(tuning.contestant)
        assert ("not converged" in line.get_label()) is not tuning.converged
        # The first generation follows the population that it starts from.
        assert line.get_xdata() == pytest.approx([2 * size, 3 * size])
        assert line.get_ydata() == pytest.approx([math.nan, 0.5], nan_ok=True)
        assert line.get_linestyle() == ("-" if tuning.seed == 1 else "--")


def test_the_winner_of_each_figure_is_named_whoever_it_is():
    done = made_up()
    winners = done.winners()
    assert winners["median_error_deg"] == ["SMC"]
    assert winners["median_disk_margin"] == ["PID"]
    assert winners["unstable"] == ["SMC", "PID"]
    assert done.better_share("SMC", "PID") == 0.75
    assert done.better_share("PID", "SMC") == 0.25


def test_the_report_says_what_did_not_converge_or_fit():
    text = report(made_up())
    assert "| SMC | 2 | 0.2 | 64 | **no** |" in text
    assert "| PID | 1 | no feasible gains found |" in text
    assert "SMC errs less than PID on 75 % of the plants" in text
    assert "- unstable:" not in text  # nobody was better there
    assert "| worst error (deg) | 0.4 | ∞ |" in text
    assert "∞" in text
    # 0.11 lies within 2 % of the way (a factor of 1.22 of 0.1…2000) of a PID's lowest gains.
    assert "integral_per_s2 = 0.11 (at its bound), derivative = 0.11, filter_s" in text
    assert "The scenario lacks plant.load.knee_torque_n_m." in text


def test_figures_have_labels_and_name_everybody():
    drawn = figures(made_up())
    assert set(drawn) == {"contest", "contest_search"}
    for figure in drawn.values():
        figure.canvas.draw()
        assert all(ax.get_xlabel() and ax.get_ylabel() for ax in figure.axes)
        plt.close(figure)
    legend = [text.get_text() for text in drawn["contest"].legends[0].get_texts()]
    assert legend[:3] == ["SMC", "PID", "SMC, default"]
    assert legend[3:5] == ["(c) tuned here", "(c) not tuned here"]


def test_a_contest_whose_every_run_failed_is_drawn():
    done = made_up()
    failed = {name: [figures_of(math.nan)] * 4 for name in done.tested}
    figure = figures(dataclasses.replace(done, tested=failed, elsewhere=failed))["contest"]
    figure.canvas.draw()
    plt.close(figure)


# -------------------------------------------------------------------------------- the runs

BASE = Scenario(reference=SineReference(amplitude_deg=0.5, frequency_hz=10.0))
MASS = UncertaintySet(values={"plant.cylinder.mass_kg": Uncertainty(low=1.4, high=1.8)})
SMALL = ContestSettings(
    contestants={
        "P": Contestant(
            controller=PidParameters(),
            gains={"controller.proportional_per_s": Uncertainty(low=1.0, high=9.0, scale="log")},
        )
    },
    training_samples=1,
    test_samples=2,
    optimizer_seeds=(1, 2),
    population=5,
    generations=1,
    duration_s=0.2,
    other_reference=SineReference(amplitude_deg=0.2, frequency_hz=20.0),
    other_duration_s=0.1,
)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    checkpoint = Checkpoint(tmp_path_factory.mktemp("contest") / "checkpoint.jsonl")
    return contest_study(BASE, MASS, SMALL, checkpoint=checkpoint), checkpoint


def test_entrants_are_assessed_on_the_test_plants(small):
    done, _ = small
    assert next(iter(done.entrants)) == "P"
    assert len(done.entrants) == 5
    assert len(done.samples) == 2
    mass = done.samples[1]["plant.cylinder.mass_kg"]
    tuning = min(done.tunings, key=lambda one: one.objective_deg)
    assert done.tunings[0].objective_deg != done.tunings[1].objective_deg
    gain = tuning.gains["controller.proportional_per_s"]
    expected = assess(
        Scenario(
            plant={"cylinder": {"mass_kg": mass}},
            nominal={},
            controller={"kind": "pid", "proportional_per_s": gain},
            reference=BASE.reference,
            simulation={"duration_s": 0.2},
        )
    )
    assert done.tested["P"][1] == expected
    assert done.elsewhere["P"][1]["max_error_deg"] != expected["max_error_deg"]


def test_the_budget_is_what_the_default_smc_uses(small):
    done, _ = small
    training = draw(MASS, 1, SMALL.training_seed)[0]["plant.cylinder.mass_kg"]
    changes = [
        assess(
            Scenario(
                plant={"cylinder": {"mass_kg": mass}},
                nominal={},
                reference=BASE.reference,
                simulation={"duration_s": 0.2},
            ),
            margins=False,
        )["mean_command_change_rpm"]
        for mass in (1.6, training)
    ]
    assert done.budget_rpm == pytest.approx(np.mean(changes), rel=1e-12)


def test_a_search_without_enough_generations_is_flagged(small):
    for tuning in small[0].tunings:
        assert tuning.evaluations == 10
        assert tuning.history_deg == (tuning.objective_deg,)  # one generation
        assert not tuning.converged
        assert tuning.spread > SMALL.tolerance
    assert "**no**" in report(small[0])


def test_a_resumed_contest_goes_on_and_gives_the_same(small):
    done, checkpoint = small
    header, *lines = checkpoint.path.read_bytes().splitlines(keepends=True)
    # 2 for the budget, twice 10 evaluations, 5 entrants on 2 plants and 2 tasks.
    assert len(lines) == len(checkpoint) == 42

    cut = checkpoint.path.with_name("cut.jsonl")
    # Interrupted in the second generation of the second search.
    cut.write_bytes(header + b"".join(lines[:19]))
    resumed = contest_study(BASE, MASS, SMALL, checkpoint=Checkpoint(cut))
    assert to_json(resumed.results()) == to_json(done.results())
    assert report(resumed) == report(done)
    assert len(cut.read_bytes().splitlines()) == 1 + 42


# ------------------------------------------------------------------------------- bad input


def test_uncertain_values_without_effect_are_left_out(small):
    done, checkpoint = small
    load = {"plant.load.segment_mass_kg": Uncertainty(low=0.0, high=3.0)}
    more = UncertaintySet(values={**MASS.values, **load})
    again = contest_study(BASE, more, SMALL, checkpoint=Checkpoint(checkpoint.path, resume=True))
    assert again.left_out == ("plant.load.segment_mass_kg",)
    assert again.tested == done.tested


def test_values_that_no_scenario_has_are_one_line():
    wrong = UncertaintySet(values={"plant.cylinder.colour": Uncertainty(low=0.0, high=3.0)})
    with pytest.raises(ParameterError, match=r"colour") as caught:
        contest_study(BASE, wrong, SMALL)
    assert "\n" not in str(caught.value)


def test_a_default_that_fails_sets_no_budget():
    wild = changed(BASE, {"reference.mean_deg": 89.4, "initial_offset_m": -3.5e-3})
    with pytest.raises(SimulationError, match="default SMC sets no budget: t = 0 s") as caught:
        contest_study(wild, MASS, SMALL)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"population": 4}, "population = 4 is out of range"),
        ({"contestants": {}}, "contestants"),
        ({"optimizer_seeds": ()}, "optimizer_seeds"),
        ({"least_disk_margin": 0.0}, "least_disk_margin = 0 is out of range"),
        ({"training_samples": 0}, "training_samples = 0 is out of range"),
    ],
)
def test_settings_out_of_range_are_one_line(values, message):
    with pytest.raises(ParameterError, match=message) as caught:
        ContestSettings(**values)
    assert "\n" not in str(caught.value)


# ------------------------------------------------------------------- the paper's own task


@pytest.mark.slow
def test_tuning_for_the_error_alone_leaves_no_margin_on_uncertain_plants():
    """docs/validation.md, "Fig. 12, fairly": 15° and 7° of phase margin, against 57°."""
    base = changed(UNCERTAIN_KNEE, {"simulation.duration_s": 20.0})
    values = [{}, *draw(UNCERTAINTY, 1, seed=1)]  # reduced order, two samples of latency

    def judge(law):
        entered = base.model_copy(update={"controller": law})
        plants = [realize(entered, UNCERTAINTY, sample) for sample in values]
        return module._judge(15.0, 0.5, plants)

    assert judge(SlidingModeParameters()) < 0.5
    for law in (PID_TUNED, PID_FEEDFORWARD):
        assert INFEASIBLE_DEG < judge(law) < 2.0 * INFEASIBLE_DEG
    assert 3.0 < judge(PID_PAPER) < 5.0
