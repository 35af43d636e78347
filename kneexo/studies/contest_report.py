"""Markdown of `kneexo.studies.contest`."""

from __future__ import annotations

from kneexo.parameters import Uncertainty
from kneexo.studies.contest import COLUMNS, ContestStudy
from kneexo.studies.markdown import markdown_table, number


def report(study: ContestStudy) -> str:
    """The outcome as Markdown."""
    return "\n".join([*_outcome_report(study), *_tuning_report(study)])


def _outcome_report(done: ContestStudy) -> list[str]:
    found, tuned = done.summary(), list(done.settings.contestants)
    other = done.settings.other_reference
    lacking = f"The scenario lacks {', '.join(done.left_out)}." if done.left_out else ""
    lines = [
        "# SMC against PID on uncertain plants",
        "",
        f"{len(done.samples)} test plants, none of which anybody was tuned on. A plant's error is "
        f"the largest after the first period; elsewhere is {other.amplitude_deg:g}° at "
        f"{other.frequency_hz:g} Hz, which nobody was tuned for. A run that failed counts as ∞, an "
        f"unstable loop as no margin. {lacking}",
        "",
        *markdown_table(
            ["", *found],
            [
                [label, *(number(own[figure]) for own in found.values())]
                for figure, label in COLUMNS.items()
            ],
        ),
        "",
        "Best of the tuned ones:",
        "",
    ]
    lines += [
        f"- {COLUMNS[figure]}: {', '.join(names)}"
        for figure, names in done.winners().items()
        if len(names) < len(tuned)
    ]
    lines += [
        f"- {one} errs less than {other_name} on "
        f"{100 * done.better_share(one, other_name):.0f} % of the plants"
        for n, one in enumerate(tuned)
        for other_name in tuned[n + 1 :]
    ]
    return [*lines, ""]


def _at_bound(gain: Uncertainty, value: float) -> str:
    """A word when the search would have gone further: within 2 % of its way from an end."""
    ends = (gain.at(0.02), gain.at(0.98))
    return "" if ends[0] < value < ends[1] else " (at its bound)"


def _tuning_report(done: ContestStudy) -> list[str]:
    settings = done.settings
    lines = [
        "## How they were tuned",
        "",
        f"Differential evolution on the logarithm of the gains, at most "
        f"{settings.population * (settings.generations + 1)} evaluations each; smallest mean of "
        f"the largest errors on {settings.training_samples + 1} training plants, with at most "
        f"{done.budget_rpm:.1f} rpm per sample on average (the default SMC's) and a disk margin "
        f"of {settings.least_disk_margin:g} or more on each.",
        "",
        "| contestant | seed | objective (deg) | evaluations | converged | spread | gains |",
        "|---|---|---|---|---|---|---|",
    ]
    for tuning in done.tunings:
        bounds = settings.contestants[tuning.contestant].gains
        gains = ", ".join(
            f"{path.split('.')[-1]} = {value:.4g}{_at_bound(bounds[path], value)}"
            for path, value in tuning.gains.items()
        )
        objective = f"{tuning.objective_deg:.4g}" if tuning.feasible else "no feasible gains found"
        lines.append(
            f"| {tuning.contestant} | {tuning.seed} | {objective} | {tuning.evaluations} "
            f"| {'yes' if tuning.converged else '**no**'} | {tuning.spread:.2g} | {gains} |"
        )
    return [*lines, ""]
