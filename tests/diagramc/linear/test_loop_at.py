"""Loops broken at ports against transfer functions by hand, and against the closed diagram."""

import math
import re

import control
import numpy as np
import pytest
from pydrake.examples import PendulumPlant
from pydrake.symbolic import Variable
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    DiscreteTimeDelay,
    DiscreteTimeIntegrator,
    Gain,
    Integrator,
    LinearSystem,
    MatrixGain,
    Multiplexer,
    SymbolicVectorSystem,
    ZeroOrderHold,
)

from diagramc import ParameterError, PeriodicLoop, linearize, loop_at, margins, sensitivity

T = 0.01
PLANT = ([[0.0, 1.0], [-4.0, -1.0]], [[0.0], [4.0]], [[1.0, 0.0]], [[0.0]])


def ring(*systems):
    """A diagram with systems in a ring: each drives the next one, and the last the first."""
    builder = DiagramBuilder()
    added = [builder.AddNamedSystem(name, system) for name, system in systems]
    for source, target in zip(added, [*added[1:], added[0]], strict=True):
        builder.Connect(source.get_output_port(0), target.get_input_port(0))
    diagram = builder.Build()
    diagram.set_name("ring")
    return diagram


def mixed(gain=-0.8, offset_sec=0.0, samples=2):
    """The plant, sampled, with a gain and a delay of a number of samples in feedback."""
    return ring(
        ("plant", LinearSystem(*PLANT)),
        ("sampler", ZeroOrderHold(T, 1, offset_sec=offset_sec)),
        ("gain", Gain(gain, 1)),
        ("delay", ZeroOrderHold(T, 1, offset_sec=offset_sec)),
        *[(f"more{i}", ZeroOrderHold(T, 1, offset_sec=offset_sec)) for i in range(samples - 2)],
    )


def expected_mixed(frequencies_hz, gain=-0.8, samples=2):
    """L of `mixed` by python-control. A hold gives its old value to the updates at its sample."""
    z = np.exp(2j * np.pi * np.asarray(frequencies_hz) * T)
    sampled = control.ss(*PLANT).sample(T, "zoh")
    return -gain * sampled(z) * z ** -(samples - 1.0)


F = np.array([0.01, 0.3, 2.0, 17.0, 50.0])


def test_a_continuous_loop_is_the_product_of_its_blocks():
    plant = control.ss(*PLANT)
    s = 2j * np.pi * F
    diagram = ring(
        ("plant", LinearSystem(*PLANT)), ("integral", Integrator(1)), ("gain", Gain(-0.3, 1))
    )
    for port in ("plant:y0", "plant:u0", "integral:y0", "gain:u0", "gain:y0"):
        loop = loop_at(diagram, port)
        assert loop.period_s is None
        np.testing.assert_allclose(loop.response(F), 0.3 / s * plant(s), rtol=1e-12)


@pytest.mark.parametrize("offset_sec", [0.0, 0.003])
def test_a_mixed_loop_has_one_transfer_at_all_its_ports(offset_sec):
    diagram = mixed(offset_sec=offset_sec)
    for port in ("plant:y0", "sampler:u", "sampler:y", "gain:y0", "delay:y", "plant:u0"):
        loop = loop_at(diagram, port)
        assert loop.period_s == T
        np.testing.assert_allclose(loop.response(F), expected_mixed(F), rtol=1e-11, atol=1e-15)


def test_the_margins_of_a_mixed_loop_destabilize_the_diagram():
    m = margins(loop_at(mixed(), "gain:y0"))
    assert m.stable
    critical = np.exp(2j * math.pi * m.gain_margin_frequency_hz * T)
    at_margin = linearize(mixed(-0.8 * m.gain_margin), inputs=[], outputs=["plant:y0"])
    assert np.abs(at_margin.eigenvalues - critical).min() < 1e-9
    assert np.abs(at_margin.eigenvalues).max() == pytest.approx(1.0, abs=1e-9)
    # More samples of delay take themselves from the delay margin, until the loop is unstable.
    samples = math.floor(m.delay_margin_s / T)
    stable, unstable = (
        linearize(mixed(samples=2 + n), inputs=[], outputs=["plant:y0"])
        for n in (samples, samples + 1)
    )
    assert stable.stable
    assert not unstable.stable
    fewer = margins(loop_at(mixed(samples=2 + samples), "gain:y0"))
    assert fewer.delay_margin_s == pytest.approx(m.delay_margin_s - samples * T, rel=1e-8)


def test_the_sensitivity_is_the_response_to_a_perturbation():
    diagram = mixed()
    model = linearize(diagram, inputs=["gain:u0"], outputs=["gain:u0"])
    response = sensitivity(loop_at(diagram, "gain:u0")).response(F)
    np.testing.assert_allclose(response, model.frequency_response(F)[:, 0, 0], rtol=1e-10)


def test_a_pendulum_is_linearized_where_its_context_stands():
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem("plant", PendulumPlant())
    law = builder.AddNamedSystem("law", MatrixGain([[-20.0, -3.0]]))
    builder.Connect(plant.get_state_output_port(), law.get_input_port())
    builder.Connect(law.get_output_port(), plant.get_input_port())
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    # m l² θ̈ = u − b θ̇ − m g l sin θ with m = 1 kg, l = 0.5 m, b = 0.1, g = 9.81 m/s²
    s = 2j * np.pi * F
    pendulum = 1.0 / (0.25 * s * s + 0.1 * s + 9.81 * 0.5)
    loop = loop_at(diagram, "law:y0", context)
    np.testing.assert_allclose(loop.response(F), (20.0 + 3.0 * s) * pendulum, rtol=1e-11)
    # An element of a vector is cut alone: the other one stays in its loop.
    rate = loop_at(diagram, "plant:state[1]", context)
    inner = 3.0 * s * pendulum / (1.0 + 20.0 * pendulum)
    np.testing.assert_allclose(rate.response(F), inner, rtol=1e-11)


def test_open_inputs_need_no_value():
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem("plant", LinearSystem(*PLANT))
    add = builder.AddNamedSystem("add", Adder(2, 1))
    gain = builder.AddNamedSystem("gain", Gain(-0.3, 1))
    builder.Connect(plant.get_output_port(), gain.get_input_port())
    builder.Connect(gain.get_output_port(), add.get_input_port(0))
    builder.Connect(add.get_output_port(), plant.get_input_port())
    builder.ExportInput(add.get_input_port(1), "reference")
    loop = loop_at(builder.Build(), "plant:y0")
    expected = 0.3 * control.ss(*PLANT)(2j * np.pi * F)
    np.testing.assert_allclose(loop.response(F), expected, rtol=1e-12)


def multirate():
    """A fast loop at T around the plant, in a slow loop at 4 T with an integrator."""
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem("plant", LinearSystem(*PLANT))
    fast = builder.AddNamedSystem("fast", ZeroOrderHold(T, 1))
    add = builder.AddNamedSystem("add", Adder(2, 1))
    gain = builder.AddNamedSystem("gain", Gain(-0.5, 1))
    slow = builder.AddNamedSystem("slow", DiscreteTimeIntegrator(1, 4 * T))
    inverse = builder.AddNamedSystem("inverse", Gain(-0.7, 1))
    builder.Connect(plant.get_output_port(), gain.get_input_port())
    builder.Connect(plant.get_output_port(), inverse.get_input_port())
    builder.Connect(inverse.get_output_port(), slow.get_input_port())
    builder.Connect(slow.get_output_port(), add.get_input_port(0))
    builder.Connect(gain.get_output_port(), add.get_input_port(1))
    builder.Connect(add.get_output_port(), fast.get_input_port())
    builder.Connect(fast.get_output_port(), plant.get_input_port())
    return builder.Build()


def slow_period(state, v):
    """The state (plant, r) of `multirate` after 4 T, if the slow integrator reads v."""
    exact = control.ss(*PLANT).sample(T, "zoh")
    x, r = state[:2], state[2]
    for tick in range(4):
        command = r - 0.5 * x[0]  # of the fast hold, which sees r before its update
        r = r - 0.7 * 4.0 * T * v if tick == 0 else r
        x = exact.A @ x + exact.B[:, 0] * command
    return np.append(x, r)


def test_the_slow_loop_of_a_multirate_diagram_is_exact():
    diagram = multirate()
    loop = loop_at(diagram, "inverse:u0")
    assert loop.period_s == 4 * T
    a = np.transpose([slow_period(row, 0.0) for row in np.eye(3)])
    b = slow_period(np.zeros(3), 1.0)
    for f in (0.01, 1.0, 12.5):
        z = np.exp(8j * np.pi * f * T)
        expected = -np.linalg.solve(z * np.eye(3) - a, b)[0]
        assert loop.response(f)[0] == pytest.approx(expected, rel=1e-11)
    assert margins(loop).stable


def held_feedback():
    """The plant with q⁺ = 0.4 q − 0.5 y − 30 s and s⁺ = s + T q, whose state q drives the plant."""
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem("plant", LinearSystem(*PLANT))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(T, 1))
    law = builder.AddNamedSystem("law", MatrixGain([[-0.5, 0.4, -30.0]]))
    join = builder.AddNamedSystem("join", Multiplexer(3))
    total = builder.AddNamedSystem("total", DiscreteTimeIntegrator(1, T))
    builder.Connect(hold.get_output_port(), total.get_input_port())
    builder.Connect(total.get_output_port(), join.get_input_port(2))
    builder.Connect(plant.get_output_port(), join.get_input_port(0))
    builder.Connect(hold.get_output_port(), join.get_input_port(1))
    builder.Connect(join.get_output_port(), law.get_input_port())
    builder.Connect(law.get_output_port(), hold.get_input_port())
    builder.Connect(hold.get_output_port(), plant.get_input_port())
    return builder.Build()


def test_a_signal_that_its_own_update_reads():
    # The updates read the old q, and the plant the new one.
    # Then q = (0.4/z − 0.5 P − 30 T/(z² − z)) q.
    z = np.exp(2j * np.pi * F * T)
    expected = 0.5 * control.ss(*PLANT).sample(T, "zoh")(z) - 0.4 / z + 0.3 / (z * z - z)
    loop = loop_at(held_feedback(), "hold:y")
    np.testing.assert_allclose(loop.response(F), expected, rtol=1e-11)


@pytest.mark.parametrize("gain", [1.0, 2.0])
def test_a_signal_that_moves_between_the_samples_has_no_transfer(gain):
    # With feedback of 1 or 2 times the gain 1, the output of 1/(s + 1) is constant by accident.
    builder = DiagramBuilder()
    lag = builder.AddNamedSystem("lag", LinearSystem([[-1.0]], [[gain]], [[1.0]], [[0.0]]))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(T, 1))
    builder.Connect(lag.get_output_port(), lag.get_input_port())
    builder.Connect(lag.get_output_port(), hold.get_input_port())
    assert isinstance(loop_at(builder.Build(), "lag:u0"), PeriodicLoop)


@pytest.mark.parametrize("block", [Integrator(1), DiscreteTimeIntegrator(1, T)])
def test_an_integral_that_only_the_cut_signal_changes_has_no_transfer(block):
    builder = DiagramBuilder()
    block = builder.AddNamedSystem("block", block.Clone())
    gain = builder.AddNamedSystem("gain", Gain(-0.5, 1))
    clock = builder.AddNamedSystem("clock", ZeroOrderHold(2 * T, 1))
    builder.Connect(block.get_output_port(), gain.get_input_port())
    builder.Connect(gain.get_output_port(), block.get_input_port())
    builder.Connect(block.get_output_port(), clock.get_input_port())
    assert isinstance(loop_at(builder.Build(), "gain:y0"), PeriodicLoop)


def test_a_fast_loop_of_a_multirate_diagram_has_no_transfer():
    loop = loop_at(multirate(), "gain:y0")
    assert repr(loop) == "PeriodicLoop(period_s=0.04, 4 states, 4 times of updates)"
    model = linearize(multirate(), inputs=[], outputs=["plant:y0"])
    np.testing.assert_allclose(loop.closed_matrices()[0], model.a, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize(
    ("port", "message"),
    [
        ("law:u0", "port law:u0: has 2 elements; name one, such as law:u0[0]"),
        ("law:u0[2]", "port law:u0[2]: must be 0…1"),
        ("y", "port 'y': must be a port inside the diagram, path/of/system:port"),
    ],
)
def test_an_element_must_exist(port, message):
    diagram = ring(
        ("plant", LinearSystem([[-1.0]], [[1.0]], [[1.0], [2.0]], [[0.0], [0.0]])),
        ("law", MatrixGain([[-1.0, -1.0]])),
    )
    with pytest.raises(ParameterError, match=rf"\A{re.escape(message)}\Z"):
        loop_at(diagram, port)


def test_a_delay_counts_as_states():
    # Drake's delay has a buffer of n + 1 values: L = 20 z⁻⁴ T/(z − 1).
    diagram = ring(
        ("sum", DiscreteTimeIntegrator(1, T)),
        ("delay", DiscreteTimeDelay(T, 3, 1)),
        ("gain", Gain(-20.0, 1)),
    )
    z = np.exp(2j * np.pi * F * T)
    np.testing.assert_allclose(
        loop_at(diagram, "gain:y0").response(F), 0.2 * z**-4.0 / (z - 1.0), rtol=1e-11
    )


def assert_loops_close(random):
    """Each loop of a random diagram, closed again, moves as the diagram does."""
    diagram, points = random.diagram, 3.0 * np.exp([0.3j, 1.2j, 2.5j])
    context = diagram.CreateDefaultContext()
    for name in random.inputs:
        diagram.GetInputPort(name).FixValue(context, [0.1])
    for system in diagram.GetSystems():
        if not system.get_name().startswith("total"):
            continue
        port = f"{system.get_name()}:{system.get_output_port().get_name()}"
        model = linearize(
            diagram, context, inputs=[], outputs=[port], equilibrium_tolerance=math.inf
        )
        loop = loop_at(diagram, port, context, equilibrium_tolerance=math.inf)
        if isinstance(loop, PeriodicLoop):
            np.testing.assert_allclose(loop.closed_matrices()[0], model.a, rtol=0.0, atol=1e-12)
            continue
        # The state at the begin of the period may differ, and the eigenvalues do not.
        ours, expected = (
            [np.linalg.det(z * np.eye(len(a)) - a) for z in points]
            for a in (loop.closed_matrix(), model.a)
        )
        np.testing.assert_allclose(ours, expected, rtol=1e-11)


@pytest.mark.parametrize(
    "kind",
    [
        *("continuous", "sampled"),
        *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("mixed", "multirate")),
    ],
)
def test_the_loops_of_a_random_diagram_close_again(random_diagram, kind):
    assert_loops_close(random_diagram(3, kind))


@pytest.mark.slow(gate=0)
@pytest.mark.parametrize("kind", ["continuous", "sampled", "mixed", "multirate"])
def test_the_loops_of_ten_random_diagrams_close_again(random_diagram, kind):
    for seed in range(10):
        assert_loops_close(random_diagram(seed, kind))


def test_a_warning_points_at_the_line_that_asks_for_the_loop():
    x, u = Variable("x"), Variable("u")
    plant = SymbolicVectorSystem(state=[x], input=[u], dynamics=[u - abs(x)], output=[x])
    with pytest.warns(UserWarning, match="corner") as caught:
        loop_at(ring(("plant", plant), ("gain", Gain(-1.0, 1))), "gain:y0")
    assert caught[0].filename == __file__
