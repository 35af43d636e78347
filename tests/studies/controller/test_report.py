import math

from controller_cases import (
    GRID,
)

from kneexo.parameters import (
    Scenario,
)
from kneexo.studies.controller.report import report


def test_every_cell_of_the_report_is_in_the_study(by_hand, tables, check_cells):
    claims, *lines, limit_cycle = tables(report(by_hand))
    for row, claim in zip(claims[1:], by_hand.claims(), strict=True):
        assert row[2] == str(claim.cases)
        assert row[5] == str(claim.sound_cases)
        assert row[4] == f"**{claim.verdict}**"
        for cell, share in ((row[3], claim.share), (row[6], claim.sound_share)):
            assert cell == ("–" if math.isnan(share) else f"{100 * share:.0f} %")
    assert claims[0][5] == "between loops of disk margin ≥ 0.5: cases"
    assert [row[0] for row in claims[1:]] == [f"“{claim.quote}”" for claim in by_hand.claims()]
    assert [row[1] for row in claims[1:]] == [claim.case for claim in by_hand.claims()]
    for table in lines:
        assert table[0][1:] == [
            *("k/Φ (1/s)", "max error (deg)", "command change (rpm/sample)", "saturated"),
            "max error at 1 Hz (deg)",
            *(f"{size}° step, settling to ±0.2° (s)" for size in (2, 20)),
            *("disk margin", "phase margin (deg)", "verdict"),
        ]
    # Along λ, Φ and η through the default: λ = 20, Φ = 3.2, η = 2.8e5.
    assert by_hand.centre == (1, 2, 1)
    columns = (
        "max_error_deg",
        "mean_command_change_rpm",
        "saturated_share",
        "fast_max_error_deg",
        "settling_s",
        "large_settling_s",
        "disk_margin",
        "phase_margin_deg",
    )
    beta = math.sqrt(1.8 / 1.4)
    axes = (GRID.lambdas_per_s, GRID.phis_m_s2, GRID.etas_m_s3)
    for axis, (shown, along) in enumerate(zip(lines, axes, strict=True)):
        rows = []
        for n, value in enumerate(along):
            at = tuple(n if i == axis else c for i, c in enumerate((1, 2, 1)))
            slope = beta * GRID.etas_m_s3[at[2]] / GRID.phis_m_s2[at[1]]
            cells = [float(by_hand.values[name][at]) for name in columns]
            share, margin = cells[2], cells[6]
            cells[2] = "–" if math.isnan(share) else f"{100 * share:.0f} %"
            verdict = "sound" if margin >= 0.5 else "small margin"
            rows.append([value, slope, *cells, "unstable" if math.isnan(margin) else verdict])
        check_cells(shown, rows)
        assert shown[0][0] == ("λ (1/s)", "Φ (m/s²)", "η (m/s³)")[axis]
    per_sample = math.pi / 30.0 / 0.002  # rad/s² of 1 rpm in a sample
    check_cells(
        limit_cycle,
        [
            [
                case.lambda_per_s,
                case.variant,
                "stable" if case.stable else "unstable",
                case.disk_margin,
                case.max_error_deg,
                case.mean_command_change_rpm,
                case.mean_command_change_rpm * per_sample,
                case.oscillation_at_rest_deg,
            ]
            for case in by_hand.limit_cycle
        ],
    )


def test_the_screen_has_the_findings(by_hand, check_screen):
    text = report(by_hand)
    lines = check_screen(text)
    slope, layer, rate = (claim.verdict for claim in by_hand.claims())
    assert lines[2] == f"The paper's claim on λ is {slope}, on Φ {layer}, on η {rate}."
    for claim in by_hand.claims():
        share, sound = (
            "–" if math.isnan(value) else f"{100 * value:.0f} %"
            for value in (claim.share, claim.sound_share)
        )
        assert (
            f"- “{claim.quote}”: holds in {share} of {claim.cases} cases; "
            f"between loops of disk margin ≥ 0.5 in {sound} of {claim.sound_cases}."
        ) in text


def test_the_words_have_the_largest_error_of_a_stable_loop(by_hand):
    text = report(by_hand)
    limit = Scenario().plant.pump.acceleration_limit_rad_s2
    demand = 31.0 * math.pi / 30.0 / 0.002 / limit
    for said in (
        "1 of 30 points have a run that failed",
        f"mean change is {demand:.2g} times",
        "## A limit cycle: T_f = 8 ms, k/Φ = 10000 1/s",
        "brings a step of 2° to within ±0.2° of its end sooner",
        "Φ at least 3 times larger or smaller",
        "more than 2 times as much per sample",
        "less than 1 % of its samples saturated",
        "errs by up to 0.33° (T_f = 20 ms, k/Φ = 10000 1/s)",
        "The step of 20° settles to the same ±0.2° in",
        "λ, at Φ (m/s²) = 3.2, η (m/s³) = 280000\n",
        "Φ, at λ (1/s) = 20, η (m/s³) = 280000\n",
        "η, at λ (1/s) = 20, Φ (m/s²) = 3.2\n",
    ):
        assert said in text
