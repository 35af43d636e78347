"""The tree of systems: which leaves have equations, and what feeds their ports."""

import pytest
from pydrake.examples import PendulumGeometry, PendulumPlant
from pydrake.geometry import SceneGraph
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource, Gain, Integrator, LogVectorOutput, Sine

from diagramc.equations.reader import read_equations
from diagramc.equations.tree import Node, cited_equations


class Printer(LeafSystem):
    """A sink without a symbolic form."""

    def __init__(self):
        LeafSystem.__init__(self)
        self.DeclareVectorInputPort("in", 2)
        self.DeclarePerStepPublishEvent(lambda context: None)


def test_viewers_and_logs_are_left_out():
    builder = DiagramBuilder()
    pendulum = builder.AddNamedSystem("pendulum", PendulumPlant())
    torque = builder.AddNamedSystem("torque", ConstantVectorSource([0.1]))
    unused = builder.AddNamedSystem("unused", Sine(1.0, 1.0, 0.0, 1))
    gain = builder.AddNamedSystem("gain", Gain(2.0, 1))
    scene = builder.AddNamedSystem("scene", SceneGraph())
    printer = builder.AddNamedSystem("printer", Printer())
    builder.Connect(unused.get_output_port(0), gain.get_input_port())
    builder.Connect(torque.get_output_port(), pendulum.get_input_port())
    builder.Connect(pendulum.get_output_port(), printer.get_input_port())
    PendulumGeometry.AddToBuilder(builder, pendulum.get_state_output_port(), scene)
    LogVectorOutput(pendulum.get_state_output_port(), builder)
    builder.ExportOutput(pendulum.get_state_output_port(), "state")
    equations = read_equations(builder.Build())
    assert {name.partition(".")[0] for name in equations.parameters} == {"pendulum", "torque"}
    assert len(equations.derivatives) == 2
    assert list(equations.outputs) == ["state"]


def test_a_leaf_that_only_a_state_depends_on_is_read():
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", ConstantVectorSource([3.0]))
    integrator = builder.AddNamedSystem("integrator", Integrator(1))
    builder.Connect(source.get_output_port(), integrator.get_input_port())
    equations = read_equations(builder.Build())
    assert equations.derivatives == [equations.graph.source("parameter", 0)]


def test_a_leaf_with_a_margin_is_read(leaf):
    def construct(self, T):
        self.DeclareVectorInputPort("in", 1)
        type(self).margin = lambda self, context: 1.0 - self.get_input_port().Eval(context)[0]

    builder = DiagramBuilder()
    sine = builder.AddNamedSystem("sine", Sine(1.0, 1.0, 0.0, 1))
    guard = builder.AddNamedSystem("guard", leaf("Guard", construct))
    builder.Connect(sine.get_output_port(0), guard.get_input_port())
    equations = read_equations(builder.Build())
    assert [limit.system for limit in equations.limits] == ["guard"]
    assert "time" in equations.graph.depends[equations.limits[0].margin]


def test_a_nested_port_is_traced_to_its_leaf(multirate):
    root = Node(multirate)
    by_path = {leaf.path: leaf for leaf in root.leaves()}
    limit = by_path["inner/limit"]
    driver, port = limit.driver(0)
    assert (driver.path, port) == ("hold", 0)
    leaf, port = root.children["inner"].output(0)
    assert (leaf.path, port) == ("inner/plant", 0)
    assert root.children["sine"].driver(0) is None
    assert root.driver(3) == 3


@pytest.mark.parametrize(
    ("text", "citations"),
    [
        (
            "Source: Lee et al. 2020, Eq. 12, 13; lag is an\n    assumption.",
            "Lee et al. 2020, Eq. 12, 13",
        ),
        (
            "(Eq. 27). Source: Lee et\n    al. 2020, Eq. 20–27, with errata.",
            "Lee et al. 2020, Eq. 20–27",
        ),
        ("θ_p follows from Eq. 3–7. x = p_1 (Eq. 10, Table 1).", "Eq. 3–7; Eq. 10"),
        ("By Eq. 3. See Eq. 3, and Eqs. 4 and 5.", "Eq. 3; Eqs. 4 and 5"),
        ("Merritt 1967, Eq. (6.2), at 2 ms.", "Merritt 1967, Eq. (6.2)"),
        ("Equations of motion.", ""),
    ],
)
def test_citations_of_equations_are_read_from_a_docstring(text, citations):
    assert cited_equations(text) == citations
