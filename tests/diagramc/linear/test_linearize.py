"""Linear models against Drake's Linearize and finite differences of Drake's Simulator."""

import math

import numpy as np
import pytest
from pydrake.examples import AcrobotPlant, PendulumPlant, QuadrotorPlant
from pydrake.symbolic import Variable, if_then_else, sin
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    DiscreteTimeDelay,
    Gain,
    Linearize,
    LinearSystem,
    SymbolicVectorSystem,
    ZeroOrderHold,
)

from diagramc import (
    CompilationError,
    LinearizationError,
    ParameterError,
    find_equilibrium,
    linearize,
    linearize_at,
    read_diagram,
)


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


def largest_difference_from_drake(random_diagram, drake_runs, kind, seed):
    """Largest difference of A, B, C and D from finite differences of Drake's Simulator."""
    random = random_diagram(seed, kind)
    context = random.at_rest(seed)
    model = linearize(
        random.diagram,
        context,
        inputs=random.inputs,
        outputs=random.outputs,
        period_s=0.25 if kind == "continuous" else None,
    )
    runs = drake_runs(random.diagram, context, random.inputs)
    n = len(model.a)
    moved, read = runs.jacobian(model.period_s)[:n], runs.jacobian(0.0)[n:]
    ours = np.block([[model.a, model.b], [model.c, model.d]])
    return np.abs(ours - np.vstack([moved, read])).max()


# Central differences with the step 1e-4 err by 1e-8 of the third derivative, RK3 by 1e-9.


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("continuous", 0),
        ("sampled", 0),
        ("mixed", 0),
        pytest.param("multirate", 2, marks=pytest.mark.slow),
    ],
)
def test_a_random_diagram_moves_as_in_drakes_simulator(random_diagram, drake_runs, kind, seed):
    assert largest_difference_from_drake(random_diagram, drake_runs, kind, seed) < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["continuous", "sampled", "mixed", "multirate"])
def test_80_random_diagrams_move_as_in_drakes_simulator(random_diagram, drake_runs, kind):
    for seed in range(1, 21):
        difference = largest_difference_from_drake(random_diagram, drake_runs, kind, seed)
        assert difference < 1e-6, (kind, seed)


@pytest.mark.parametrize("seeds", [range(1), pytest.param(range(1, 51), marks=pytest.mark.slow)])
def test_random_diagrams_equal_drakes_linearize_anywhere(random_diagram, seeds):
    for seed in seeds:
        random = random_diagram(seed, "continuous")
        diagram, context = random.diagram, random.diagram.CreateDefaultContext()
        state = np.random.default_rng(seed).uniform(-0.5, 0.5, context.num_continuous_states())
        context.SetContinuousState(state)
        for name in random.inputs:
            diagram.GetInputPort(name).FixValue(context, [0.2])
        ports = {"inputs": random.inputs, "outputs": random.outputs}
        model = linearize(diagram, context, **ports, equilibrium_tolerance=math.inf)
        for column, name in enumerate(random.inputs):
            for row, output in enumerate(random.outputs):
                ends = (diagram.GetInputPort(name), diagram.GetOutputPort(output))
                drake = Linearize(diagram, context, *(p.get_index() for p in ends), math.inf)
                cell = slice(row, row + 1), slice(column, column + 1)
                ours = (model.a, model.b[:, cell[1]], model.c[cell[0]], model.d[cell])
                theirs = (drake.A(), drake.B(), drake.C(), drake.D())
                for values, expected in zip(ours, theirs, strict=True):
                    np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("make", [AcrobotPlant, PendulumPlant, QuadrotorPlant])
def test_drakes_examples_equal_drakes_linearize_anywhere(make):
    plant, rng = make(), np.random.default_rng(3)
    context = plant.CreateDefaultContext()
    context.SetContinuousState(rng.uniform(-0.5, 0.5, context.num_continuous_states()))
    ports = plant.get_input_port(0), plant.get_output_port(0)
    ports[0].FixValue(context, rng.uniform(0.5, 1.0, ports[0].size()))
    model = linearize(
        plant,
        context,
        inputs=[ports[0].get_name()],
        outputs=[ports[1].get_name()],
        equilibrium_tolerance=math.inf,
    )
    drake = Linearize(plant, context, *(port.get_index() for port in ports), math.inf)
    for name in "abcd":
        expected = getattr(drake, name.upper())()
        atol = 1e-12 * np.abs(expected).max()
        np.testing.assert_allclose(getattr(model, name), expected, rtol=1e-12, atol=atol)


def test_a_sampled_diagram_equals_drakes_linearize():
    a, b = [[0.5, 0.2], [-0.1, 0.3]], [[1.0], [0.4]]
    plant = LinearSystem(a, b, [[1.0, 2.0]], [[0.7]], 0.1)
    context = plant.CreateDefaultContext()
    plant.get_input_port().FixValue(context, [0.0])
    model = linearize(plant, context, inputs=["u0"], outputs=["y0"])
    drake = Linearize(plant, context)
    for name in "abcd":
        np.testing.assert_array_equal(getattr(model, name), getattr(drake, name.upper())())
    assert model.period_s == drake.time_period() == 0.1


def test_a_multirate_loop_moves_as_drake_over_the_common_period(loop, drake_runs):
    model = linearize(loop, inputs=["r"], outputs=["y"])
    assert model.period_s == 0.02
    context = loop.CreateDefaultContext()
    loop.GetInputPort("r").FixValue(context, [0.0])
    moved = drake_runs(loop, context, ["r"]).jacobian(0.02)[: len(model.a)]
    # RK3 with steps of 0.488 ms: (20 rad/s · step)³/24 of the motion
    np.testing.assert_allclose(np.hstack([model.a, model.b]), moved, rtol=0.0, atol=1e-6)
    assert (model.c == np.eye(1, len(model.a))).all()
    assert not model.d.any()
    assert model.state_names[:3] == ("plant.x[0]", "plant.x[1]", "sampler.0[0]")


def test_models_in_several_contexts_equal_single_ones():
    plant, contexts = PendulumPlant(), []
    for angle in (0.0, math.pi / 6.0, math.pi):
        context = plant.CreateDefaultContext()
        context.SetContinuousState([angle, 0.0])
        # The first Context has no torque, which counts as zero.
        if angle:
            plant.get_input_port().FixValue(context, [9.81 * 0.5 * math.sin(angle)])
        contexts.append(context)
    ports = {"inputs": ["tau"], "outputs": ["state"]}
    models = linearize_at(plant, contexts, **ports)
    stiffness = [model.a[1, 0] for model in models]
    assert stiffness == pytest.approx([-19.62 * f for f in (1.0, math.sqrt(0.75), -1.0)], rel=1e-12)
    for model, context in zip(models, contexts, strict=True):
        single = linearize(plant, context, **ports)
        assert (model.a == single.a).all()
        assert (model.operating_point.state == single.operating_point.state).all()
        assert (model.operating_point.inputs == single.operating_point.inputs).all()


def test_a_warning_points_at_the_caller():
    x = Variable("x")
    plant = SymbolicVectorSystem(state=[x], dynamics=[-abs(x)], output=[x])
    for call in (
        lambda: linearize(plant, inputs=[], outputs=["y0"]),
        lambda: linearize_at(plant, [None], inputs=[], outputs=["y0"]),
    ):
        with pytest.warns(UserWarning, match="corner") as caught:
            call()
        assert caught[0].filename == __file__


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


def test_a_model_that_changes_with_the_time_warns():
    x, u, t = Variable("x"), Variable("u"), Variable("t")

    def model(rate, time_s):
        plant = SymbolicVectorSystem(time=t, state=[x], input=[u], dynamics=[rate], output=[x])
        context = plant.CreateDefaultContext()
        context.SetTime(time_s)
        return linearize(
            plant, context, inputs=["u0"], outputs=["y0"], equilibrium_tolerance=math.inf
        )

    match = r"\Athe derivatives of the rate of x\[0\] depend on the time: [^\n]* t = 0\.5 s\Z"
    with pytest.warns(UserWarning, match=match):
        assert model(-(2.0 + sin(t)) * x + u, 0.5).a == [[-(2.0 + math.sin(0.5))]]
    # A source that only adds leaves the model as it is; warnings are errors here.
    assert model(-2.0 * x + u + sin(t), 0.5).a == [[-2.0]]


def test_the_default_ports_are_all_vector_ports_of_the_diagram():
    model = linearize(PendulumPlant())
    assert (model.input_names, model.output_names) == (("tau",), ("state[0]", "state[1]"))
    assert model.a == pytest.approx(linearize(PendulumPlant(), inputs=[], outputs=["state"]).a)


def test_a_diagram_without_ports_has_an_autonomous_model():
    builder = DiagramBuilder()
    pendulum = builder.AddNamedSystem("pendulum", PendulumPlant())
    motor = builder.AddNamedSystem("motor", ConstantVectorSource([0.0]))
    builder.Connect(motor.get_output_port(), pendulum.get_input_port())
    model = linearize(builder.Build())
    assert repr(model) == "LinearModel(continuous, 2 states, inputs: none, outputs: none)"
    assert (model.b.shape, model.c.shape, model.d.shape) == ((2, 0), (0, 2), (0, 0))
    # The default pendulum hangs at rest: m = 1 kg, l = 0.5 m, damping 0.1 N·m·s.
    assert np.poly(model.poles()) == pytest.approx([1.0, 0.1 / 0.5**2, 9.81 / 0.5])
    with pytest.raises(LinearizationError, match=r"\Ainputs: is empty; python-control [^\n]*\Z"):
        model.to_control()
    with pytest.raises(LinearizationError, match="outputs: is empty"):
        linearize(PendulumPlant(), outputs=[]).to_control()


@pytest.mark.parametrize(
    ("error", "match", "arguments"),
    [
        (CompilationError, "no input port 'x'; it has r", {"inputs": ["x"]}),
        (CompilationError, "did you mean hold:y or hold:u", {"outputs": ["hold:y0"]}),
        (ParameterError, r"\Ainputs: has 'r' twice; ", {"inputs": ["r", "r"]}),
        (ParameterError, "must be a multiple of 0.02 s", {"period_s": 0.01}),
    ],
)
def test_a_wrong_argument_is_one_line(loop, error, match, arguments):
    with pytest.raises(error, match=rf"\A(?=.*{match})[^\n]*\Z"):
        linearize(loop, **({"inputs": ["r"], "outputs": ["y"]} | arguments))


@pytest.mark.parametrize(
    "call", [lambda: linearize(3, inputs=[], outputs=["y"]), lambda: find_equilibrium(3)]
)
def test_what_is_no_diagram_is_one_line(call):
    with pytest.raises(CompilationError, match=r"\Aint 3: cannot be compiled; [^\n]*\Z"):
        call()


def test_sample_periods_with_a_large_common_multiple_are_refused():
    builder = DiagramBuilder()
    fast = builder.AddNamedSystem("fast", ZeroOrderHold(1e-4, 1))
    slow = builder.AddNamedSystem("slow", ZeroOrderHold(50.0, 1))
    builder.Connect(fast.get_output_port(), slow.get_input_port())
    builder.ExportInput(fast.get_input_port(), "u")
    match = r"\Athe least common multiple of the sample periods, 50 s, has 500001 updates: [^\n]*\Z"
    with pytest.raises(LinearizationError, match=match):
        linearize(builder.Build(), inputs=["u"], outputs=["slow:y"])


def test_a_point_that_moves_names_the_state(loop):
    context = loop.CreateDefaultContext()
    loop.GetInputPort("r").FixValue(context, [0.5])
    match = r"\Athe operating point is no equilibrium: an update changes hold\.0\[0\] by 0\.5"
    with pytest.raises(LinearizationError, match=match):
        linearize(loop, context, inputs=["r"], outputs=["y"])
    model = linearize(loop, context, inputs=["r"], outputs=["y"], equilibrium_tolerance=math.inf)
    assert model.operating_point.inputs == [0.5]


@pytest.mark.parametrize("period_s", ["1", True, 0.0, -1.0, math.nan, math.inf, [0.1]])
def test_a_period_of_another_type_or_sign_is_refused(period_s):
    plant = PendulumPlant()
    with pytest.raises(ParameterError, match=r"\Aperiod_s = .*finite and > 0\Z"):
        linearize(plant, inputs=["tau"], outputs=["state"], period_s=period_s)


def test_a_period_beyond_the_accuracy_of_the_exponential_is_refused():
    lag = LinearSystem([[-20.0]], [[1.0]], [[1.0]], [[0.0]])
    ports = {"inputs": ["u0"], "outputs": ["y0"]}
    # The largest time is 1e9/20 s. There the lag forgets its state, and its gain is 1/20.
    model = linearize(lag, period_s=5e7, **ports)
    np.testing.assert_allclose([model.a, model.b], [[[0.0]], [[0.05]]], rtol=1e-6)
    for period_s in (5.1e7, 1e100, 1e300):
        with pytest.raises(
            ParameterError, match=r"must be at most 5e\+07 s, 1e\+09 time constants"
        ):
            linearize(lag, period_s=period_s, **ports)
    integrator = LinearSystem([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    assert linearize(integrator, period_s=1e50, **ports).b == pytest.approx(1e50)
    with pytest.raises(LinearizationError, match=r"the period, 1e\+308 s, is not finite; choose a"):
        linearize(integrator, period_s=1e308, **ports)


def test_equations_that_were_read_once_give_the_models_of_the_diagram(loop):
    """Other open inputs, after those of the model, take no part."""
    read = read_diagram(loop, inputs=["r", "plant:u0", "delay:u"], outputs=["hold:y", "plant:y0"])
    context = find_equilibrium(read, free_inputs=["r"], outputs={"y": [0.0]})
    for inputs in (["r"], ["r", "plant:u0"]):
        ours = linearize(read, context, inputs=inputs, outputs=["hold:y", "y"])
        theirs = linearize(loop, context, inputs=inputs, outputs=["hold:y", "y"])
        assert ours.input_names == theirs.input_names
        for matrix in ("a", "b", "c", "d"):
            np.testing.assert_array_equal(getattr(ours, matrix), getattr(theirs, matrix))


@pytest.mark.parametrize(
    "arguments", [{"inputs": ["plant:u0"]}, {"outputs": ["hold:y"]}, {"bypass": ["gain"]}]
)
def test_equations_that_were_read_for_another_call_say_so(loop, arguments):
    message = r"\Adiagram: its equations were read with the inputs \('r',\) first[^\n]*\Z"
    read = read_diagram(loop, inputs=["r", "plant:u0"])
    with pytest.raises(ParameterError, match=message):
        linearize(read, **{"inputs": ["r"], "outputs": ["y"]} | arguments)


@pytest.mark.filterwarnings("error")
def test_derivatives_beside_a_corner_are_the_mean_of_both_sides():
    """dx/dt = u − 2x for x > 0 and u − 4x else has the mean rate −3x."""
    x, u = Variable("x"), Variable("u")
    rate = if_then_else(x > 0.0, u - 2.0 * x, u - 4.0 * x)
    system = SymbolicVectorSystem(state=[x], input=[u], dynamics=[rate], output=[x])
    contexts = []
    for value in (0.0, 1e-9, -1e-9):
        context = system.CreateDefaultContext()
        context.SetContinuousState([value])
        system.get_input_port().FixValue(context, [0.0])
        contexts.append(context)
    at, *beside = contexts
    model = linearize(system, at, beside=beside)
    assert model.a == pytest.approx(np.array([[-3.0]]), rel=1e-12)
    assert model.operating_point.state == [0.0]
