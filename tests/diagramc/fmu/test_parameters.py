"""Parameters of an FMU from the Context parameters and states of a diagram."""

import numpy as np
import pytest
from pydrake.examples import PendulumPlant
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import DiscreteTimeIntegrator, LinearSystem

from diagramc import context_parameters, initial_states, read_diagram, source_of
from diagramc.errors import CompilationError
from diagramc.fmu.parameters import chosen_parameters
from diagramc.fmu.variables import FmuParameter, VariableTable

TICK_S = 0.1


def sampler(self, T):
    """Construct a leaf that samples its input at the initialization and then periodically."""

    def sample(context, discrete):
        discrete.set_value(self.get_input_port().Eval(context))

    self.DeclareVectorInputPort("u", 1)
    self.DeclareStateOutputPort("y", self.DeclareDiscreteState(1))
    self.DeclarePeriodicDiscreteUpdateEvent(TICK_S, 0.0, sample)
    self.DeclareInitializationDiscreteUpdateEvent(sample)


@pytest.fixture(scope="module")
def mixed(leaf):
    """Input → sampler → lag → sum, with two states each but the sampler."""
    builder = DiagramBuilder()
    first = builder.AddNamedSystem("sampler", leaf("Sampler", sampler))
    lag = builder.AddNamedSystem("lag", LinearSystem(-2.0 * np.eye(2), [[1.0], [0.0]], np.eye(2)))
    total = builder.AddNamedSystem("sum", DiscreteTimeIntegrator(2, TICK_S))
    builder.Connect(first.get_output_port(), lag.get_input_port())
    builder.Connect(lag.get_output_port(), total.get_input_port())
    builder.ExportInput(first.get_input_port(), "u")
    builder.ExportOutput(total.get_output_port(), "y")
    builder.ExportOutput(lag.get_output_port(), "x")
    builder.ExportOutput(first.get_output_port(), "sampled")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    lag.GetMyMutableContextFromRoot(context).SetContinuousState([0.5, -0.25])
    total.GetMyMutableContextFromRoot(context).SetDiscreteState([3.0, 4.0])
    return source_of(read_diagram(diagram, inputs=["u"]), "mixed", context)


def test_context_parameters_of_a_leaf_have_the_names_of_drake():
    pendulum = PendulumPlant()
    context = pendulum.CreateDefaultContext()
    context.SetContinuousState([0.1, -0.2])
    source = source_of(read_diagram(pendulum, inputs=["tau"]), "swing", context, tick_s=TICK_S)
    drakes = context.get_numeric_parameter(0)
    parameters = context_parameters(source)
    assert {p.name: (p.start, p.members, p.tunable) for p in parameters} == {
        f"swing.{name}": (getattr(drakes, name)(), (f"swing.{name}",), True)
        for name in ("mass", "length", "damping", "gravity")
    }
    assert parameters[0].description == "Context parameter mass"
    assert initial_states(source) == [
        FmuParameter(
            f"initial.swing.{name}",
            value,
            (f"initial_x[{i}]",),
            f"start value of the state {name}",
            tunable=False,
        )
        for i, (name, value) in enumerate({"theta": 0.1, "thetadot": -0.2}.items())
    ]


def test_states_that_events_replace_are_no_parameters(mixed):
    rows = {p.name: (p.start, p.members) for p in initial_states(mixed)}
    names = mixed.equations.discrete
    first = names.index("sum.0[0]")
    assert rows == {
        "initial.lag.x[0]": (0.5, ("initial_x[0]",)),
        "initial.lag.x[1]": (-0.25, ("initial_x[1]",)),
        "initial.sum.group_0[0]": (3.0, (f"initial_d[{first}]",)),
        "initial.sum.group_0[1]": (4.0, (f"initial_d[{first + 1}]",)),
    }


def test_the_start_of_an_output_depends_on_initial_states(mixed):
    """The outputs are the states; the sampler samples its input at the initialization."""
    table = VariableTable(mixed.plan, initial_states(mixed), {})
    names = [variable.name for variable in table.variables]
    setters = [[names[i] for i in references] for references in table.initial_dependencies()]
    assert dict(zip([names[i] for i in table.references("output")], setters, strict=True)) == {
        "y_0": ["initial.sum.group_0[0]"],
        "y_1": ["initial.sum.group_0[1]"],
        "x_0": ["initial.lag.x[0]"],
        "x_1": ["initial.lag.x[1]"],
        "sampled": ["u"],
    }


def test_parameters_are_chosen_by_name(mixed):
    every = initial_states(mixed)  # there are no Context parameters
    assert context_parameters(mixed) == []
    assert chosen_parameters(mixed, None) == every
    assert chosen_parameters(mixed, ()) == []
    extra = FmuParameter("start", 1.0, ("initial_x[0]",))
    chosen = chosen_parameters(mixed, ["initial.lag.x[1]", extra])
    assert [parameter.name for parameter in chosen] == ["initial.lag.x[1]", "start"]
    assert chosen_parameters(mixed, "initial.lag.x[0]") == [every[0]]
    with pytest.raises(CompilationError, match=r"^parameter 'lag\.k\\n': is unknown; known: init"):
        chosen_parameters(mixed, ["lag.k\n"])
