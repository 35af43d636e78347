"""Markdown report on a `kneexo.studies.order.study.OrderResult`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from kneexo.analysis.margins import soundness
from kneexo.parameters.criteria import SOUND_DISK_MARGIN
from kneexo.studies.markdown import number
from kneexo.studies.order.rows import FrequencyRow, SwitchingRow
from kneexo.studies.order.study import ORDERS, OrderResult
from kneexo.studies.paper import PAPER_BANDWIDTH_HZ
from kneexo.studies.template import filled


def report(result: OrderResult) -> str:
    """Return the Markdown report that compares the full and the reduced order of the cylinder."""
    oscillating = [row for row in result.switching if row.oscillates]
    calm = [r for r in result.switching if not r.oscillates and r.direction == "in"]
    return filled(
        "order/report.md",
        result=result,
        load_pressure=lambda row: _limits(row.load_pressure_min_mpa, row.load_pressure_max_mpa),
        cap_pressure=lambda row: _limits(row.cap_min_mpa, row.cap_max_mpa),
        rod_side_pressure=lambda row: _limits(row.rod_side_min_mpa, row.rod_side_max_mpa),
        saturated=lambda row: f"{100.0 * row.saturated_share:.0f}",
        bandwidth=lambda row: _small_signal(row, row.bandwidth_hz),
        complementary_sensitivity_bandwidth=lambda row: _small_signal(
            row, row.complementary_sensitivity_bandwidth_hz
        ),
        verdict=lambda row: soundness(row.disk_margin),
        sound_disk_margin=SOUND_DISK_MARGIN,
        oscillation=lambda row: "oscillates" if row.oscillates else "calm",
        ranges=_ranges,
        paper_bandwidth_hz=PAPER_BANDWIDTH_HZ,
        inside=_largest(oscillating),
        beside=_largest(calm),
    )


def _ranges(rows: Sequence[Any], name: str, form: str) -> str:
    """Return a text with the smallest and largest value of the column ``name`` for each order.

    Values that are nan do not count.
    """
    texts = []
    for order in ORDERS:
        values = [getattr(row, name) for row in rows if row.order == order]
        values = [value for value in values if not math.isnan(value)] or [math.nan]
        low, high = number(min(values), form), number(max(values), form)
        texts.append(f"{order} {low if low == high else f'{low}…{high}'}")
    return ", ".join(texts)


def _largest(rows: Sequence[SwitchingRow]) -> dict[str, float]:
    """Return a dictionary with the largest velocity swing, pressure swing and error.

    The dictionary is empty without rows.
    """
    names = ("velocity_swing_mm_s", "load_pressure_swing_mpa", "max_error_deg")
    return {name: max(getattr(row, name) for row in rows) for name in names} if rows else {}


def _small_signal(row: FrequencyRow, hz: float) -> str:
    """Return the −3 dB frequency ``hz`` of a row as text.

    If the row has no such frequency, the text is the reason.
    """
    if row.failure or not row.stable:
        return row.failure or "unstable"
    return "none below Nyquist" if math.isnan(hz) else number(hz)


def _limits(low: float | None, high: float | None) -> str:
    """Return the range of a pressure in MPa as text.

    The text is empty if the run's model of the cylinder has no such pressure.
    """
    return "" if low is None else f"{low:.3f}…{high:.3f}"
