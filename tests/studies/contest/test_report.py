import dataclasses
import math

from contest_cases import (
    made_up,
)

from kneexo.parameters.paths import changed
from kneexo.parameters.uncertainty import realize
from kneexo.studies.contest.report import failed_runs, report
from kneexo.studies.contest.study import (
    COLUMNS,
    CONTESTANTS,
    UNTUNED,
    ContestSettings,
)

GAINS = {
    "lambda_per_s": "λ (1/s)",
    "phi_m_s2": "Φ (m/s²)",
    "eta_m_s3": "η (m/s³)",
    "time_constant_s": "time constant (s)",
    "proportional_per_s": "proportional (1/s)",
    "integral_per_s2": "integral (1/s²)",
    "derivative": "derivative",
    "filter_s": "filter (s)",
}
"""Words of the gains, by name."""


def said_gains(contest, tuning):
    """Gains as the report has them: a mark on those within 2 % of the way from a bound."""
    texts = []
    for path, value in tuning.gains.items():
        span = contest.settings.contestants[tuning.contestant].gains[path]
        share = math.log(value / span.low) / math.log(span.high / span.low)
        mark = "" if 0.02 < share < 0.98 else " (at its bound)"
        text = f"{value:.3g}"
        text = f"{float(text):.0f}" if "e+" in text and value < 1e6 else text
        texts.append(f"{GAINS[path.split('.')[1]]} = {text}{mark}")
    return ", ".join(texts)


def test_every_cell_of_the_report_is_in_the_summary(contest, tables, check_cells):
    text, summary = report(contest), contest.summary()
    findings, outcome, tunings = tables(text)
    names = ("median_error_deg", "error_of_95_percent_deg", "worst_error_deg")
    names += ("worst_command_change_rpm", "least_disk_margin", "unstable", "failed_runs")
    check_cells(
        findings, [[entrant, *(row[name] for name in names)] for entrant, row in summary.items()]
    )
    assert findings[0][1:] == [
        *("median", "95 %", "worst", "command", "margin"),
        *("unstable", "failed"),
    ]
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
        f"least disk margin on {len(contest.samples)} new plants:",
        f"margin ≥ {settings.least_disk_margin:g}): {', '.join(settings.contestants)}.",
        f"No controller was tuned on the {len(contest.samples)} test plants.",
        f"The other reference has {task.amplitude_deg:g}° at {task.frequency_hz:g} Hz, and",
        f"at most {settings.population * settings.generations + settings.population} evaluations",
        f"on {1 + settings.training_samples} training plants",
        f"with at most {contest.budget_rpm:.1f} rpm per sample",
        f"a disk margin of {settings.least_disk_margin:g} or more",
    ):
        assert sentence in text


def test_the_screen_has_the_findings(contest, check_screen):
    lines = check_screen(report(contest))
    if len(contest.settings.contestants) > 1:
        assert lines[2] == "SMC has a smaller error than PID on 75 % of the plants."


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
    assert [cell for cell in first_cells if cell in names] == names


def test_the_report_says_what_did_not_converge_or_fit():
    text = report(made_up())
    assert "2 of 4 tunings did not converge or found no feasible gains" in text
    assert "| SMC | 2 | 0.2 | 64 | **no** |" in text
    assert "| PID | 1 | no feasible gains found |" in text
    assert "SMC has a smaller error than PID on 75 % of the plants." in text
    assert "- unstable:" not in text  # nobody was better there
    assert "| worst error (deg) | 0.4 | ∞ |" in text
    assert "∞" in text
    assert "are left out: knee torque (N·m)." in " ".join(text.split())


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
