"""Linear models of diagrams without symbolic equations, against equations written by hand."""

import math
import re
import warnings

import numpy as np
import pytest
import scipy
from pydrake.autodiffutils import AutoDiffXd
from pydrake.common.value import AbstractValue
from pydrake.geometry import Box
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    MultibodyPlant,
    Propeller,
)
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PrismaticJoint,
    RevoluteJoint,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.framework import DiagramBuilder, LeafSystem, LeafSystem_
from pydrake.systems.primitives import DiscreteTimeDelay, Gain, MatrixGain, ZeroOrderHold
from pydrake.systems.scalar_conversion import TemplateSystem
from pydrake.systems.sensors import RotaryEncoders

from diagramc import (
    CompilationError,
    advice,
    find_equilibrium,
    linearize,
    loop_at,
    margins,
    read_for_linearization,
)

GRAVITY = 9.81
MASSES, LENGTHS = (1.0, 0.7, 0.5), (0.6, 0.5, 0.4)


def hanging_arm(count, plant):
    """Add rods with point masses at their lower ends, which motors turn about the y axis."""
    body, height = plant.world_body(), 0.0
    for number in range(count):
        mass, length = MASSES[number], LENGTHS[number]
        inertia = SpatialInertia(mass, [0.0, 0.0, -length], UnitInertia(length**2, length**2, 0.0))
        link = plant.AddRigidBody(f"link{number}", inertia)
        offset = RigidTransform([0.0, 0.0, height])
        frame = plant.AddFrame(FixedOffsetFrame(f"end{number}", body.body_frame(), offset))
        joint = RevoluteJoint(f"joint{number}", frame, link.body_frame(), [0.0, 1.0, 0.0])
        plant.AddJointActuator(f"motor{number}", plant.AddJoint(joint))
        body, height = link, -length
    plant.Finalize()
    return plant


def arm_matrices(count):
    """Return A and B of the hanging arm at rest, from the Lagrangian of point masses."""
    absolute = np.tril(np.ones((count, count)))  # angles to the vertical from relative angles
    mass, stiffness = np.zeros((2, count, count))
    for number in range(count):
        reach = np.where(np.arange(count) <= number, LENGTHS[:count], 0.0)
        mass += MASSES[number] * np.outer(reach @ absolute, reach @ absolute)
        stiffness += MASSES[number] * GRAVITY * absolute.T @ np.diag(reach) @ absolute
    zero = np.zeros((count, count))
    a = np.block([[zero, np.eye(count)], [-np.linalg.solve(mass, stiffness), zero]])
    return a, np.vstack([zero, np.linalg.inv(mass)])


class Floats(LeafSystem):
    """y = f(u), for floats only."""

    def __init__(self, function, inputs=1, outputs=1):
        super().__init__()
        self.function = function
        self.DeclareVectorInputPort("u", inputs)
        self.DeclareVectorOutputPort("y", outputs, self._output)

    def _output(self, context, output):
        output.SetFromVector(self.function(self.get_input_port().Eval(context)))


def float_gain(gains):
    """Return the leaf y = K u."""
    return Floats(lambda u: gains @ u, *gains.shape[::-1])


class FloatSine(LeafSystem):
    """y = sin u, for floats only."""

    def __init__(self):
        super().__init__()
        port = self.DeclareVectorInputPort("u", 1)
        self.DeclareVectorOutputPort("y", 1, lambda c, y: y.SetFromVector(np.sin(port.Eval(c))))


@pytest.mark.parametrize("u", [0.7, 40.0])
def test_differences_of_a_leaf_of_floats_are_as_exact_as_they_say(u):
    system = FloatSine()
    context = system.CreateDefaultContext()
    system.get_input_port().FixValue(context, [u])
    with pytest.warns(UserWarning, match="about 1e-11 if the leaf is smooth over 0.1 %"):
        model = linearize(system, context)
    assert model.d[0, 0] == pytest.approx(np.cos(u), abs=1e-10 if u < 1.0 else 1e-7)


@pytest.mark.parametrize("width", [1.0, 5e-3, 1e-3])
def test_differences_take_shorter_steps_where_a_leaf_changes_fast(width):
    # Friction near rest: u changes the force within `width`, and the state within 1.
    leaf = Floats(lambda u: np.tanh(u / width) + np.sin(u), 1, 1)
    context = leaf.CreateDefaultContext()
    leaf.get_input_port().FixValue(context, [0.1 * width])
    with pytest.warns(UserWarning, match="central differences"):
        (found,) = linearize(leaf, context).d.ravel()
    exact = 1.0 / (width * np.cosh(0.1) ** 2) + np.cos(0.1 * width)
    assert found == pytest.approx(exact, rel=1e-10 if width == 1.0 else 1e-7)


def test_steps_of_a_table_are_no_zero_derivative():
    leaf = Floats(lambda u: [np.round(1e4 * u[0]) / 1e4 + u[1]], 2, 1)
    context = leaf.CreateDefaultContext()
    leaf.get_input_port().FixValue(context, [0.3, 0.2])
    with pytest.warns(UserWarning, match="has no derivative near this point"):
        model = linearize(leaf, context)
    np.testing.assert_allclose(model.d, [[1.0, 1.0]], rtol=1e-9)


def test_leaves_that_are_not_symbolic_are_read_once_for_many_models():
    builder = DiagramBuilder()
    leaf = builder.AddNamedSystem("leaf", float_gain(np.array([[-2.0]])))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.1, 1))
    builder.Connect(leaf.get_output_port(), hold.get_input_port())
    builder.Connect(hold.get_output_port(), leaf.get_input_port())
    diagram = builder.Build()
    read = read_for_linearization(diagram, inputs=["leaf:u"], outputs=["hold:y"])
    for gain, value in ((-2.0, 0.0), (-3.0, 0.5)):
        leaf.function = lambda u, gain=gain: gain * u
        context = diagram.CreateDefaultContext()
        context.SetDiscreteState([value])
        with pytest.warns(UserWarning, match="leaf: Floats: does not convert to AutoDiffXd"):
            model = linearize(
                read,
                context,
                inputs=["leaf:u"],
                outputs=["hold:y"],
                equilibrium_tolerance=math.inf,
            )
        np.testing.assert_allclose([model.a[0, 0], model.b[0, 0]], [gain, gain], rtol=1e-11)


def sampled_loop(plant, gain, period_s, delay_s=0.0):
    """Return a diagram in which sampled feedback of the state moves the joints of a plant."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("arm", plant)
    hold = builder.AddNamedSystem("sampler", ZeroOrderHold(period_s, plant.num_multibody_states()))
    builder.AddNamedSystem("gain", gain)
    builder.Connect(plant.get_state_output_port(), hold.get_input_port())
    builder.Connect(hold.get_output_port(), gain.get_input_port())
    command = gain.get_output_port()
    if delay_s:
        delay = builder.AddNamedSystem("delay", DiscreteTimeDelay(delay_s, 1, command.size()))
        builder.Connect(command, delay.get_input_port())
        command = delay.get_output_port()
    builder.Connect(command, plant.get_actuation_input_port())
    builder.ExportOutput(plant.get_state_output_port(), "state")
    return builder.Build()


def gains_of(count):
    return np.hstack([5.0 * np.eye(count), 0.3 * np.eye(count)])


def stepped(count, period_s):
    """Return the exact matrices of the arm over a period with a constant torque."""
    a, b = arm_matrices(count)
    n = 2 * count
    both = scipy.linalg.expm(
        period_s * np.vstack([np.hstack([a, b]), np.zeros((count, n + count))])
    )
    return both[:n, :n], both[:n, n:]


@pytest.mark.parametrize("form", [MatrixGain, float_gain])
@pytest.mark.parametrize("period_s", [0.001, 0.005, 0.02])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_sampled_arm_against_its_own_equations(count, period_s, form):
    gain = form(-gains_of(count))
    diagram = sampled_loop(hanging_arm(count, MultibodyPlant(0.0)), gain, period_s)
    with warnings.catch_warnings():
        warnings.simplefilter("error" if form is MatrixGain else "ignore")
        model = linearize(diagram)
    a, b = stepped(count, period_s)
    n = 2 * count
    # The state of the arm, and the state that the sampler holds from the beginning of the period.
    expected = np.block(
        [[a - b @ gains_of(count), np.zeros((n, n))], [np.eye(n), np.zeros((n, n))]]
    )
    assert model.period_s == period_s
    np.testing.assert_allclose(model.a, expected, rtol=1e-9, atol=1e-10)


def test_two_rates_and_a_delay_against_powers_of_the_matrices():
    diagram = sampled_loop(
        hanging_arm(1, MultibodyPlant(0.0)), MatrixGain(-gains_of(1)), 0.01, 0.005
    )
    model = linearize(diagram)
    a, b = stepped(1, 0.005)
    rows = np.eye(len(model.a))
    arm, sampler, delay = rows[:2], rows[2:4], rows[4:]
    for samples in (True, False):
        # All updates of a time read the states from before this time.
        delay = np.vstack([delay[1:], -gains_of(1) @ sampler])
        sampler = arm if samples else sampler
        arm = a @ arm + b @ delay[:1]
    np.testing.assert_allclose(model.a, np.vstack([arm, sampler, delay]), rtol=1e-9, atol=1e-10)


def test_margins_of_an_arm_against_a_dense_grid():
    diagram = sampled_loop(hanging_arm(1, MultibodyPlant(0.0)), MatrixGain(-gains_of(1)), 0.02)
    a, b = stepped(1, 0.02)

    def loop(w):
        z = np.exp(1j * w * 0.02)
        return (gains_of(1) @ np.linalg.solve(z * np.eye(2) - a, b))[0, 0]

    found = margins(loop_at(diagram, "gain:y0"))
    grid = np.linspace(1.0, np.pi / 0.02, 2_001)
    values = np.array([loop(w) for w in grid])
    crossing = np.nonzero((np.abs(values[:-1]) > 1.0) & (np.abs(values[1:]) <= 1.0))[0][-1]
    w = scipy.optimize.brentq(lambda w: abs(loop(w)) - 1.0, *grid[crossing : crossing + 2])
    assert found.phase_margin_deg == pytest.approx(180.0 + np.degrees(np.angle(loop(w))), rel=1e-6)


def tree_of(seed, plant):
    """Add a random tree of four bodies with revolute and prismatic joints to a plant."""
    random = np.random.default_rng(seed)
    bodies = [plant.world_body()]
    for number in range(4):
        mass, place = random.uniform(0.5, 2.0), random.uniform(-0.3, 0.3, 3)
        own = UnitInertia(*random.uniform(0.05, 0.08, 3)).ShiftFromCenterOfMass(place)
        body = plant.AddRigidBody(f"body{number}", SpatialInertia(mass, place, own))
        parent = bodies[random.integers(len(bodies))].body_frame()
        frame = plant.AddFrame(
            FixedOffsetFrame(f"frame{number}", parent, RigidTransform(random.uniform(-0.3, 0.3, 3)))
        )
        kind = (RevoluteJoint, PrismaticJoint)[number % 2]
        axis = random.normal(size=3)
        joint = kind(f"joint{number}", frame, body.body_frame(), axis / np.linalg.norm(axis))
        plant.AddJointActuator(f"motor{number}", plant.AddJoint(joint))
        bodies.append(body)
    plant.Finalize()
    return plant


@pytest.mark.parametrize("seed", range(5))
def test_random_trees_against_central_differences(seed):
    plant = tree_of(seed, MultibodyPlant(0.0))
    context = plant.CreateDefaultContext()
    random = np.random.default_rng(seed)
    start, torque = random.uniform(-0.5, 0.5, 8), random.uniform(-1.0, 1.0, 4)
    context.SetContinuousState(start)
    plant.get_actuation_input_port().FixValue(context, torque)
    model = linearize(
        plant, context, inputs=["actuation"], outputs=["state"], equilibrium_tolerance=np.inf
    )

    def rates(values):
        context.SetContinuousState(values[:8])
        plant.get_actuation_input_port().FixValue(context, values[8:])
        return plant.EvalTimeDerivatives(context).CopyToVector()

    at = np.concatenate([start, torque])

    def slope(direction, step):
        return (rates(at + step * direction) - rates(at - step * direction)) / (2.0 * step)

    for column, unit in enumerate(np.eye(12)):
        found = np.hstack([model.a, model.b])[:, column]
        np.testing.assert_allclose(
            found, (4.0 * slope(unit, 1e-3) - slope(unit, 2e-3)) / 3.0, rtol=1e-6, atol=1e-7
        )


def test_the_torques_that_hold_an_arm_are_found():
    plant = hanging_arm(2, MultibodyPlant(0.0))
    context = plant.CreateDefaultContext()
    context.SetContinuousState([0.4, 0.3, 0.0, 0.0])
    rest = find_equilibrium(plant, context, fixed=["x[0]", "x[1]"], free_inputs=["actuation"])
    lower = MASSES[1] * GRAVITY * LENGTHS[1] * np.sin(0.7)
    upper = lower + (MASSES[0] + MASSES[1]) * GRAVITY * LENGTHS[0] * np.sin(0.4)
    np.testing.assert_allclose(
        plant.get_actuation_input_port().Eval(rest), [upper, lower], rtol=1e-9
    )


@TemplateSystem.define("Forgetful_", T_list=[float, AutoDiffXd])
def Forgetful_(T):
    class Impl(LeafSystem_[T]):
        """y = 2 x, dx/dt = u + 1 − gain (x + 1), without symbolic form; a message is no vector."""

        def _construct(self, gain=3.0, forgets=False, converter=None):
            LeafSystem_[T].__init__(self, converter)
            self.gain, self.forgets = gain, forgets
            self.DeclareVectorInputPort("u", 1)
            self.DeclareContinuousState(1)
            self.DeclareVectorOutputPort("y", 1, self._output, {self.all_state_ticket()})
            text = lambda: AbstractValue.Make("text")  # noqa: E731
            self.DeclareAbstractOutputPort("message", text, lambda c, out: out.set_value("x"))

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, 1.0 if other.forgets else other.gain, other.forgets, converter)

        def _output(self, context, output):
            output.SetFromVector([2.0 * context.get_continuous_state_vector()[0]])

        def DoCalcTimeDerivatives(self, context, rates):
            x, u = context.get_continuous_state_vector()[0], self.get_input_port().Eval(context)[0]
            rates.get_mutable_vector().SetFromVector([u + 1.0 - self.gain * (x + 1.0)])

    return Impl


def leaf_loop(leaf, middle=None):
    """Return a diagram that feeds the port y of a leaf back to its port u."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("leaf", leaf)
    middle = builder.AddNamedSystem("middle", Gain(-1.0, 1) if middle is None else middle)
    builder.Connect(leaf.GetOutputPort("y"), middle.get_input_port())
    builder.Connect(middle.get_output_port(), leaf.GetInputPort("u"))
    for name in ("y", "message"):
        builder.ExportOutput(leaf.GetOutputPort(name), name)
    return builder.Build()


def test_an_output_that_is_no_vector_does_not_matter():
    model = linearize(leaf_loop(Forgetful_[None]()), equilibrium_tolerance=np.inf)
    np.testing.assert_allclose([model.a, model.c], [[[-5.0]], [[2.0]]], rtol=1e-12)


def floating_body():
    plant = MultibodyPlant(0.0)
    plant.AddRigidBody("body", SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.1, 0.1))
    plant.Finalize()
    return plant


def box_on_ground():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.0)
    body = plant.AddRigidBody("box", SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.1, 0.1))
    joint = PrismaticJoint("z", plant.world_frame(), body.body_frame(), [0.0, 0.0, 1.0])
    plant.AddJoint(joint)
    for of in (plant.world_body(), body):
        shape, friction = Box(0.1, 0.1, 0.1), CoulombFriction(0.5, 0.5)
        plant.RegisterCollisionGeometry(of, RigidTransform(), shape, "shape", friction)
    plant.Finalize()
    plant.set_name("plant")
    return builder.Build()


def propelled_body():
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem("plant", MultibodyPlant(0.0))
    body = plant.AddRigidBody("body", SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.1, 0.1))
    plant.Finalize()
    propeller = builder.AddNamedSystem("propeller", Propeller(body.index()))
    for source, target in (
        (plant.get_body_poses_output_port(), propeller.get_body_poses_input_port()),
        (
            propeller.get_spatial_forces_output_port(),
            plant.get_applied_spatial_force_input_port(),
        ),
    ):
        builder.Connect(source, target)
    return builder.Build()


def test_a_torque_fixed_inside_moves_the_equilibrium():
    builder = DiagramBuilder()
    arm = builder.AddNamedSystem("arm", hanging_arm(1, MultibodyPlant(0.0)))
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    torque = 0.5 * MASSES[0] * GRAVITY * LENGTHS[0]
    arm.get_actuation_input_port().FixValue(arm.GetMyMutableContextFromRoot(context), [torque])
    rest = find_equilibrium(diagram, context)
    assert rest.get_continuous_state_vector()[0] == pytest.approx(np.pi / 6.0, rel=1e-9)


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (
            propelled_body,
            "plant: time derivatives: its input applied_spatial_force: is no vector",
        ),
        (
            lambda: leaf_loop(Forgetful_[None](), Floats(lambda u: [math.sqrt(u[0])])),
            r"middle: output port y: fails beside this point, for differences \(.*test_leafwise.py",
        ),
        (
            lambda: leaf_loop(Forgetful_[None](forgets=True)),
            "leaf: time derivatives: AutoDiffXd gives 0 where floats give -2; the conversion of "
            "Forgetful must keep",
        ),
        (
            lambda: hanging_arm(1, MultibodyPlant(0.01)),
            "MultibodyPlant: has an abstract state, which has no derivative; for .* call "
            r"SetUseSampledOutputPorts\(False\) before its Finalize\(\)",
        ),
        (
            box_on_ground,
            "plant: time derivatives: its input geometry_query: is no vector",
        ),
    ],
)
def test_a_leaf_without_a_right_derivative_is_refused(make, line):
    with pytest.raises(CompilationError, match=line):
        linearize(make(), equilibrium_tolerance=np.inf)


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (
            lambda: leaf_loop(Forgetful_[None](), RotaryEncoders([64])),
            "middle: output port y0: has no derivative near this point",
        ),
        (
            lambda: leaf_loop(Forgetful_[None](), Floats(np.abs)),
            "middle: output port y: has no derivative near this point",
        ),
        (floating_body, "has a quaternion: the model has one more eigenvalue"),
        (
            lambda: leaf_loop(Forgetful_[None](), float_gain(np.eye(1))),
            "middle: Floats: does not convert to AutoDiffXd: its derivatives are central",
        ),
    ],
)
def test_what_a_linear_model_hides_is_said(make, line):
    diagram = make()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        linearize(diagram, inputs=(), equilibrium_tolerance=np.inf)
    assert any(re.search(line, str(warning.message)) for warning in said)
    assert any(re.search(line, str(obstacle)) for obstacle in advice(diagram))


def test_a_sampled_plant_without_sampled_outputs():
    plant = MultibodyPlant(0.01)
    plant.SetUseSampledOutputPorts(False)
    hanging_arm(1, plant)
    model = linearize(plant, inputs=["actuation"], outputs=["state"])
    a, b = arm_matrices(1)
    # Semi-implicit Euler: the new velocity moves the angle.
    expected = np.eye(2) + 0.01 * np.array([[0.01 * a[1, 0], 1.0], [a[1, 0], 0.0]])
    np.testing.assert_allclose(model.a, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(model.b, 0.01 * b[1] * np.array([[0.01], [1.0]]), rtol=1e-9)
