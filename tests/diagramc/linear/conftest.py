"""Random diagrams: continuous, sampled, mixed, multirate; runs of Drake from any state."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import pydrake.math as drake
import pytest
from pydrake.symbolic import Variable, sin, tanh
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    DiscreteTimeDelay,
    DiscreteTimeIntegrator,
    FirstOrderLowPassFilter,
    Integrator,
    LinearSystem,
    MatrixGain,
    Saturation,
    SymbolicVectorSystem,
    ZeroOrderHold,
)

from diagramc import LinearizationError, find_equilibrium

UNIT_S = 1 / 64
"""Divides all sample periods and offsets; whole in binary, so that Drake's events coincide."""

STEP_S = 1 / 2048
"""Step of Drake's RK3. Its error is about (|λ| step)³/24 of a period's motion, 1e-9 at 5 per s."""

CONTINUOUS = ("linear", "filter", "integrator", "nonlinear")
SAMPLED = ("hold", "delay", "sum", "linear_z", "nonlinear_z")
STATIC = ("gain", "product", "limit")


def nonlinear_map(period, offset, b):
    """x(k+1) = 0.5 sin x + 0.3 b tanh u + 0.1 x y, y(k+1) = 0.4 x + 0.2 y; the output is x."""

    def construct(self, T):
        self.DeclareDiscreteState(2)
        port = self.DeclareVectorInputPort("u", 1)
        ticket = {self.all_state_ticket()}
        self.DeclareVectorOutputPort("x", 1, lambda c, y: y.SetAtIndex(0, states(c)[0]), ticket)

        def states(context):
            return context.get_discrete_state(0).CopyToVector()

        def update(context, discrete):
            (x, y), (u,) = states(context), port.Eval(context)
            first = 0.5 * drake.sin(x) + 0.3 * b * drake.tanh(u) + 0.1 * x * y
            discrete.get_mutable_vector(0).SetFromVector([first, 0.4 * x + 0.2 * y])

        self.DeclarePeriodicDiscreteUpdateEvent(period, offset, update)

    return construct


def product(b):
    """Construct a leaf y = u cos u + 0.2 b u²."""

    def construct(self, T):
        port = self.DeclareVectorInputPort("u", 1)

        def output(context, y):
            (u,) = port.Eval(context)
            y.SetAtIndex(0, u * drake.cos(u) + 0.2 * b * u * u)

        self.DeclareVectorOutputPort("y", 1, output, {port.ticket()})

    return construct


@dataclass
class RandomDiagram:
    """A diagram with the input ports r0, r1 and output ports y0, y1 …, all of one element."""

    diagram: object
    inputs: list
    outputs: list

    def at_rest(self, seed=0):
        """A Context that rests, with inputs unlike zero if the diagram can."""
        context = self.diagram.CreateDefaultContext()
        for values in (np.random.default_rng(seed).uniform(-0.3, 0.3, 2), np.zeros(2)):
            for name, value in zip(self.inputs, values, strict=False):
                self.diagram.GetInputPort(name).FixValue(context, [value])
            try:
                return find_equilibrium(self.diagram, context)
            except LinearizationError:  # an integrator moves under a constant input
                continue
        raise AssertionError("no equilibrium at zero")


def _block(leaf, rng, kind, period, offset):
    """A block with one input element and one output element."""
    a, b = rng.uniform(0.3, 3.0), rng.uniform(0.5, 2.0) * rng.choice([-1.0, 1.0])
    x, y, u = Variable("x"), Variable("y"), Variable("u")
    match kind:
        case "linear":
            matrix = rng.uniform(-2.0, 2.0, (2, 2)) - 2.0 * np.eye(2)
            return LinearSystem(matrix, [[b], [0.3]], [[1.0, a]], [[0.0]])
        case "filter":
            return FirstOrderLowPassFilter(a, 1)
        case "integrator":
            return Integrator(1)
        case "nonlinear":
            rates = [y, -a * sin(x) - y * (1.0 + 0.2 * x) + tanh(b * u)]
            return SymbolicVectorSystem(
                state=[x, y], input=[u], dynamics=rates, output=[x + 0.1 * y]
            )
        case "hold":
            return ZeroOrderHold(period, 1, offset_sec=offset)
        case "delay":
            return DiscreteTimeDelay(period, int(rng.integers(1, 4)), 1)
        case "sum":
            return DiscreteTimeIntegrator(1, period)
        case "linear_z":
            matrix = rng.uniform(-0.5, 0.5, (2, 2))
            return LinearSystem(matrix, [[b], [0.3]], [[1.0, a]], [[0.0]], period)
        case "nonlinear_z":
            return leaf("NonlinearMap", nonlinear_map(period, offset, b))
        case "gain":
            return MatrixGain([[b]])
        case "product":
            return leaf("Product", product(b))
    return Saturation([-50.0], [50.0])


def _random_diagram(leaf, seed, kind):
    """``kind``: continuous, sampled (one period), mixed (one period) or multirate."""
    rng = np.random.default_rng([seed, len(kind)])
    choices = {"continuous": CONTINUOUS, "sampled": SAMPLED}.get(kind, CONTINUOUS + SAMPLED)
    kinds = [str(k) for k in rng.choice(choices, rng.integers(2, 5))]
    if kind in ("mixed", "multirate"):
        kinds += ["hold", "nonlinear"]
    if kind == "multirate":
        kinds += ["hold", "nonlinear_z"]
    dynamic = len(kinds)
    kinds += [str(k) for k in rng.choice(STATIC, rng.integers(0, 3))]
    unit = UNIT_S * int(rng.integers(1, 4))
    builder, ports, sums = DiagramBuilder(), [], []
    for number, name in enumerate(kinds):
        period, offset = unit, 0.0
        if kind == "multirate":
            period = UNIT_S * int(rng.choice([1, 2, 3, 4, 6]))
            offset = UNIT_S * int(rng.integers(0, round(period / UNIT_S)))
        block = builder.AddNamedSystem(f"{name}_{number}", _block(leaf, rng, name, period, offset))
        total = builder.AddNamedSystem(f"total_{number}", Adder(3, 1))
        # A static block reads earlier blocks alone, so that there is no algebraic loop.
        weights = [
            builder.AddNamedSystem(f"weight_{number}_{i}", MatrixGain([[rng.uniform(-0.6, 0.6)]]))
            for i in range(2)
        ]
        for index, weight in enumerate(weights):
            builder.Connect(weight.get_output_port(), total.get_input_port(index))
        builder.Connect(total.get_output_port(), block.get_input_port(0))
        ports.append(block.get_output_port(0))
        sums.append((weights, total))
    inputs = []
    for number, (weights, total) in enumerate(sums):
        sources = ports[:dynamic] if number < dynamic else ports[:number]
        for weight in weights:
            builder.Connect(sources[rng.integers(len(sources))], weight.get_input_port())
        name = f"r{number % 2}"
        if name in inputs:
            builder.ConnectInput(name, total.get_input_port(2))
        else:
            builder.ExportInput(total.get_input_port(2), name)
            inputs.append(name)
    outputs = [f"y{number}" for number in range(len(ports))]
    for name, port in zip(outputs, ports, strict=True):
        builder.ExportOutput(port, name)
    return RandomDiagram(builder.Build(), inputs, outputs)


@pytest.fixture(scope="session")
def random_diagram(leaf):
    """``random_diagram(seed, kind)``: see `_random_diagram`."""
    return partial(_random_diagram, leaf)


def _drake_state(context):
    groups = range(context.num_discrete_state_groups())
    discrete = [context.get_discrete_state(group).CopyToVector() for group in groups]
    return np.concatenate([context.get_continuous_state_vector().CopyToVector(), *discrete])


class DrakeRuns:
    """Runs of Drake's Simulator from a Context, with another state and other inputs."""

    def __init__(self, diagram, context, inputs):
        self.diagram, self.context, self.inputs = diagram, context, inputs
        self.state = _drake_state(context)
        ports = [diagram.GetInputPort(name) for name in inputs]
        self.values = np.concatenate([np.empty(0), *(port.Eval(context) for port in ports)])

    def end(self, state, values, duration_s):
        """State before the updates at ``duration_s`` and outputs at this time."""
        context = self.context.Clone()
        count = context.num_continuous_states()
        context.SetContinuousState(state[:count])
        for group in range(context.num_discrete_state_groups()):
            vector = context.get_mutable_discrete_state(group)
            vector.SetFromVector(state[count : count + vector.size()])
            count += vector.size()
        for name, value in zip(self.inputs, values, strict=True):
            self.diagram.GetInputPort(name).FixValue(context, [value])
        if duration_s:
            simulator = Simulator(self.diagram, context)
            ResetIntegratorFromFlags(simulator, "runge_kutta3", STEP_S)
            simulator.get_mutable_integrator().set_fixed_step_mode(True)
            simulator.AdvanceTo(duration_s)
        ports = range(self.diagram.num_output_ports())
        outputs = [self.diagram.get_output_port(index).Eval(context) for index in ports]
        return np.concatenate([_drake_state(context), *outputs])

    def jacobian(self, duration_s, step=1e-4):
        """Central differences of `end` by the state and the inputs."""
        size = self.state.size
        start = np.concatenate([self.state, self.values])
        columns = [
            self.end(*np.split(start + move, [size]), duration_s)
            - self.end(*np.split(start - move, [size]), duration_s)
            for move in step * np.eye(start.size)
        ]
        return np.array(columns).T / (2.0 * step)


@pytest.fixture(scope="session")
def drake_runs():
    """``drake_runs(diagram, context, inputs)``: see `DrakeRuns`."""
    return DrakeRuns
