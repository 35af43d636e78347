"""Markdown report on a `kneexo.studies.order.study.OrderResult`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from kneexo.studies.markdown import number
from kneexo.studies.order.study import ORDERS, OrderResult, Rows
from kneexo.studies.paper import PAPER_BANDWIDTH_HZ
from kneexo.studies.template import filled


def report(result: OrderResult) -> str:
    """Return the Markdown report that compares the full and the reduced order of the cylinder."""
    oscillating = [row for row in result.switching if row["oscillates"]]
    calm = [r for r in result.switching if not r["oscillates"] and r["direction"] == "in"]
    return filled(
        "order/report.md",
        result=result,
        pressures=_pressures,
        saturated=lambda row: f"{100.0 * row['saturated_share']:.0f}",
        small_signal=_small_signal,
        ranges=_ranges,
        paper_bandwidth_hz=PAPER_BANDWIDTH_HZ,
        inside=_largest(oscillating),
        beside=_largest(calm),
    )


def _ranges(rows: Rows, name: str, form: str) -> str:
    """Return a text with the smallest and largest value of the column ``name`` for each order.

    Values that are nan do not count.
    """
    texts = []
    for order in ORDERS:
        values = [row[name] for row in rows if row["order"] == order]
        values = [value for value in values if not math.isnan(value)] or [math.nan]
        low, high = number(min(values), form), number(max(values), form)
        texts.append(f"{order} {low if low == high else f'{low}…{high}'}")
    return ", ".join(texts)


def _largest(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return a dictionary with the largest velocity swing, pressure swing and error.

    The rows are from the table ``switching``. The dictionary is empty without rows.
    """
    names = ("velocity_swing_mm_s", "load_pressure_swing_mpa", "max_error_deg")
    return {name: max(row[name] for row in rows) for name in names} if rows else {}


def _small_signal(name: str) -> Callable[[Mapping[str, Any]], str]:
    """Return a function that prints a row's −3 dB frequency from the column ``name``.

    If the row has no such frequency, the function returns the reason.
    """

    def text(row: Mapping[str, Any]) -> str:
        if row["failure"] or not row["stable"]:
            return row["failure"] or "unstable"
        hz = row[name]
        return "none below Nyquist" if math.isnan(hz) else number(hz)

    return text


def _pressures(name: str) -> Callable[[Mapping[str, Any]], str]:
    """Return a function that prints the range in MPa of the pressure ``name`` in a tracking run.

    The function returns an empty text if the run's model of the cylinder has no such pressure.
    """

    def text(row: Mapping[str, Any]) -> str:
        if f"{name}_min_mpa" not in row:
            return ""
        return f"{row[f'{name}_min_mpa']:.3f}…{row[f'{name}_max_mpa']:.3f}"

    return text
