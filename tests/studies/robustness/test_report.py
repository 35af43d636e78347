import dataclasses
import math

import pytest
from robustness_cases import (
    LINEAR,
    POSITION,
    SMALL,
    UNITS,
    assessment,
    expected_summary,
)

from kneexo.parameters import (
    UncertaintySet,
)
from kneexo.parameters.paths import changed
from kneexo.studies.robustness.report import failed_runs, report
from kneexo.studies.robustness.study import (
    MERITS,
)

WORDS = {"mass_kg": "mass (kg)", "lag_s": "lag (s)", "latency_samples": "latency (samples)"}


def test_every_cell_of_the_report_is_in_the_visits(by_hand, tables, check_cells):
    findings, summary, corners, *effects = tables(report(by_hand))
    merits = ("max_error_deg", "bandwidth_hz", "disk_margin")
    chosen = [MERITS[merit].label for merit in merits]
    assert findings == [summary[0], *(row for row in summary if row[0] in chosen)]
    fails = {math.inf: "fails", -math.inf: "fails"}
    check_cells(
        summary,
        [
            [MERITS[merit].label, *(fails.get(v, v) for v in expected_summary(merit))]
            for merit in POSITION
        ],
    )
    assert corners[0] == ["value", *(MERITS[merit].label for merit in merits)]
    check_cells(
        corners,
        [
            ["mass (kg)", 1.4, 1.8, 1.8],
            ["lag (s)", 0.005, 0.02, 0.02],
            ["latency (samples)", 0.0, 1.0, 1.0],
            ["**the metric there**", 2.3, 0.6 * 0.3, 0.6 * 0.7],
        ],
    )
    assert len(effects) == 3
    alone = {
        "mass (kg)": (1.1, 0.8),
        "lag (s)": (0.7, 1.6),
        "latency (samples)": (1.0, 1.2, 1.25),
    }
    correlations = by_hand.results()["rank_correlation"]
    for table, merit in zip(effects, ("rms_error_deg", *merits[1:]), strict=True):
        assert table[0][0] == MERITS[merit].label
        assert [*table[0][1:]] == ["ρ", "alone", *(["linear"] if merit in LINEAR else [])]
        by_name = {row[0]: row[1:] for row in table[1:]}
        strengths = [abs(float(row[1].removesuffix("*"))) for row in table[1:]]
        assert strengths == sorted(strengths, reverse=True)
        for n, (path, values) in enumerate(correlations[merit].items()):
            name = WORDS[path.rpartition(".")[2]]
            rank, ends, *linear = by_name[name]
            assert rank == f"{values:.2f}" + ("*" if n == 2 else "")
            shown = [float(value) for value in ends.split(" / ")]
            assert shown == pytest.approx([UNITS[merit] * v for v in alone[name]], rel=1e-3)
            if merit in LINEAR:
                (cell,) = linear
                assert cell == "" if n == 2 else f"{LINEAR[merit][n]:+.3g}"


def test_the_screen_has_the_findings(by_hand, check_screen):
    text = report(by_hand)
    lines = [" ".join(line.split()) for line in check_screen(text)]
    assert "disk margin 0.7 0.84 0.63 1.33 0.63 0.42" in lines[2:8]
    counts = "1 of 5 samples, 0 of 3 corners, 0 of 7 plants with one value changed."
    assert f"- Failed in part or unstable: {counts}\n" in text
    assert (
        "rank correlation: rms error (deg): lag (s) 1.00; bandwidth (Hz): lag (s) 1.00; disk"
        in text
    )
    assert "disk margin: lag (s) 1.00.\n" in text


def test_the_words_count_as_the_results_do(by_hand):
    text = report(by_hand)
    assert "Controller smc, reference sine 10 … 70 deg, 30 s. 3 uncertain values; the" in text
    assert "believes in the nominal plant. Values that the scenario does not have" in text
    assert "With 95 % confidence at least" in text
    assert "of the 5 samples (seed 2020)" in text
    assert "No local sensitivity: tracking: too long." in text
    assert "1 of the 5 samples (20 %) fail in part" in text
    assert "- 1 times: t = 1 s: out of range" in text
    assert "None of the 3 corners fails" in text
    assert f"at least {100.0 * 0.05 ** (1 / 5):.4g} % of all plants" in text
    assert "worse than every corner visited in: largest error (deg)." in text
    assert "3 of 12 corners" in text
    assert "left out: knee torque (N·m)." in text


def test_values_above_chance_and_those_that_the_controller_knows_are_reported(by_hand):
    known = SMALL.values["plant.pump.lag_s"].model_copy(update={"known": True})
    samples = tuple(assessment(n, 1.5, 0.01 + 1e-3 * n, n % 3) for n in range(1, 8))
    text = report(
        dataclasses.replace(
            by_hand,
            uncertainty=UncertaintySet(values=SMALL.values | {"plant.pump.lag_s": known}),
            samples=(*samples, assessment(8.0, 1.6, 0.02, 0)),
            local_failures=(),
        )
    )
    assert "believes in the nominal plant, but knows lag (s)." in text
    # Of eight samples √(3.84/7) = 0.74 may be chance: ρ is 1 of the lag, 0.58 of the mass.
    idle = "Not above chance (95 %): mass (kg), latency (samples)."
    assert text.count(idle) == 3
    assert "No local sensitivity" not in text


def test_unstable_loops_whose_runs_end_are_counted_with_their_errors(by_hand):
    lost = {"stable": False, "disk_margin": math.nan}
    unstable = [assessment(n, 1.5, 0.01, 0, **lost) for n in (3.0, 7.0, 5.0)]
    stopped = assessment(1.0, 1.5, 0.01, 0, **lost, max_error_deg=math.nan)
    text = report(dataclasses.replace(by_hand, corners=(*unstable, stopped)))
    assert "4 of the 4 corners (100 %) fail in part or are unstable" in text
    assert "- 3 runs of those 4 unstable loops go to their end all the same, with" in text
    assert "largest errors of 3 … 7 deg" in text


def test_failures_are_reported_as_a_share(by_hand):
    two = tuple(
        dataclasses.replace(assessment, metrics=by_hand.samples[3].metrics)
        for assessment in by_hand.samples[:2]
    )
    text = report(dataclasses.replace(by_hand, samples=two + by_hand.samples[2:3] * 8))
    assert "2 of the 10 samples (20 %) fail in part" in text


def test_a_failed_run_is_named_with_the_command_that_repeats_it(by_hand):
    error = "t = 1 s: out of range"
    (run,) = failed_runs(by_hand).items()
    values = {
        "nominal": by_hand.scenario.plant,
        "plant.cylinder.mass_kg": 1.75,
        "plant.pump.lag_s": 0.011,
        "bus.latency_samples": 2,
    }
    assert run == (error, changed(by_hand.scenario, values))
    command = "kneexo simulate failure_1.yaml --out failure_1"
    assert f"- 1 times: {error} (repeat: `{command}`)\n" in report(by_hand)


def test_only_tracking_runs_of_plants_that_exist_are_repeated(by_hand):
    slow = assessment(1.0, 1.5, 0.01, 0, bandwidth_failure="no bandwidth")
    impossible = assessment(1.0, -1.5, 0.01, 0, tracking_failure="mass_kg = -1.5 kg")
    first = assessment(1.0, 1.5, 0.01, 0, tracking_failure="t = 2 s: out")
    second = assessment(1.0, 1.6, 0.01, 0, tracking_failure="t = 3 s: out")
    result = dataclasses.replace(
        by_hand, samples=(slow, impossible, first), corners=(second, first)
    )
    runs = failed_runs(result)
    masses = {error: run.plant.cylinder.mass_kg for error, run in runs.items()}
    assert masses == {"t = 2 s: out": 1.5, "t = 3 s: out": 1.6}
    text = report(result)
    assert "- 1 times: no bandwidth\n" in text
    assert "- 1 times: mass_kg = -1.5 kg\n" in text
    assert "- 1 times: t = 2 s: out (repeat: `kneexo simulate failure_1.yaml --out f" in text
    assert "- 2 times: t = 3 s: out (repeat: `kneexo simulate failure_2.yaml --out f" in text
