"""Linear models against Drake's Linearize and finite differences of Drake's Simulator."""

import math

import numpy as np
import pytest
from pydrake.examples import PendulumPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    DiscreteTimeDelay,
    Gain,
    Linearize,
    LinearSystem,
    ZeroOrderHold,
)

from kneexo.compiler import CompilationError, LinearizationError, ParameterError, linearize


@pytest.fixture(scope="module")
def loop():
    """A plant behind a hold every 4 ms and a delay, sampled every 10 ms from 5 ms on."""
    builder = DiagramBuilder()
    plant = LinearSystem([[0.0, 1.0], [-400.0, -4.0]], [[0.0], [400.0]], [[1.0, 0.0]], [[0.0]])
    plant = builder.AddNamedSystem("plant", plant)
    sampler = builder.AddNamedSystem("sampler", ZeroOrderHold(0.010, 1, offset_sec=0.005))
    gain = builder.AddNamedSystem("gain", Gain(-0.4, 1))
    add = builder.AddNamedSystem("add", Adder(2, 1))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.004, 1))
    delay = builder.AddNamedSystem("delay", DiscreteTimeDelay(0.004, 2, 1))
    builder.Connect(plant.get_output_port(), sampler.get_input_port())
    builder.Connect(sampler.get_output_port(), gain.get_input_port())
    builder.Connect(gain.get_output_port(), add.get_input_port(0))
    builder.ExportInput(add.get_input_port(1), "r")
    builder.Connect(add.get_output_port(), hold.get_input_port())
    builder.Connect(hold.get_output_port(), delay.get_input_port())
    builder.Connect(delay.get_output_port(), plant.get_input_port())
    builder.ExportOutput(plant.get_output_port(), "y")
    diagram = builder.Build()
    diagram.set_name("loop")
    return diagram


def drake_state(context):
    """Continuous and then discrete states of a Context."""
    groups = range(context.num_discrete_state_groups())
    discrete = [context.get_discrete_state(group).CopyToVector() for group in groups]
    return np.concatenate([context.get_continuous_state_vector().CopyToVector(), *discrete])


def drake_period(diagram, state, inputs, period_s):
    """The state at ``period_s`` by Drake's Simulator, before the updates at that time."""
    context = diagram.CreateDefaultContext()
    continuous = context.num_continuous_states()
    context.SetContinuousState(state[:continuous])
    first = continuous
    for group in range(context.num_discrete_state_groups()):
        vector = context.get_mutable_discrete_state(group)
        vector.SetFromVector(state[first : first + vector.size()])
        first += vector.size()
    for name, value in inputs.items():
        diagram.GetInputPort(name).FixValue(context, [value])
    simulator = Simulator(diagram, context)
    simulator.get_mutable_integrator().set_target_accuracy(1e-12)
    simulator.get_mutable_integrator().set_maximum_step_size(1e-3)
    simulator.AdvanceTo(period_s)
    return drake_state(context)


def test_a_multirate_loop_moves_as_drake_over_the_common_period(loop):
    model = linearize(loop, inputs=["r"], outputs=["y"])
    assert model.period_s == 0.02
    moved = [drake_period(loop, row, {"r": 0.0}, 0.02) for row in np.eye(len(model.a))]
    np.testing.assert_allclose(model.a, np.transpose(moved), rtol=0.0, atol=1e-10)
    moved = drake_period(loop, np.zeros(len(model.a)), {"r": 1.0}, 0.02)
    np.testing.assert_allclose(model.b[:, 0], moved, rtol=0.0, atol=1e-10)
    assert (model.c == np.eye(1, len(model.a))).all()
    assert not model.d.any()
    assert model.state_names[:3] == ("plant.x[0]", "plant.x[1]", "sampler.0[0]")


def test_a_pendulum_equals_drakes_linearization():
    plant = PendulumPlant()
    context = plant.CreateDefaultContext()
    context.SetContinuousState([math.pi, 0.0])
    plant.get_input_port().FixValue(context, [0.0])
    model = linearize(plant, context, inputs=["tau"], outputs=["state"])
    drake = Linearize(plant, context)
    for name in "abcd":
        expected = getattr(drake, name.upper())()
        np.testing.assert_allclose(getattr(model, name), expected, rtol=1e-13, atol=1e-13)
    assert model.period_s is None
    assert not model.stable


def test_a_perturbation_inside_adds_to_the_signal(loop):
    context = loop.CreateDefaultContext()
    loop.GetInputPort("r").FixValue(context, [0.0])
    model = linearize(loop, context, inputs=["gain:u0", "hold:y"], outputs=["gain:y0", "plant:u0"])
    hold = model.state_names.index("hold.0[0]")
    assert model.output_names == ("gain:y0", "plant:u0")
    assert model.d[0].tolist() == [-0.4, 0.0]
    assert model.c[0, model.state_names.index("sampler.0[0]")] == -0.4
    # At t = 0 the hold takes the perturbed gain, and the delay the perturbed hold.
    first = model.ticks[0]
    assert first.jump_input[hold].tolist() == [-0.4, 0.0]
    assert first.jump_input[model.state_names.index("delay.0[2]")].tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("error", "match", "arguments"),
    [
        (CompilationError, "no input port 'x'; it has r", {"inputs": ["x"]}),
        (CompilationError, "did you mean hold:y or hold:u", {"outputs": ["hold:y0"]}),
        (ParameterError, "'r' twice", {"inputs": ["r", "r"]}),
        (ParameterError, "outputs: is empty", {"outputs": []}),
        (ParameterError, "must be a multiple of 0.02 s", {"period_s": 0.01}),
        (ParameterError, "must be finite and > 0", {"period_s": -1.0}),
    ],
)
def test_a_wrong_argument_is_one_line(loop, error, match, arguments):
    with pytest.raises(error, match=rf"\A(?=.*{match})[^\n]*\Z"):
        linearize(loop, **({"inputs": ["r"], "outputs": ["y"]} | arguments))


def test_a_point_that_moves_names_the_state(loop):
    context = loop.CreateDefaultContext()
    loop.GetInputPort("r").FixValue(context, [0.5])
    match = r"\Athe operating point is no equilibrium: an update changes hold\.0\[0\] by 0\.5"
    with pytest.raises(LinearizationError, match=match):
        linearize(loop, context, inputs=["r"], outputs=["y"])
    model = linearize(loop, context, inputs=["r"], outputs=["y"], equilibrium_tolerance=math.inf)
    assert model.operating_point.inputs == [0.5]
