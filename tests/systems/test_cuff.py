import math

import numpy as np
import pytest

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


def test_a_cuff_without_slip_torque_does_not_slip(leaf):
    rigid = Cuff(CuffParameters(stiffness_n_m_per_rad=1000.0, damping_n_m_s_per_rad=4.0))
    check_leaf(rigid, FAR)
    probe = leaf.Probe(rigid, FAR)
    z = probe.points(1)[0]
    _, leg, leg_rate, knee, velocity, arm = z
    torque = 1000.0 * (leg - knee) + 4.0 * (leg_rate + velocity / arm)
    assert probe.results(z)[:2] == pytest.approx([torque, 0.0], rel=1e-12)


def test_a_rate_that_is_not_finite_is_an_error(leaf):
    probe = leaf.Probe(Cuff(CuffParameters(**NUMBERS)), INPUTS, STATE)
    z = probe.points(1)[0]
    z[1] = math.nan  # the angle of the leg
    context = probe.context(z)
    with pytest.raises(SimulationError, match="slip_rate = nan is not finite"):
        probe.system.EvalTimeDerivatives(context)
    assert np.isnan(probe.system.GetOutputPort("interaction_torque").Eval(context)[0])
