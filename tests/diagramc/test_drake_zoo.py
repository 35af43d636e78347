"""Drake's examples and primitives, compiled, against Drake's Simulator; or refused in words.

Both sides run the same Runge-Kutta method of third order with the same fixed step, so they differ
by rounding alone: 1e-16 a step, 1e2 to 1e3 steps, little amplified by what is not chaotic within
the run. Hence 1e-9 of the largest value. All times are whole in binary: Drake handles events one
after the other whose times differ in the last bit.
"""

import re
import zlib

import numpy as np
import pytest
import scipy.sparse
from pydrake.common import RandomDistribution
from pydrake.common.value import Value
from pydrake.examples import (
    AcrobotPlant,
    AcrobotSpongController,
    CompassGait,
    PendulumGeometry,
    PendulumPlant,
    QuadrotorPlant,
    VanDerPolOscillator,
)
from pydrake.geometry import (
    Meshcat,
    MeshcatParams,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    SceneGraph,
)
from pydrake.math import BarycentricMesh
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteJoint, SpatialInertia
from pydrake.symbolic import Variable, sin
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.controllers import PidController
from pydrake.systems.framework import DiagramBuilder, PortDataType
from pydrake.systems.primitives import (
    Adder,
    AffineSystem,
    BarycentricMeshSystem,
    ConstantVectorSource,
    Demultiplexer,
    DiscreteDerivative,
    DiscreteTimeDelay,
    DiscreteTimeIntegrator,
    FirstOrderLowPassFilter,
    Gain,
    Integrator,
    LinearSystem,
    LinearTransformDensity,
    LogVectorOutput,
    MatrixGain,
    MultilayerPerceptron,
    Multiplexer,
    PassThrough,
    PortSwitch,
    RandomSource,
    Saturation,
    SharedPointerSystem,
    Sine,
    SparseMatrixGain,
    StateInterpolatorWithDiscreteDerivative,
    SymbolicVectorSystem,
    TrajectoryAffineSystem,
    TrajectoryLinearSystem,
    TrajectorySource,
    VectorLogSink,
    WrapToSystem,
    ZeroOrderHold,
)
from pydrake.trajectories import PiecewisePolynomial

from diagramc import compile_diagram
from diagramc.equations.reader import read_equations
from diagramc.errors import CompilationError
from diagramc.trajectories import input_table

DURATION_S = 1.5
STEP_S = 1 / 128
RECORD_S = 1 / 16
SAMPLE_S = 1 / 8
TOLERANCE = 1e-9


@pytest.fixture
def run():
    """``run(diagram, context, inputs, table)``: records of the compiled diagram."""

    def simulate(diagram, context, inputs=(), table=None):
        model = compile_diagram(diagram, inputs=inputs)
        parameters = model.parameters(context)
        return model.simulate(
            parameters,
            model.initialized(parameters, model.state(context), table),
            DURATION_S,
            record_period_s=RECORD_S,
            integrator="runge_kutta3",
            step_s=STEP_S,
            inputs=table,
        )

    return simulate


def vector_outputs(system):
    ports = map(system.get_output_port, range(system.num_output_ports()))
    return [port for port in ports if port.get_data_type() == PortDataType.kVectorValued]


def driven(system, offset=0.0):
    """A diagram: sines around ``offset`` into all inputs of ``system``, its outputs logged."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("block", system)
    for index in range(system.num_input_ports()):
        size = system.get_input_port(index).size()
        phases = np.linspace(0.3, 1.5, size) + index
        sine = builder.AddNamedSystem(
            f"sine_{index}", Sine(np.full(size, 1.5), 3.0 + np.arange(size), phases, True)
        )
        mean = builder.AddNamedSystem(f"mean_{index}", ConstantVectorSource(np.full(size, offset)))
        total = builder.AddNamedSystem(f"total_{index}", Adder(2, size))
        builder.Connect(sine.get_output_port(0), total.get_input_port(0))
        builder.Connect(mean.get_output_port(), total.get_input_port(1))
        builder.Connect(total.get_output_port(), system.get_input_port(index))
    for number, port in enumerate(vector_outputs(system)):
        logged(builder, port, f"out_{number}")
    return builder.Build()


def logged(builder, port, name):
    builder.ExportOutput(port, name)
    LogVectorOutput(port, builder, publish_period=RECORD_S).set_name(f"log_{name}")


def some_context(diagram, seed):
    """Parameters a little above their defaults and a random state."""
    rng = np.random.default_rng(seed)
    context = diagram.CreateDefaultContext()
    for system in diagram.GetSystems():
        if hasattr(system, "connection_map"):
            continue
        own = system.GetMyMutableContextFromRoot(context)
        for group in range(own.num_numeric_parameter_groups()):
            vector = own.get_mutable_numeric_parameter(group)
            values = np.nan_to_num(vector.CopyToVector())  # of a SymbolicVectorSystem: nan
            vector.SetFromVector(values + 0.1 * rng.uniform(size=values.size))
    context.SetContinuousState(rng.uniform(-0.5, 0.5, context.num_continuous_states()))
    for group in range(context.num_discrete_state_groups()):
        vector = context.get_mutable_discrete_state(group)
        vector.SetFromVector(rng.uniform(-0.5, 0.5, vector.size()))
    return context


def drake_run(diagram, context):
    """The log of each output of a diagram in Drake's Simulator."""
    simulator = Simulator(diagram, context.Clone())
    ResetIntegratorFromFlags(simulator, "runge_kutta3", STEP_S)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    simulator.AdvanceTo(DURATION_S)
    names = [diagram.get_output_port(n).get_name() for n in range(diagram.num_output_ports())]
    logs = {}
    for name in names:
        log = diagram.GetSubsystemByName(f"log_{name}").FindLog(simulator.get_context())
        logs[name] = log.data().T.copy()
    return logs


# ----------------------------------------------------------------------- what compiles

X, Y, U, A, TIME = (Variable(name) for name in ("x", "y", "u", "a", "t"))


def named(make, **arguments):
    return lambda: driven(make(), **arguments)


def pid_loop():
    """A pendulum under a PID controller at a set point."""
    builder = DiagramBuilder()
    pendulum = builder.AddNamedSystem("pendulum", PendulumPlant())
    controller = builder.AddNamedSystem("controller", PidController([10.0], [1.0], [1.0]))
    desired = builder.AddNamedSystem("desired", ConstantVectorSource([1.0, 0.0]))
    builder.Connect(pendulum.get_output_port(), controller.get_input_port_estimated_state())
    builder.Connect(desired.get_output_port(), controller.get_input_port_desired_state())
    builder.Connect(controller.get_output_port(), pendulum.get_input_port())
    logged(builder, pendulum.get_output_port(), "state")
    return builder.Build()


def viewed_pendulum():
    """A pendulum with its geometry and a Meshcat view."""
    builder = DiagramBuilder()
    pendulum = builder.AddNamedSystem("pendulum", PendulumPlant())
    torque = builder.AddNamedSystem("torque", ConstantVectorSource([0.1]))
    scene = builder.AddNamedSystem("scene", SceneGraph())
    builder.Connect(torque.get_output_port(), pendulum.get_input_port())
    PendulumGeometry.AddToBuilder(builder, pendulum.get_state_output_port(), scene)
    # A publish event ends a step in Drake, so the view follows the log.
    view = MeshcatVisualizerParams(publish_period=RECORD_S)
    MeshcatVisualizer.AddToBuilder(builder, scene, Meshcat(MeshcatParams(host="localhost")), view)
    logged(builder, pendulum.get_state_output_port(), "state")
    return builder.Build()


def sampled_oscillator():
    """Blocks of three sample times in a row behind a Van der Pol oscillator."""
    builder = DiagramBuilder()
    port = builder.AddNamedSystem("oscillator", VanDerPolOscillator()).get_output_port(0)
    for name, block in (
        ("hold", ZeroOrderHold(SAMPLE_S / 8, 1)),
        ("delay", DiscreteTimeDelay(SAMPLE_S / 2, 3, 1)),
        ("derivative", DiscreteDerivative(1, SAMPLE_S, False)),
        ("filter", FirstOrderLowPassFilter(0.2)),
    ):
        builder.AddNamedSystem(name, block)
        builder.Connect(port, block.get_input_port(0))
        port = block.get_output_port(0)
        logged(builder, port, name)
    return builder.Build()


SQUARE = np.array([[-1.0, 2.0], [-3.0, -0.5]])

COMPILES = {
    # pydrake.examples
    "PendulumPlant": named(PendulumPlant),
    "AcrobotPlant": named(AcrobotPlant),
    "VanDerPolOscillator": named(VanDerPolOscillator),
    "QuadrotorPlant": named(QuadrotorPlant, offset=2.0),
    # continuous
    "Integrator": named(lambda: Integrator(2)),
    "FirstOrderLowPassFilter": named(lambda: FirstOrderLowPassFilter([0.1, 0.5])),
    "LinearSystem": named(lambda: LinearSystem(SQUARE, np.eye(2), np.ones((1, 2)), [[0.0, 3.0]])),
    "AffineSystem": named(
        lambda: AffineSystem(SQUARE, np.eye(2), [1.0, 2.0], np.eye(2), SQUARE, [3.0, 4.0])
    ),
    "PidController": named(lambda: PidController([1.0, 2.0], [3.0, 4.0], [5.0, 6.0])),
    "PidController in a loop": pid_loop,
    "SymbolicVectorSystem": named(
        lambda: SymbolicVectorSystem(
            time=TIME,
            state=[X, Y],
            input=[U],
            parameter=[A],
            dynamics=[Y + sin(TIME), -(X**3) - (1.0 + A) * Y + U],
            output=[X * Y],
        )
    ),
    # sampled
    "LinearSystem, sampled": named(
        lambda: LinearSystem(0.3 * SQUARE, np.eye(2), np.eye(2), SQUARE, SAMPLE_S)
    ),
    "SymbolicVectorSystem, sampled": named(
        lambda: SymbolicVectorSystem(
            time=TIME,
            state=[X],
            input=[U],
            dynamics=[0.5 * X + sin(TIME) * U],
            output=[X],
            time_period=SAMPLE_S,
        )
    ),
    "DiscreteTimeIntegrator": named(lambda: DiscreteTimeIntegrator(2, SAMPLE_S)),
    "DiscreteTimeDelay": named(lambda: DiscreteTimeDelay(SAMPLE_S, 3, 2)),
    "DiscreteDerivative": named(lambda: DiscreteDerivative(2, SAMPLE_S, False)),
    "DiscreteDerivative, transient": named(lambda: DiscreteDerivative(1, SAMPLE_S, True)),
    "StateInterpolatorWithDiscreteDerivative": named(
        lambda: StateInterpolatorWithDiscreteDerivative(1, SAMPLE_S, True)
    ),
    "ZeroOrderHold": named(lambda: ZeroOrderHold(SAMPLE_S, 2)),
    "ZeroOrderHold, offset": named(lambda: ZeroOrderHold(SAMPLE_S, 2, offset_sec=SAMPLE_S / 4)),
    "three sample times": sampled_oscillator,
    # without state
    "Adder": named(lambda: Adder(3, 2)),
    "ConstantVectorSource": named(lambda: ConstantVectorSource([1.0, 2.0])),
    "Demultiplexer": named(lambda: Demultiplexer([1, 2])),
    "Gain": named(lambda: Gain([2.0, 3.0])),
    "MatrixGain": named(lambda: MatrixGain(SQUARE)),
    "MultilayerPerceptron": named(lambda: MultilayerPerceptron([1, 3, 1])),
    "Multiplexer": named(lambda: Multiplexer([1, 2])),
    "PassThrough": named(lambda: PassThrough(2)),
    "Saturation": named(lambda: Saturation([-1.0, -0.5], [0.5, 1.0])),
    "Sine": named(lambda: Sine([1.0, 2.0], [3.0, 4.0], [0.1, 0.2], True)),
    "SparseMatrixGain": named(lambda: SparseMatrixGain(scipy.sparse.csc_matrix(SQUARE))),
    # what the equations do not see
    "Meshcat": viewed_pendulum,
}

NO_OUTPUT = {
    "SceneGraph": SceneGraph,
    "SharedPointerSystem": lambda: SharedPointerSystem([1]),
    "VectorLogSink": lambda: VectorLogSink(1),
}


@pytest.mark.parametrize("name", COMPILES)
def test_compiled_is_drake(name, run):
    diagram = COMPILES[name]()
    context = some_context(diagram, zlib.crc32(name.encode()))
    expected = drake_run(diagram, context)
    result = run(diagram, context)
    assert result.outputs.keys() == expected.keys() != set()
    for output, values in expected.items():
        assert result[output].shape == values.shape
        scale = max(1.0, np.max(np.abs(values)))
        np.testing.assert_allclose(result[output], values, rtol=0, atol=TOLERANCE * scale)


@pytest.mark.parametrize("name", NO_OUTPUT)
def test_blocks_without_a_part_in_the_equations_are_left_out(name):
    equations = read_equations(driven(NO_OUTPUT[name]()))
    assert equations.parameters == equations.states == []
    assert equations.outputs == {}


def test_trajectory_as_an_input_table(run):
    trajectory = PiecewisePolynomial.CubicShapePreserving(
        [0.0, 0.25, 0.5, 0.75], np.array([[0.0, 1.0, 0.5, 2.0]])
    )

    def plant_behind(source):
        builder = DiagramBuilder()
        plant = builder.AddNamedSystem("plant", LinearSystem(SQUARE, SQUARE, np.eye(2)))
        if source:
            block = builder.AddNamedSystem("source", TrajectorySource(trajectory, 1))
            builder.Connect(block.get_output_port(), plant.get_input_port())
        else:
            builder.ExportInput(plant.get_input_port(), "reference")
        logged(builder, plant.get_output_port(), "out")
        return builder.Build()

    diagram = plant_behind(source=True)
    expected = drake_run(diagram, diagram.CreateDefaultContext())
    diagram = plant_behind(source=False)
    context = diagram.CreateDefaultContext()
    result = run(diagram, context, ["reference"], input_table(trajectory, 1))
    np.testing.assert_allclose(result["out"], expected["out"], rtol=0, atol=TOLERANCE)


# ---------------------------------------------------------------------- what is refused


def one_joint(time_step):
    plant = MultibodyPlant(time_step)
    body = plant.AddRigidBody("arm", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
    plant.AddJoint(RevoluteJoint("joint", plant.world_frame(), body.body_frame(), [0, 1, 0]))
    plant.Finalize()
    return plant


def one_by_one(value):
    return PiecewisePolynomial(np.array([[value]]))


NOT_SYMBOLIC = "block: {} does not convert to symbolic Expression"
ABSTRACT = "block: {} has an abstract state or parameter; only vectors compile"

REFUSED = {
    # RimlessWheel: see test_events, in a process of its own
    "CompassGait": (CompassGait, "block: CompassGait has a witness function"),
    "MultibodyPlant": (lambda: one_joint(0.0), ABSTRACT.format("MultibodyPlant")),
    "MultibodyPlant, sampled": (lambda: one_joint(0.001), ABSTRACT.format("MultibodyPlant")),
    "ZeroOrderHold of values": (
        lambda: ZeroOrderHold(0.1, Value(1)),
        ABSTRACT.format("ZeroOrderHold"),
    ),
    "DiscreteTimeDelay of values": (
        lambda: DiscreteTimeDelay(0.1, 3, Value(1)),
        ABSTRACT.format("DiscreteTimeDelay"),
    ),
    "AcrobotSpongController": (
        AcrobotSpongController,
        NOT_SYMBOLIC.format("AcrobotSpongController"),
    ),
    "BarycentricMeshSystem": (
        lambda: BarycentricMeshSystem(BarycentricMesh([{0.0, 1.0}]), [[0.0, 1.0]]),
        NOT_SYMBOLIC.format("BarycentricMeshSystem"),
    ),
    "LinearTransformDensity": (
        lambda: LinearTransformDensity(RandomDistribution.kUniform, 2, 2),
        NOT_SYMBOLIC.format("LinearTransformDensity"),
    ),
    "RandomSource": (
        lambda: RandomSource(RandomDistribution.kUniform, 1, 0.1),
        NOT_SYMBOLIC.format("RandomSource"),
    ),
    "TrajectoryAffineSystem": (
        lambda: TrajectoryAffineSystem(*map(one_by_one, range(6))),
        NOT_SYMBOLIC.format("TrajectoryAffineSystem"),
    ),
    "TrajectoryLinearSystem": (
        lambda: TrajectoryLinearSystem(*map(one_by_one, range(4))),
        NOT_SYMBOLIC.format("TrajectoryLinearSystem"),
    ),
    "WrapToSystem": (lambda: WrapToSystem(1), NOT_SYMBOLIC.format("WrapToSystem")),
    "PortSwitch": (lambda: PortSwitch(1), "block: output port value: has no symbolic form"),
    "TrajectorySource": (
        lambda: TrajectorySource(one_by_one(1.0)),
        "block: output port y0: has no symbolic form, and pydrake hides its trajectory; export "
        "the input port that it feeds, keep that open by inputs=[...], and pass "
        "input_table(trajectory)",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_does_not_compile_says_why(name):
    make, words = REFUSED[name]
    builder = DiagramBuilder()
    system = builder.AddNamedSystem("block", make())
    names = []
    for index in range(system.num_input_ports()):
        port = system.get_input_port(index)
        builder.ExportInput(port, f"in_{index}")
        if port.get_data_type() == PortDataType.kVectorValued:
            names.append(f"in_{index}")
    for number, port in enumerate(vector_outputs(system)):
        builder.ExportOutput(port, f"out_{number}")
    with pytest.raises(CompilationError, match=re.escape(words)) as error:
        read_equations(builder.Build(), names)
    assert "\n" not in str(error.value)
