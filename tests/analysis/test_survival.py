"""Critical durations against a reference whose motion is known, and runs on both sides."""

import math

import numpy as np
import pytest

from kneexo.analysis import fault_survival
from kneexo.errors import ParameterError
from kneexo.parameters import FaultParameters, Scenario
from kneexo.simulation import simulate

T = 0.002
RAMP = Scenario(
    reference={"kind": "ramp", "start_deg": 20, "end_deg": 60, "rate_deg_s": 10, "time_s": 0.1},
    simulation={"duration_s": 2.0},
)
DEAD = FaultParameters(place="command", kind="scale", size=0.0)


@pytest.fixture(scope="module")
def survival():
    return fault_survival(RAMP, [DEAD], [0.6, 0.9], bound_deg=2.0)


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
def test_lines_and_plot_have_the_shortest_duration_of_each_fault(survival):
    assert str(survival).splitlines()[1].startswith("command scale 0: at most ")
    (line,) = survival.plot().lines
    np.testing.assert_allclose(line.get_xdata(), [0.6, 0.9])
    expected = [1e3 * case.critical_duration_s for case in survival.cases]
    np.testing.assert_allclose(line.get_ydata(), expected)


@pytest.mark.slow
def test_a_fault_that_moves_the_knee_little_may_be_permanent():
    small = FaultParameters(place="command", kind="offset", size=1.0)
    never = DEAD.changed({"signal": "knee_angle_rad", "above": 10.0})
    result = fault_survival(RAMP, [never, small], [0.6])
    assert math.isnan(result.cases[0].critical_duration_s)
    assert math.isinf(result.worst.critical_duration_s)
    assert str(result).splitlines()[1].endswith("> 10: never active")
    result = fault_survival(RAMP, [small], [0.6])
    assert math.isinf(result.worst.critical_duration_s)
    assert math.isnan(result.worst.failing_duration_s)
    assert str(result).splitlines()[1] == "command offset 1 rpm: may be permanent"


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
    ("arguments", "message"),
    [
        (([], [1.0]), "must have at least one fault and one start"),
        (([DEAD], []), "must have at least one fault and one start"),
        (([DEAD], [2.0]), r"start_s = 2 s: must be <= 1.998 s, the last sample"),
    ],
)
def test_wrong_arguments_are_one_line(arguments, message):
    with pytest.raises(ParameterError, match=message):
        fault_survival(RAMP, *arguments)
    for bound_deg in (0.0, math.inf):
        with pytest.raises(ParameterError, match=f"bound_deg = {bound_deg:g} deg: must be > 0 and"):
            fault_survival(RAMP, [DEAD], [1.0], bound_deg=bound_deg)


def test_one_fault_and_a_start_as_text_are_one_line():
    with pytest.raises(ParameterError, match=r"faults = FaultParameters.*: must be a list$"):
        fault_survival(RAMP, DEAD, [1.0])
    with pytest.raises(ParameterError, match=r"starts_s.0 = 'a': must be a number, >= 0 and"):
        fault_survival(RAMP, [DEAD], ["a"])
