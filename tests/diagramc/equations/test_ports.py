"""Ports inside a diagram as inputs, which perturb a signal, and as outputs."""

import numpy as np
import pytest
from pydrake.examples import PendulumGeometry, PendulumPlant
from pydrake.geometry import SceneGraph
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, Gain, PassThrough

from diagramc import CompilationError, InputTable, compile_diagram, read_diagram
from diagramc.equations.graph_values import values_of
from diagramc.equations.ports import bypass, find_port, route_of, size_of
from diagramc.equations.tree import Node


@pytest.fixture
def nested():
    """R → box(r → 2 r = a; total = 3 a + 100 r; both exported) → 5 · first port → y; source 7 → z.

    The box exports its input r and the outputs a and total.
    """
    inner = DiagramBuilder()
    double = inner.AddNamedSystem("double", Gain(2.0, 1))
    triple = inner.AddNamedSystem("triple", Gain(3.0, 1))
    direct = inner.AddNamedSystem("direct", Gain(100.0, 1))
    total = inner.AddNamedSystem("total", Adder(2, 1))
    inner.Connect(double.get_output_port(), triple.get_input_port())
    inner.Connect(triple.get_output_port(), total.get_input_port(0))
    inner.Connect(direct.get_output_port(), total.get_input_port(1))
    inner.ExportInput(double.get_input_port(), "r")
    inner.ConnectInput("r", direct.get_input_port())
    inner.ExportOutput(double.get_output_port(), "a")
    inner.ExportOutput(total.get_output_port(), "total")
    box = inner.Build()
    box.set_name("box")
    builder = DiagramBuilder()
    builder.AddSystem(box)
    last = builder.AddNamedSystem("last", Gain(5.0, 1))
    source = builder.AddNamedSystem("source", ConstantVectorSource([7.0, 8.0]))
    sink = builder.AddNamedSystem("sink", PassThrough(2))
    builder.ExportInput(box.get_input_port(), "r")
    builder.Connect(box.GetOutputPort("a"), last.get_input_port())
    builder.Connect(source.get_output_port(), sink.get_input_port())
    builder.ExportOutput(last.get_output_port(), "y")
    builder.ExportOutput(box.GetOutputPort("total"), "total")
    diagram = builder.Build()
    diagram.set_name("nested")
    return diagram


def gains(diagram, port, *outputs):
    """Value of each output for a perturbation 1 of one port; the parameters are the defaults."""
    read = read_diagram(diagram, inputs=["r", port], outputs=outputs)
    equations = read.equations
    assert list(equations.inputs) == ["r", port]
    roots = [equations.outputs[name][0] for name in (*equations.outputs,)]
    ends = [
        values_of(equations.graph, roots, {"input": [0.0, value], "parameter": read.parameters()})
        for value in (0.0, 1.0)
    ]
    return dict(zip(equations.outputs, np.subtract(*ends[::-1]), strict=True))


@pytest.mark.parametrize(
    ("port", "y", "total"),
    [
        ("box:r", 10.0, 106.0),  # all readers in the box
        ("box/double:u0", 10.0, 6.0),  # one reader
        ("box/double:y0", 5.0, 3.0),  # all readers of the signal
        ("box:a", 5.0, 0.0),  # the readers outside the box
        ("box/triple:u0", 0.0, 3.0),
        ("last:u0", 5.0, 0.0),
        ("box/total:sum", 0.0, 1.0),
    ],
)
def test_a_perturbation_reaches_the_readers_through_its_port(nested, port, y, total):
    assert gains(nested, port) == {"y": y, "total": total}


def test_an_output_includes_the_perturbations_on_its_way(nested):
    values = gains(nested, "box:a", "box:a", "box/double:y0", "last:u0")
    assert values == {"y": 5.0, "total": 0.0, "box:a": 1.0, "box/double:y0": 0.0, "last:u0": 1.0}


def test_an_output_of_a_leaf_that_nothing_depends_on_is_read(nested):
    read = read_diagram(nested, inputs=["r"], outputs=["sink:y", "source:y0"])
    nodes = read.equations.outputs
    assert nodes["sink:y"] == nodes["source:y0"]
    names = [name for name in read.parameter_names if name.startswith("source")]
    assert len(names) == 2
    assert read.parameters().tolist()[-2:] == [7.0, 8.0]


def test_a_run_perturbs_a_port_inside(nested):
    model = compile_diagram(nested, inputs=["r", "box:a"])
    table = InputTable(np.empty(0), np.array([[[1.0], [0.5]]]))
    run = model.simulate(model.parameters(), model.state(), 0.0, record_period_s=0.1, inputs=table)
    assert run["y"].tolist() == [[12.5]]  # 5 (2 · 1 + 0.5)
    assert run["total"].tolist() == [[106.0]]


def test_a_route_ends_at_the_source(nested):
    root = Node(nested)
    route = list(route_of(find_port(root, "last:u0", "input")))
    places = [(node.path, kind, index) for node, kind, index in route]
    assert places == [("last", "input", 0), ("box", "output", 0), ("box/double", "output", 0)]
    (*_, (node, kind, index)) = route_of(find_port(root, "box/direct:u0", "input"))
    assert (node, kind, index) == (root, "input", 0)
    assert size_of(find_port(root, "source:y0", "output")) == 2


@pytest.mark.parametrize(
    ("name", "kind", "message"),
    [
        ("s", "input", "nested: has no input port 's'; it has r"),
        ("y", "input", "nested: has no input port 'y'; it has r"),
        ("r", "output", "nested: has no output port 'r'; it has y, total"),
        (
            "last:y",
            "input",
            "nested: has no port 'last:y' inside; did you mean last:y0 or last:u0?",
        ),
        (
            "box/dubble:y0",
            "output",
            "nested: has no port 'box/dubble:y0' inside; did you mean "
            "box/double:y0 or box/double:u0?",
        ),
    ],
)
def test_an_unknown_port_is_named_with_similar_ones(nested, name, kind, message):
    with pytest.raises(CompilationError) as caught:
        find_port(Node(nested), name, kind)
    assert str(caught.value) == message


def test_a_port_that_is_no_vector_is_refused():
    builder = DiagramBuilder()
    pendulum = builder.AddNamedSystem("pendulum", PendulumPlant())
    scene = builder.AddNamedSystem("scene", SceneGraph())
    geometry = PendulumGeometry.AddToBuilder(builder, pendulum.get_state_output_port(), scene)
    geometry.set_name("geometry")
    diagram = builder.Build()
    name = f"geometry:{geometry.get_output_port(0).get_name()}"
    scene_input = "scene:" + scene.get_input_port(0).get_name()
    for port, kind in ((name, "output"), (scene_input, "input")):
        with pytest.raises(CompilationError, match=r"is not a vector; only vectors compile\Z"):
            find_port(Node(diagram), port, kind)


def test_messages_name_the_class_of_a_diagram_without_a_name():
    builder = DiagramBuilder()
    builder.AddNamedSystem("pendulum", PendulumPlant())
    root = Node(builder.Build())
    root.system.set_name("")
    with pytest.raises(CompilationError, match=r"\Abypass: Diagram has no system 'nope'\Z"):
        bypass(root, "nope")
    with pytest.raises(CompilationError, match=r"\ADiagram: has no port 'no:y0' inside; its sys"):
        find_port(root, "no:y0", "input")
    with pytest.raises(
        CompilationError, match=r"\AGain: has no port 'no:y0' inside; it is one sys"
    ):
        find_port(Node(Gain(1.0, 1)), "no:y0", "input")
    with pytest.raises(CompilationError) as caught:
        find_port(root, "x\x00" + "y" * 5000, "output")
    assert r"'x\x00yyy" in str(caught.value)
    assert len(str(caught.value)) < 500
