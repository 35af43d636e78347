"""The study `faults`: rows against single runs, verdicts, refusals, and the words of the report."""

import math
from dataclasses import replace

import numpy as np
import pytest
from faults_cases import DEAD, FAST, QUICK, SWAPPED, made_up, row

from kneexo.analysis import fault_survival
from kneexo.errors import ParameterError
from kneexo.parameters import UNCERTAIN_KNEE, FaultParameters, PidParameters
from kneexo.parameters.device.safety_states import REASONS
from kneexo.simulation import simulate
from kneexo.studies.faults import FaultsSettings, faults_study
from kneexo.studies.faults.faults import Rest, _controlled, _rest, _safe_after, _starts
from kneexo.studies.faults.figures import plot_worst_case
from kneexo.studies.faults.report import report


class SimpleRun(dict):
    """Columns with times, as a `Run` has them."""

    def __init__(self, columns, time_s):
        super().__init__(columns)
        self.time_s = time_s


@pytest.mark.slow
def test_a_row_is_that_of_single_runs(small):
    """Without protection, with it, and the critical duration; the swapped phases end the run."""
    result, _ = small
    assert [r.start_s for r in result.rows] == [5.0, 7.5, 5.0, 7.5]
    assert [r.alone.complete for r in result.rows] == [True, True, False, True]
    for found, fault in zip(result.rows, (DEAD, DEAD, SWAPPED, SWAPPED), strict=True):
        scenario = FAST.changed({"simulation.duration_s": found.start_s + 2.0})
        healthy = np.degrees(simulate(scenario)["knee_angle_rad"])
        faulty = scenario.changed({"faults": (fault.changed({"start_s": found.start_s}),)})
        (case,) = fault_survival(scenario, [fault], [found.start_s], observed_s=2.0).cases
        assert found.censored == case.censored
        assert found.critical_duration_s == case.critical_duration_s
        if found.alone.complete:
            run = simulate(faulty)
            deviation = np.degrees(run["knee_angle_rad"]) - healthy
            assert found.alone.deviation_deg == pytest.approx(np.abs(deviation).max(), rel=1e-12)
            assert found.flexes == (deviation[np.abs(deviation).argmax()] > 0.0)
            late = run.time_s >= found.start_s - 1e-9
            torque = np.abs(run["rod_force_n"] * run["moment_arm_m"])[late].max()
            assert found.alone.torque_n_m == pytest.approx(torque, rel=1e-12)
            assert found.alone.pressure_mpa == 1e-6 * np.abs(run["load_pressure_pa"])[late].max()
        run = simulate(faulty.changed({"protection": {}}))
        stopped = np.flatnonzero(run["safety_reason"])[0]
        assert found.detector == REASONS[int(run["safety_reason"][stopped])]
        assert found.detected_after_s == pytest.approx(run.time_s[stopped] - found.start_s)
        safe = np.flatnonzero(run["safety_state"] == 3.0)[0]
        assert found.safe_after_s == pytest.approx(run.time_s[safe] - found.start_s)
        moved = np.abs(np.degrees(run["knee_angle_rad"]) - healthy)[: safe + 1].max()
        assert found.protected.deviation_deg == pytest.approx(moved, rel=1e-12)


@pytest.mark.slow
def test_an_emergency_stop_is_that_of_a_single_run(small):
    result, _ = small
    scenario = FAST.changed({"protection": {}, "simulation.duration_s": 9.5})
    assert [stop.start_s for stop in result.stops] == [5.0, 7.5]
    for stop in result.stops:
        scenario = scenario.changed({"simulation.duration_s": stop.start_s + 2.0})
        press = {"place": "emergency_stop", "kind": "value", "size": 1.0, "start_s": stop.start_s}
        run = simulate(scenario.changed({"faults": (press,)}))
        first = round(stop.start_s / 0.002)
        # Each record is that before the update of its sample: the stop begins one sample later.
        speed = abs(run["motor_speed_command_rad_s"][first])
        ramp = math.ceil(speed / (scenario.protection.stop_rad_s2 * 0.002))
        assert stop.safe_after_s >= 0.002 * (ramp + 1)
        last = first + round(stop.safe_after_s / 0.002)
        assert [run["safety_state"][n] for n in (first, last - 1, last)] == [1.0, 2.0, 3.0]
        assert abs(run["motor_speed_rad_s"][last]) < 30.0 * math.pi / 30.0
        angle = np.degrees(run["knee_angle_rad"][first : last + 1])
        assert stop.knee_deg == angle[0]
        assert stop.turn_deg == pytest.approx(np.abs(angle - angle[0]).max(), rel=1e-12)
        torque = np.abs(run["rod_force_n"] * run["moment_arm_m"])[first : last + 1]
        assert stop.torque_n_m == pytest.approx(torque.max(), rel=1e-12)


@pytest.mark.slow(gate=0)
def test_the_safe_states_of_the_plant_are_compared_and_each_is_that_of_a_single_run():
    """A drive adds 1,000 rpm; the oil at rest turns a released motor a little."""
    adds = FaultParameters(place="command", kind="offset", size=1000.0)
    settings = QUICK.changed({"faults": (adds,), "onsets": 1, "observed_s": 1.3})
    base = FAST.changed({"plant.motor": {}, "protection": {"safe_state": "torque_off"}})
    result = faults_study(base, settings)
    assert result.safe_states == ("torque_off", "zero_speed", "dynamic_brake")
    assert [row.safe_state for row in result.all_rows] == list(result.safe_states)
    assert [stop.safe_state for stop in result.stops] == list(result.safe_states)
    assert [row.safe_state for row in result.rows] == ["torque_off"]
    adds = adds.changed({"start_s": 5.0})
    press = FaultParameters(place="emergency_stop", kind="value", size=1.0, start_s=5.0)
    for found, fault in ((result.rows[0], adds), (result.stops[0], press)):
        values = {"faults": (fault,), "simulation.duration_s": 6.3}
        run = simulate(base.changed(values))
        safe = np.flatnonzero(run["safety_state"] == 4.0)[0]
        assert found.safe_after_s == pytest.approx(run.time_s[safe] - 5.0)
        rest = run.time_s[safe:] < 6.3 - 1e-9
        angle = np.degrees(run["knee_angle_rad"][safe:])[rest]
        turn, torque = found.rest.turn_deg, found.rest.torque_n_m
        assert turn == pytest.approx(np.abs(angle - angle[0]).max(), rel=1e-12)
        arms = (run["rod_force_n"] * run["moment_arm_m"])[safe:][rest]
        assert torque == pytest.approx(np.abs(arms).max(), rel=1e-12)
    run = simulate(base.changed({"faults": (adds,), "simulation.duration_s": 6.3}))
    drawn = result.traces["protected"]["knee_deg"]
    np.testing.assert_array_equal(drawn, np.degrees(run["knee_angle_rad"]))
    assert math.isnan(result.all_rows[1].rest.turn_deg)  # at zero speed the motor turns on
    assert result.all_rows[2].safe_after_s < 1.0
    chosen = settings.changed({"safe_states": ("dynamic_brake",)})
    assert faults_study(base, chosen).safe_states == ("dynamic_brake",)
    with pytest.raises(ParameterError, match="safe_state = bypass: the plant has no bypass"):
        faults_study(base, settings.changed({"safe_states": ("bypass",)}))


def test_the_rest_is_that_from_the_safe_motor_until_the_end_of_the_observation():
    """Safe at the sample 5.002; the knee then turns from 2° to 5° and back, against 3 N·m."""
    columns = {
        "knee_angle_rad": np.radians([1.0, 2.0, 5.0, 4.0, 9.0]),
        "interaction_torque_n_m": np.array([9.0, 1.0, -3.0, 2.0, 9.0]),
    }
    run = SimpleRun(columns, time_s=5.0 + 0.002 * np.arange(5))
    run.columns = columns
    found = _rest(run, 2, 5.008)
    assert found["turn_deg"] == pytest.approx(3.0)
    assert (found["torque_n_m"], found["complete"]) == (3.0, True)
    assert _rest(run, 2, 5.1)["complete"] is False
    for end in (None, 4):  # never safe, or at the end of the observation
        assert math.isnan(_rest(run, end, 5.008)["turn_deg"])


def test_a_motor_is_safe_when_it_stands_in_the_state_stopped():
    """The samples: operating, stopping, stopped at 31 rpm, stopped at 29 rpm."""
    columns = {
        "safety_state": np.array([1.0, 2.0, 3.0, 3.0]),
        "motor_speed_rad_s": np.array([0.0, 0.0, -31.0, -29.0]) * math.pi / 30.0,
    }
    run = SimpleRun(columns, time_s=np.array([4.998, 5.0, 5.002, 5.004]))
    after_s, end = _safe_after(run, FAST.changed({"protection": {}}), 5.0)
    assert (after_s, end) == (pytest.approx(0.004), 4)
    columns["safety_state"][2:] = 2.0
    assert _safe_after(run, FAST.changed({"protection": {}}), 5.0) == (math.inf, None)
    columns["safety_state"][2] = 4.0  # the bypass is open, whatever the motor does
    assert _safe_after(run, FAST.changed({"protection": {}}), 5.0)[1] == 3


@pytest.mark.slow
def test_a_motor_that_turns_on_after_an_overdue_stop_is_not_safe():
    """A drive that adds 2000 rpm behind the supervisor gets to the state stopped, and turns on."""
    drive = FaultParameters(place="command", kind="offset", size=2000.0)
    settings = QUICK.changed({"faults": (drive,), "onsets": 1, "observed_s": 1.3})
    (found,) = faults_study(FAST, settings).rows
    scenario = FAST.changed({"protection": {}, "simulation.duration_s": 6.3})
    run = simulate(scenario.changed({"faults": (drive.changed({"start_s": 5.0}),)}))
    assert run["safety_state"][-1] == 3.0
    assert abs(run["motor_speed_rad_s"][-1]) > 100.0
    assert found.detector == "speed"
    assert found.safe_after_s == math.inf


@pytest.mark.slow
def test_the_curves_are_those_of_the_worst_row(small):
    result, _ = small
    worst, traces = result.worst, result.traces
    assert worst.margin_s == min(r.margin_s for r in result.rows)
    time_s = traces["alone"]["time_s"]
    apart = traces["alone"]["knee_deg"] - traces["healthy"]["knee_deg"][: time_s.size]
    assert np.abs(apart).max() == pytest.approx(worst.alone.deviation_deg, rel=1e-12)
    assert np.all(apart[time_s <= worst.start_s] == 0.0)


@pytest.mark.slow
def test_healthy_runs_are_counted_and_a_low_threshold_stops_them():
    nervous = FAST.changed({"protection": {"following_deg": 0.3}})
    result = faults_study(nervous, QUICK)
    assert result.healthy_runs == 3
    assert result.healthy_hours == pytest.approx(3 * 9.5 / 3600.0)
    assert result.alarms == {"following": 2}


def test_a_tuned_controller_stays_beside_the_other_one():
    tuned = FAST.changed({"controller.lambda_per_s": 7.0})
    assert _controlled(tuned, "smc") == tuned
    assert _controlled(tuned, "pid").controller == PidParameters()


def test_faults_begin_in_the_second_period_or_late_in_the_run():
    scenario, starts_s = _starts(FAST, FaultsSettings())
    assert (scenario.duration_s, starts_s) == (20.75, [5.0, 6.25, 7.5, 8.75])
    step = UNCERTAIN_KNEE.changed({"reference": {"kind": "step"}, "simulation.duration_s": 20.0})
    scenario, starts_s = _starts(step, FaultsSettings())
    assert (scenario.duration_s, starts_s) == (20.0, [2.0, 3.5, 5.0, 6.5])
    with pytest.raises(ParameterError, match="observed_s = 20 s: must be < 20 s, the duration"):
        _starts(step, FaultsSettings(observed_s=20.0))


@pytest.mark.parametrize(("safe_s", "end_s"), [(1.5, 22.0), (12.5, 23.5), (math.inf, 22.0)])
def test_the_worst_case_is_drawn_until_the_motor_is_safe(safe_s, end_s):
    late = row("a", "late", 0.5, "rate", safe_s, moved_deg=9.0)
    figure = plot_worst_case(replace(made_up(), all_rows=(late,)))
    assert figure.axes[0].get_xlim() == (9.0, end_s)


@pytest.mark.slow
def test_a_protection_that_stops_the_healthy_run_is_refused():
    nervous = FAST.changed({"protection": {"following_deg": 0.1}})
    with pytest.raises(ParameterError, match=r"the detector following stops the run without a fau"):
        faults_study(nervous, QUICK)


VERDICTS = [  # the bound is 5°, and without protection the deviation is 23.45°
    (12.0, "", math.inf, 4.9, "not seen within 12 s", math.nan),
    (12.0, "rate", 0.1, 4.9, "in time", 11.9),
    (12.0, "rate", math.inf, 4.9, "late", math.nan),
    (0.5, "rate", 0.4, 5.0, "in time", 0.1),
    (0.5, "rate", 0.502, 4.9, "in time", -0.002),
    (0.5, "rate", 0.4, 5.1, "late", 0.1),
    (0.5, "rate", math.inf, 4.9, "late", -math.inf),
    (0.5, "rate", 0.4, 23.46, "made worse", 0.1),
    (0.5, "", math.inf, 23.45, "missed", -math.inf),
    (math.nan, "", math.inf, 0.0, "never active", math.nan),
]


@pytest.mark.parametrize(
    ("critical_s", "detector", "safe_s", "moved_deg", "verdict", "margin_s"), VERDICTS
)
def test_the_verdict_is_that_of_the_motion_with_protection(
    critical_s, detector, safe_s, moved_deg, verdict, margin_s
):
    found = row("cause", "fault", critical_s, detector, safe_s, moved_deg=moved_deg)
    assert found.verdict == verdict
    assert found.has_failed == (verdict in ("late", "missed", "made worse"))
    assert found.margin_s == pytest.approx(margin_s, nan_ok=True)


@pytest.mark.parametrize(("part", "verdict"), [("alone", "late"), ("protected", "late")])
def test_a_run_that_leaves_the_range_of_motion_has_no_last_word_on_the_motion(part, verdict):
    """Such a run may have gone on: the protection is not worse, and not in time."""
    found = row("cause", "fault", 0.5, "rate", 0.4, moved_deg=23.46 if part == "alone" else 4.9)
    early = replace(getattr(found, part), complete=False)
    assert replace(found, **{part: early}).verdict == verdict


def test_the_worst_row_is_the_failure_with_the_largest_motion_or_the_least_margin():
    missed = row("a", "missed", 0.5, "", math.inf, moved_deg=7.0)
    farther = row("b", "late", 0.5, "rate", 0.4, moved_deg=9.0)
    tight, loose = row("c", "tight", 0.5, "rate", 0.49), row("d", "loose", 0.5, "rate", 0.1)
    result = made_up()
    assert replace(result, all_rows=(tight, missed, farther, loose)).worst == farther
    assert replace(result, all_rows=(loose, tight)).worst == tight


def test_a_motor_that_is_never_safe_is_counted_and_has_no_turn(tables):
    """The row after; tests/studies/shown/faults.txt has the report of the result as it is."""
    result = made_up()
    never = replace(result.all_rows[1], safe_after_s=math.inf, rest=Rest(math.nan, math.nan, False))
    _, _, phases, *_ = tables(
        report(replace(result, all_rows=(result.all_rows[0], never, *result.all_rows[2:])))
    )
    assert phases[1][5:8] == ["1", "0.876", "command lost"]
    assert "Which safe state" not in report(replace(result, safe_states=("zero_speed",)))
