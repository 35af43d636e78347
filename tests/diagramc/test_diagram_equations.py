"""Diagrams as equations: what is refused, names, the key of equal equations."""

import dataclasses

import pytest
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, Variable, if_then_else, max as symbolic_max
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Integrator, LinearSystem

from diagramc import compile_diagram
from diagramc.diagram_equations import ExpressionGraph, equations_key
from diagramc.equations.equations import Equations, Limit, Section, Update
from diagramc.equations.graph import Graph
from diagramc.equations.passes import Program
from diagramc.equations.reader import read_equations
from diagramc.errors import CompilationError
from diagramc.native.time_loop import run_text


def lag(name=""):
    system = LinearSystem([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.0)
    system.set_name(name)
    return system


def two_of_one_path():
    """A leaf ``a/b`` beside a diagram ``a`` with a leaf ``b``."""
    inner = DiagramBuilder()
    inner.AddNamedSystem("b", Integrator(1))
    builder = DiagramBuilder()
    builder.AddNamedSystem("a/b", Integrator(1))
    builder.AddNamedSystem("a", inner.Build())
    return builder.Build()


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (lambda: 42, "int 42: cannot be compiled; must be a Diagram or leaf system of floats$"),
        (lambda: None, "NoneType None: cannot be compiled; must be a Diagram"),
        (lambda: lag().ToScalarType[AutoDiffXd](), r".*leaf system of floats$"),
        (lag, "LinearSystem: .*name the diagram's port in inp"),
        (lambda: lag("lag"), "lag: time derivatives"),
        (two_of_one_path, "a/b: two systems have this path; rename one$"),
    ],
)
def test_what_does_not_compile_is_one_line(make, line):
    with pytest.raises(CompilationError, match=rf"\A{line}") as caught:
        compile_diagram(make())
    assert "\n" not in str(caught.value)


def test_unknown_inputs_are_named_with_the_known_ones():
    with pytest.raises(CompilationError, match=r"^LinearSystem: has no input port 'u'; it has u0$"):
        compile_diagram(lag(), inputs=["u"])


def test_every_part_of_equations_is_in_their_key():
    graph = Graph()
    x = graph.source("state", 0)
    base = Equations(graph=graph, states=["x"], derivatives=[x], outputs={"y": [x]})
    assert equations_key(base) == equations_key(dataclasses.replace(base))
    others = {"parameters": ["p"], "states": ["z"], "discrete": ["d"], "inputs": {"u": 1}}
    others |= {"derivatives": [], "initial_discrete": [x], "outputs": {}, "limits": [Limit("a", x)]}
    others |= {"updates": [Update(0.1, 0.0, ())], "graph": Graph()}
    others |= {"sections": [Section("law: output y", "Law.", (x,))]}
    assert set(others) == {field.name for field in dataclasses.fields(Equations)}
    keys = [equations_key(dataclasses.replace(base, **{k: v})) for k, v in others.items()]
    assert len({equations_key(base), *keys}) == 1 + len(others)


def test_equal_diagrams_of_nameless_systems_give_equal_text():
    def text():
        builder = DiagramBuilder()
        first, second = builder.AddSystem(Integrator(1)), builder.AddSystem(Integrator(1))
        builder.Connect(first.get_output_port(), second.get_input_port())
        builder.ExportInput(first.get_input_port(), "in")
        builder.ExportOutput(second.get_output_port(), "out")
        diagram = builder.Build()
        equations = read_equations(diagram, ("in", "in"))
        return equations_key(equations), run_text(Program(equations), "exact_hold", 2)

    first = text()
    assert text() == first


def test_the_key_of_expressions_depends_on_operations_numbers_and_places_of_variables():
    def key(function):
        variables = [Variable(name) for name in "ab"]
        return ExpressionGraph([function(*map(Expression, variables))], variables).key

    expected = key(lambda a, b: 0.1 * a + b)
    assert key(lambda a, b: b + a * 0.1) == expected
    others = [
        lambda a, b: 0.1 * b + a,
        lambda a, b: 0.10000000000000002 * a + b,
        lambda a, b: 0.1 * a - b,
        lambda a, b: symbolic_max(0.1 * a, b),
        lambda a, b: if_then_else(a > b, 0.1 * a, b),
        lambda a, b: if_then_else(a >= b, 0.1 * a, b),
    ]
    assert len({expected, *map(key, others)}) == 1 + len(others)
