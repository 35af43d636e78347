import dataclasses
import math

import numpy as np

from kneexo.parameters import UNCERTAIN_KNEE
from kneexo.studies.order.report import report
from kneexo.studies.order.study import (
    OrderResult,
    OrderSettings,
)


def limits(row, name):
    """Least and largest pressure, to a thousandth of a MPa; empty where the order has none."""
    ends = [getattr(row, f"{name}_{end}_mpa") for end in ("min", "max")]
    return "" if ends[0] is None else f"{ends[0]:.3f}…{ends[1]:.3f}"


def small_signal(row, name):
    if row.failure or not row.stable:
        return row.failure or "unstable"
    return "none below Nyquist" if math.isnan(getattr(row, name)) else getattr(row, name)


def verdict(disk_margin):
    if math.isnan(disk_margin):
        return "unstable"
    return "sound" if disk_margin >= 0.5 else "small margin"


def test_every_cell_of_the_report_is_in_its_row(study, tables, check_cells):
    tracking, speeds, bandwidth, frequency, switching = tables(report(study))

    def case(row):
        return {"order": row.order, "disturbance (N)": row.disturbance_n}

    check_cells(
        tracking,
        [
            case(row)
            | {
                "rms error (deg)": row.rms_error_deg,
                "largest error (deg)": row.max_error_deg,
                "change of command (rpm/sample)": row.mean_command_change_rpm,
                "P_L (MPa)": limits(row, "load_pressure"),
                "P_1 (MPa)": limits(row, "cap"),
                "P_2 (MPa)": limits(row, "rod_side"),
            }
            for row in study.tracking
        ],
    )
    check_cells(
        speeds,
        [
            {
                "order": row.order,
                "force (N)": row.force_n,
                "direction": row.direction,
                "rod speed (mm/s)": row.rod_speed_mm_s,
                "saturated (%)": 100.0 * row.saturated_share,
            }
            for row in study.speeds
        ],
    )
    check_cells(
        bandwidth, [case(row) | {"bandwidth (Hz)": row.bandwidth_hz} for row in study.bandwidth]
    )
    check_cells(
        frequency,
        [
            case(row)
            | {
                "posture (deg)": row.posture_deg,
                "rod force (N)": row.rod_force_n,
                "mode (Hz)": row.mode_hz,
                "damping ratio": row.mode_damping,
                "phase margin (deg)": row.phase_margin_deg,
                "gain margin": row.gain_margin,
                "delay margin (ms)": row.delay_margin_ms,
                "disk margin": row.disk_margin,
                "small-signal −3 dB, with feedforward (Hz)": small_signal(row, "bandwidth_hz"),
                "complementary sensitivity −3 dB (Hz)": small_signal(
                    row, "complementary_sensitivity_bandwidth_hz"
                ),
                "verdict": verdict(row.disk_margin),
            }
            for row in study.frequency
        ],
    )
    check_cells(
        switching,
        [
            {
                "force (N)": row.force_n,
                "direction": row.direction,
                "swing of the rod's velocity (mm/s)": row.velocity_swing_mm_s,
                "swing of P_L (MPa)": row.load_pressure_swing_mpa,
                "largest error (deg)": row.max_error_deg,
                "verdict": "oscillates" if row.oscillates else "calm",
            }
            for row in study.switching
        ],
    )
    rate = study.settings.switching_rate_deg_s
    assert f"## Near the switching force, full order, {rate:g} deg/s\n" in report(study)


def test_the_findings_have_the_extremes_of_each_order(study):
    text = report(study)
    for part, name, form in (
        ("tracking", "rms_error_deg", ".3f"),
        ("speeds", "rod_speed_mm_s", ".1f"),
        ("bandwidth", "bandwidth_hz", ".3f"),
        ("frequency", "mode_hz", ".0f"),
        ("frequency", "mode_damping", ".2g"),
        ("frequency", "phase_margin_deg", ".1f"),
        ("frequency", "disk_margin", ".2f"),
    ):
        extremes = []
        for order in ("reduced", "full"):
            values = [getattr(row, name) for row in getattr(study, part) if row.order == order]
            ends = sorted({f"{f(values):{form}}" for f in (np.nanmin, np.nanmax)}, key=float)
            extremes.append(f"{order} {'…'.join(ends)}")
        assert ", ".join(extremes) in text
    assert "the paper measured 0.21 Hz" in text
    assert study.oscillating_n("in") == [16.0]
    assert study.oscillating_n("out") == []
    assert "oscillates at 16…16 N when it retracts" in text
    assert "oscillates at none of the forces when it extends" in text


def test_the_screen_has_the_findings(study, check_screen):
    lines = check_screen(report(study))
    assert lines[2].startswith("Rms tracking error in deg: reduced ")


def test_the_zone_of_oscillation_is_compared_with_what_lies_beside_it(by_hand):
    # Forces of 6 and 16 N, inward and outward; it oscillates at 16 N inward alone.
    beside, inside, *_ = by_hand.switching
    numbers = (
        f"swings by up to {inside.velocity_swing_mm_s:.0f} mm/s and "
        f"P_L by {inside.load_pressure_swing_mpa:.2f} MPa, but the error is at most "
        f"{inside.max_error_deg:.2f} deg, beside the zone {beside.max_error_deg:.2f} deg"
    )
    assert numbers in report(by_hand)
    still = dataclasses.replace(by_hand, switching=(beside,))
    assert "beside the zone" not in report(still)


def test_a_comparison_without_forces_has_dashes_in_its_report():
    settings = OrderSettings(disturbances_n=(0.0,), switching_forces_n=(0.0,))
    empty = OrderResult((), (), (), (), (), UNCERTAIN_KNEE, settings)
    assert "Rod speed at the limit in mm/s: reduced –, full –." in report(empty)
