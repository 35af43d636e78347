"""Equilibria in closed form, of continuous, sampled and mixed diagrams."""

import math

import numpy as np
import pytest
from pydrake.examples import PendulumPlant
from pydrake.symbolic import Variable, atan, sin
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    DiscreteTimeIntegrator,
    Gain,
    Integrator,
    LinearSystem,
    SymbolicVectorSystem,
)

from diagramc import LinearizationError, ParameterError, find_equilibrium, linearize

MASS_GRAVITY_LENGTH = 9.81 * 0.5  # of PendulumPlant: 1 kg, 0.5 m


@pytest.fixture
def pendulum():
    """A pendulum and a Context with its torque."""
    plant = PendulumPlant()
    context = plant.CreateDefaultContext()
    plant.get_input_port().FixValue(context, [0.3 * MASS_GRAVITY_LENGTH])
    return plant, context


def test_a_pendulum_rests_where_weight_and_torque_balance(pendulum):
    plant, context = pendulum
    context.SetContinuousState([0.1, 0.2])
    rest = find_equilibrium(plant, context)
    expected = [math.asin(0.3), 0.0]
    state = rest.get_continuous_state_vector().CopyToVector()
    np.testing.assert_allclose(state, expected, rtol=0.0, atol=1e-12)
    assert context.get_continuous_state_vector().CopyToVector().tolist() == [0.1, 0.2]
    assert linearize(plant, rest, inputs=["tau"], outputs=["state"]).stable


def test_a_free_input_holds_a_fixed_state(pendulum):
    plant, context = pendulum
    context.SetContinuousState([1.0, 0.2])
    rest = find_equilibrium(plant, context, fixed=["theta"], free_inputs=["tau"])
    assert rest.get_continuous_state_vector().CopyToVector() == pytest.approx([1.0, 0.0])
    torque = plant.get_input_port().Eval(rest)
    assert torque == pytest.approx([MASS_GRAVITY_LENGTH * math.sin(1.0)], rel=1e-12)


def test_two_free_inputs_give_two_outputs_their_values():
    # At rest x = −A⁻¹ B u, so that C x = y requires u = −(C A⁻¹ B)⁻¹ y.
    a, b = np.array([[-1.0, 0.5], [0.2, -2.0]]), np.array([[1.0, 0.3], [-0.4, 2.0]])
    plant = LinearSystem(a, b, np.eye(2), np.zeros((2, 2)))
    ends = []
    for value in (np.zeros(2), np.array([3.0, -1.0])):
        context = plant.CreateDefaultContext()
        plant.get_input_port().FixValue(context, value)
        target = {"y0": [1.0, 4.0]}
        rest = find_equilibrium(plant, context, free_inputs=["u0"], outputs=target)
        ends.append(plant.get_input_port().Eval(rest))
    expected = -np.linalg.solve(np.linalg.solve(a, b), [1.0, 4.0])
    np.testing.assert_allclose(ends, [expected, expected], rtol=1e-12)


def test_an_output_has_its_required_value(pendulum):
    plant, context = pendulum
    rest = find_equilibrium(plant, context, free_inputs=["tau"], outputs={"state": [-0.7, 0.0]})
    torque = plant.get_input_port().Eval(rest)
    assert torque == pytest.approx([-MASS_GRAVITY_LENGTH * math.sin(0.7)], rel=1e-12)


def test_a_mixed_loop_rests_where_its_sampled_integral_cancels_the_load():
    # x' = u - 2 (x + sin x) with u = 0.5 s, s(k+1) = s(k) + 0.1 (1 - x): rests at x = 1.
    x, u = Variable("x"), Variable("u")
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem(
        "plant",
        SymbolicVectorSystem(state=[x], input=[u], dynamics=[u - 2.0 * (x + sin(x))], output=[x]),
    )
    error = builder.AddNamedSystem("error", Adder(2, 1))
    back = builder.AddNamedSystem("back", Gain(-1.0, 1))
    total = builder.AddNamedSystem("total", DiscreteTimeIntegrator(1, 0.1))
    gain = builder.AddNamedSystem("gain", Gain(0.5, 1))
    builder.Connect(plant.get_output_port(), back.get_input_port())
    builder.ExportInput(error.get_input_port(0), "r")
    builder.Connect(back.get_output_port(), error.get_input_port(1))
    builder.Connect(error.get_output_port(), total.get_input_port())
    builder.Connect(total.get_output_port(), gain.get_input_port())
    builder.Connect(gain.get_output_port(), plant.get_input_port())
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    diagram.GetInputPort("r").FixValue(context, [1.0])
    rest = find_equilibrium(diagram, context)
    assert rest.get_continuous_state_vector().CopyToVector() == pytest.approx([1.0], rel=1e-12)
    total = rest.get_discrete_state(0).CopyToVector()
    assert total == pytest.approx([4.0 * (1.0 + math.sin(1.0))], rel=1e-12)
    assert linearize(diagram, rest, inputs=["r"], outputs=["plant:y0"]).period_s == 0.1


def test_a_state_without_influence_keeps_its_value():
    plant = Integrator(2)
    context = plant.CreateDefaultContext()
    context.SetContinuousState([3.0, -1.0])
    plant.get_input_port().FixValue(context, [0.0, 0.0])
    rest = find_equilibrium(plant, context)
    assert rest.get_continuous_state_vector().CopyToVector().tolist() == [3.0, -1.0]


def test_a_search_that_newton_overshoots_ends_by_least_squares():
    # Newton's steps for arctan x = 0 grow from every start beyond |x| = 1.3917.
    x = Variable("x")
    plant = SymbolicVectorSystem(state=[x], dynamics=[-atan(x)], output=[x])
    context = plant.CreateDefaultContext()
    context.SetContinuousState([5.0])
    rest = find_equilibrium(plant, context)
    assert abs(rest.get_continuous_state_vector().CopyToVector()[0]) < 1e-6


def test_a_diagram_without_unknowns_rests_or_not(pendulum):
    gain = Gain(2.0, 1)
    context = gain.CreateDefaultContext()
    gain.get_input_port().FixValue(context, [3.0])
    assert gain.get_output_port().Eval(find_equilibrium(gain, context)) == [6.0]
    plant, context = pendulum
    context.SetContinuousState([math.asin(0.3), 0.0])
    rest = find_equilibrium(plant, context, fixed=["theta", "thetadot"])
    assert rest.get_continuous_state_vector().CopyToVector()[0] == math.asin(0.3)
    context.SetContinuousState([math.asin(0.3), 0.5])
    with pytest.raises(LinearizationError, match=r"ends, d\(theta\)/dt = 0\.5 per s"):
        find_equilibrium(plant, context, fixed=["theta", "thetadot"])


def test_stiff_units_do_not_prevent_an_equilibrium():
    # Rates of 1e12 per s with rounding errors of about 1e-4 per s.
    x = Variable("x")
    plant = SymbolicVectorSystem(state=[x], dynamics=[1e12 * (0.3 - x * x)], output=[x])
    context = plant.CreateDefaultContext()
    context.SetContinuousState([1.0])
    rest = find_equilibrium(plant, context)
    state = rest.get_continuous_state_vector().CopyToVector()
    assert state == pytest.approx([math.sqrt(0.3)], rel=1e-14)


def test_a_value_of_a_scalar_output_must_be_a_number():
    x = Variable("x")
    plant = SymbolicVectorSystem(state=[x], dynamics=[-x], output=[x])
    for value in ("a", 1j, [1.0, 2.0], math.nan):
        with pytest.raises(ParameterError, match=r"\Aoutputs: y0 = .*: must be a finite number\Z"):
            find_equilibrium(plant, outputs={"y0": value})


def test_an_output_that_cannot_have_its_value_is_named():
    x = Variable("x")
    plant = SymbolicVectorSystem(state=[x], dynamics=[0.0 * x], output=[x * x])
    context = plant.CreateDefaultContext()
    context.SetContinuousState([1.0])
    with pytest.raises(LinearizationError, match=r"ends, y0 = .* in place of -1; start nearer"):
        find_equilibrium(plant, context, outputs={"y0": -1.0})


@pytest.mark.parametrize(
    ("error", "match", "arguments"),
    [
        (
            ParameterError,
            r"'angle' is no state; the states are theta, thetadot",
            {"fixed": "angle"},
        ),
        (ParameterError, r"state = \[1\.0\]: must be 2 finite", {"outputs": {"state": [1.0]}}),
        (ParameterError, r"state = 'a': must be 2 finite numbers", {"outputs": {"state": "a"}}),
        (ParameterError, r"outputs: has 3; must be names", {"outputs": {3: 1.0}}),
        (ParameterError, r"outputs = 'state': must be a dictionary", {"outputs": "state"}),
        (ParameterError, r"free_inputs = 3: must be a list of names", {"free_inputs": 3}),
        (ParameterError, r"fixed: has 'theta' twice", {"fixed": ["theta", "theta"]}),
        # With v = thetadot: least squares of v and 9.81 (2·0.3 − 2 sin 1.2) − 0.4 v.
        (LinearizationError, r"d\(thetadot\)/dt = -10\.69.* per s", {"fixed": "theta"}),
        # The torque exceeds the weight's largest by half: v and 9.81 − 0.4 v at best.
        (LinearizationError, r"d\(thetadot\)/dt = [89]\..* per s; start nearer", {"torque": 1.5}),
    ],
)
def test_no_equilibrium_is_one_line(pendulum, error, match, arguments):
    plant, context = pendulum
    arguments = dict(arguments)
    if torque := arguments.pop("torque", None):
        plant.get_input_port().FixValue(context, [torque * MASS_GRAVITY_LENGTH])
    context.SetContinuousState([1.2, 0.0])
    with pytest.raises(error, match=rf"\A(?=.*{match})[^\n]*\Z"):
        find_equilibrium(plant, context, **arguments)
