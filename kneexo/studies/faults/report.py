"""Markdown report on a `kneexo.studies.faults.faults.FaultsResult`."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from itertools import product
from typing import Any, TypeVar

from kneexo.studies.faults.faults import (
    FAILED,
    EmergencyStop,
    FaultRow,
    FaultsResult,
    not_seen,
    urgency,
)
from kneexo.studies.faults.typical_faults import TYPICAL_FAULTS, typical_faults
from kneexo.studies.markdown import number
from kneexo.studies.template import filled

Case = TypeVar("Case", FaultRow, EmergencyStop)

_HAZARDS = {
    "flexes": ("knee flexes on its own", "stance: the leg gives way", "fall"),
    "extends": ("knee extends on its own", "swing: the foot meets the ground early", "stumble"),
}
"""Hazard, hazardous situation and harm, by how the knee leaves its motion."""

_VERDICTS = (*FAILED, "in time", "never active")
"""The verdicts of a row whose harm is not unseen, the worst first."""


def report(result: FaultsResult) -> str:
    """Return the Markdown report on all faults."""
    groups = [min(rows, key=urgency) for rows in _by_fault(result.rows).values()]
    unfound = [row for row in result.rows if not row.detector]
    compared = len(result.safe_states) > 1
    alarms = sum(result.alarms.values())
    unseen = not_seen(result.settings.observed_s)
    worn = result.scenario.wearer.kind != "none"
    return filled(
        "faults/report.md",
        result=result,
        settings=result.settings,
        worst=result.worst,
        worst_deg=_peak("protected.deviation_deg")(vars(result.worst)),
        worst_alone_deg=_peak("alone.deviation_deg")(vars(result.worst)),
        undetected=result.undetected,
        strongest=max(unfound, key=lambda row: row.alone.torque_n_m, default=None),
        counts=Counter(row.verdict for row in result.rows),
        alarms=alarms,
        largest_share=1.0 - 0.05 ** (1.0 / result.healthy_runs),
        not_seen=unseen,
        rows=[_line(row) for row in groups if row.verdict != unseen],
        tolerated=[_line(row) for row in groups if row.verdict == unseen],
        torque_note=(
            "The torque is that of the wearer on the device."
            if worn
            else "The torque is that of the actuator on the knee."
        ),
        compared=_by_phase(result) if compared else [],
        failed_by_state=[
            f"{sum(r.has_failed and r.safe_state == state for r in result.all_rows)} with {state}"
            for state in result.safe_states
        ],
        differing=_differing(result),
        differing_columns={
            name: name for name in ("cause", "fault", "controller", *result.safe_states)
        },
        hazards=_hazards(result),
        evidence=_evidence(result),
        absent=_absent(result),
        peak=_peak,
    )


def _by_fault(rows: Iterable[FaultRow]) -> dict[tuple[str, str, str], list[FaultRow]]:
    """Group the rows of equal controller, cause and fault, which differ in start or safe state."""
    groups: dict[tuple[str, str, str], list[FaultRow]] = {}
    for row in rows:
        groups.setdefault((row.controller, row.cause, row.fault), []).append(row)
    return groups


def _line(row: FaultRow) -> dict[str, Any]:
    """Return the values of a line of the table of faults."""
    return vars(row) | {
        "controller": row.controller.upper(),
        "critical_duration": ("≥ " if row.censored else "") + number(row.critical_duration_s),
        "detector": row.detector or "–",
        "detected_after_s": _finite(row.detected_after_s),
        "safe_after_s": _finite(row.safe_after_s),
        "verdict": row.verdict,
    }


def _peak(path: str) -> Callable[[dict[str, Any]], str]:
    """Return the function that writes one value of `Peaks` or `Rest` into a cell of a table.

    ``path`` is the field of the row and the field of the value, such as ``rest.turn_deg``. The text
    begins with > if the run ended early, because the value could have become larger.
    """
    part, name = path.split(".")

    def text(line: dict[str, Any]) -> str:
        peaks = line[part]
        value = getattr(peaks, name)
        return ("" if peaks.complete or math.isnan(value) else "> ") + number(value)

    return text


def _finite(value: float) -> float:
    """Return the value, or nan for inf, because a table shows a dash for nan."""
    return value if math.isfinite(value) else math.nan


def _absent(result: FaultsResult) -> list[str]:
    """Return the typical faults that this scenario cannot have, as texts for the report.

    Each text is the cause that the fault stands for, and the place of the fault in brackets, such
    as ``loose plug (encoder)``. The list is empty if the user has chosen the faults.
    """
    if result.settings.faults:
        return []
    present = typical_faults(result.scenario)
    return [f"{t.cause} ({t.place})" for t in TYPICAL_FAULTS if t.cause not in present]


def _by_phase(result: FaultsResult) -> list[dict[str, Any]]:
    """Return a line of a table for each start and safe state, over all faults and controllers."""
    lines = []
    for start_s, safe_state in product(
        dict.fromkeys(stop.start_s for stop in result.stops), result.safe_states
    ):
        key = (start_s, safe_state)
        rows = [row for row in result.all_rows if (row.start_s, row.safe_state) == key]
        stops = [stop for stop in result.stops if (stop.start_s, stop.safe_state) == key]
        failed = [row for row in rows if row.has_failed]
        turning = max(_safe(rows), key=lambda row: row.rest.turn_deg)
        turned = max(_safe(stops), key=lambda stop: stop.rest.turn_deg)
        pressed = max(_safe(stops), key=lambda stop: stop.rest.torque_n_m)
        lines.append(
            {
                "start_s": start_s,
                "knee_deg": stops[0].knee_deg,
                "safe_state": safe_state,
                "failed": f"{len(failed)} of {len(rows)}",
                "never_safe": sum(
                    row.detector != "" and row.safe_after_s == math.inf for row in rows
                ),
                "deviation_deg": max((r.protected.deviation_deg for r in failed), default=math.nan),
                "turn": _peak("rest.turn_deg")(vars(turning)),
                "turning": turning.cause,
                "stop_turn": _peak("rest.turn_deg")(vars(turned)),
                "stop_torque": _peak("rest.torque_n_m")(vars(pressed)),
            }
        )
    return lines


def _differing(result: FaultsResult) -> list[dict[str, str]]:
    """Return a line for each fault whose worst verdicts differ between the safe states."""
    lines = []
    for group in _by_fault(result.all_rows).values():
        worst = {
            safe_state: min((r for r in group if r.safe_state == safe_state), key=urgency)
            for safe_state in result.safe_states
        }
        if len({row.verdict for row in worst.values()}) > 1:
            first = group[0]
            line = {"cause": first.cause, "fault": first.fault}
            line["controller"] = first.controller.upper()
            for safe_state, row in worst.items():
                deviation = _peak("protected.deviation_deg")(vars(row))
                line[safe_state] = f"{row.verdict}, {deviation}° at {row.start_s:g} s"
            lines.append(line)
    return lines


def _safe(cases: list[Case]) -> list[Case]:
    """Return the cases in which the motor becomes safe, or all cases if it never does."""
    return [case for case in cases if not math.isnan(case.rest.turn_deg)] or cases


def _evidence(result: FaultsResult) -> list[dict[str, str]]:
    """Return a line for each requirement of 21 CFR 890.3480(b)(5) that a simulation can inform."""
    counts = Counter(row.verdict for row in result.rows)
    relevant = [row for row in result.rows if row.has_failed or row.verdict == "in time"]
    delays_s = sorted(row.detected_after_s for row in relevant if row.detector) or [math.nan]
    median_s, worst_s = delays_s[len(delays_s) // 2], delays_s[-1]
    worst = result.worst
    stops = [stop for stop in result.stops if stop.safe_state == result.safe_states[0]]
    places: dict[str, Counter[str]] = {}
    for row in result.rows:
        place = row.fault.split(" ")[0].split(".")
        verdict = "failed" if row.has_failed else row.verdict
        places.setdefault(" ".join(place[:2]), Counter())[verdict] += 1
    findings = {
        "(ii) commands and safeguards in the worst case": (
            f"{worst.fault} at {worst.start_s:g} s ({worst.controller.upper()}): {worst.verdict}, "
            f"{_peak('protected.deviation_deg')(vars(worst))}° and "
            f"{_peak('protected.torque_n_m')(vars(worst))} N·m"
        ),
        "(iii) manual override": (
            f"{len(stops)} emergency stops: safe within "
            f"{number(max(stop.safe_after_s for stop in stops))} s, in which the knee turns by up "
            f"to {number(max(stop.turn_deg for stop in stops))}° at up to "
            f"{number(max(stop.torque_n_m for stop in stops))} N·m"
        ),
        "(iv) accuracy of the safeguards": (
            f"in time in {counts['in time']} of {len(relevant)} cases that are found or missed; "
            f"found after {number(median_s)} s (median), {number(worst_s)} s (worst); "
            f"{sum(result.alarms.values())} false alarms in {result.healthy_runs} healthy runs"
        ),
        "(v) sensors, actuator and motor": "; ".join(
            f"{place}: {', '.join(f'{count} {name}' for name, count in verdicts.items())}"
            for place, verdicts in places.items()
        ),
    }
    return [{"requirement": name, "finding": text} for name, text in findings.items()]


def _hazards(result: FaultsResult) -> list[dict[str, str]]:
    """Return a line of the table of hazards for each cause of a fault whose harm is seen."""
    unseen = not_seen(result.settings.observed_s)
    causes: dict[str, list[FaultRow]] = {}
    for row in result.rows:
        if row.verdict != unseen:
            causes.setdefault(row.cause, []).append(row)
    lines = []
    for cause, rows in causes.items():
        hazard, situation, harm = _HAZARDS["flexes" if min(rows, key=urgency).flexes else "extends"]
        found = sorted({row.detector for row in rows if row.detector})
        lines.append(
            {
                "cause": cause,
                "hazard": hazard,
                "situation": situation,
                "harm": harm,
                "detectors": ", ".join(found) or "–",
                "verdict": min((row.verdict for row in rows), key=_VERDICTS.index),
            }
        )
    return lines
