"""Markdown report on a `kneexo.studies.contest.contest.ContestResult`."""

from __future__ import annotations

from itertools import combinations

from kneexo.parameters import Scenario, Uncertainty
from kneexo.parameters.labels import labels
from kneexo.parameters.paths import changed
from kneexo.parameters.uncertainty import realize
from kneexo.studies.contest.contest import COLUMNS, ContestResult, Tuning
from kneexo.studies.markdown import number, repeating_commands
from kneexo.studies.template import filled


def report(result: ContestResult) -> str:
    """Return the report on a contest in Markdown."""
    tuned = list(result.settings.contestants)

    def gains(tuning: Tuning) -> str:
        ranges = result.settings.contestants[tuning.contestant].gains
        words = labels(tuning.gains)
        return ", ".join(
            f"{words[path]} = {number(value)}{_at_bound(ranges[path], value)}"
            for path, value in tuning.gains.items()
        )

    summary = result.summary()
    return filled(
        "contest/report.md",
        result=result,
        settings=result.settings,
        left_out=list(labels(result.left_out).values()),
        other=result.settings.other_reference,
        summary=summary,
        rows={label: (name, ".3g") for name, label in COLUMNS.items()},
        summary_rows=[{"name": name} | metrics for name, metrics in summary.items()],
        unconverged=sum(not (t.converged and t.feasible) for t in result.tunings),
        winners={
            COLUMNS[metric]: names
            for metric, names in result.winners().items()
            if len(names) < len(tuned)  # a metric on which all tie has no winner
        },
        pairs=[
            {"first": first, "second": second, "share": result.better_share(first, second)}
            for first, second in combinations(tuned, 2)
        ],
        commands=repeating_commands(failed_runs(result)),
        objective=_objective,
        converged=lambda tuning: "yes" if tuning.converged else "**no**",
        gains=gains,
    )


def failed_runs(result: ContestResult) -> dict[str, Scenario]:
    """Return a dictionary from the text of an error to the scenario of a run that failed with it.

    Each controller adds its first failed run. If two of these runs have the same error, the run of
    the controller that comes first stays.
    """
    base = changed(result.scenario, {"simulation.duration_s": result.settings.duration_s})
    runs: dict[str, Scenario] = {}
    for name, controller_values in result.entrants.items():
        for values, metrics in zip(result.samples, result.tested[name], strict=True):
            if error := metrics["tracking_failure"]:
                run = realize(changed(base, controller_values), result.uncertainty, values)
                runs.setdefault(error, run)
                break
    return runs


def _objective(tuning: Tuning) -> str:
    return f"{tuning.objective_deg:.4g}" if tuning.feasible else "no feasible gains found"


def _at_bound(gain: Uncertainty, value: float) -> str:
    """Return a remark if a gain lies within 2 % of an end of its range, otherwise an empty text."""
    ends = (gain.at(0.02), gain.at(0.98))
    return "" if ends[0] < value < ends[1] else " (at its bound)"
