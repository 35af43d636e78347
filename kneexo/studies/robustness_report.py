"""Markdown of `kneexo.studies.robustness`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from kneexo.studies.robustness import (
    CONFIDENCE,
    MERITS,
    RobustnessStudy,
    chance,
    failures,
    quantile,
    short_names,
    signed,
    worst,
)


def report(study: RobustnessStudy) -> str:
    """What was found, in Markdown."""
    return "\n".join(_report(study))


def shown(value: Any) -> str:
    """A value or option, short."""
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else "fails"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} = {shown(item)}" for key, item in value.items()) or "default"
    return "none" if value is None else str(value)


def _report(r: RobustnessStudy) -> Iterator[str]:
    law, reference = r.scenario.controller.kind, r.scenario.reference
    low, high = reference.range_deg
    names = short_names(r.uncertainty.values)
    known = [names[path] for path, one in r.uncertainty.values.items() if one.known]
    yield "# Robustness"
    yield ""
    yield (
        f"Controller {law}, reference {reference.kind} {low:g} … {high:g} deg, "
        f"{r.scenario.simulation.duration_s:g} s. {len(names)} uncertain values; the controller "
        f"believes in the nominal plant"
        + (f", but knows {', '.join(known)}." if known else ".")
        + (f" Not in this scenario, left out: {', '.join(r.left_out)}." if r.left_out else "")
    )
    yield ""
    yield from _distribution_table(r)
    yield ""
    yield from _failure_lines(r)
    yield ""
    yield "## Worst corners"
    yield ""
    yield _corner_sentence(r)
    yield ""
    shown_merits = [m for m in ("max_error_deg", "bandwidth_hz", "disk_margin") if m in r.merits]
    yield "| value | " + " | ".join(MERITS[m].label for m in shown_merits) + " |"
    yield "|---" * (len(shown_merits) + 1) + "|"
    corners = [worst(r.corners, merit) for merit in shown_merits]
    for path, name in names.items():
        yield f"| {name} | " + " | ".join(shown(c.values[path]) for c in corners) + " |"
    at_worst = [
        shown(float(signed([corner], merit)[0]))
        for corner, merit in zip(corners, shown_merits, strict=True)
    ]
    yield "| **the figure there** | " + " | ".join(at_worst) + " |"
    beyond = [
        MERITS[merit].label
        for merit in r.merits
        if MERITS[merit].worse * signed([worst(r.samples, merit)], merit)[0]
        > MERITS[merit].worse * signed([worst(r.corners, merit)], merit)[0]
    ]
    if beyond:
        yield ""
        yield (
            f"A sample within the ranges is worse than every corner visited in: "
            f"{', '.join(beyond)}. There corners alone would be too kind."
        )
    yield ""
    yield "## What matters most"
    yield ""
    yield (
        "ρ: Spearman's rank correlation over the samples; for options (*) the correlation ratio η "
        "of the ranks, which has no sign. alone: the figure at the low and high end, or at each "
        "option, all else nominal. linear: what the derivative by AutoDiff (quantizer bypassed, at "
        "the nominal plant) makes of the whole interval; far from the difference of the ends, the "
        "effect is not linear."
    )
    correlations = r.correlations()
    for merit in ("rms_error_deg", *shown_merits[1:]):
        yield ""
        yield from _importance_table(r, merit, correlations[merit], names)
    if r.local_failures:
        yield ""
        yield "No local sensitivity: " + "; ".join(r.local_failures) + "."
    yield ""


def _distribution_table(r: RobustnessStudy) -> Iterator[str]:
    yield "| figure | nominal | median | 5 % | 95 % | worst sample | worst corner |"
    yield "|---|---|---|---|---|---|---|"
    for merit in r.merits:
        cells = [float(signed([r.nominal], merit)[0])]
        cells += [quantile(r.samples, merit, share) for share in (0.5, 0.05, 0.95)]
        cells += [float(signed([worst(v, merit)], merit)[0]) for v in (r.samples, r.corners)]
        yield f"| {MERITS[merit].label} | " + " | ".join(map(shown, cells)) + " |"


def _failure_lines(r: RobustnessStudy) -> Iterator[str]:
    sets = {
        "samples": r.samples,
        "corners": r.corners,
        "plants with one value changed": r.one_at_a_time,
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
        yield ""
        for entry in failures(visits):
            yield f"- {entry['count']} times: {entry['example']}"
        unstable = [visit for visit in visits if visit.figures["stable"] is False]
        errors = signed(unstable, "max_error_deg")
        if np.isfinite(errors).any():
            runs = errors[np.isfinite(errors)]
            yield (
                f"- {runs.size} runs of those {errors.size} unstable loops go to their end all the "
                f"same, with largest errors of {runs.min():.3g} … {runs.max():.3g} deg"
            )
        yield ""
    yield (
        f"With {100.0 * CONFIDENCE:g} % confidence at least {100.0 * r.covered:.4g} % of all "
        f"plants do no worse in a figure than the worst of the {len(r.samples)} samples (seed "
        f"{r.settings.seed})."
    )


def _corner_sentence(r: RobustnessStudy) -> str:
    if r.corners_settled is None:
        return f"All {r.corners_possible} corners (ends of intervals, options) were visited."
    searched = (
        "and no single change makes the worst one of any figure worse"
        if r.corners_settled
        else "but the search from the worst ones on ran out of its budget"
    )
    return (
        f"{len(r.corners)} of {r.corners_possible} corners (ends of intervals, options) were "
        f"visited: those at which the ends are worse one at a time, for all options and each "
        f"figure; from the worst of them on all that differ in one value, {searched}; and random "
        f"ones."
    )


def _importance_table(
    r: RobustnessStudy, merit: str, correlation: Mapping[str, float], names: Mapping[str, str]
) -> Iterator[str]:
    effects, local = r.effects(merit), merit in r.local
    yield f"| {MERITS[merit].label} | ρ | alone |" + (" linear |" if local else "")
    yield "|---|---|---|" + ("---|" if local else "")
    order = sorted(names, key=lambda path: -abs(correlation[path]))
    for path in order:
        one, linear = r.uncertainty.values[path], r.linear_effect(merit, path)
        cells = [
            f"{correlation[path]:.2f}" + ("*" if one.options else ""),
            " / ".join(map(shown, effects[path])),
            *(["" if math.isnan(linear) else f"{linear:+.3g}"] if local else []),
        ]
        yield f"| {names[path]} | " + " | ".join(cells) + " |"
    idle = [
        names[path]
        for path in order
        if not abs(correlation[path]) > chance(r.uncertainty.values[path], len(r.samples))
    ]
    if idle:
        yield ""
        yield f"Not above chance ({100.0 * CONFIDENCE:g} %): {', '.join(idle)}."
