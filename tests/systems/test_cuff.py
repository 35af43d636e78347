import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from diagramc.testing import check_leaf
from kneexo.errors import SimulationError
from kneexo.parameters import CuffParameters
from kneexo.systems import Cuff

NUMBERS = {
    "stiffness_n_m_per_rad": 1000.0,
    "damping_n_m_s_per_rad": 4.0,
    "slip_torque_n_m": 20.0,
    "slip_damping_n_m_s_per_rad": 30.0,
}
INPUTS = {
    "wearer_motion": [(0.5, 0.52), (-2.0, 2.0)],
    "knee_angle": [(0.5, 0.52)],
    "rod_velocity": [(-0.1, 0.1)],
    "moment_arm": [(0.03, 0.11)],
}
FAR = INPUTS | {"knee_angle": [(0.2, 0.3)]}
STATE = [(-0.005, 0.005)]


def fixed(leg=(0.5, 0.0), knee=0.5, velocity=0.0, arm=0.1, slip=0.0):
    system = Cuff(CuffParameters(**NUMBERS))
    context = system.CreateDefaultContext()
    context.SetContinuousState([slip])
    values = {
        "wearer_motion": list(leg),
        "knee_angle": knee,
        "rod_velocity": velocity,
        "moment_arm": arm,
    }
    for name, value in values.items():
        system.GetInputPort(name).FixValue(context, value)
    return system, context


@pytest.mark.parametrize("ranges", [INPUTS, FAR], ids=["elastic", "slips"])
def test_conversions_agree_and_keep_arguments_and_changes(ranges):
    check_leaf(Cuff(CuffParameters(**NUMBERS)), ranges | {"continuous_state": STATE})


@pytest.mark.parametrize("ranges", [INPUTS, FAR], ids=["elastic", "slips"])
def test_random_points_meet_the_written_out_equations(leaf, ranges):
    probe = leaf.Probe(Cuff(CuffParameters(**NUMBERS)), ranges, STATE)
    for z in probe.points(50):
        _, leg, leg_rate, knee, velocity, arm, slip = z[:7]
        spring = 1000.0 * (leg - knee - slip)
        torque = spring + 4.0 * (leg_rate + velocity / arm)
        surplus = math.copysign(max(abs(spring) - 20.0, 0.0), spring)
        power = [torque * leg_rate, -torque * velocity / arm]
        expected = [torque, slip, *power, surplus / 30.0]
        assert probe.results(z) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_power_lost_between_leg_and_exoskeleton_is_not_negative():
    system, context = fixed(leg=(0.5, 1.0), velocity=0.03)
    given, taken = system.GetOutputPort("interaction_power").Eval(context)
    # Without strain only the damper: 4 N·m·s/rad at 1.3 rad/s.
    assert given - taken == pytest.approx(4.0 * 1.3**2)


def test_a_cuff_without_slip_torque_does_not_slip(leaf):
    rigid = Cuff(CuffParameters(stiffness_n_m_per_rad=1000.0, damping_n_m_s_per_rad=4.0))
    check_leaf(rigid, FAR)
    probe = leaf.Probe(rigid, FAR)
    z = probe.points(1)[0]
    _, leg, leg_rate, knee, velocity, arm = z
    torque = 1000.0 * (leg - knee) + 4.0 * (leg_rate + velocity / arm)
    assert probe.results(z)[:2] == pytest.approx([torque, 0.0], rel=1e-12)


def test_above_its_limit_the_cuff_slips_until_the_spring_has_the_slip_torque():
    system, context = fixed(leg=(0.6, 0.0))
    simulator = Simulator(system, context)
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    tau = 30.0 / 1000.0
    for time in (0.02, 0.1):
        simulator.AdvanceTo(time)
        slip = system.GetOutputPort("cuff_slip").Eval(context)[0]
        # A first-order decay to 0.1 rad − 20/1000 rad.
        assert slip == pytest.approx(0.08 * (1.0 - math.exp(-time / tau)), rel=1e-6)


def test_a_rate_that_is_not_finite_is_an_error():
    system, context = fixed(leg=(math.nan, 0.0))
    with pytest.raises(SimulationError, match="slip_rate = nan is not finite"):
        system.EvalTimeDerivatives(context)
    assert np.isnan(system.GetOutputPort("interaction_torque").Eval(context)[0])
