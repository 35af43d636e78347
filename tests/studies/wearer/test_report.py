"""Each number of the report on the study `wearer` is that of its row."""

import math
from dataclasses import replace

import pytest

from kneexo.parameters.paths import changed
from kneexo.studies.wearer.report import report
from kneexo.studies.wearer.study import DEVICES

SIZED = "sized pump, higher gains"
WEAK = {
    "rms torque (N·m)": "rms_torque_n_m",
    "assistance ratio": "assistance_ratio",
    "wearer gives (W)": "power_from_wearer_w",
    "wearer gets (W)": "power_to_wearer_w",
    "deviation of the leg from its path (deg)": "deviation_deg",
}


def motion(row):
    if math.isnan(row.rise_time_s):
        return f"walking, {row.cadence_hz:g} Hz"
    return f"rising in {row.rise_time_s:g} s"


def torques(row):
    numbers = row.rms_torque_n_m, row.mean_torque_n_m, row.peak_torque_n_m
    rms, mean, peak = (f"{value:.3g}" for value in numbers)
    return f"{rms} ({mean}, {peak})" + (" †" if row.lowest_pressure_pa < -1e5 else "")


def test_every_cell_of_the_report_is_in_its_row(by_hand, tables, check_cells):
    follow, devices, margins, weak = tables(report(by_hand))
    motions = ["walking, 0.5 Hz", "walking, 2 Hz", "rising in 0.8 s"]
    assert follow[0] == ["design", *motions]
    assert len(follow) == 11
    cells = {
        (line[0], head): cell
        for line in follow[1:]
        for head, cell in zip(follow[0][1:], line[1:], strict=True)
    }
    assert cells == {(row.design, motion(row)): torques(row) for row in by_hand.transparency}
    assert [tuple(line) for line in devices[1:]] == list(DEVICES)
    check_cells(
        margins,
        [
            {
                "design": row.design,
                "disk margin": row.disk_margin,
                "gain margin": row.gain_margin,
                "verdict": "sound" if row.disk_margin >= 0.5 else "small margin",
                "stable virtual springs (N·m/rad)": f"{1 + k}…2350",
                "felt stiffness without desired torque, at 1 Hz (N·m/rad)": row.felt_n_m_per_rad,
            }
            for k, row in enumerate(by_hand.margins)
        ],
    )
    check_cells(
        weak,
        [
            {"design": row.design, "wearer": row.wearer, "motion": motion(row), "mode": row.mode}
            | {head: getattr(row, name) for head, name in WEAK.items()}
            | {"motor at its limit (%)": 100.0 * row.saturated_share}
            for row in by_hand.help
        ],
    )
    assert {row.disk_margin >= 0.5 for row in by_hand.margins} == {True, False}


def test_the_screen_has_the_answers(by_hand, check_screen):
    lines = check_screen(report(by_hand))
    text = " ".join(line.strip() for line in lines)
    rows = {(row.design, motion(row)): row for row in by_hand.transparency}

    def rms(design, at="walking, 0.5 Hz"):
        return rows[design, at].rms_torque_n_m

    paper = rows["paper's pump", "walking, 0.5 Hz"]
    rising = rms("paper's pump", "rising in 0.8 s")
    assert (
        f"The leg must push the paper's knee with {paper.rms_torque_n_m:.3g} N·m rms (peak "
        f"{paper.peak_torque_n_m:.3g}) to walk at 0.5 Hz, and with {rising:.3g} N·m to stand up in "
        f"0.8 s."
    ) in text
    alone = rms("paper's pump, higher gains")
    limitless = rms("motor without limits")
    assert (
        f"With the same control and a motor without limits the torque falls to {limitless:.3g} N·m."
    ) in text
    sized = rows[SIZED, "walking, 0.5 Hz"]
    assert (
        f"With higher gains {sized.rms_torque_n_m:.3g} N·m remain (mean "
        f"{sized.mean_torque_n_m:.3g}) at 16.3 times the flow, "
        f"{rms('larger pump, higher gains'):.3g} N·m at 10 times the flow, and {alone:.3g} N·m "
        f"with the paper's pump."
    ) in text
    inertia = rms("sized pump, inertia of the shank")
    assert f"the gains must be lower, and {inertia:.3g} N·m remain." in text
    margins = (
        "The least disk margin with six legs is 0.40, 0.60 with higher gains, and 0.80 with the "
        "inertia."
    )
    assert margins in text
    average = [row for row in by_hand.help if row.wearer == "average"]
    off = [row.deviation_deg for row in average if row.design == "paper's pump"]
    assert (
        f"by at most {min(off):.1f}…{max(off):.1f}°, depending on the mode, with the paper's "
        f"pump. With the {SIZED}: " in text
    )
    for row in by_hand.help:
        for shown in (
            f"{row.deviation_deg:.1f}° ({row.mode})",
            f"{row.assistance_ratio:.2f} ({row.mode})",
        ):
            assert (shown in text) == (row.wearer == "average" and row.design == SIZED)
    assert "Failed runs: 1." in text


def test_a_dagger_marks_the_runs_below_vacuum(by_hand):
    assert "† The pressure of a chamber falls below -0.1 MPa" in report(by_hand)
    rows = tuple(replace(row, lowest_pressure_pa=-0.99e5) for row in by_hand.transparency)
    assert "†" not in report(replace(by_hand, transparency=rows))


def test_the_assumptions_have_the_seal_friction(by_hand):
    stiff = changed(by_hand.scenario, {"plant.full_order.coulomb_friction_n": 12.0})
    reduced = changed(by_hand.scenario, {"plant.full_order": None})
    text = " ".join(report(replace(by_hand, scenario=stiff)).split())
    assert "seal friction of the cylinder is 12 N. The preset `wearer` has 40 N." in text
    assert "seal friction" not in report(replace(by_hand, scenario=reduced))


def test_a_failed_run_has_its_reason_and_dashes(by_hand):
    text = report(by_hand)
    assert "- sized pump, heavy, walking, 0.5 Hz, zero torque: left the range\n" in text
    assert "| sized pump | heavy | walking, 0.5 Hz | zero torque | – | – |" in text


@pytest.mark.slow
def test_the_report_on_runs_has_the_screen(small, check_screen):
    check_screen(report(small))
