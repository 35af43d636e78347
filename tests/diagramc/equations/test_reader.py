"""Equations of leaves, joined at their ports."""

from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain, Saturation, Sine

from diagramc.equations.reader import read_equations


def test_a_chain_of_300_blocks_is_read():
    builder = DiagramBuilder()
    port = builder.AddNamedSystem("sine", Sine(1.0, 1.0, 0.0, 1)).get_output_port(0)
    for number in range(300):
        block = Gain(1.001, 1) if number % 2 else Saturation([-2.0], [2.0])
        builder.AddNamedSystem(f"block_{number}", block)
        builder.Connect(port, block.get_input_port(0))
        port = block.get_output_port(0)
    builder.ExportOutput(port, "out")
    equations = read_equations(builder.Build())
    kinds = [kind for kind, *_ in equations.graph.nodes]
    assert kinds.count("min") + kinds.count("where") >= 150


def test_a_loop_through_the_ports_of_two_leaves_is_no_algebraic_loop(leaf):
    # Each leaf has two independent paths; the loop goes through both leaves.
    def construct(self, T):
        first = self.DeclareVectorInputPort("a", 1)
        second = self.DeclareVectorInputPort("b", 1)
        for name, port in (("2a", first), ("2b", second)):
            self.DeclareVectorOutputPort(
                name,
                1,
                lambda context, out, port=port: out.SetAtIndex(0, 2.0 * port.Eval(context)[0]),
                prerequisites_of_calc={port.ticket()},
            )

    builder = DiagramBuilder()
    one, two = (builder.AddNamedSystem(name, leaf(name, construct)) for name in ("one", "two"))
    builder.ExportInput(one.GetInputPort("a"), "in")
    builder.Connect(one.GetOutputPort("2a"), two.GetInputPort("a"))
    builder.Connect(two.GetOutputPort("2a"), one.GetInputPort("b"))
    builder.Connect(one.GetOutputPort("2b"), two.GetInputPort("b"))
    builder.ExportOutput(two.GetOutputPort("2b"), "out")
    equations = read_equations(builder.Build(), ["in"])
    graph = equations.graph
    node = graph.source("input", 0)
    for _ in range(4):
        node = graph.multiply(graph.constant(2.0), node)
    assert equations.outputs["out"] == [node]
