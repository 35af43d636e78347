"""Compare SMC with PID, tuned alike: the same optimizer, budget, measurements and plants.

Lee et al. 2020 compare their sliding-mode controller with one PID on one plant. Here the same
search tunes each contestant, with the same budget of evaluations, encoder, sample time, speed limit
and chattering. Each contestant must keep a stability margin on every training plant, because a
search for the smallest error alone gives up margin. The contest is decided on test plants that were
not used for tuning.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Annotated, Any, Unpack

import numpy as np
import scipy
from pydantic import Field

from kneexo.common.progress import progress_bar
from kneexo.common.result import Array, Result
from kneexo.errors import ParameterError, SimulationError
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
from kneexo.parameters.criteria import SOUND_DISK_MARGIN
from kneexo.parameters.fields.quantity import Parameters, quantities, quantity
from kneexo.parameters.paths import changed
from kneexo.parameters.uncertainty import applicable, draw, realize
from kneexo.simulation import needs_runs
from kneexo.studies.assessment import assess
from kneexo.studies.paper import PID_FEEDFORWARD, PID_PAPER, PID_TUNED
from kneexo.studies.robustness.robustness import Values
from kneexo.sweeps import Sweep, SweepOptions, open_sweep

_WIDE = "assumption: wide enough that the optimum lies inside"
_TIMES_S = 0.002, 0.1, _WIDE + "; not below one sample"


def _search_range(low: float, high: float, source: str = _WIDE) -> Uncertainty:
    return Uncertainty(low=low, high=high, scale="log", source=source)


class Contestant(Parameters):
    """A controller to tune. ``gains`` maps a gain's dotted path to the range that is searched."""

    controller: Annotated[SlidingModeParameters | PidParameters, Field(discriminator="kind")]
    gains: dict[str, Uncertainty] = Field(min_length=1)


_PID_GAINS = {
    "controller.proportional_per_s": _search_range(0.1, 100.0),
    "controller.integral_per_s2": _search_range(0.1, 2000.0),
    "controller.derivative": _search_range(1e-4, 1.0, _WIDE + "; the lowest is none"),
    "controller.filter_s": _search_range(*_TIMES_S),
}

CONTESTANTS = {
    "SMC": Contestant(
        controller=SlidingModeParameters(),
        gains={
            "controller.lambda_per_s": _search_range(2.0, 200.0),
            "controller.phi_m_s2": _search_range(0.1, 100.0),
            "controller.eta_m_s3": _search_range(1e4, 1e7),
            "estimator.time_constant_s": _search_range(*_TIMES_S),
        },
    ),
    "PID": Contestant(controller=PidParameters(), gains=_PID_GAINS),
    "PID with reference velocity": Contestant(
        controller=PidParameters(velocity_feedforward=1.0), gains=_PID_GAINS
    ),
}
"""The controllers that are tuned by default. Each controller has four gains."""

UNTUNED = {
    "SMC, default": SlidingModeParameters(),
    "PID as in the paper": PID_PAPER,
    "PID, error only": PID_TUNED,
    "PID with reference velocity, error only": PID_FEEDFORWARD,
}
"""Controllers that are tested without tuning: the default SMC, the paper's PID, and two other PIDs.

``benchmarks/tune_pid.py`` tuned the two other PIDs for the error of Fig. 12 alone.
"""


class ContestSettings(Parameters):
    """Settings of the tuning and of the test. All contestants have the same tuning budget."""

    contestants: dict[str, Contestant] = Field(default=CONTESTANTS, min_length=1)
    training_samples: int = quantity(
        6,
        "1",
        "assumption: of the uncertainty, beside the nominal plant; each costs a run "
        "in every evaluation",
        ge=1,
        le=10_000,
    )
    training_seed: int = quantity(1, "1", "assumption: any number", ge=0)
    test_samples: int = quantity(
        200, "1", "assumption: the 95 % level then stands on ten samples", ge=1, le=100_000
    )
    test_seed: int = quantity(2, "1", "assumption: any other number", ge=0)
    optimizer_seeds: tuple[int, ...] = quantities(
        (1, 2), "1", "assumption: two searches that end alike have converged", ge=0
    )
    population: int = quantity(32, "1", "assumption: eight for each gain", ge=5, le=10_000)
    generations: int = quantity(
        60, "1", "assumption: the most; the budget of each", ge=1, le=100_000
    )
    tolerance: float = quantity(
        0.05,
        "1",
        "assumption: spread of the population's objectives, relative to their mean, at which a "
        "search has converged",
        ge=1e-6,
        le=1,
    )
    least_disk_margin: float = quantity(
        SOUND_DISK_MARGIN,
        "1",
        "assumption: gain by a factor of 0.6…1.67 and phase by 28°, alone, on every training plant",
        ge=1e-3,
        le=2,
    )
    duration_s: float = quantity(
        20.0, "s", "assumption: two periods of 0.1 Hz, of which the second counts", ge=1e-3, le=1e5
    )
    other_reference: SineReference = SineReference(amplitude_deg=2.5, frequency_hz=1.0)
    """A reference that was not used for tuning, slow enough for the motor's speed limit."""
    other_duration_s: float = quantity(5.0, "s", "assumption: five of its periods", ge=0.01, le=1e5)


INFEASIBLE_DEG = 90.0
"""Least objective in deg of gains that violate a constraint of the tuning.

The largest error of a run inside the range of motion is always smaller.
"""


@dataclass(frozen=True)
class Tuning:
    """The best gains that one search found for a contestant, and whether the search converged.

    ``objective_deg`` is the largest error of a run in deg, averaged over the training plants. The
    objective exceeds `INFEASIBLE_DEG` if the gains violate a constraint. ``history_deg`` has the
    best objective of each generation. ``spread`` is the standard deviation of the last population's
    objectives divided by their mean.
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
        """True if the best gains violate no constraint (no failed run, chattering, disk margin)."""
        return self.objective_deg < INFEASIBLE_DEG


@dataclass(frozen=True, repr=False)
class ContestResult(Result):
    """Metrics of tuned and untuned controllers on the test plants.

    ``entrants`` maps a controller's name to a dictionary of the values, with dotted paths, that
    put this controller into the scenario. ``tested`` maps the name to the metrics of each test
    plant from `assess`, at the scenario's reference. ``other_reference`` has the same metrics,
    without margins, at a reference that was not used for tuning. ``budget_rpm`` is the largest
    chattering that the tuning allows: the default SMC's mean change of command in rpm per sample
    over the training plants.
    """

    scenario: Scenario
    uncertainty: UncertaintySet
    left_out: tuple[str, ...]
    settings: ContestSettings
    budget_rpm: float
    tunings: tuple[Tuning, ...]
    entrants: Mapping[str, Values]
    samples: tuple[Values, ...]
    tested: Mapping[str, Sequence[Values]]
    other_reference: Mapping[str, Sequence[Values]]

    def summary(self) -> dict[str, dict[str, Any]]:
        """Return a dictionary from each controller's name to its metrics over all test plants.

        `COLUMNS` lists the metrics.
        """
        return {
            name: _summary(self.tested[name], self.other_reference[name]) for name in self.entrants
        }

    def better_share(self, name: str, other: str) -> float:
        """Return the share of the test plants on which ``name`` has less error than ``other``."""
        return float(np.mean(errors_of(self.tested[name]) < errors_of(self.tested[other])))

    def winners(self) -> dict[str, list[str]]:
        """Return a dictionary from each metric of `summary` to the tuned contestants that lead."""
        summary, tuned = self.summary(), self.settings.contestants
        best = {
            figure: (max if "margin" in figure else min)(summary[name][figure] for name in tuned)
            for figure in COLUMNS
        }
        return {
            figure: [name for name in tuned if summary[name][figure] == value]
            for figure, value in best.items()
        }

    def results(self) -> dict[str, Any]:
        """Return the whole result as plain data, with units in the names."""
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
            "other_reference": self.other_reference,
        }


# ------------------------------------------------------------------------------------- runs


def contest_study(
    scenario: Scenario = UNCERTAIN_KNEE,
    uncertainty: UncertaintySet = UNCERTAINTY,
    settings: ContestSettings = ContestSettings(),
    **options: Unpack[SweepOptions],
) -> ContestResult:
    """Tune controllers on some plants, and test tuned and untuned controllers on other plants.

    A resumed contest repeats its searches but reads finished runs from the checkpoint. If a search
    does not converge, no error is raised, and ``Tuning.converged`` is False.

    Parameters
    ----------
    scenario
        The scenario, whose controller the contest replaces.
    uncertainty
        Uncertain values of the training and test plants. Values that the scenario lacks are
        ignored.
    settings
        Contestants, number of plants, seeds and bounds of the searches.
    options
        Workers, checkpoint and progress: see `kneexo.sweeps.SweepOptions`.

    Raises
    ------
    ParameterError
        An uncertain value does not exist in any scenario, or is out of range. ``scenario`` has none
        of the uncertain values. The controller is a law of the user.
    SimulationError
        The default SMC fails on a training plant. The chattering of the default SMC is the
        budget of the tuning.
    """
    with open_sweep(**options) as sweep:
        return _contest(scenario, uncertainty, settings, sweep)


def _contest(
    scenario: Scenario, uncertainty: UncertaintySet, settings: ContestSettings, sweep: Sweep
) -> ContestResult:
    if scenario.controller.kind == "law":
        raise ParameterError(
            "controller.kind = law: the contest replaces the controller by "
            "SMC and PID; the tutorial 'A fair contest' tunes and compares a law of the user"
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
    default_smc = plants({"controller": SlidingModeParameters().model_dump()})
    without_margins = partial(assess, margins=False)
    default_metrics = sweep.map(without_margins, default_smc, "budget of chattering")
    for metrics in default_metrics:
        if metrics["tracking_failure"]:
            raise SimulationError(f"the default SMC sets no budget: {metrics['tracking_failure']}")
    budget_rpm = float(np.mean([m["mean_command_change_rpm"] for m in default_metrics]))
    judge = partial(objective_deg, budget_rpm, settings.least_disk_margin)

    searches = [(name, seed) for name in settings.contestants for seed in settings.optimizer_seeds]
    evaluations = len(searches) * settings.population * (settings.generations + 1)
    with progress_bar(evaluations, "tuning" if sweep.progress else None) as bar:

        def judged(entrants: Sequence[Values], most_deg: Array) -> Array:
            candidates = map(Candidate, map(plants, entrants), most_deg.tolist())
            result = np.array(sweep.map(judge, list(candidates)))
            bar.update(len(entrants))
            return result

        tunings = tuple(_tune(name, seed, settings, judged) for name, seed in searches)
    best = {
        name: min((t for t in tunings if t.contestant == name), key=lambda t: t.objective_deg)
        for name in settings.contestants
    }
    entrants: dict[str, Values] = {
        name: _entrant(contestant, best[name].gains)
        for name, contestant in settings.contestants.items()
    } | untuned
    samples = draw(uncertainty, settings.test_samples, settings.test_seed)
    test_plants = [plant for entrant in entrants.values() for plant in plants(entrant, samples)]
    tested = sweep.map(assess, test_plants, "test")
    other_task = {
        "reference": settings.other_reference.model_dump(),
        "simulation.duration_s": settings.other_duration_s,
    }
    at_other_reference = [changed(plant, other_task) for plant in test_plants]
    other_reference = sweep.map(without_margins, at_other_reference, "other reference")

    def by_entrant(metrics: Sequence[Values]) -> dict[str, Sequence[Values]]:
        n = len(samples)
        return {name: metrics[i * n : (i + 1) * n] for i, name in enumerate(entrants)}

    return ContestResult(
        scenario,
        uncertainty,
        tuple(left_out),
        settings,
        budget_rpm,
        tunings,
        entrants,
        tuple(samples),
        tested=by_entrant(tested),
        other_reference=by_entrant(other_reference),
    )


def _tune(
    name: str,
    seed: int,
    settings: ContestSettings,
    objectives_deg: Callable[[Sequence[Values], Array], Array],
) -> Tuning:
    """Search for the best gains of the contestant ``name``.

    ``objectives_deg`` returns the objective of each entrant in a list, or a lower bound of an
    objective that exceeds the second argument.
    """
    contestant = settings.contestants[name]

    def objective(units: Array, most_deg: Array) -> Array:
        entrants = [_entrant(contestant, _gains(contestant, unit)) for unit in units]
        return objectives_deg(entrants, most_deg)

    optimum, history = search(objective, len(contestant.gains), settings, seed)
    last_objectives = optimum.population_energies
    return Tuning(
        name,
        seed,
        gains=_gains(contestant, optimum.x),
        objective_deg=float(optimum.fun),
        evaluations=settings.population * (int(optimum.nit) + 1),
        converged=bool(optimum.success) and optimum.fun < INFEASIBLE_DEG,
        spread=float(np.std(last_objectives) / np.mean(last_objectives)),
        history_deg=tuple(history),
    )


def search(
    objective: Callable[[Array, Array], Array],
    dimensions: int,
    settings: ContestSettings,
    seed: int,
) -> tuple[scipy.optimize.OptimizeResult, list[float]]:
    """Minimize an objective over the unit cube by differential evolution.

    ``objective`` maps n candidates (n, dimensions) to their objectives (n,). The second argument
    (n,) has the objectives of their parents, as far as they are known, and otherwise inf. A larger
    objective need not be exact, because the candidate then does not replace its parent. Returns
    SciPy's result and the best objective of each generation. SciPy's ``success`` is True if the
    search converged: the standard deviation of the last population's objectives, divided by their
    mean, is below ``settings.tolerance``.
    """
    history: list[float] = []
    parents = np.full(settings.population, math.inf)  # SciPy tells them after each generation

    def note(intermediate_result: scipy.optimize.OptimizeResult) -> None:
        history.append(float(intermediate_result.fun))
        parents[:] = intermediate_result.population_energies

    optimum = scipy.optimize.differential_evolution(
        lambda candidates: objective(candidates.T, parents),
        [(0.0, 1.0)] * dimensions,
        init=scipy.stats.qmc.LatinHypercube(dimensions, seed=seed).random(settings.population),
        seed=seed,
        maxiter=settings.generations,
        tol=settings.tolerance,
        atol=0.0,
        polish=False,
        updating="deferred",
        vectorized=True,
        callback=note,
    )
    return optimum, history


@dataclass(frozen=True)
class Candidate:
    """A controller on each training plant, and the largest objective in deg that matters.

    A candidate replaces its parent in the search if its objective is at most that of the parent.
    """

    plants: Sequence[Scenario]
    most_deg: float = math.inf


@needs_runs
def objective_deg(budget_rpm: float, least_disk_margin: float, candidate: Candidate) -> float:
    """Return the objective of a candidate: its largest error in deg, averaged over its plants.

    A candidate that violates a constraint gets a larger objective, which grows with the violation.
    The objective exceeds 3·`INFEASIBLE_DEG` if a run fails, 2·`INFEASIBLE_DEG` with too much
    chattering, and `INFEASIBLE_DEG` with too little margin on any plant. The margin of an unstable
    loop counts as zero.

    An analysis of one more plant never makes the objective smaller. So the analyses end as soon as
    the objective exceeds ``candidate.most_deg``. The result is then a lower bound of the objective.
    """
    tracked: list[Values] = []
    linear: list[Values] = []
    count = len(candidate.plants)

    def objective() -> float:
        """Return the objective as if all plants without an analysis had zero error."""
        failed_share = np.sum([bool(values["tracking_failure"]) for values in tracked]) / count
        if failed_share > 0.0:
            return float(INFEASIBLE_DEG * (3.0 + failed_share))
        change_rpm = np.sum([values["mean_command_change_rpm"] for values in tracked]) / count
        if change_rpm > budget_rpm:
            return float(INFEASIBLE_DEG * (3.0 - budget_rpm / change_rpm))
        margins = np.nan_to_num([values["disk_margin"] for values in linear])
        missing_share = np.sum(np.maximum(0.0, 1.0 - margins / least_disk_margin)) / count
        if missing_share > 0.0:
            return float(INFEASIBLE_DEG * (1.0 + missing_share))
        return float(np.sum([values["max_error_deg"] for values in tracked]) / count)

    for plant in candidate.plants:
        if objective() <= candidate.most_deg:
            tracked.append(assess(plant, margins=False))
    # Last, because a linear loop takes twice as long as a run, and some runs alone decide.
    most_deg = min(candidate.most_deg, 2.0 * INFEASIBLE_DEG)
    for plant in candidate.plants:
        if objective() <= most_deg:
            linear.append(assess(plant, tracking=False))
    return objective()


def _gains(contestant: Contestant, unit: Array) -> dict[str, float]:
    """Convert ``unit`` (gains,) to gains. Return a dictionary from dotted path to gain.

    Each number in ``unit`` lies between 0 and 1, the ends of the gain's range.
    """
    return {
        path: float(span.at(float(x)))
        for (path, span), x in zip(contestant.gains.items(), unit, strict=True)
    }


def _entrant(contestant: Contestant, gains: Values) -> dict[str, Any]:
    return {"controller": contestant.controller.model_dump(), **gains}


# ---------------------------------------------------------------------------------- summary


def errors_of(metrics: Sequence[Values], name: str = "max_error_deg") -> Array:
    """Return the metric ``name`` on each of n plants, (n,), and inf where the run failed."""
    return np.array([math.inf if math.isnan(v[name]) else v[name] for v in metrics])


def _level(values: Array, share: float) -> float:
    """Return the smallest of ``values`` (n,) with at least ``share`` of all values up to it."""
    return float(np.quantile(values, share, method="inverted_cdf"))


def _summary(tested: Sequence[Values], other_reference: Sequence[Values]) -> dict[str, Any]:
    errors, other = errors_of(tested), errors_of(other_reference)
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
        "median_error_other_reference_deg": _level(other, 0.5),
        "error_of_95_percent_other_reference_deg": _level(other, 0.95),
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
    "median_error_other_reference_deg": "median error, other reference (deg)",
    "error_of_95_percent_other_reference_deg": "95 % error, other reference (deg)",
}
"""Labels of the metrics in the report. The keys are the names in `ContestResult.summary`."""
