"""What a point reads from a Context, its values and its rest."""

import math

import numpy as np
import pytest
from pydrake.examples import PendulumPlant
from pydrake.symbolic import Variable, sqrt
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain, Integrator, Sine, SymbolicVectorSystem, ZeroOrderHold

from diagramc import (
    CompilationError,
    LinearizationError,
    ParameterError,
    find_equilibrium,
    linearize_at,
)
from diagramc.linear.reading import read_point


@pytest.fixture
def pendulum():
    """A pendulum at 0.3 rad and 0.2 rad/s with a torque of 0.7 N·m, at 4 s."""
    plant = PendulumPlant()
    context = plant.CreateDefaultContext()
    context.SetTime(4.0)
    context.SetContinuousState([0.3, 0.2])
    plant.get_input_port().FixValue(context, [0.7])
    return plant, context


def test_a_point_has_the_values_of_the_context(pendulum):
    point = read_point(*pendulum)
    assert point.time_s == 4.0
    assert point.state.tolist() == [0.3, 0.2]
    assert point.inputs.tolist() == [0.7]  # fixed, although no name asks for it
    assert point.parameters.tolist() == [1.0, 0.5, 0.1, 9.81]
    assert point.state_names == ("theta", "thetadot")


def test_an_input_without_a_value_is_zero():
    plant = PendulumPlant()
    assert read_point(plant, plant.CreateDefaultContext(), ["tau"]).inputs.tolist() == [0.0]
    assert read_point(plant, None, ["tau"]).inputs.tolist() == [0.0]


def test_an_input_that_is_neither_named_nor_fixed_is_an_error():
    x, u = Variable("x"), Variable("u")
    plant = SymbolicVectorSystem(state=[x], input=[u], dynamics=[u - x], output=[x])
    context = plant.CreateDefaultContext()
    message = r"\Ainput port 'u0' has no value: FixValue it in the Context, or name it in inputs\Z"
    with pytest.raises(CompilationError, match=message):
        read_point(plant, context)
    with pytest.raises(CompilationError, match=message.replace("inputs", "free_inputs")):
        find_equilibrium(plant, context)


def test_an_input_inside_that_is_open_is_no_input_of_the_diagram():
    builder = DiagramBuilder()
    builder.AddNamedSystem("integrator", Integrator(1))
    with pytest.raises(CompilationError, match="integrator: input port 'u0' has no value: Fix"):
        read_point(builder.Build(), None)


def test_the_time_of_the_context_is_the_time_of_the_equations():
    sine = Sine(2.0, 3.0, 0.1, 1)
    context = sine.CreateDefaultContext()
    context.SetTime(0.4)
    point = read_point(sine, context)
    assert point.slopes(["y0"]).outputs == pytest.approx([2.0 * math.sin(1.3)], rel=1e-15)


def test_rates_and_residual_of_continuous_and_discrete_states():
    builder = DiagramBuilder()
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.1, 1))
    x, u = Variable("x"), Variable("u")
    plant = SymbolicVectorSystem(state=[x], input=[u], dynamics=[u - x * x], output=[x])
    builder.AddNamedSystem("plant", plant)
    gain = builder.AddNamedSystem("gain", Gain(4.0, 1))
    builder.Connect(hold.get_output_port(), plant.get_input_port())
    builder.Connect(plant.get_output_port(), gain.get_input_port())
    builder.Connect(gain.get_output_port(), hold.get_input_port())
    point = read_point(builder.Build(), None).at(np.array([3.0, 2.0]))
    slopes = point.slopes()
    assert slopes.rates.tolist() == [2.0 - 9.0, 12.0]
    assert point.residual(slopes.rates).tolist() == [-7.0, 10.0]
    assert slopes.rates_jacobian.tolist() == [[-6.0, 1.0], [4.0, 0.0]]
    assert point.residual_jacobian(slopes).tolist() == [[-6.0, 1.0], [4.0, -1.0]]
    assert point.motion(slopes, 1e-6) == "an update changes hold.0[0] by 10"
    assert point.motion(slopes, 10.5) == ""
    slower = point.at(np.array([3.0, 12.5])).slopes()
    assert point.at(np.array([3.0, 12.5])).motion(slower, 1e-6) == "d(plant.x[0])/dt = 3.5 per s"


def test_another_diagrams_context_is_refused(pendulum):
    pendulum[0].set_name("")
    with pytest.raises(ParameterError, match="context: is no Context of PendulumPlant; create"):
        read_point(pendulum[0], 3)
    with pytest.raises(ParameterError, match=r"contexts = .*: must be a list of Contexts\Z"):
        linearize_at(*pendulum, inputs=[], outputs=["state"])
    for context in (Gain(1.0, 1).CreateDefaultContext(), "context"):
        with pytest.raises(ParameterError, match=r"\Acontext: is no Context of [^\n]*\Z"):
            read_point(pendulum[0], context)


@pytest.mark.parametrize(
    ("state", "text"),
    [(-1.0, "the rate of x[0] is not finite"), (0.0, "the derivative of the rate of x[0] is not")],
)
def test_a_point_outside_the_domain_is_named(state, text):
    x = Variable("x")
    plant = SymbolicVectorSystem(state=[x], dynamics=[-sqrt(x)], output=[x])
    point = read_point(plant, None).at(np.array([state]))
    slopes = point.slopes(["y0"])
    with pytest.raises(LinearizationError, match="there is no linear model") as caught:
        point.require_finite(slopes, ["y0"])
    assert str(caught.value).startswith(text)
