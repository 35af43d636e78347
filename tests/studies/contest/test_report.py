import math

from contest_cases import (
    made_up,
)

from kneexo.studies.contest.report import report
from kneexo.studies.contest.study import (
    COLUMNS,
)


def said_gains(contest, tuning):
    """Gains as the report has them: a mark on those within 2 % of the way from a bound."""
    texts = []
    for path, value in tuning.gains.items():
        span = contest.settings.contestants[tuning.contestant].gains[path]
        share = math.log(value / span.low) / math.log(span.high / span.low)
        mark = "" if 0.02 < share < 0.98 else " (at its bound)"
        texts.append(f"{path.split('.')[1]} = {value:.4g}{mark}")
    return ", ".join(texts)


def test_every_cell_of_the_report_is_in_the_summary(contest, tables, check_cells):
    text, summary = report(contest), contest.summary()
    outcome, tunings = tables(text)
    assert outcome[0] == ["", *contest.entrants]
    check_cells(
        outcome,
        [[COLUMNS[key], *(summary[name][key] for name in contest.entrants)] for key in COLUMNS],
    )
    for name, unit in (("_deg", "(deg)"), ("_rpm", "(rpm/sample)")):
        assert all(label.endswith(unit) for key, label in COLUMNS.items() if key.endswith(name))
    check_cells(
        tunings,
        [
            {
                "contestant": tuning.contestant,
                "seed": tuning.seed,
                "objective (deg)": tuning.objective_deg
                if tuning.objective_deg < 90.0
                else "no feasible gains found",
                "evaluations": tuning.evaluations,
                "converged": "yes" if tuning.converged else "**no**",
                "spread": tuning.spread,
                "gains": said_gains(contest, tuning),
            }
            for tuning in contest.tunings
        ],
    )
    settings, task = contest.settings, contest.settings.other_reference
    for sentence in (
        f"{len(contest.samples)} test plants, none",
        f"the other reference is {task.amplitude_deg:g}° at {task.frequency_hz:g} Hz, which",
        f"at most {settings.population * settings.generations + settings.population} evaluations",
        f"on {1 + settings.training_samples} training plants",
        f"with at most {contest.budget_rpm:.1f} rpm per sample",
        f"a disk margin of {settings.least_disk_margin:g} or more",
    ):
        assert sentence in text


def test_the_report_says_what_did_not_converge_or_fit():
    text = report(made_up())
    assert "| SMC | 2 | 0.2 | 64 | **no** |" in text
    assert "| PID | 1 | no feasible gains found |" in text
    assert "SMC errs less than PID on 75 % of the plants" in text
    assert "- unstable:" not in text  # nobody was better there
    assert "| worst error (deg) | 0.4 | ∞ |" in text
    assert "∞" in text
    assert "The scenario lacks plant.load.knee_torque_n_m." in text
