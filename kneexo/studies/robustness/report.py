"""Markdown of `kneexo.studies.robustness.study`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from kneexo.studies.markdown import document, markdown_table
from kneexo.studies.robustness.study import (
    CONFIDENCE,
    MERITS,
    RobustnessResult,
    chance,
    failures,
    merit_value,
    merit_values,
    quantile,
    short_names,
    worst,
    worst_value,
)


def report(study: RobustnessResult) -> str:
    """What was found, in Markdown."""
    law, reference = study.scenario.controller.kind, study.scenario.reference
    low, high = reference.range_deg
    names = short_names(study.uncertainty.values)
    knowledge = [names[path] for path, span in study.uncertainty.values.items() if span.known]
    left_out = ", ".join(study.left_out)
    merits = [m for m in ("max_error_deg", "bandwidth_hz", "disk_margin") if m in study.merits]
    return document(
        "# Robustness",
        f"Controller {law}, reference {reference.kind} {low:g} … {high:g} deg, "
        f"{study.scenario.simulation.duration_s:g} s. {len(names)} uncertain values; the "
        f"controller believes in the nominal plant"
        + (f", but knows {', '.join(knowledge)}." if knowledge else ".")
        + (f" Not in this scenario, left out: {left_out}." if left_out else ""),
        _distribution_table(study),
        *_failure_texts(study),
        f"With {100.0 * CONFIDENCE:g} % confidence at least {100.0 * study.covered:.4g} % of all "
        f"plants do no worse in a figure than the worst of the {len(study.samples)} samples (seed "
        f"{study.settings.seed}).",
        "## Worst corners",
        _corner_sentence(study),
        _corner_table(study, merits, names),
        _worse_samples(study),
        "## What matters most",
        "ρ: Spearman's rank correlation over the samples; for options (*) the correlation ratio η "
        "of the ranks, which has no sign. alone: the figure at the low and high end, or at each "
        "option, all else nominal. linear: what the derivative by AutoDiff (quantizer bypassed, at "
        "the nominal plant) makes of the whole interval; far from the difference of the ends, the "
        "effect is not linear.",
        *_importance_tables(study, ("rms_error_deg", *merits[1:]), names),
        f"No local sensitivity: {'; '.join(study.local_failures)}." if study.local_failures else "",
    )


def shown(value: Any) -> str:
    """A value or option, short."""
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else "fails"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} = {shown(item)}" for key, item in value.items()) or "default"
    return "none" if value is None else str(value)


def _distribution_table(study: RobustnessResult) -> list[str]:
    rows = []
    for merit in study.merits:
        cells = [merit_value(study.nominal, merit)]
        cells += [quantile(study.samples, merit, share) for share in (0.5, 0.05, 0.95)]
        cells += [worst_value(visits, merit) for visits in (study.samples, study.corners)]
        rows.append([MERITS[merit].label, *map(shown, cells)])
    head = ("figure", "nominal", "median", "5 %", "95 %", "worst sample", "worst corner")
    return markdown_table(head, rows)


def _failure_texts(study: RobustnessResult) -> Iterator[str | list[str]]:
    sets = {
        "samples": study.samples,
        "corners": study.corners,
        "plants with one value changed": study.one_at_a_time,
    }
    for name, visits in sets.items():
        bad = sum(bool(visit.failures) for visit in visits)
        if not bad:
            yield f"None of the {len(visits)} {name} fails or is unstable."
            continue
        yield (
            f"{bad} of the {len(visits)} {name} ({100.0 * bad / len(visits):.3g} %) fail in part "
            f"or are unstable, which the table counts as worse than any number:"
        )
        lines = [f"- {entry['count']} times: {entry['example']}" for entry in failures(visits)]
        unstable = [visit for visit in visits if visit.figures["stable"] is False]
        errors = merit_values(unstable, "max_error_deg")
        if np.isfinite(errors).any():
            runs = errors[np.isfinite(errors)]
            lines.append(
                f"- {runs.size} runs of those {errors.size} unstable loops go to their end all the "
                f"same, with largest errors of {runs.min():.3g} … {runs.max():.3g} deg"
            )
        yield lines


def _corner_sentence(study: RobustnessResult) -> str:
    if study.corners_settled is None:
        return f"All {study.corners_possible} corners (ends of intervals, options) were visited."
    searched = (
        "and no single change makes the worst one of any figure worse"
        if study.corners_settled
        else "but the search from the worst ones on ran out of its budget"
    )
    return (
        f"{len(study.corners)} of {study.corners_possible} corners (ends of intervals, options) "
        f"were visited: those at which the ends are worse one at a time, for all options and each "
        f"figure; from the worst of them on all that differ in one value, {searched}; and random "
        f"ones."
    )


def _corner_table(
    study: RobustnessResult, merits: Sequence[str], names: Mapping[str, str]
) -> list[str]:
    corners = [worst(study.corners, merit) for merit in merits]
    at_worst = [shown(worst_value(study.corners, merit)) for merit in merits]
    return markdown_table(
        ("value", *(MERITS[merit].label for merit in merits)),
        [
            *((name, *(shown(c.values[path]) for c in corners)) for path, name in names.items()),
            ("**the figure there**", *at_worst),
        ],
    )


def _worse_samples(study: RobustnessResult) -> str:
    """Where a sample is worse than all corners; empty when none is."""
    beyond = [
        MERITS[merit].label
        for merit in study.merits
        if MERITS[merit].worse * worst_value(study.samples, merit)
        > MERITS[merit].worse * worst_value(study.corners, merit)
    ]
    if not beyond:
        return ""
    return (
        f"A sample within the ranges is worse than every corner visited in: {', '.join(beyond)}. "
        f"Corners alone understate the worst case there."
    )


def _importance_tables(
    study: RobustnessResult, merits: Sequence[str], names: Mapping[str, str]
) -> Iterator[str | list[str]]:
    correlations = study.correlations()
    for merit in merits:
        correlation, effects = correlations[merit], study.effects(merit)
        order = sorted(names, key=lambda path: -abs(correlation[path]))
        head = [MERITS[merit].label, "ρ", "alone", *(["linear"] if merit in study.local else [])]
        rows = []
        for path in order:
            star = "*" if study.uncertainty.values[path].options else ""
            alone = " / ".join(map(shown, effects[path]))
            linear = study.linear_effect(merit, path)
            row = [names[path], f"{correlation[path]:.2f}{star}", alone]
            rows.append([*row, "" if math.isnan(linear) else f"{linear:+.3g}"][: len(head)])
        yield markdown_table(head, rows)
        idle = [
            names[path]
            for path in order
            if not abs(correlation[path])
            > chance(study.uncertainty.values[path], len(study.samples))
        ]
        yield f"Not above chance ({100.0 * CONFIDENCE:g} %): {', '.join(idle)}." if idle else ""
