"""Critical durations against a reference whose motion is known, and runs on both sides."""

import math

import matplotlib.pyplot as plt
import numpy as np
import pytest

from kneexo.analysis import fault_survival
from kneexo.analysis.faults.survival import FaultCase, FaultSurvival
from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import FaultParameters, Scenario
from kneexo.simulation import simulate

T = 0.002
RAMP = Scenario(
    reference={"kind": "ramp", "start_deg": 20, "end_deg": 60, "rate_deg_s": 10, "time_s": 0.1},
    simulation={"duration_s": 2.0},
)
DEAD = FaultParameters(place="command", kind="scale", size=0.0)


def case(name, start_s, critical_s, censored=False):
    failing_s = math.nan if censored else critical_s + T
    return FaultCase(name, start_s, 9.0, critical_s, censored, failing_s)


def test_the_text_has_the_shortest_duration_and_a_censored_one_as_not_seen():
    cases = (
        *(case("dead", 5.0, 0.106), case("dead", 7.5, 0.07), case("dead", 10.0, 12.0, True)),
        *(case("small", 5.0, 12.0, True), case("small", 7.5, 12.0, True)),
        *(case("sometimes", 5.0, math.nan), case("sometimes", 7.5, 12.0, True)),
        case("never", 5.0, math.nan),
    )
    result = FaultSurvival(2.0, cases)
    assert str(result).splitlines() == [
        "Within 2° of the run without the fault:",
        "dead: at most 70 ms, at 7.5 s",
        "small: a larger deviation is not seen within 12 s",
        "sometimes: a larger deviation is not seen within 12 s",
        "never: never active",
    ]
    assert result.worst == cases[1]
    dead, small, *_ = (ax := result.plot()).lines
    np.testing.assert_array_equal(dead.get_xdata(), [5.0, 7.5, 10.0])
    np.testing.assert_array_equal(dead.get_ydata(), [106.0, 70.0, math.nan])
    assert np.isnan(small.get_ydata()).all()
    plt.close(ax.figure)


def test_each_start_is_observed_equally_long_beyond_the_end_of_the_scenario():
    """A dead command leaves the bound 0.2 s after its start, so 0.1 s are too short to see it."""
    brief = fault_survival(RAMP, [DEAD], [0.6, 2.9], bound_deg=2.0, observed_s=0.1).cases
    assert [c.censored for c in brief] == [True, True]
    assert [c.critical_duration_s for c in brief] == pytest.approx([0.1, 0.1], abs=1e-9)
    late = fault_survival(RAMP, [DEAD], [1.95], bound_deg=2.0, observed_s=0.5).cases[0]
    assert (late.censored, late.critical_duration_s) == (False, pytest.approx(0.2, abs=0.03))


@pytest.fixture(scope="module")
def survival():
    return fault_survival(RAMP, [DEAD], [0.6, 0.9], bound_deg=2.0, observed_s=1.4)


EIGHT = [
    FaultParameters(place=place, kind=kind, size=size)
    for place, kind, size in (
        *(("command", "scale", 0.0), ("command", "offset", 300.0), ("command", "offset", 1.0)),
        *(("encoder", "offset", 8.0), ("encoder", "offset", 1.0), ("encoder", "frozen", 0.0)),
        *(("encoder", "drift", 0.5), ("encoder", "drift", 0.3)),
    )
]


@pytest.mark.slow
def test_eight_faults_last_as_long_as_in_a_bisection_that_observes_60_s():
    base = Scenario(plant={"load": "knee"}, simulation={"duration_s": 72.5})
    healthy = simulate(base, signals=("knee_angle",))["knee_angle_rad"]

    def stays(fault, samples):
        ends = fault.changed({"start_s": 12.5, "duration_s": samples * T})
        try:
            run = simulate(base.changed({"faults": [ends]}), signals=("knee_angle",))
        except SimulationError:  # the knee leaves its range
            return False
        return np.degrees(np.abs(run["knee_angle_rad"] - healthy).max()) <= 5.0

    cases = fault_survival(base, EIGHT, [12.5]).cases
    assert {c.censored for c in cases} == {True, False}
    for found, fault in zip(cases, EIGHT, strict=True):
        if found.censored:  # so long the fault may last; it may do harm later
            assert found.critical_duration_s == pytest.approx(12.0)
            continue
        low, high = 0, 6000
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if stays(fault, middle) else (low, middle)
        assert found.critical_duration_s == pytest.approx(T * low, abs=1e-9), fault


@pytest.mark.slow
def test_a_dead_command_may_last_as_long_as_the_reference_takes_to_leave_the_bound(survival):
    """The knee stops, and the reference moves 2 deg at 10 deg/s in 0.2 s.

    The motor runs down and up with a time constant of 10 ms.
    """
    for case in survival.cases:
        assert case.critical_duration_s == pytest.approx(0.2, abs=0.03)
        assert case.largest_deviation_deg > 5.0
    assert survival.worst.critical_duration_s == min(c.critical_duration_s for c in survival.cases)


@pytest.mark.slow
def test_runs_on_both_sides_confirm_the_critical_duration(survival):
    healthy = simulate(RAMP)["knee_angle_rad"]
    for case in survival.cases:
        assert case.failing_duration_s - case.critical_duration_s == pytest.approx(T)
        for duration_s, survives in (
            (case.critical_duration_s, True),
            (case.failing_duration_s, False),
        ):
            fault = DEAD.changed({"start_s": case.start_s, "duration_s": duration_s})
            angle = simulate(RAMP.changed({"faults": [fault]}))["knee_angle_rad"]
            assert (np.degrees(np.max(np.abs(angle - healthy))) <= 2.0) == survives


@pytest.mark.slow
def test_a_fault_that_moves_the_knee_little_is_censored_at_the_time_that_it_was_active():
    small = FaultParameters(place="command", kind="offset", size=1.0)
    never = DEAD.changed({"signal": "knee_angle_rad", "above": 10.0})
    late = small.changed({"signal": "knee_angle_rad", "above": math.radians(50.0)})
    result = fault_survival(RAMP, [never, small, late], [0.6])
    assert result.to_dataframe().censored.tolist() == [False, True, True]
    expected = [math.nan, 12.0, 12.0 - 2.5]  # the ramp reaches 50° at 3.1 s
    found = [c.critical_duration_s for c in result.cases]
    assert found == pytest.approx(expected, abs=0.03, nan_ok=True)
    assert math.isnan(result.worst.failing_duration_s)
    assert str(result).splitlines()[1].endswith("> 10: never active")


@pytest.mark.slow
def test_a_controller_of_short_samples_has_a_critical_duration_too():
    quick = RAMP.changed({"controller.sample_time_s": 5e-4})
    (case,) = fault_survival(quick, [DEAD], [0.6], bound_deg=2.0).cases
    assert case.critical_duration_s == pytest.approx(0.2, abs=0.03)


@pytest.mark.slow
def test_faults_that_differ_by_seed_or_trigger_have_lines_of_their_own():
    noise = {"kind": "noise", "size": 0.1}
    when = {"signal": "knee_angle_rad", "above": 0.5}
    faults = [FaultParameters(**noise), FaultParameters(**noise, seed=1, **when)]
    lines = str(fault_survival(RAMP, faults, [0.6])).splitlines()
    assert [line.partition(":")[0] for line in lines[1:]] == [
        "encoder noise 0.1 deg",
        "encoder noise 0.1 deg seed 1 if knee_angle_rad > 0.5",
    ]


@pytest.mark.parametrize(
    ("faults", "starts_s", "options", "message"),
    [
        ([], [1.0], {}, "must have at least one fault and one start"),
        ([DEAD], [], {}, "must have at least one fault and one start"),
        ([DEAD], [-1.0], {}, r"starts_s\.0 = -1 s is out of range: must be finite and >= 0"),
        ([DEAD], ["a"], {}, r"starts_s.0 = 'a': must be a number, >= 0 and"),
        (DEAD, [1.0], {}, r"faults = FaultParameters.*: must be a list$"),
        *(
            ([DEAD], [1.0], {name: value}, f"{name} = {value:g} {unit}: must be > 0 and")
            for name, unit in (("observed_s", "s"), ("bound_deg", "deg"))
            for value in (0.0, math.inf, math.nan)
        ),
    ],
)
def test_wrong_arguments_are_one_line(faults, starts_s, options, message):
    with pytest.raises(ParameterError, match=message):
        fault_survival(RAMP, faults, starts_s, **options)
