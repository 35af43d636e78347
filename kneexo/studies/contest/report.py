"""Markdown of `kneexo.studies.contest.study`."""

from __future__ import annotations

from itertools import combinations

from kneexo.parameters import Uncertainty
from kneexo.studies.contest.study import COLUMNS, ContestResult, Tuning
from kneexo.studies.markdown import column_table, document, row_table


def report(study: ContestResult) -> str:
    """The outcome as Markdown."""
    summary, tuned, settings = study.summary(), list(study.settings.contestants), study.settings
    other = settings.other_reference
    lacking = f"The scenario lacks {', '.join(study.left_out)}." if study.left_out else ""
    best = [
        f"- {COLUMNS[figure]}: {', '.join(names)}"
        for figure, names in study.winners().items()
        if len(names) < len(tuned)
    ]
    best += [
        f"- {first} errs less than {second} on "
        f"{100 * study.better_share(first, second):.0f} % of the plants"
        for first, second in combinations(tuned, 2)
    ]
    return document(
        "# SMC against PID on uncertain plants",
        f"{len(study.samples)} test plants, none of which anybody was tuned on. A plant's error is "
        f"the largest after the first period; elsewhere is {other.amplitude_deg:g}° at "
        f"{other.frequency_hz:g} Hz, which nobody was tuned for. A run that failed counts as ∞, an "
        f"unstable loop as no margin. {lacking}",
        column_table(
            list(summary),
            summary.values(),
            {label: (name, ".3g") for name, label in COLUMNS.items()},
        ),
        "Best of the tuned ones:",
        best,
        "## How they were tuned",
        f"Differential evolution on the logarithm of the gains, at most "
        f"{settings.population * (settings.generations + 1)} evaluations each; smallest mean of "
        f"the largest errors on {settings.training_samples + 1} training plants, with at most "
        f"{study.budget_rpm:.1f} rpm per sample on average (the default SMC's) and a disk margin "
        f"of {settings.least_disk_margin:g} or more on each.",
        _tuning_table(study),
    )


def _at_bound(gain: Uncertainty, value: float) -> str:
    """A word when the search would have gone further: within 2 % of its way from an end."""
    ends = (gain.at(0.02), gain.at(0.98))
    return "" if ends[0] < value < ends[1] else " (at its bound)"


def _tuning_table(study: ContestResult) -> list[str]:
    def objective(tuning: Tuning) -> str:
        return f"{tuning.objective_deg:.4g}" if tuning.feasible else "no feasible gains found"

    def gains(tuning: Tuning) -> str:
        bounds = study.settings.contestants[tuning.contestant].gains
        return ", ".join(
            f"{path.split('.')[-1]} = {value:.4g}{_at_bound(bounds[path], value)}"
            for path, value in tuning.gains.items()
        )

    return row_table(
        study.tunings,
        {
            "contestant": "contestant",
            "seed": ("seed", "d"),
            "objective (deg)": objective,
            "evaluations": ("evaluations", "d"),
            "converged": lambda tuning: "yes" if tuning.converged else "**no**",
            "spread": ("spread", ".2g"),
            "gains": gains,
        },
    )
