"""The user's law as a leaf system, and the leaves that take its place."""

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.analysis import Simulator

from kneexo.law import FunctionLaw, FunctionLaw_, HeldCommand, LinearLaw
from kneexo.parameters import LawParameters


def proportional(rod_extension, rod_reference, gain=1e3):
    return gain * (rod_reference[0] - rod_extension)


def integrating(rod_extension, time_s, state=(1.0,), gain=10.0):
    return state[0] + 0.1 * time_s, [state[0] + gain * rod_extension]


def started(system, **inputs):
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    for name, value in inputs.items():
        system.GetInputPort(name).FixValue(context, value)
    simulator.Initialize()
    return simulator


def command_of(simulator):
    system = simulator.get_system()
    return system.GetOutputPort("motor_speed_command").Eval(simulator.get_context())[0]


def test_the_command_is_held_for_a_sample_and_limited() -> None:
    limit = 50.0
    system = FunctionLaw(LawParameters(function=proportional, command_limit_rad_s=limit))
    simulator = started(system, rod_extension=[0.03], rod_reference=[0.05, 0.0, 0.0, 0.0])
    assert command_of(simulator) == 0.0
    simulator.AdvanceTo(0.001)
    assert command_of(simulator) == pytest.approx(20.0, rel=1e-12)
    system.GetInputPort("rod_extension").FixValue(simulator.get_mutable_context(), [0.15])
    simulator.AdvanceTo(0.0019)
    assert command_of(simulator) == pytest.approx(20.0, rel=1e-12)
    simulator.AdvanceTo(0.0021)
    assert command_of(simulator) == -limit


def test_state_time_and_gains() -> None:
    system = FunctionLaw(LawParameters(function=integrating, values={"gain": 4.0}))
    simulator = started(system, rod_extension=[0.5])
    # u_k = x_k + 0.1 t_k with x_0 = 1 and x_{k+1} = x_k + 4 · 0.5
    for sample, expected in enumerate((1.0, 3.0 + 0.0002, 5.0 + 0.0004)):
        simulator.AdvanceTo(0.002 * sample + 0.001)
        assert command_of(simulator) == pytest.approx(expected, rel=1e-12)


def test_derivatives_against_mathematics() -> None:
    system = FunctionLaw_[AutoDiffXd](LawParameters(function=proportional))
    context = system.CreateDefaultContext()
    error = 0.02
    system.GetInputPort("rod_extension").FixValue(context, [AutoDiffXd(0.03, [1.0, 0.0])])
    reference = [AutoDiffXd(0.03 + error, [0.0, 1.0]), *[AutoDiffXd(0.0, [0.0, 0.0])] * 3]
    system.GetInputPort("rod_reference").FixValue(context, reference)
    updated = system.EvalUniquePeriodicDiscreteUpdate(context).get_vector(0)[0]
    np.testing.assert_allclose(updated.derivatives(), [-1e3, 1e3], rtol=1e-8)


def with_flag(rod_extension, state=(0.0,), gain=10.0):
    return (gain * rod_extension if state[0] else 0.0), [1.0 - state[0]]


def test_a_branch_on_a_state_follows_its_value_in_derivatives() -> None:
    system = FunctionLaw_[AutoDiffXd](LawParameters(function=with_flag))
    context = system.CreateDefaultContext()
    system.GetInputPort("rod_extension").FixValue(context, [AutoDiffXd(0.5, [1.0])])
    for flag, expected in ((0.0, 0.0), (1.0, 5.0)):
        context.SetDiscreteState([AutoDiffXd(0.0), AutoDiffXd(flag)])
        updated = system.EvalUniquePeriodicDiscreteUpdate(context).get_vector(0)[0]
        assert updated.value() == expected


def test_held_command() -> None:
    system = HeldCommand(0.01, ("rod_extension", "estimated_state"))
    assert system.GetInputPort("estimated_state").size() == 3
    simulator = started(system, law_command=[7.0])
    assert command_of(simulator) == 0.0
    simulator.AdvanceTo(0.005)
    assert command_of(simulator) == 7.0
    assert system.ToSymbolic() is not None


def test_a_linear_law_updates_by_its_matrix() -> None:
    """(dx/dt, u⁺, z⁺) = M (1, x, z, y) with the inputs y = (rod, θ_d and three derivatives)."""
    system = LinearLaw(0.01, ("rod_extension", "rod_reference"), 1, 1)
    simulator = started(system, rod_extension=[2.0], rod_reference=[3.0, 4.0, 5.0, 6.0])
    context = simulator.get_mutable_context()
    rate, command, state = [3.0] + 7 * [0.0], [7.0, 0.25, 0.5, 1.0, 10.0] + 3 * [0.0], [1.0] * 8
    system.set_matrix(context, [rate, command, state])
    context.SetContinuousState([20.0])
    context.SetDiscreteState([100.0, 8.0])
    simulator.AdvanceTo(0.005)
    updated = context.get_discrete_state_vector().CopyToVector()
    assert updated.tolist() == [7.0 + 5.0 + 4.0 + 2.0 + 30.0, 1.0 + 20.0 + 8.0 + 2.0 + 18.0]
    assert command_of(simulator) == updated[0]
    assert context.get_continuous_state_vector()[0] == pytest.approx(20.015, rel=1e-12)
