import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from diagramc.testing import check_leaf
from kneexo.errors import SimulationError
from kneexo.parameters import KneeLoadParameters, LegParameters
from kneexo.systems import WearerKnee

BANK_HZ = np.array([0.06, 0.3, 1.4142, 6.6667, 33.333])
WEIGHTS = np.array([1.3939, 0.9620, 0.9980, 0.9620, 1.3939])
NUMBERS = {
    "inertia_kg_m2": 0.4,
    "leg_mass_kg": 4.0,
    "centre_of_mass_m": 0.25,
    "stiffness_n_m_per_rad": 3.0,
    "loss_modulus_n_m_per_rad": 0.8,
    "damping_n_m_s_per_rad": 0.2,
    "neutral_angle_rad": 0.3,
    "effort": 0.7,
}
LOAD = KneeLoadParameters(thigh_inclination_rad=0.4, gravity_m_s2=9.8)
INPUTS = {
    "knee_reference": [(0.2, 1.2), (-2.0, 2.0), (-9.0, 9.0), (-50.0, 50.0)],
    "biological_moment": [(-60.0, 60.0)],
    "interaction_torque": [(-20.0, 20.0)],
}
STATE = [(0.2, 1.2), (-2.0, 2.0), *[(-0.5, 0.5)] * 5]


def leg(motion, **numbers):
    return WearerKnee(LegParameters(motion=motion, **(NUMBERS | numbers)), LOAD)


def rates(system, state, reference=(0.0, 0.0, 0.0, 0.0), moment=0.0, torque=0.0):
    context = system.CreateDefaultContext()
    context.SetContinuousState(state)
    system.GetInputPort("knee_reference").FixValue(context, list(reference))
    system.GetInputPort("biological_moment").FixValue(context, moment)
    system.GetInputPort("interaction_torque").FixValue(context, torque)
    return system.EvalTimeDerivatives(context).CopyToVector()


# ----------------------------------------------------------------------------- conversion


@pytest.mark.parametrize("motion", ["prescribed", "active", "passive"])
def test_conversions_agree_and_keep_arguments_and_changes(motion):
    state = {} if motion == "prescribed" else {"continuous_state": STATE}
    check_leaf(leg(motion), INPUTS | state)


# -------------------------------------------------------------------------------- numbers


@pytest.mark.parametrize("motion", ["active", "passive"])
def test_random_points_meet_the_written_out_equations(leaf, motion):
    probe = leaf.Probe(leg(motion), INPUTS, STATE)
    for z in probe.points(50):
        _, ref, ref_1, ref_2, _, moment, torque, angle, rate, *memories = z[:14]
        strain, strain_rate, muscles = angle - 0.3, rate, 0.0
        if motion == "active":
            strain, strain_rate = angle - ref, rate - ref_1
            # 70 % of the moment by the muscles; the environment balances the whole moment.
            balance = -moment + 0.4 * ref_2 - 4.0 * 9.8 * 0.25 * math.sin(0.4 - ref)
            muscles = 0.7 * moment + balance
        lags = strain - np.array(memories)
        at_1_hz = np.sum(WEIGHTS / (1.0 + BANK_HZ**2))
        spring = (3.0 - 0.8 * at_1_hz) * strain + 0.2 * strain_rate + 0.8 * WEIGHTS @ lags
        weight = 4.0 * 9.8 * 0.25 * math.sin(0.4 - angle)
        acceleration = (muscles + weight - spring - torque) / 0.4
        expected = [angle, rate, rate, acceleration, *(2.0 * math.pi * BANK_HZ * lags)]
        assert probe.results(z) == pytest.approx(expected, rel=1e-11, abs=1e-9)


def test_a_prescribed_leg_moves_as_the_reference():
    system = leg("prescribed")
    context = system.CreateDefaultContext()
    system.GetInputPort("knee_reference").FixValue(context, [0.5, -1.5, 3.0, 4.0])
    assert list(system.GetOutputPort("wearer_motion").Eval(context)) == [0.5, -1.5]


def test_an_active_leg_with_its_whole_effort_accelerates_as_the_reference():
    system = leg("active", effort=1.0)
    state = [0.6, 1.5, *[0.0] * 5]
    for moment in (0.0, -65.0):  # the environment balances the moment
        acceleration = rates(system, state, (0.6, 1.5, 7.0, 0.0), moment)[1]
        assert acceleration == pytest.approx(7.0, rel=1e-12)
    pulled = rates(system, state, (0.6, 1.5, 7.0, 0.0), torque=2.0)[1]
    assert pulled == pytest.approx(7.0 - 2.0 / 0.4, rel=1e-12)


def dynamic_stiffness(system, frequencies_hz):
    """The complex stiffness, from the linear rates at the neutral angle without weight."""
    start = rates(system, [0.3, *[0.0] * 6])
    matrix = np.array([rates(system, start * 0 + [0.3, *[0] * 6] + row) for row in np.eye(7)]).T
    matrix -= start[:, None]
    response = []
    for s in 2j * math.pi * np.atleast_1d(frequencies_hz):
        # Force the angle; the memories follow, and the acceleration row gives the torque.
        memories = np.linalg.solve(s * np.eye(5) - matrix[2:, 2:], matrix[2:, 0])
        response.append(-0.4 * (matrix[1, 0] + matrix[1, 1] * s + matrix[1, 2:] @ memories))
    return np.array(response)


def test_loss_modulus_is_constant_and_the_stiffness_is_meant_at_1_hz():
    system = leg("passive", leg_mass_kg=0.0, damping_n_m_s_per_rad=0.0)
    frequencies = np.geomspace(0.1, 20.0, 200)
    loss = dynamic_stiffness(system, frequencies).imag
    np.testing.assert_allclose(loss, 0.8, rtol=0.008)  # ripple of five elements
    # Five printed digits of the weights, each near 1.
    assert dynamic_stiffness(system, 1.0)[0].real == pytest.approx(3.0, rel=1e-5)


def test_stiffness_grows_with_frequency_as_causality_requires():
    system = leg("passive", leg_mass_kg=0.0, damping_n_m_s_per_rad=0.0)
    low, high = dynamic_stiffness(system, [0.5, 5.0]).real
    # Kramers and Kronig: (2/π) h ln(f/f_0); the ripple of the loss modulus is 0.8 %.
    assert high - low == pytest.approx(2.0 / math.pi * 0.8 * math.log(10.0), rel=0.02)


def test_relaxed_leg_swings_as_measured():
    """A seated pendulum test: peaks after the release, and the period, of a published trace.

    Leg and foot are those of Winter's table. Stiffness, viscous damping and neutral angle are
    fitted to the trace, so that the test shows that the model can move as the leg does.
    """
    numbers = {
        "stiffness_n_m_per_rad": 3.72,
        "loss_modulus_n_m_per_rad": 0.0,
        "damping_n_m_s_per_rad": 0.408,
        "neutral_angle_rad": math.pi / 2.0 + 0.263,
    }
    seated = KneeLoadParameters(thigh_inclination_rad=math.pi / 2.0)
    parameters = LegParameters(motion="passive", **numbers)
    system = WearerKnee(parameters, seated, initial_angle_rad=math.pi / 2.0 - 1.06)
    simulator = Simulator(system)
    simulator.get_mutable_integrator().set_target_accuracy(1e-6)
    times, angles = np.arange(0.0, 4.5, 0.005), []
    port = system.GetOutputPort("wearer_motion")
    for time in times:
        simulator.AdvanceTo(time)
        angles.append(port.Eval(simulator.get_context())[0] - math.pi / 2.0)
    inner = np.array(angles)
    peaks = 1 + np.flatnonzero((inner[1:-1] > inner[:-2]) & (inner[1:-1] >= inner[2:]))
    assert inner[peaks[:4]] == pytest.approx([0.94, 0.60, 0.38, 0.26], abs=0.01)
    assert np.diff(times[peaks[:4]]) == pytest.approx([1.10] * 3, rel=0.02)


def test_a_leg_held_still_starts_relaxed():
    parameters = LegParameters(motion="passive", **NUMBERS)
    system = WearerKnee(parameters, LOAD, initial_angle_rad=1.1)
    context = system.CreateDefaultContext()
    system.GetInputPort("knee_reference").FixValue(context, [0.0] * 4)
    derivatives = system.EvalTimeDerivatives(context).CopyToVector()
    assert derivatives[2:] == pytest.approx([0.0] * 5, abs=1e-12)
    at_1_hz = np.sum(WEIGHTS / (1.0 + BANK_HZ**2))
    weight = 4.0 * 9.8 * 0.25 * math.sin(0.4 - 1.1)
    assert 0.4 * derivatives[1] == pytest.approx(weight - (3.0 - 0.8 * at_1_hz) * 0.8, rel=1e-10)


def test_an_acceleration_that_is_not_finite_is_an_error():
    system = leg("passive")
    with pytest.raises(SimulationError, match="leg_acceleration = nan is not finite"):
        rates(system, [0.3, 0.0, *[0.0] * 5], torque=math.nan)
