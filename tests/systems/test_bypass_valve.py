"""The opening of the bypass valve, with its lag and its stuck positions."""

import math

import pytest
from pydrake.systems.analysis import Simulator

from diagramc.testing import check_leaf
from kneexo.parameters import BypassParameters
from kneexo.systems import BypassValve

LAG_S = 0.03


def valve(**values):
    return BypassValve(BypassParameters(**{"time_constant_s": LAG_S} | values))


def opening_after(time_s, command, system):
    context = system.CreateDefaultContext()
    if command is not None:
        system.GetInputPort("bypass").FixValue(context, command)
    simulator = Simulator(system, context)
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    simulator.AdvanceTo(time_s)
    return system.GetOutputPort("bypass_opening").Eval(simulator.get_context())[0]


def test_conversions_agree_and_keep_arguments_and_changes():
    check_leaf(valve(minimum_opening=0.2), {"bypass": (0.1, 0.9), "continuous_state": (0.0, 1.0)})


@pytest.mark.parametrize(("command", "reached"), [(1.0, 1.0), (0.4, 0.4), (7.0, 1.0), (-2.0, 0.0)])
def test_the_opening_follows_the_command_between_closed_and_open(command, reached):
    for share in (0.5, 1.0, 3.0):
        expected = reached * (1.0 - math.exp(-share))
        assert opening_after(share * LAG_S, command, valve()) == pytest.approx(expected, abs=1e-7)


def test_a_valve_without_command_stays_closed():
    assert opening_after(1.0, None, valve()) == 0.0


def test_a_valve_that_is_stuck_open_does_not_close():
    assert opening_after(1.0, 0.0, valve(minimum_opening=1.0)) == 1.0
    partly = opening_after(20.0 * LAG_S, 0.5, valve(minimum_opening=0.2))
    assert partly == pytest.approx(0.2 + 0.8 * 0.5, rel=1e-7)
