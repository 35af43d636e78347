"""Verdict, metrics and reductions of 60 runs against a table made from their ``signals.csv``."""

import math

import pytest
from verdict_table import RUNS, verdict

from kneexo.analysis.tracking.reduced_tracking import track_basic_metrics
from kneexo.analysis.tracking.tracking import track
from kneexo.parameters import Scenario

NUMBERS = ("max_error_deg", "rms_error_deg")
SHARES = ("saturated_share", "pressure_over_rating_share", "power_over_rating_share")


def numbers(row):
    """The values of a row as numbers; nan for those that the run lacks."""
    return {name: math.nan if value is None else float(value) for name, value in row.items()}


def check(name):
    preset, values, right = RUNS[name].values()
    scenario = Scenario.preset(preset).changed(values)
    result = track(scenario)
    found = {"limit_cycle_deg": getattr(result.verdict.limit_cycle, "amplitude_deg", None)}
    found["rms_error_deg"] = result.metrics.rms_error_deg
    found |= {key: getattr(result.verdict, key) for key in right if key not in found}
    found, same, right = map(numbers, (found, verdict(result.run.columns, values), right))
    # The same run, by NumPy: the verdict has no other error than rounding.
    assert found == pytest.approx(same, rel=1e-9, nan_ok=True)
    # Another processor rounds differently: a share moves by samples, a largest error in time.
    for key in NUMBERS:
        assert found[key] == pytest.approx(right[key], rel=1e-3, abs=1e-4), key
    for key in (*SHARES, "relief_share"):
        assert found[key] == pytest.approx(right[key], abs=2e-3, nan_ok=True), key
    assert found["tracks"] == right["tracks"]
    # One definition for verdict, metrics and the metrics of a batch, which has no log.
    reduced = track_basic_metrics(scenario)
    for key in ("max_error_deg", *SHARES):
        assert getattr(result.metrics, key) == found[key], key
    for key in (*NUMBERS, "saturated_share"):
        assert reduced[key] == pytest.approx(found[key], rel=1e-9), key


@pytest.mark.slow(gate=13)
@pytest.mark.parametrize("name", RUNS)
def test_each_run_has_the_verdict_of_its_signals(name):
    check(name)


@pytest.mark.parametrize("span_s", ["4.1", "7.998"])
def test_a_run_of_less_than_two_periods_is_judged_whole(span_s):
    check(f"paper pid, sine of 4 s, {span_s} s")
