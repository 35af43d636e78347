"""SMC against PID, fairly: one optimizer, one budget, one set of measurements, many plants.

Lee et al. 2020 compare their sliding-mode controller with one PID on one plant. Here each
contestant is tuned by the same search with the same number of evaluations, on the same encoder, at
the same sample time and speed limit, within the same chattering, and with a margin that it must
keep on every plant it is tuned on: a search for the smallest error alone buys error with margin.
Then all of them meet plants that nobody was tuned on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import OptimizeResult, differential_evolution
from scipy.stats import qmc
from tqdm import tqdm

from kneexo.analysis.assessment import assess
from kneexo.analysis.checkpoint import Checkpoint
from kneexo.analysis.coroutines import Steps, steps
from kneexo.analysis.markdown import markdown_table, number
from kneexo.analysis.parallel import parallel_map, process_pool
from kneexo.analysis.robustness import Values, draw, realize
from kneexo.analysis.simulation import Array, needs_runs
from kneexo.errors import SimulationError
from kneexo.parameters import (
    UNCERTAIN_KNEE,
    UNCERTAINTY,
    UNTUNED,
    Contestant,
    ContestParameters,
    Scenario,
    SlidingModeParameters,
    Uncertainty,
    UncertaintySet,
)
from kneexo.result import Result
from kneexo.scenario import applicable, changed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INFEASIBLE_DEG = 90.0
"""Objective from which on a candidate breaks a constraint: no run inside the range of motion errs
by so much."""


@dataclass(frozen=True)
class Tuning:
    """One search: what it found, and whether it converged.

    ``objective_deg``: mean over the training plants of the largest error, or beyond
    `INFEASIBLE_DEG`. ``history_deg``: the best of each generation. ``spread``: standard deviation
    of the last population's objectives over their mean.
    """

    contestant: str
    seed: int
    gains: Mapping[str, float]
    objective_deg: float
    evaluations: int
    converged: bool
    spread: float
    history_deg: tuple[float, ...]

    @property
    def feasible(self) -> bool:
        """Whether every constraint holds."""
        return self.objective_deg < INFEASIBLE_DEG


@dataclass(frozen=True, repr=False)
class Contest(Result):
    """Tuned and untuned controllers on the test plants.

    ``entrants``: by name, what each sets in the scenario. ``tested`` and ``elsewhere``: by
    entrant, `assess` of each test plant at the scenario's reference and, without margins, at one
    that nobody was tuned for. ``budget_rpm``: mean change of command per sample of the default
    SMC over the training plants.
    """

    scenario: Scenario
    uncertainty: UncertaintySet
    left_out: tuple[str, ...]
    settings: ContestParameters
    budget_rpm: float
    tunings: tuple[Tuning, ...]
    entrants: Mapping[str, Values]
    samples: tuple[Values, ...]
    tested: Mapping[str, Sequence[Values]]
    elsewhere: Mapping[str, Sequence[Values]]

    def summary(self) -> dict[str, dict[str, Any]]:
        """Figures of each entrant over the test plants."""
        return {name: _summary(self.tested[name], self.elsewhere[name]) for name in self.entrants}

    def better_share(self, one: str, other: str) -> float:
        """Share of the test plants on which ``one`` has the smaller largest error."""
        first, second = (errors_of(self.tested[name]) for name in (one, other))
        return float(np.mean(first < second))

    def winners(self) -> dict[str, list[str]]:
        """The tuned contestants with the best value of each figure of `summary`."""
        found, tuned = self.summary(), self.settings.contestants
        best = {
            figure: (max if "margin" in figure else min)(found[name][figure] for name in tuned)
            for figure in COLUMNS
        }
        return {
            figure: [name for name in tuned if found[name][figure] == value]
            for figure, value in best.items()
        }

    def results(self) -> dict[str, Any]:
        """Plain data."""
        tuned = list(self.settings.contestants)
        return {
            "uncertainty": self.uncertainty.model_dump(mode="json")["values"],
            "left_out": self.left_out,
            "settings": self.settings.model_dump(mode="json"),
            "budget_rpm": self.budget_rpm,
            "tunings": [asdict(t) | {"feasible": t.feasible} for t in self.tunings],
            "entrants": self.entrants,
            "summary": self.summary(),
            "winners": self.winners(),
            "better_share": {a: {b: self.better_share(a, b) for b in tuned} for a in tuned},
            "samples": self.samples,
            "tested": self.tested,
            "elsewhere": self.elsewhere,
        }

    def report(self) -> str:
        """The outcome as Markdown."""
        return "\n".join([*_outcome_report(self), *_tuning_report(self)])

    def figures(self) -> dict[str, Figure]:
        """Figures by name; the caller closes them."""
        from kneexo.analysis import contest_figures as plots

        return {"contest": plots.outcome(self), "contest_search": plots.search(self)}


# ------------------------------------------------------------------------------------- runs


def contest(
    scenario: Scenario = UNCERTAIN_KNEE,
    uncertainty: UncertaintySet = UNCERTAINTY,
    settings: ContestParameters = ContestParameters(),
    *,
    workers: int | None = 1,
    executor: Executor | None = None,
    checkpoint: Checkpoint | None = None,
    progress: bool = False,
) -> Contest:
    """Tune every contestant, then test all; ``workers``, ``executor``: see `parallel_map`.

    The controller of ``scenario`` is replaced, and uncertain values that it does not have are left
    out. With a ``checkpoint`` every evaluation is kept, and a search that goes on replays what it
    has. A search that did not converge is no error: `Tuning` says so.

    Raises `ParameterError` for uncertain values that no scenario has, that are out of range, and
    when none of them applies; `SimulationError` when the default SMC fails on a training plant,
    because it then gives no budget.
    """
    if executor is None and workers != 1:
        with process_pool(workers) as pool:
            return contest(
                scenario,
                uncertainty,
                settings,
                executor=pool,
                checkpoint=checkpoint,
                progress=progress,
            )

    def run(function: Any, items: Sequence[Any], what: str = "") -> list[Any]:
        return parallel_map(
            function,
            items,
            executor=executor,
            description=what if progress and what else None,
            checkpoint=checkpoint,
        )

    uncertainty, left_out = applicable(scenario, uncertainty)
    base = changed(scenario, {"simulation.duration_s": settings.duration_s})
    training = [{}, *draw(uncertainty, settings.training_samples, settings.training_seed)]

    def plants(entrant: Values, samples: Iterable[Values] = training) -> list[Scenario]:
        entered = changed(base, entrant)
        return [realize(entered, uncertainty, values) for values in samples]

    untuned: dict[str, Values] = {
        name: {"controller": law.model_dump()} for name, law in UNTUNED.items()
    }
    default = plants({"controller": SlidingModeParameters().model_dump()})
    changes = run(partial(assess, margins=False), default, "budget of chattering")
    for values in changes:
        if values["tracking_failure"]:
            raise SimulationError(f"the default SMC sets no budget: {values['tracking_failure']}")
    budget = float(np.mean([values["mean_command_change_rpm"] for values in changes]))
    judge = partial(_judge, budget, settings.least_disk_margin)

    def tune(name: str, seed: int) -> Tuning:
        contestant = settings.contestants[name]
        size = settings.population * (settings.generations + 1)
        with tqdm(total=size, desc=f"{name}, seed {seed}", disable=not progress) as bar:

            def objective(units: Array) -> Array:
                items = [plants(_entrant(contestant, _gains(contestant, unit))) for unit in units]
                bar.update(len(items))
                return np.array(run(judge, items))

            found, history = search(objective, len(contestant.gains), settings, seed)
        energies = found.population_energies
        return Tuning(
            name,
            seed,
            gains=_gains(contestant, found.x),
            objective_deg=float(found.fun),
            evaluations=settings.population * (int(found.nit) + 1),
            converged=bool(found.success) and found.fun < INFEASIBLE_DEG,
            spread=float(np.std(energies) / np.mean(energies)),
            history_deg=tuple(history),
        )

    tunings = tuple(
        tune(name, seed) for name in settings.contestants for seed in settings.optimizer_seeds
    )
    best = {
        name: min((t for t in tunings if t.contestant == name), key=lambda t: t.objective_deg)
        for name in settings.contestants
    }
    entrants: dict[str, Values] = {
        name: _entrant(contestant, best[name].gains)
        for name, contestant in settings.contestants.items()
    } | untuned
    samples = draw(uncertainty, settings.test_samples, settings.test_seed)
    task = {
        "reference": settings.other_reference.model_dump(),
        "simulation.duration_s": settings.other_duration_s,
    }
    test = [plant for entrant in entrants.values() for plant in plants(entrant, samples)]
    tested = run(assess, test, "test")
    elsewhere = run(
        partial(assess, margins=False), [changed(plant, task) for plant in test], "another task"
    )

    def by_entrant(found: list[Values]) -> dict[str, list[Values]]:
        n = len(samples)
        return {name: found[i * n : (i + 1) * n] for i, name in enumerate(entrants)}

    return Contest(
        scenario,
        uncertainty,
        tuple(left_out),
        settings,
        budget,
        tunings,
        entrants,
        tuple(samples),
        tested=by_entrant(tested),
        elsewhere=by_entrant(elsewhere),
    )


def search(
    objective: Callable[[Array], Array], dimensions: int, settings: ContestParameters, seed: int
) -> tuple[OptimizeResult, list[float]]:
    """Differential evolution over the unit cube; its result and the best of each generation.

    ``objective`` maps candidates (n, dimensions) to (n,). It has converged (``success``) when the
    population's objectives spread by less than ``settings.tolerance`` of their mean.
    """
    history: list[float] = []

    def note(intermediate_result: OptimizeResult) -> None:
        history.append(float(intermediate_result.fun))

    found = differential_evolution(
        lambda candidates: objective(candidates.T),
        [(0.0, 1.0)] * dimensions,
        init=qmc.LatinHypercube(dimensions, seed=seed).random(settings.population),
        seed=seed,
        maxiter=settings.generations,
        tol=settings.tolerance,
        atol=0.0,
        polish=False,
        updating="deferred",
        vectorized=True,
        callback=note,
    )
    return found, history


@needs_runs
def _judge(budget_rpm: float, least_disk_margin: float, plants: Sequence[Scenario]) -> Steps[float]:
    """Objective of one candidate on its training plants, in deg.

    The mean of the largest errors. A run that fails or too much chattering makes it more than
    2·`INFEASIBLE_DEG`, too little margin on any plant more than `INFEASIBLE_DEG`; both grow with
    the violation. An unstable loop has no margin.
    """
    tracked = []
    for plant in plants:
        tracked.append((yield from steps(assess, plant, margins=False)))
    failed = np.mean([bool(values["tracking_failure"]) for values in tracked])
    if failed > 0.0:
        return float(INFEASIBLE_DEG * (3.0 + failed))
    change = np.mean([values["mean_command_change_rpm"] for values in tracked])
    if change > budget_rpm:
        return float(INFEASIBLE_DEG * (3.0 - budget_rpm / change))
    linear = [assess(plant, tracking=False) for plant in plants]
    margin = np.nan_to_num([values["disk_margin"] for values in linear])
    missing = np.mean(np.maximum(0.0, 1.0 - margin / least_disk_margin))
    if missing > 0.0:
        return float(INFEASIBLE_DEG * (1.0 + missing))
    return float(np.mean([values["max_error_deg"] for values in tracked]))


def _gains(contestant: Contestant, unit: Array) -> dict[str, float]:
    """Gains at a point of the unit cube."""
    return {
        path: float(one.at(float(x)))
        for (path, one), x in zip(contestant.gains.items(), unit, strict=True)
    }


def _entrant(contestant: Contestant, gains: Values) -> dict[str, Any]:
    return {"controller": contestant.controller.model_dump(), **gains}


# ---------------------------------------------------------------------------------- summary


def errors_of(found: Sequence[Values], name: str = "max_error_deg") -> Array:
    """One figure of every plant (n,); inf where the run failed."""
    return np.array([math.inf if math.isnan(v[name]) else v[name] for v in found])


def _level(values: Array, share: float) -> float:
    """The value that ``share`` of ``values`` (n,) do not exceed, itself one of them."""
    return float(np.quantile(values, share, method="inverted_cdf"))


def _summary(tested: Sequence[Values], elsewhere: Sequence[Values]) -> dict[str, Any]:
    errors, other = errors_of(tested), errors_of(elsewhere)
    changes = errors_of(tested, "mean_command_change_rpm")
    margins = np.nan_to_num([values["disk_margin"] for values in tested])
    return {
        "median_error_deg": _level(errors, 0.5),
        "error_of_95_percent_deg": _level(errors, 0.95),
        "worst_error_deg": float(np.max(errors)),
        "mean_command_change_rpm": float(np.mean(changes[np.isfinite(changes)], dtype=float)),
        "worst_command_change_rpm": float(np.max(changes)),
        "median_disk_margin": _level(margins, 0.5),
        "least_disk_margin": float(np.min(margins)),
        "unstable": sum(values["stable"] is False for values in tested),
        "not_linearized": sum(bool(values["margins_failure"]) for values in tested),
        "failed_runs": int(np.count_nonzero(np.isinf(errors))),
        "median_error_elsewhere_deg": _level(other, 0.5),
        "error_of_95_percent_elsewhere_deg": _level(other, 0.95),
    }


COLUMNS = {
    "median_error_deg": "median error (deg)",
    "error_of_95_percent_deg": "95 % error (deg)",
    "worst_error_deg": "worst error (deg)",
    "mean_command_change_rpm": "command change (rpm/sample)",
    "worst_command_change_rpm": "worst command change (rpm/sample)",
    "median_disk_margin": "median disk margin",
    "least_disk_margin": "least disk margin",
    "unstable": "unstable",
    "not_linearized": "no linear loop found",
    "failed_runs": "failed runs",
    "median_error_elsewhere_deg": "median error elsewhere (deg)",
    "error_of_95_percent_elsewhere_deg": "95 % error elsewhere (deg)",
}


# ----------------------------------------------------------------------------------- report


def _outcome_report(done: Contest) -> list[str]:
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


def _tuning_report(done: Contest) -> list[str]:
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
