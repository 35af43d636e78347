"""What spoils a linear model: the block, the port, the reason and the remedy."""

import warnings

import numpy as np
import pytest
from pydrake.symbolic import (
    Expression,
    Variable,
    abs as symbolic_abs,
    atan2,
    cos,
    floor,
    if_then_else,
    max as symbolic_max,
    sin,
    sqrt,
)
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    Gain,
    Integrator,
    LinearSystem,
    Saturation,
    SymbolicVectorSystem,
    ZeroOrderHold,
)
from pydrake.systems.sensors import RotaryEncoders

from diagramc import (
    CompilationError,
    LinearizationError,
    ParameterError,
    advice,
    find_equilibrium,
    linearize,
    loop_at,
    margins,
)

U = Variable("u")
LAG = ([[-1.0]], [[1.0]], [[1.0]], [[0.0]])


def function(expression):
    """A block of the name f with the input U and an output."""
    return SymbolicVectorSystem(input=[U], output=[expression])


def feedback(*blocks, reference=0.0, hold=False):
    """A lag whose output passes the blocks, a hold if required, and −1, and adds to a reference."""
    builder = DiagramBuilder()
    lag = builder.AddNamedSystem("lag", LinearSystem(*LAG))
    source = builder.AddNamedSystem("reference", ConstantVectorSource([reference]))
    add = builder.AddNamedSystem("add", Adder(2, 1))
    chain = [*blocks, ("minus", Gain(-1.0, 1))]
    if hold:
        chain.insert(0, ("hold", ZeroOrderHold(0.1, 1)))
    port = lag.get_output_port()
    for name, block in chain:
        block = builder.AddNamedSystem(name, block)
        builder.Connect(port, block.get_input_port(0))
        port = block.get_output_port(0)
    builder.Connect(source.get_output_port(), add.get_input_port(0))
    builder.Connect(port, add.get_input_port(1))
    builder.Connect(add.get_output_port(), lag.get_input_port())
    builder.ExportOutput(lag.get_output_port(), "y")
    diagram = builder.Build()
    diagram.set_name("loop")
    return diagram


def at(diagram, state):
    context = diagram.CreateDefaultContext()
    context.SetContinuousState([state])
    return context


def test_smooth_blocks_have_no_obstacle():
    diagram = feedback(("f", function(sin(U) + U * U)), ("limit", Saturation([-1.0], [1.0])))
    assert advice(diagram, outputs=["y"]) == []


def test_an_encoder_is_named_with_what_to_do():
    diagram = feedback(("encoder", RotaryEncoders([100])))
    (obstacle,) = advice(diagram)
    assert (obstacle.path, obstacle.port) == ("encoder", "output port y0")
    assert str(obstacle) == (
        "encoder: output port y0: rounds its input: its derivative is zero; remove the quantizer, "
        "or bypass=['encoder']"
    )


def test_a_bypassed_encoder_is_a_wire():
    diagram = feedback(("encoder", RotaryEncoders([100])), reference=1.0)
    with pytest.warns(UserWarning, match=r"\Aencoder: output port y0: rounds") as record:
        blind = linearize(diagram, at(diagram, 0.51), outputs=["y"], inputs=[], **ANYWHERE)
    assert record[0].filename == __file__
    assert blind.a.tolist() == [[-1.0]]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        context = find_equilibrium(diagram, bypass=["encoder"])
        model = linearize(diagram, context, inputs=[], outputs=["y"], bypass=["encoder"])
        loop = loop_at(diagram, "lag:y0", context, bypass=["encoder"])
    assert context.get_continuous_state_vector()[0] == pytest.approx(0.5, rel=1e-14)
    assert model.a.tolist() == [[-2.0]]
    assert loop.response(0.0)[0] == pytest.approx(1.0, rel=1e-14)
    assert margins(loop).stable


ANYWHERE = {"equilibrium_tolerance": np.inf}


def test_whole_turns_of_an_angle_are_no_quantizer():
    diagram = feedback(("f", function(atan2(sin(U), cos(U)))))
    assert advice(diagram, at(diagram, 7.0), **ANYWHERE) == []
    model = linearize(diagram, at(diagram, 7.0), inputs=[], outputs=["y"], **ANYWHERE)
    assert model.a == pytest.approx(-2.0)


@pytest.mark.parametrize(
    ("expression", "state", "reason"),
    [
        (0.1 * floor(10.0 * U + 0.5), 0.03, "rounds its input: its derivative is zero"),
        (2.0 * U + floor(U), 0.5, "rounds its input: its derivative is zero"),
        (symbolic_abs(U - 1.0), 1.0, "an absolute value is at its corner: the derivatives on"),
        (symbolic_max(U, 2.0 * U), 0.0, "a maximum is at its corner: the derivatives on both"),
        (if_then_else(U > 1.0, U, 3.0 * U), 1.0, "a switch is at its corner: the derivatives on"),
        (if_then_else(U > 1.0, U, Expression(4.0)), 0.5, "is constant at 4 here, as at a limit"),
        (symbolic_abs(U - 1.0), 1.0 + 1e-13, "an absolute value is at its corner"),
        (symbolic_max(U, 2.0 - U), 1.0 + 1e-13, "a maximum is at its corner"),
        (sqrt(U), 0.0, "the derivative of sqrt is not finite"),
    ],
    ids=[
        "quantizer",
        "in_part",
        "abs",
        "max",
        "switch",
        "constant",
        "near_abs",
        "near_max",
        "root",
    ],
)
def test_each_kind_of_obstacle(expression, state, reason):
    diagram = feedback(("f", function(expression)))
    (obstacle,) = advice(diagram, at(diagram, state), **ANYWHERE)
    assert (obstacle.path, obstacle.port) == ("f", "output port y0")
    assert obstacle.reason.startswith(reason)
    assert obstacle.remedy.endswith(", or bypass=['f']")


@pytest.mark.parametrize(
    ("expression", "state"),
    [
        (symbolic_abs(U - 1.0), 1.01),
        (symbolic_max(U, 2.0 * U), 0.01),
        (if_then_else(U > 1.0, U, 3.0 * U), 1.01),
        (if_then_else(U > 1.0, U * U, U * U), 1.0),
        (if_then_else(U > 1.0, U, floor(U)), 2.0),
        (if_then_else(U > 1.0, U, sqrt(2.0 - U)), 2.0),
        (U + if_then_else(U > 1.0, U, Expression(4.0)), 0.5),
        (sqrt(U), 0.01),
    ],
    ids=["abs", "max", "switch", "equal", "branch", "branch_root", "sum", "root"],
)
def test_beside_a_corner_there_is_no_obstacle(expression, state):
    diagram = feedback(("f", function(expression)))
    assert advice(diagram, at(diagram, state), **ANYWHERE) == []


@pytest.mark.parametrize(("state", "count"), [(0.9, 0), (1.1, 1), (-1.1, 1), (1.0, 1)])
def test_a_saturation_at_its_limit(state, count):
    diagram = feedback(("limit", Saturation([-1.0], [1.0])), hold=True)
    context = at(diagram, state)
    context.SetDiscreteState([state])
    assert len(advice(diagram, context, **ANYWHERE)) == count


def test_a_corner_behind_a_quantizer_is_seen():
    diagram = feedback(("encoder", RotaryEncoders([100])), ("limit", Saturation([-1.0], [1.0])))
    paths = [obstacle.path for obstacle in advice(diagram, at(diagram, 2.0), **ANYWHERE)]
    assert paths == ["encoder", "limit"]


def test_obstacles_that_nothing_depends_on_do_not_count():
    builder = DiagramBuilder()
    lag = builder.AddNamedSystem("lag", LinearSystem(*LAG))
    rounds = builder.AddNamedSystem("rounds", function(floor(U)))
    builder.Connect(lag.get_output_port(), rounds.get_input_port())
    builder.ExportInput(lag.get_input_port(), "u")
    builder.ExportOutput(lag.get_output_port(), "y")
    builder.ExportOutput(rounds.get_output_port(), "z")
    diagram = builder.Build()
    assert advice(diagram, inputs=["u"], outputs=["y"]) == []
    assert [o.path for o in advice(diagram, inputs=["u"], outputs=["z"])] == ["rounds"]


def test_an_integrator_of_a_constant_has_no_equilibrium():
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", ConstantVectorSource([2.0]))
    first = builder.AddNamedSystem("first", Integrator(1))
    second = builder.AddNamedSystem("second", Integrator(1))
    builder.Connect(source.get_output_port(), first.get_input_port())
    builder.Connect(first.get_output_port(), second.get_input_port())
    diagram = builder.Build()
    (obstacle,) = advice(diagram)
    assert (obstacle.path, obstacle.port) == ("first", "state first.x[0]")
    assert obstacle.reason == "changes by 2 per s, and no state brings this to zero"
    assert advice(diagram, **ANYWHERE) == []


def test_an_open_input_brings_no_state_to_rest():
    context = (integrator := Integrator(1)).CreateDefaultContext()
    integrator.get_input_port().FixValue(context, [3.0])
    (obstacle,) = advice(integrator, context, inputs=["u0"])
    assert obstacle.reason == "changes by 3 per s, and no state brings this to zero"


def test_a_state_off_its_equilibrium_is_named_as_linearize_refuses_the_point():
    diagram = feedback(reference=1.0)
    (obstacle,) = advice(diagram)
    assert (obstacle.path, obstacle.port) == ("lag", "state lag.x[0]")
    assert obstacle.reason == "is not at rest: d(lag.x[0])/dt = 1 per s"
    assert advice(diagram, **ANYWHERE) == []
    assert advice(diagram, find_equilibrium(diagram)) == []


def test_a_point_that_is_not_finite_is_the_error_of_linearize():
    diagram = feedback()
    errors = []
    for function in (advice, linearize):
        with pytest.raises(
            LinearizationError, match=r"the rate of lag.x.0. is not finite"
        ) as error:
            function(diagram, at(diagram, np.nan), inputs=[], outputs=["y"])
        errors.append(str(error.value))
    assert errors[0] == errors[1]


@pytest.mark.parametrize("tolerance", [-1.0, "a", True, np.nan])
def test_a_wrong_tolerance_is_refused(tolerance):
    diagram = feedback()
    for function in (advice, linearize):
        with pytest.raises(ParameterError, match=r"\Aequilibrium_tolerance = .*>= 0\Z"):
            function(diagram, inputs=[], outputs=["y"], equilibrium_tolerance=tolerance)


@pytest.mark.parametrize(
    "wrong", [{"inputs": 3}, {"outputs": [3]}, {"bypass": None}, {"bypass": [3]}]
)
def test_names_of_another_type_are_refused(wrong):
    diagram = feedback()
    for function in (advice, linearize):
        with pytest.raises(
            ParameterError, match=r"\A(inputs|outputs|bypass).*must be [^\n]*names\Z"
        ):
            function(diagram, **{"inputs": [], "outputs": ["y"], **wrong})


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("encode", r"bypass: loop has no system 'encode'; did you mean encoder\?"),
        ("lag", "bypass: 'lag': has a state, or ports that do not fit; must have no state, one"),
        ("reference", "bypass: 'reference': has a state, or ports that do not fit"),
    ],
)
def test_what_cannot_be_bypassed_is_refused_in_one_line(path, message):
    diagram = feedback(("encoder", RotaryEncoders([100])))
    with pytest.raises(CompilationError, match=rf"\A{message}[^\n]*\Z"):
        linearize(diagram, inputs=[], outputs=["y"], bypass=[path])
