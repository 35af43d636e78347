import dataclasses
import math

from robustness_cases import (
    SMALL,
    assessment,
)

from kneexo.parameters import (
    UncertaintySet,
)
from kneexo.parameters.paths import changed
from kneexo.studies.robustness.report import failed_runs, report


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


def test_a_failed_run_has_the_scenario_that_repeats_it(by_hand):
    values = {
        "nominal": by_hand.scenario.plant,
        "plant.cylinder.mass_kg": 1.75,
        "plant.pump.lag_s": 0.011,
        "bus.latency_samples": 2,
    }
    expected = {"t = 1 s: out of range": changed(by_hand.scenario, values)}
    assert failed_runs(by_hand) == expected


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
