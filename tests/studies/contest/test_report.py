import dataclasses

from contest_cases import (
    made_up,
)

from kneexo.parameters.paths import changed
from kneexo.parameters.uncertainty import realize
from kneexo.studies.contest.contest import (
    CONTESTANTS,
    UNTUNED,
    ContestSettings,
)
from kneexo.studies.contest.report import failed_runs, report


def test_the_screen_holds_all_contestants_of_the_default_settings(check_screen):
    small = made_up()
    names = [*CONTESTANTS, *UNTUNED]
    tested = dict.fromkeys(names, small.tested["SMC"])
    contest = dataclasses.replace(
        small,
        settings=ContestSettings(),
        tunings=small.tunings[:1],
        entrants={name: {} for name in names},
        tested=tested,
        other_reference=tested,
    )
    first_cells = [line.strip().partition("  ")[0] for line in check_screen(report(contest))]
    cells = [cell for cell in first_cells if cell and any(name.startswith(cell) for name in names)]
    for name, cell in zip(names, cells, strict=True):
        assert name.startswith(cell)  # some versions of rich break the longest name


def test_tunings_without_convergence_or_feasible_gains_are_counted():
    small = made_up()
    well = dataclasses.replace(small.tunings[0], converged=True, objective_deg=0.3)
    slow = dataclasses.replace(well, converged=False)
    infeasible = dataclasses.replace(well, objective_deg=small.tunings[2].objective_deg)
    assert (well.feasible, infeasible.feasible) == (True, False)
    for tunings, line in (
        ((well, slow, well, infeasible, slow), "- 3 of 5 tunings did not converge or found no"),
        ((well, infeasible), "- 1 of 2 tunings did not converge or found no"),
    ):
        assert line in report(dataclasses.replace(small, tunings=tunings))
    text = report(dataclasses.replace(small, tunings=(well, well)))
    assert "did not converge" not in text.partition("\n## ")[0]


def test_the_first_failed_run_of_each_controller_is_repeated_by_a_command():
    contest = made_up()
    well = [metrics | {"tracking_failure": ""} for metrics in next(iter(contest.tested.values()))]
    tested = dict.fromkeys(contest.entrants, well)
    assert failed_runs(dataclasses.replace(contest, tested=tested)) == {}
    assert "kneexo simulate" not in report(dataclasses.replace(contest, tested=tested))
    for name, failing in (("PID", (1, 2)), ("SMC", (2,))):
        tested[name] = [
            metrics | {"tracking_failure": f"{name} on {n}" if n in failing else ""}
            for n, metrics in enumerate(well)
        ]
    contest = dataclasses.replace(contest, tested=tested)
    duration = {"simulation.duration_s": contest.settings.duration_s}
    expected = {
        f"{name} on {n}": realize(
            changed(contest.scenario, contest.entrants[name] | duration),
            contest.uncertainty,
            contest.samples[n],
        )
        for name, n in (("SMC", 2), ("PID", 1))
    }
    assert list(failed_runs(contest).items()) == list(expected.items())
    text = report(contest)
    assert text.count("Failed runs, the first of each controller:\n") == 1
    assert "- SMC on 2 (repeat: `kneexo simulate failure_1.yaml --out failure_1`)\n" in text
    assert "- PID on 1 (repeat: `kneexo simulate failure_2.yaml --out failure_2`)\n" in text
