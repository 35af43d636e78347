"""Effects of uncertainty on a closed loop: samples, corners, one value at a time, sensitivities.

The plant and its measurement vary. The controller keeps its nominal plant, except for the values
that are ``known`` in `Uncertainty`. Failed runs and unstable loops are worse than any number.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice, product
from typing import Any, NamedTuple, Unpack

import numpy as np
import scipy

from kneexo.common.result import Array, Result
from kneexo.errors import failure_noted
from kneexo.parameters import UNCERTAIN_KNEE, UNCERTAINTY, Scenario, Uncertainty, UncertaintySet
from kneexo.parameters.fields.quantity import Parameters, choice, quantity
from kneexo.parameters.paths import value_at
from kneexo.parameters.uncertainty import applicable, draw, options_of, realize
from kneexo.simulation import needs_runs
from kneexo.studies.assessment import assess
from kneexo.studies.robustness.sensitivity import (
    differentiable,
    loop_sensitivities,
    tracking_sensitivities,
)
from kneexo.sweeps import Sweep, SweepOptions, open_sweep


class RobustnessSettings(Parameters):
    """Settings of ``kneexo study robustness``: numbers of plants, and parts of the study."""

    samples: int = quantity(
        500,
        "1",
        "assumption: the worst of 500 leaves out 0.6 % of all plants at most, with 95 % confidence",
        ge=2,
        le=1_000_000,
    )
    seed: int = quantity(2020, "1", "assumption: any number", ge=0)
    corners_max: int = quantity(
        1000, "1", "assumption: as many minutes as the samples", ge=1, le=10_000_000
    )
    bandwidth: bool = choice(True, "False leaves out the large-signal bandwidth, which costs most")
    sensitivity_duration_s: float = quantity(
        20.0,
        "s",
        "assumption: two periods of 0.1 Hz, of which the second counts; 0 leaves the tracking "
        "error out of the sensitivities",
        ge=0,
        le=1e5,
    )
    nyquist_loops: int = quantity(
        60, "1", "assumption: lines that a plot can carry", ge=0, le=10_000
    )


Values = Mapping[str, Any]
"""Dictionary from the dotted path of an uncertain quantity to a value of this quantity."""
Corner = tuple[int, ...]
"""A corner of the uncertainty set: for each uncertain value, an index into `Uncertainty.levels`."""

CONFIDENCE = 0.95
"""Confidence level of the statistical bounds in the report."""
UNSTABLE = "the sampled loop, linearized in the middle of the reference, is unstable"
"""Text that is reported as the failure of a plant whose linearized loop is unstable."""


class Merit(NamedTuple):
    """A figure of merit. ``sign_of_worse`` is 1 if a larger value is worse, else −1."""

    label: str
    sign_of_worse: float


MERITS = {
    "max_error_deg": Merit("largest error (deg)", 1.0),
    "rms_error_deg": Merit("rms error (deg)", 1.0),
    "peak_torque_n_m": Merit("largest torque of the wearer (N·m)", 1.0),
    "rms_torque_n_m": Merit("rms torque of the wearer (N·m)", 1.0),
    "mean_command_change_rpm": Merit("chattering (rpm per sample)", 1.0),
    "bandwidth_hz": Merit("bandwidth (Hz)", -1.0),
    "phase_margin_deg": Merit("phase margin (deg)", -1.0),
    "delay_margin_s": Merit("delay margin (s)", -1.0),
    "disk_margin": Merit("disk margin", -1.0),
}
"""The figures of merit, which are the metrics of `assess` whose worst cases are sought."""
COMPARED = ("max_error_deg", "peak_torque_n_m", "bandwidth_hz", "disk_margin")
"""Figures of merit whose worst corner the report shows, and the effect of each value alone."""


def merits_of(scenario: Scenario, metrics: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the figures of merit of a scenario that are in ``metrics``.

    A torque controller does not follow the reference, so the errors of the angle are left out.
    """
    errors = ("max_error_deg", "rms_error_deg") if scenario.controller.kind == "torque" else ()
    return tuple(name for name in MERITS if name in metrics and name not in errors)


@dataclass(frozen=True)
class Assessment:
    """One assessed plant: its values that are not nominal, and its metrics from `assess`."""

    values: Values
    metrics: dict[str, Any]

    @property
    def failures(self) -> tuple[str, ...]:
        """The reasons of missing metrics. An unstable loop adds the text `UNSTABLE`."""
        texts = [text for name, text in self.metrics.items() if name.endswith("_failure") and text]
        return (*texts, UNSTABLE) if self.metrics["stable"] is False else tuple(texts)


@needs_runs
def assess_plant(
    scenario: Scenario,
    uncertainty: UncertaintySet,
    judge: Callable[[Scenario], dict[str, Any]],
    values: Values,
) -> dict[str, Any]:
    """Make one plant with sampled values and return its metrics; runs in a worker process.

    If the values make no valid scenario or the metrics fail, the result has two entries:
    ``stable`` is None, and ``tracking_failure`` is the reason.

    Parameters
    ----------
    scenario
        The scenario with nominal values.
    uncertainty
        The uncertain values of the study.
    judge
        Function that returns the metrics of a scenario.
    values
        One sample, from dotted path to value.
    """
    metrics: dict[str, Any] = {"stable": None}
    with failure_noted(metrics, "tracking_failure"):
        plant = realize(scenario, uncertainty, values)
        return judge(plant)
    return metrics


def merit_value(assessment: Assessment, merit: str) -> float:
    """Return a figure of merit of an assessed plant, infinitely bad (±inf) if missing or nan."""
    value = assessment.metrics[merit]
    failed = value is None or math.isnan(value)
    return MERITS[merit].sign_of_worse * math.inf if failed else float(value)


def merit_values(assessments: Iterable[Assessment], merit: str) -> Array:
    """Return the `merit_value` of each of n assessments, (n,)."""
    return np.array([merit_value(assessment, merit) for assessment in assessments], dtype=float)


def worst(assessments: Sequence[Assessment], merit: str) -> Assessment:
    """Return the assessment with the worst figure of merit, the first if several are equal."""
    return assessments[
        int(np.argmax(MERITS[merit].sign_of_worse * merit_values(assessments, merit)))
    ]


def worst_value(assessments: Sequence[Assessment], merit: str) -> float:
    """Return the figure of merit of the `worst` assessment."""
    return merit_value(worst(assessments, merit), merit)


def quantile(assessments: Sequence[Assessment], merit: str, share: float) -> float:
    """Return the lowest figure of merit that a ``share`` (0 … 1) of the plants do not exceed.

    The result is infinite if this figure of merit belongs to a failed assessment.
    """
    return float(np.quantile(merit_values(assessments, merit), share, method="inverted_cdf"))


def failures(assessments: Sequence[Assessment]) -> list[dict[str, Any]]:
    """Group the failures whose texts differ only in numbers. Return the largest group first.

    Each group has ``count``, the text of its first failure, and ``values`` of the plant of that
    failure.
    """
    kinds: dict[str, dict[str, Any]] = {}
    for assessment in assessments:
        for text in assessment.failures:
            kind = re.sub(r"[-+−]?\d[\d.e+-]*", "#", text)
            entry = kinds.setdefault(
                kind, {"count": 0, "example": text, "values": assessment.values}
            )
            entry["count"] += 1
    return sorted(kinds.values(), key=lambda entry: -entry["count"])


def rank_correlation(
    uncertainty: UncertaintySet, assessments: Sequence[Assessment], merit: str
) -> Array:
    """Return how strongly each uncertain value acts on a figure of merit, (values,).

    For an interval the strength is Spearman's rank correlation over ``assessments``. For options
    the strength is the correlation ratio η ≥ 0: η² is the share of the ranks' variance between the
    options. Failures have the worst rank. If the figure of merit is constant, all strengths are
    nan.
    """
    ranks = scipy.stats.rankdata(merit_values(assessments, merit)) - 0.5 * (len(assessments) + 1)
    size = math.sqrt(ranks @ ranks)
    if size == 0.0:
        return np.full(len(uncertainty.values), math.nan)

    def strength(path: str, span: Uncertainty) -> float:
        values = [assessment.values[path] for assessment in assessments]
        if not span.options:
            x = scipy.stats.rankdata(values) - 0.5 * (len(assessments) + 1)
            return float(x @ ranks / (math.sqrt(x @ x) * size))
        groups = np.array([span.options.index(value) for value in values])
        sums = [ranks[groups == g].sum() ** 2 / np.sum(groups == g) for g in np.unique(groups)]
        return math.sqrt(sum(sums)) / size

    return np.array([strength(path, span) for path, span in uncertainty.values.items()])


def chance(span: Uncertainty, count: int) -> float:
    """Return the rank correlation that is beyond chance.

    The `rank_correlation` of a value without effect is larger in 5 % of cases. ``span`` is the
    range of the value, and ``count`` is the number of sampled plants.
    """
    freedom = max(len(span.options), 2) - 1
    return math.sqrt(scipy.stats.chi2.ppf(CONFIDENCE, freedom) / (count - 1))


@dataclass(frozen=True, repr=False)
class RobustnessResult(Result):
    """Assessments of the nominal plant, of one value at a time, of samples and of corners.

    ``uncertainty`` has the uncertain values that the scenario has, ``left_out`` the other paths.
    ``local`` maps metric and path to a derivative at the nominal plant. ``local_failures`` has the
    reasons of missing derivatives. ``corners_possible`` counts all corners. ``corners_settled`` is
    None if all corners were visited, else True if no neighbour of the worst corners is worse.
    """

    scenario: Scenario
    uncertainty: UncertaintySet
    left_out: tuple[str, ...]
    settings: RobustnessSettings
    nominal: Assessment
    one_at_a_time: tuple[Assessment, ...]
    samples: tuple[Assessment, ...]
    corners: tuple[Assessment, ...]
    corners_possible: int
    corners_settled: bool | None
    local: dict[str, dict[str, float]]
    local_failures: tuple[str, ...]

    @property
    def merits(self) -> tuple[str, ...]:
        """Names of the figures of merit that the study computed. The bandwidth can be missing."""
        return merits_of(self.scenario, self.nominal.metrics)

    def effects(self, merit: str) -> dict[str, list[float]]:
        """Return what each uncertain value alone does to a figure of merit.

        The result maps the path of an uncertain value to the figures of merit of the plants in
        which only this uncertain value has one of its levels, in the order of the levels.
        """
        values = iter(merit_values(self.one_at_a_time, merit).tolist())
        return {
            path: list(islice(values, len(span.levels)))
            for path, span in self.uncertainty.values.items()
        }

    def spread(self, merit: str, path: str) -> float:
        """Return by how much a figure of merit varies while one uncertain value takes its levels.

        The result is the largest less the smallest figure of merit. The nominal value is one of the
        levels. The result is inf if a run fails.
        """
        values = [*self.effects(merit)[path], merit_value(self.nominal, merit)]
        return float(np.max(values) - np.min(values)) if np.isfinite(values).all() else math.inf

    def linear_effect(self, merit: str, path: str) -> float:
        """Return the sensitivity of a figure of merit times the length of the value's interval.

        With ``scale: log`` the two factors are about the value's logarithm. The result is nan for a
        missing sensitivity and for options.
        """
        slope = self.local.get(merit, {}).get(path, math.nan)
        span = self.uncertainty.values[path]
        if span.low is None or span.high is None:
            return math.nan
        if span.scale == "log":
            return float(slope * value_at(self.scenario, path) * math.log(span.high / span.low))
        return slope * (span.high - span.low)

    def correlations(self) -> dict[str, dict[str, float]]:
        """Return the `rank_correlation` of each figure of merit and uncertain value.

        The result maps the figure of merit to a dictionary from the path of the uncertain value to
        the correlation over the samples.
        """
        return {
            merit: dict(
                zip(
                    self.uncertainty.values,
                    rank_correlation(self.uncertainty, self.samples, merit).tolist(),
                    strict=True,
                )
            )
            for merit in self.merits
        }

    @property
    def covered(self) -> float:
        """Share of all plants that, with 95 % confidence, are no worse than the worst sample."""
        return float((1.0 - CONFIDENCE) ** (1.0 / len(self.samples)))

    def results(self) -> dict[str, Any]:
        """Return all numbers of the study as plain data. Failed computations give nan."""

        def listed(assessments: Sequence[Assessment]) -> list[dict[str, Any]]:
            return [{"values": dict(v.values), **v.metrics} for v in assessments]

        def summary(merit: str) -> dict[str, Any]:
            sets = {"sample": self.samples, "corner": self.corners}
            return {
                "nominal": self.nominal.metrics[merit],
                "median": quantile(self.samples, merit, 0.5),
                "percentile_5": quantile(self.samples, merit, 0.05),
                "percentile_95": quantile(self.samples, merit, 0.95),
                **{
                    f"worst_{name}": {
                        "value": worst(assessments, merit).metrics[merit],
                        "values": dict(worst(assessments, merit).values),
                    }
                    for name, assessments in sets.items()
                },
                **{
                    f"failed_{name}s": int(np.sum(~np.isfinite(merit_values(assessments, merit))))
                    for name, assessments in sets.items()
                },
            }

        return {
            "uncertainty": self.uncertainty.model_dump(mode="json")["values"],
            "left_out": list(self.left_out),
            "settings": self.settings.model_dump(),
            "metrics": {merit: summary(merit) for merit in self.merits},
            "share_within_worst_sample_at_95_percent_confidence": self.covered,
            "failures": {
                "samples": failures(self.samples),
                "corners": failures(self.corners),
                "one_at_a_time": failures(self.one_at_a_time),
            },
            "corners_visited": len(self.corners),
            "corners_possible": self.corners_possible,
            "corners_settled": self.corners_settled,
            "rank_correlation": self.correlations(),
            "local_sensitivity": self.local,
            "local_failures": list(self.local_failures),
            "nominal": self.nominal.metrics,
            "one_at_a_time": listed(self.one_at_a_time),
            "samples": listed(self.samples),
            "corners": listed(self.corners),
        }


# ------------------------------------------------------------------------------------- runs


def robustness_study(
    scenario: Scenario = UNCERTAIN_KNEE,
    uncertainty: UncertaintySet = UNCERTAINTY,
    settings: RobustnessSettings = RobustnessSettings(),
    **options: Unpack[SweepOptions],
) -> RobustnessResult:
    """Assess how a closed loop behaves on plants with uncertain values.

    The bandwidth is measured only if the knee follows a sine that moves. A torque controller does
    not follow the reference, so its tracking error has no derivatives.

    Parameters
    ----------
    scenario
        The closed loop with nominal values.
    uncertainty
        The uncertain values. Values that the scenario lacks, such as those of a load in a scenario
        without load, are ignored, and their paths are reported.
    settings
        Number of samples, seed, and what is measured.
    options
        Workers, checkpoint and progress: see `kneexo.sweeps.SweepOptions`.

    Raises
    ------
    ParameterError
        An uncertain value is one that no scenario has, or is out of range. The scenario has none of
        the values.
    SimulationError
        Every run fails.
    """
    with open_sweep(**options) as sweep:
        return _explore(scenario, uncertainty, settings, sweep)


def _explore(
    scenario: Scenario, uncertainty: UncertaintySet, settings: RobustnessSettings, sweep: Sweep
) -> RobustnessResult:
    kept, left_out = applicable(scenario, uncertainty)
    reference = scenario.reference
    follows = scenario.controller.kind != "torque"
    moves = reference.kind == "sine" and reference.amplitude_deg > 0.0 and follows
    judge = partial(
        assess_plant, scenario, kept, partial(assess, bandwidth=settings.bandwidth and moves)
    )

    def assessment(points: Sequence[Values], what: str) -> tuple[Assessment, ...]:
        metrics = sweep.map(judge, points, what, group=options_of)
        return tuple(map(Assessment, points, (missing | values for values in metrics)))

    missing: dict[str, Any] = {}  # metrics of a plant with contradictory values
    at_nominal = assessment([{}], "nominal")[0]
    nominal = at_nominal.metrics
    missing |= {name: math.nan for name, value in nominal.items() if isinstance(value, float)}
    each = [{path: level} for path, span in kept.values.items() for level in span.levels]
    singly = assessment(each, "one at a time")
    samples = assessment(draw(kept, settings.samples, settings.seed), "samples")
    merits = merits_of(scenario, nominal)
    corners, settled = _corners(kept, merits, singly, settings, partial(assessment, what="corners"))
    paths = [
        p for p, span in kept.values.items() if not span.options and differentiable(scenario, p)
    ]
    local: dict[str, dict[str, float]] = {}
    troubles = []
    if paths:
        tasks = ["margins", *(["tracking"] if settings.sensitivity_duration_s and follows else [])]
        function = partial(_local, scenario, tuple(paths), settings.sensitivity_duration_s)
        for task, gradients in zip(tasks, sweep.map(function, tasks, "sensitivities"), strict=True):
            if trouble := gradients.pop("trouble"):
                troubles.append(f"{task}: {trouble}")
            local |= gradients
    return RobustnessResult(
        scenario=scenario,
        uncertainty=kept,
        left_out=left_out,
        settings=settings,
        nominal=at_nominal,
        one_at_a_time=singly,
        samples=samples,
        corners=corners,
        corners_possible=math.prod(len(span.levels) for span in kept.values.values()),
        corners_settled=settled,
        local=local,
        local_failures=tuple(troubles),
    )


def _local(
    scenario: Scenario, paths: Sequence[str], duration_s: float, task: str
) -> dict[str, Any]:
    """Return the derivatives of metrics with respect to uncertain values.

    The keys are the metric, then the path. ``task`` (``margins`` or ``tracking``) selects metrics.
    If the computation fails, the result has only the key ``trouble`` with the reason. Otherwise
    ``trouble`` is an empty text.
    """
    gradients: dict[str, Any] = {}
    with failure_noted(gradients, "trouble"):  # a sweep counts a "failure" as that of a run
        if task == "margins":
            sensitivities = loop_sensitivities(scenario, paths)
        else:
            sensitivities = tracking_sensitivities(scenario, paths, duration_s=duration_s)
        gradients |= {metric: sensitivities.of(metric) for metric in sensitivities.metrics}
    return gradients


def _corners(
    uncertainty: UncertaintySet,
    merits: Sequence[str],
    singly: Sequence[Assessment],
    settings: RobustnessSettings,
    assess_all: Callable[[Sequence[Values]], tuple[Assessment, ...]],
) -> tuple[tuple[Assessment, ...], bool | None]:
    """Assess all corners, or ``corners_max`` of them. Return assessments and ``corners_settled``.

    If there are more than ``corners_max`` corners, the search visits first the corners of
    ``_pointed_at``. Then it visits all neighbours of each figure of merit's worst corner, until the
    worst corners have no new neighbour. Random corners follow. Neighbours differ in one value.
    """
    entries = uncertainty.values
    sizes = [len(span.levels) for span in entries.values()]
    visited: dict[Corner, Assessment] = {}

    def values_at(corner: Corner) -> Values:
        levels = zip(entries.items(), corner, strict=True)
        return {path: span.levels[index] for (path, span), index in levels}

    def visit(corners: Iterable[Corner]) -> None:
        """Assess the corners that are not visited yet, up to ``corners_max`` in total."""
        new = list(dict.fromkeys(corner for corner in corners if corner not in visited))
        new = new[: settings.corners_max - len(visited)]
        visited.update(zip(new, assess_all([values_at(corner) for corner in new]), strict=True))

    if math.prod(sizes) <= settings.corners_max:
        visit(product(*map(range, sizes)))
        return tuple(visited.values()), None
    visit(_pointed_at(uncertainty, merits, singly))
    settled = False
    while len(visited) < settings.corners_max and not settled:
        worst_corners = dict.fromkeys(_worst_corner(visited, merit) for merit in merits)
        before = len(visited)
        visit(chain.from_iterable(_neighbours(corner, sizes) for corner in worst_corners))
        settled = len(visited) == before
    random = np.random.default_rng((settings.seed, 1))
    while missing := settings.corners_max - len(visited):
        visit(map(tuple, random.integers(sizes, size=(missing, len(sizes))).tolist()))
    return tuple(visited.values()), settled


def _pointed_at(
    uncertainty: UncertaintySet, merits: Sequence[str], singly: Sequence[Assessment]
) -> Iterator[Corner]:
    """Yield a promising corner for each figure of merit and each combination of options.

    In such a corner, each uncertain interval is at the end that alone makes the figure of merit
    worse. ``singly`` has the assessments with one uncertain value changed at a time.
    """
    one_by_one = iter(singly)
    groups = [list(islice(one_by_one, len(span.levels))) for span in uncertainty.values.values()]
    for merit in merits:
        choices = []
        for span, assessments in zip(uncertainty.values.values(), groups, strict=True):
            bad = MERITS[merit].sign_of_worse * merit_values(assessments, merit)
            choices.append(range(len(assessments)) if span.options else [int(np.argmax(bad))])
        yield from product(*choices)


def _worst_corner(visited: Mapping[Corner, Assessment], merit: str) -> Corner:
    bad = MERITS[merit].sign_of_worse * merit_values(visited.values(), merit)
    return list(visited)[int(np.argmax(bad))]


def _neighbours(corner: Corner, sizes: Sequence[int]) -> Iterator[Corner]:
    """Yield all corners that differ from ``corner`` in one value."""
    for place, size in enumerate(sizes):
        for index in range(size):
            if index != corner[place]:
                yield (*corner[:place], index, *corner[place + 1 :])


# ---------------------------------------------------------------------------------- summary
