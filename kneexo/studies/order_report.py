"""Markdown of `kneexo.studies.order`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from kneexo.studies.markdown import markdown_table, number
from kneexo.studies.order import ORDERS, OrderStudy, Rows
from kneexo.studies.paper import PAPER_BANDWIDTH_HZ


def report(study: OrderStudy) -> str:
    """Markdown: tables, and what the reduction leaves out in words."""
    tracking = [
        (
            row["order"],
            f"{row['disturbance_n']:g}",
            f"{row['rms_error_deg']:.3f}",
            f"{row['max_error_deg']:.3f}",
            f"{row['mean_command_change_rpm']:.1f}",
            *(_range(row, name) for name in ("load_pressure", "cap", "rod_side")),
        )
        for row in study.tracking
    ]
    speeds = [
        (
            row["order"],
            f"{row['force_n']:g}",
            row["direction"],
            f"{row['rod_speed_mm_s']:.2f}",
            f"{100.0 * row['saturated_share']:.0f}",
        )
        for row in study.speeds
    ]
    bandwidth = [
        (row["order"], f"{row['disturbance_n']:g}", number(row["bandwidth_hz"], ".4g"))
        for row in study.bandwidth
    ]
    frequency = [
        (
            row["order"],
            f"{row['disturbance_n']:g}",
            f"{row['posture_deg']:g}",
            *(number(row[name]) for name in ("rod_force_n", "mode_hz", "mode_damping")),
            *(number(row[name]) for name in ("phase_margin_deg", "gain_margin")),
            *(number(row[name]) for name in ("delay_margin_ms", "disk_margin")),
            row["failure"] or ("" if row["stable"] else "unstable") or _crossing(row),
        )
        for row in study.frequency
    ]
    switching = [
        (
            f"{row['force_n']:g}",
            row["direction"],
            f"{row['velocity_swing_mm_s']:.3g}",
            f"{row['load_pressure_swing_mpa']:.3g}",
            f"{row['max_error_deg']:.3f}",
        )
        for row in study.switching
    ]
    load = "disturbance (N)"
    return "\n".join(
        [
            "# Full against reduced order of the cylinder",
            "",
            "The disturbance comes on top of the scenario's load; positive loads P_1.",
            "",
            "## Tracking",
            "",
            *markdown_table(
                (
                    *("order", load, "rms error (deg)", "largest error (deg)"),
                    *("change of command (rpm/sample)", "P_L (MPa)", "P_1 (MPa)", "P_2 (MPa)"),
                ),
                tracking,
            ),
            "",
            "## Rod speed at the limit of the command",
            "",
            *markdown_table(
                ("order", "force (N)", "direction", "rod speed (mm/s)", "saturated (%)"), speeds
            ),
            "",
            "## Large-signal −3 dB",
            "",
            *markdown_table(("order", load, "bandwidth (Hz)"), bandwidth),
            "",
            "## Linearized: the oil's mode and the sampled loop",
            "",
            *markdown_table(
                (
                    *("order", load, "posture (deg)", "rod force (N)", "mode (Hz)"),
                    *("damping ratio", "phase margin (deg)", "gain margin"),
                    *("delay margin (ms)", "disk margin", "small-signal −3 dB (Hz)"),
                ),
                frequency,
            ),
            "",
            f"## Near the switching force, full order, {study.settings.switching_rate_deg_s:g} "
            "deg/s",
            "",
            *markdown_table(
                (
                    *("force (N)", "direction", "swing of the rod's velocity (mm/s)"),
                    *("swing of P_L (MPa)", "largest error (deg)"),
                ),
                switching,
            ),
            "",
            "## Findings",
            "",
            *_findings(study),
            "",
        ]
    )


def _findings(study: OrderStudy) -> list[str]:
    def extremes(rows: Rows, name: str, order: str) -> tuple[float, float]:
        values = [row[name] for row in rows if row["order"] == order]
        values = [value for value in values if not math.isnan(value)] or [math.nan]
        return min(values), max(values)

    def both(rows: Rows, name: str, form: str) -> str:
        texts = []
        for order in ORDERS:
            low, high = (number(value, form) for value in extremes(rows, name, order))
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
        found = f"at {min(forces):g}…{max(forces):g} N" if forces else "at none of the forces"
        lines.append(f"- Near the switching force the rod oscillates {found} when it {words}.")
    inside = [r for r in study.switching if r["oscillates"]]
    beside = [r for r in study.switching if not r["oscillates"] and r["direction"] == "in"]
    if inside and beside:
        lines.append(
            f"- There its velocity swings by up to "
            f"{max(r['velocity_swing_mm_s'] for r in inside):.0f} mm/s and P_L by "
            f"{max(r['load_pressure_swing_mpa'] for r in inside):.2f} MPa, but the error is at "
            f"most {max(r['max_error_deg'] for r in inside):.2f} deg, beside the zone "
            f"{max(r['max_error_deg'] for r in beside):.2f} deg: on average both chambers "
            f"carry, as if with the mean area."
        )
    return lines


def _crossing(row: Mapping[str, Any]) -> str:
    hz = row["bandwidth_hz"]
    return "none below Nyquist" if math.isnan(hz) else number(hz)


def _range(row: Mapping[str, Any], name: str) -> str:
    if f"{name}_min_mpa" not in row:
        return ""
    return f"{row[f'{name}_min_mpa']:.3f}…{row[f'{name}_max_mpa']:.3f}"
