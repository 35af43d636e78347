"""Markdown report on a `kneexo.studies.robustness.robustness.RobustnessResult`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from kneexo.errors import ParameterError
from kneexo.parameters import Scenario
from kneexo.parameters.labels import labels, value_text
from kneexo.parameters.uncertainty import realize
from kneexo.studies.markdown import number, repeating_commands
from kneexo.studies.robustness.robustness import (
    COMPARED,
    CONFIDENCE,
    MERITS,
    Assessment,
    RobustnessResult,
    chance,
    failures,
    merit_value,
    merit_values,
    quantile,
    worst,
    worst_value,
)
from kneexo.studies.template import filled

_MEANS = {"max_error_deg": "rms_error_deg", "peak_torque_n_m": "rms_torque_n_m"}
"""For each peak value, the root mean square that the table of importance has in its place."""
_DISTRIBUTION_HEAD = ("metric", "nominal", "median", "5 %", "95 %", "worst sample", "worst corner")
_STRONGEST = 2
"""Largest number of uncertain values that the findings name for a figure of merit."""


def report(result: RobustnessResult) -> str:
    """Return the report on a robustness study in Markdown."""
    names = labels(result.uncertainty.values)
    merits = [merit for merit in COMPARED if merit in result.merits]
    distribution = {merit: _distribution(result, merit) for merit in result.merits}
    return filled(
        "robustness/report.md",
        result=result,
        left_out=list(labels(result.left_out).values()),
        scenario=result.scenario,
        names=names,
        known=[names[path] for path, span in result.uncertainty.values.items() if span.known],
        confidence_percent=100.0 * CONFIDENCE,
        distribution_head=_DISTRIBUTION_HEAD,
        distribution=list(distribution.values()),
        compared=[distribution[merit] for merit in merits],
        failures=[
            _failure_summary("samples", result.samples),
            _failure_summary("corners", result.corners),
            _failure_summary("plants with one value changed", result.one_at_a_time),
        ],
        corner_labels=[MERITS[merit].label for merit in merits],
        corners=list(_corners(result, merits, names)),
        beyond=[MERITS[merit].label for merit in result.merits if _sample_is_worst(result, merit)],
        commands=repeating_commands(failed_runs(result)),
        importance=list(_importance(result, [_MEANS.get(m, m) for m in merits], names)),
    )


def failed_runs(result: RobustnessResult) -> dict[str, Scenario]:
    """Return the plants whose tracking runs are the examples of failures in the report, by error.

    Values that contradict each other make no plant, and so no run.
    """
    runs: dict[str, Scenario] = {}
    for assessments in (result.samples, result.corners, result.one_at_a_time):
        for failure in failures(assessments):
            error, values = failure["example"], failure["values"]
            if any(error == a.metrics["tracking_failure"] for a in assessments):
                with suppress(ParameterError):
                    runs.setdefault(error, realize(result.scenario, result.uncertainty, values))
    return runs


def shown(value: float) -> str:
    """Return a metric as short text; ``fails`` for a number that is not finite."""
    return number(value) if math.isfinite(value) else "fails"


def _distribution(result: RobustnessResult, merit: str) -> list[str]:
    """Return the table row of a figure of merit, with the cells of `_DISTRIBUTION_HEAD`.

    The quantiles are those of the samples.
    """
    values = [merit_value(result.nominal, merit)]
    values += [quantile(result.samples, merit, share) for share in (0.5, 0.05, 0.95)]
    values += [worst_value(assessments, merit) for assessments in (result.samples, result.corners)]
    return [MERITS[merit].label, *map(shown, values)]


def _failure_summary(name: str, assessments: Sequence[Assessment]) -> dict[str, Any]:
    """Return failure counts for a set of plants, and the largest error on each unstable plant."""
    unstable = [assessment for assessment in assessments if assessment.metrics["stable"] is False]
    errors = merit_values(unstable, "max_error_deg")
    return {
        "name": name,
        "size": len(assessments),
        "count": sum(bool(assessment.failures) for assessment in assessments),
        "reasons": failures(assessments),
        "unstable": len(unstable),
        "errors_of_unstable_deg": errors[np.isfinite(errors)].tolist(),
    }


def _corners(
    result: RobustnessResult, merits: Sequence[str], names: Mapping[str, str]
) -> Iterator[list[str]]:
    """Yield table rows. The columns are the worst corners, one for each figure of merit.

    Each row has one uncertain value at these corners. The last row has the figures of merit there.
    """
    corners = [worst(result.corners, merit) for merit in merits]
    for path, name in names.items():
        yield [name, *(value_text(path, corner.values[path]) for corner in corners)]
    yield [
        "**the metric there**",
        *(shown(worst_value(result.corners, merit)) for merit in merits),
    ]


def _sample_is_worst(result: RobustnessResult, merit: str) -> bool:
    """Return True if a figure of merit is worse at some sample than at all corners."""
    sample, corner = (
        worst_value(assessments, merit) for assessments in (result.samples, result.corners)
    )
    return MERITS[merit].sign_of_worse * sample > MERITS[merit].sign_of_worse * corner


def _importance(
    result: RobustnessResult, merits: Sequence[str], names: Mapping[str, str]
) -> Iterator[dict[str, Any]]:
    """Yield a table for each figure of merit. Each row describes an uncertain value.

    The value with the strongest correlation comes first. ``idle`` names the values whose
    correlation does not exceed `chance` in magnitude. ``strongest`` names the first values that do.
    """
    correlations = result.correlations()
    for merit in merits:
        correlation, effects = correlations[merit], result.effects(merit)
        order = sorted(names, key=lambda path: -abs(correlation[path]))
        head = [MERITS[merit].label, "ρ", "alone", *(["linear"] if merit in result.local else [])]
        rows, idle = [], []
        for path in order:
            span = result.uncertainty.values[path]
            star = "*" if span.options else ""
            alone = " / ".join(map(shown, effects[path]))
            linear = result.linear_effect(merit, path)
            strength = f"{correlation[path]:.2f}{star}" if math.isfinite(correlation[path]) else "–"
            row = [names[path], strength, alone]
            rows.append([*row, "" if math.isnan(linear) else f"{linear:+.3g}"][: len(head)])
            if not abs(correlation[path]) > chance(span, len(result.samples)):
                idle.append(names[path])
        strongest = [f"{name} {text.strip('*')}" for name, text, *_ in rows if name not in idle]
        yield {
            "head": head,
            "rows": rows,
            "idle": idle,
            "strongest": ", ".join(strongest[:_STRONGEST]) or "none above chance",
        }
