"""Levels of residuals against counters step by step, and healthy runs over an uncertainty set."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given, strategies as st

from kneexo.analysis.faults.thresholds import (
    MARGIN,
    DetectorThresholds,
    detector_thresholds,
    level_of,
)
from kneexo.diagrams.signals import columns
from kneexo.errors import ParameterError
from kneexo.parameters import ProtectionParameters, Scenario, Uncertainty, UncertaintySet
from kneexo.parameters.device.safety_states import DETECTORS
from kneexo.parameters.uncertainty import draw
from kneexo.simulation import simulate

SHORT = Scenario(
    protection={"overdue_s": 0.1}, plant={"load": "knee"}, simulation={"duration_s": 0.3}
)
MASSES = UncertaintySet(values={"plant.cylinder.mass_kg": Uncertainty(low=1.4, high=1.8)})


def trips(residual, threshold, samples):
    """The counter of `FaultDetectors`, one sample after the other."""
    count = 0
    for value in residual:
        count = max(count + (1 if value >= threshold else -1), 0)
        if count == samples:
            return True
    return False


@given(st.lists(st.integers(0, 6), min_size=1, max_size=25), st.integers(1, 6))
def test_the_level_is_the_largest_threshold_that_trips(values, samples):
    residual = np.array(values, dtype=float)
    tripping = [level for level in sorted(set(values)) if trips(values, level, samples)]
    assert level_of(residual, samples) == max(tripping, default=0.0)


def test_the_text_and_the_figure_have_the_levels():
    levels = {name: np.array([[1.0, 2.0, 4.0], [3.0, 3.0, 5.0]]) for name in DETECTORS}
    result = DetectorThresholds(
        ProtectionParameters(flow_mm=3.5), 4, 1, 0.5, {"flow": 1, "start": 2}, (0.01, 0.002), levels
    )
    assert result.largest("flow") == 4.0
    assert [result.false_alarms("flow", threshold) for threshold in (0.5, 3.0, 4.0)] == [3, 1, 0]
    text = str(result).splitlines()
    assert text[0] == "4 healthy runs, 0.5 h, 1 failed, 3 false alarms"
    assert text[4].split() == ["flow", "4", f"{MARGIN * 4:g}", "3.5", "1", "mm"]
    assert text[-1] == "start: 2"
    ax = result.plot()
    flow = ax.get_lines()[list(DETECTORS).index("flow")]
    np.testing.assert_allclose(flow.get_xdata(), [2.0, 10.0])
    np.testing.assert_allclose(flow.get_ydata(), [5 / 3.5, 4 / 3.5])
    limit = ax.get_lines()[-1]  # above it a detector raises a false alarm
    np.testing.assert_array_equal(limit.get_ydata(), [1.0, 1.0])
    assert limit.get_zorder() < flow.get_zorder()
    plt.close(ax.figure)


def test_the_levels_of_a_run_are_those_of_its_residuals():
    result = detector_thresholds(SHORT, MASSES, 1, trips_s=[0.002], seed=4)
    (mass,) = (values["plant.cylinder.mass_kg"] for values in draw(MASSES, 1, 4))
    run = simulate(SHORT.changed({"plant.cylinder.mass_kg": mass}), signals=("residuals",))
    found = np.array([run[name] for name in columns(["residuals"])])
    rpm, mm = found[list(DETECTORS).index("speed"), 50:] * 30 / np.pi, 1e3 * found[2]
    np.testing.assert_allclose(result.levels["speed"][1], rpm.max(), rtol=1e-12)
    np.testing.assert_allclose(result.levels["flow"][1], mm.max(), rtol=1e-12)
    assert result.levels["speed"][0] < rpm.max()
    assert (dict(result.alarms), result.hours) == ({}, pytest.approx(0.3 / 3600))


@pytest.mark.slow
def test_a_false_alarm_is_counted_and_its_level_is_that_of_the_whole_run():
    free = detector_thresholds(SHORT, MASSES, 2)
    less = 0.9 * np.min(free.levels["speed"])
    strict = detector_thresholds(SHORT.changed({"protection.speed_rpm": less}), MASSES, 2)
    assert dict(strict.alarms) == {"speed": 2}
    np.testing.assert_array_equal(strict.levels["speed"], free.levels["speed"])


@pytest.mark.parametrize(
    ("values", "trips_s", "message"),
    [
        ({"protection.overdue_s": 0.3}, [], r"protection.overdue_s = 0.3 s: must be < 0.3 s, the "),
        ({"protection.trip_s": 1.0}, [], r"protection.trip_s = 1 s: must be < 0.3 s"),
        ({}, [0.1, 0.3], r"^trips_s = 0.3 s: must be < 0.3 s"),
        ({}, [-1.0], r"trips_s.0 = -1 s is out of range: must be finite and >= 0"),
    ],
)
def test_a_run_too_short_for_a_level_is_refused(values, trips_s, message):
    with pytest.raises(ParameterError, match=message):
        detector_thresholds(SHORT.changed(values), MASSES, 1, trips_s=trips_s)


@pytest.mark.slow
def test_following_and_speed_have_no_level_during_the_start():
    """A step at 0.1 s leaves the knee 4° behind. That counts if the start has ended before."""
    step = {"kind": "step", "start_deg": 40.0, "end_deg": 44.0, "time_s": 0.1}
    late = SHORT.changed({"protection.overdue_s": 1.0, "reference": step})
    late = late.changed({"simulation.duration_s": 1.5})
    early = late.changed({"protection.overdue_s": 0.1, "protection.speed_rpm": 1e4})
    levels = [detector_thresholds(s, MASSES, 1).largest("following") for s in (late, early)]
    assert levels[0] < 0.5 < 3.0 < levels[1] < 4.5


@pytest.mark.slow
def test_a_motion_that_the_pump_cannot_follow_is_an_alarm():
    fast = {"reference": {"frequency_hz": 1.0}, "simulation.duration_s": 1.5}
    result = detector_thresholds(SHORT.changed(fast), MASSES, 1)
    assert set(result.alarms) <= {"speed", "following"}
    assert sum(result.alarms.values()) == 1


def test_runs_without_protection_or_number_are_refused():
    with pytest.raises(ParameterError, match="protection: is missing; add protection"):
        detector_thresholds(Scenario())
    for runs, line in (
        (0, "runs = 0 is out of range: must be finite and >= 1"),
        (1.5, "runs = 1.5: must be a whole number"),
        (10**9, "runs = 1000000000 is out of range"),
    ):
        with pytest.raises(ParameterError, match=line):
            detector_thresholds(SHORT, MASSES, runs)
    wrong = {"values": {"plant.cylinder.mas_kg": Uncertainty(low=1.0, high=2.0)}}
    with pytest.raises(ParameterError, match=r"did you mean plant.cylinder.mass_kg"):
        detector_thresholds(SHORT, wrong)
