"""Markdown of `kneexo.studies.order.study`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from kneexo.studies.markdown import Cell, document, number, row_table
from kneexo.studies.order.study import ORDERS, OrderResult, Rows
from kneexo.studies.paper import PAPER_BANDWIDTH_HZ


def report(study: OrderResult) -> str:
    """Markdown: tables, and what the reduction leaves out in words."""
    case: dict[str, Cell] = {"order": "order", "disturbance (N)": ("disturbance_n", "g")}
    ramp: dict[str, Cell] = {"force (N)": ("force_n", "g"), "direction": "direction"}
    return document(
        "# Full against reduced order of the cylinder",
        "The disturbance comes on top of the scenario's load; positive loads P_1.",
        "## Tracking",
        row_table(
            study.tracking,
            case
            | {
                "rms error (deg)": ("rms_error_deg", ".3f"),
                "largest error (deg)": ("max_error_deg", ".3f"),
                "change of command (rpm/sample)": ("mean_command_change_rpm", ".1f"),
                "P_L (MPa)": _range("load_pressure"),
                "P_1 (MPa)": _range("cap"),
                "P_2 (MPa)": _range("rod_side"),
            },
        ),
        "## Rod speed at the limit of the command",
        row_table(
            study.speeds,
            {"order": "order"}
            | ramp
            | {
                "rod speed (mm/s)": ("rod_speed_mm_s", ".2f"),
                "saturated (%)": lambda row: f"{100.0 * row['saturated_share']:.0f}",
            },
        ),
        "## Large-signal −3 dB",
        row_table(study.bandwidth, case | {"bandwidth (Hz)": ("bandwidth_hz", ".4g")}),
        "## Linearized: the oil's mode and the sampled loop",
        row_table(
            study.frequency,
            case
            | {
                "posture (deg)": ("posture_deg", "g"),
                "rod force (N)": ("rod_force_n", ".3g"),
                "mode (Hz)": ("mode_hz", ".3g"),
                "damping ratio": ("mode_damping", ".3g"),
                "phase margin (deg)": ("phase_margin_deg", ".3g"),
                "gain margin": ("gain_margin", ".3g"),
                "delay margin (ms)": ("delay_margin_ms", ".3g"),
                "disk margin": ("disk_margin", ".3g"),
                "small-signal −3 dB, with feedforward (Hz)": partial(
                    _small_signal, name="bandwidth_hz"
                ),
                "complementary sensitivity −3 dB (Hz)": partial(
                    _small_signal, name="complementary_sensitivity_bandwidth_hz"
                ),
            },
        ),
        f"## Near the switching force, full order, {study.settings.switching_rate_deg_s:g} deg/s",
        row_table(
            study.switching,
            ramp
            | {
                "swing of the rod's velocity (mm/s)": ("velocity_swing_mm_s", ".3g"),
                "swing of P_L (MPa)": ("load_pressure_swing_mpa", ".3g"),
                "largest error (deg)": ("max_error_deg", ".3f"),
            },
        ),
        "## Findings",
        _findings(study),
    )


def _findings(study: OrderResult) -> list[str]:
    def both(rows: Rows, name: str, form: str) -> str:
        texts = []
        for order in ORDERS:
            values = [row[name] for row in rows if row["order"] == order]
            values = [value for value in values if not math.isnan(value)] or [math.nan]
            low, high = number(min(values), form), number(max(values), form)
            texts.append(f"{order} {low if low == high else f'{low}…{high}'}")
        return ", ".join(texts)

    lines = [
        f"- Tracking error, rms in deg: {both(study.tracking, 'rms_error_deg', '.3f')}. The "
        f"area that moves the oil is not the mean area; `kneexo.analysis.error_model`.",
        f"- Rod speed at the limit in mm/s: {both(study.speeds, 'rod_speed_mm_s', '.1f')}. It "
        f"follows the loaded chamber, not the direction.",
        f"- −3 dB in Hz: {both(study.bandwidth, 'bandwidth_hz', '.3f')}; the paper measured "
        f"{PAPER_BANDWIDTH_HZ:g} Hz.",
        f"- Oil's mode in Hz: {both(study.frequency, 'mode_hz', '.0f')}; damping ratio "
        f"{both(study.frequency, 'mode_damping', '.2g')}: one chamber is stiff in place of two, "
        f"and the make-up valve damps.",
        f"- Phase margin of the sampled loop in deg: "
        f"{both(study.frequency, 'phase_margin_deg', '.1f')}; disk margin "
        f"{both(study.frequency, 'disk_margin', '.2f')}.",
    ]
    for direction, words in (("in", "retracts"), ("out", "extends")):
        forces = study.oscillating_n(direction)
        where = f"at {min(forces):g}…{max(forces):g} N" if forces else "at none of the forces"
        lines.append(f"- Near the switching force the rod oscillates {where} when it {words}.")
    inside = [row for row in study.switching if row["oscillates"]]
    beside = [r for r in study.switching if not r["oscillates"] and r["direction"] == "in"]
    if inside and beside:

        def largest(name: str, rows: Rows = tuple(inside)) -> float:
            return max(row[name] for row in rows)

        lines.append(
            f"- There its velocity swings by up to {largest('velocity_swing_mm_s'):.0f} mm/s and "
            f"P_L by {largest('load_pressure_swing_mpa'):.2f} MPa, but the error is at most "
            f"{largest('max_error_deg'):.2f} deg, beside the zone "
            f"{largest('max_error_deg', tuple(beside)):.2f} deg: on average both chambers "
            f"carry, as if with the mean area."
        )
    return lines


def _small_signal(row: Mapping[str, Any], *, name: str) -> str:
    """Return the −3 dB frequency ``name`` of the linear loop, or why there is none."""
    if row["failure"] or not row["stable"]:
        return row["failure"] or "unstable"
    hz = row[name]
    return "none below Nyquist" if math.isnan(hz) else number(hz)


def _range(name: str) -> Callable[[Mapping[str, Any]], str]:
    """Least and largest pressure of a name; empty where the order has none."""

    def text(row: Mapping[str, Any]) -> str:
        if f"{name}_min_mpa" not in row:
            return ""
        return f"{row[f'{name}_min_mpa']:.3f}…{row[f'{name}_max_mpa']:.3f}"

    return text
