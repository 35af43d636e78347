"""Reads the equations of a diagram, and the values of Contexts as points of these equations."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..arguments import names, quoted
from ..diagram_equations import DiagramEquations, equations_of, require_system
from ..equations.ports import bypass as bypass_system, find_port, is_vector
from ..equations.tree import Node, Port
from ..errors import CompilationError, DifferenceError, ParameterError, shown
from ..run_data import Array
from .leafwise import LeafwiseEquations, LeafwisePoint
from .point import Point


def read_points(
    diagram: Any,
    contexts: Iterable[Any],
    inputs: Iterable[str] = (),
    outputs: Iterable[str] = (),
    bypass: Iterable[str] = (),
    setting: str = "inputs",
) -> list[Point]:
    """Read the equations of a diagram of floats once, and the values of several Contexts.

    The open inputs are ``inputs``, then all other input ports of the diagram that have a value in
    one of the Contexts, and all ports inside that have a value and no connection. An input without
    a value has the value zero. For the names and errors see `linearize`. ``setting`` is the name of
    ``inputs`` in the caller's arguments, for the message about an input that has no value.

    ``diagram`` may be a diagram with its equations, which are then not read again. The open inputs
    of these equations are then the open inputs of the points.
    """
    system = system_of(diagram)
    try:
        given = list(contexts)
    except TypeError:
        raise ParameterError(f"contexts = {quoted(contexts)}: must be a list of Contexts") from None
    contexts = [system.CreateDefaultContext() if each is None else each for each in given]
    root = diagram.root if isinstance(diagram, DiagramEquations) else Node(system)
    undriven = _open_ports(root)
    values = [_input_values(root, undriven, context) for context in contexts]
    bypass = names("bypass", bypass)
    if isinstance(diagram, DiagramEquations):
        read, first = diagram, tuple(diagram.equations.inputs)[: len(tuple(inputs))]
        if bypass or first != tuple(inputs) or not {*outputs} <= {*read.equations.outputs}:
            raise ParameterError(
                f"diagram: its equations were read with the inputs {quoted(first)} first, and with "
                f"other outputs or bypass; must be read with those of this call"
            )
    else:
        for path in bypass:
            bypass_system(root, path)
        in_ports = {name: find_port(root, name, "input") for name in inputs}
        in_ports |= {name: undriven[name] for name in itertools.chain(*values)}
        out_ports = {name: find_port(root, name, "output") for name in outputs}
        read = _read(root, in_ports, out_ports)
    sizes = read.equations.inputs
    states = [read.state(context) for context in contexts]
    points: list[Point] = []
    for context, of_port, state in zip(contexts, values, states, strict=True):
        numbers = (
            float(context.get_time()),
            read.parameters(context),
            np.concatenate([state.continuous, state.discrete]),
            np.concatenate(
                [np.empty(0), *(of_port.get(name, np.zeros(sizes[name])) for name in sizes)]
            ),
        )
        if isinstance(read, LeafwiseEquations):
            point: Point = LeafwisePoint(read, *numbers, context, setting)
            point.slopes(tuple(outputs))  # so that a leaf that cannot be called is told here
        else:
            point = Point(read, *numbers)
        points.append(point)
    return points


def read_for_linearization(
    diagram: Any, *, inputs: Iterable[str] = (), outputs: Iterable[str] = ()
) -> DiagramEquations:
    """Read a diagram once, for many calls of `linearize`, `loop_at` and `find_equilibrium`.

    Unlike `read_diagram`, this function takes leaf systems without symbolic form.

    Parameters
    ----------
    diagram, inputs, outputs
        As in `read_diagram`.

    Raises
    ------
    CompilationError
        A leaf has no linear model, such as one with witness functions.
    """
    require_system(diagram)
    root = Node(diagram)
    in_ports = {port: find_port(root, port, "input") for port in names("inputs", inputs)}
    out_ports = {port: find_port(root, port, "output") for port in names("outputs", outputs)}
    return _read(root, in_ports, out_ports)


def _read(root: Node, inputs: Mapping[str, Port], outputs: Mapping[str, Port]) -> DiagramEquations:
    """Return the equations of a diagram, or its leaf systems if a leaf has no equations."""
    try:  # equations first, because they tell more: see `advice`
        return equations_of(root, inputs, outputs)
    except DifferenceError:  # a leaf whose forms disagree has no right derivative
        raise
    except CompilationError:
        return LeafwiseEquations(root, inputs, outputs)


def read_point(diagram: Any, context: Any, *ports: Any, **options: Any) -> Point:
    """Read the equations of a diagram of floats, and the values of a Context; see `read_points`."""
    return read_points(diagram, [context], *ports, **options)[0]


def system_of(diagram: Any) -> Any:
    """Return the system of a diagram with its equations, or a Diagram or leaf system itself.

    Raises `CompilationError` for anything else.
    """
    if isinstance(diagram, DiagramEquations):
        return diagram.diagram
    require_system(diagram)
    return diagram


def _open_ports(root: Node) -> dict[str, Port]:
    """Return the input ports of vectors of a diagram, and those inside that nothing drives."""
    ends = [(root, "input", index) for index in range(root.system.num_input_ports())]
    for leaf in root.leaves():
        ends += [[*leaf.route(index)][-1] for index in range(leaf.system.num_input_ports())]
    ports: dict[str, Port] = {}
    for node, kind, index in ends:
        port = getattr(node.system, f"get_{kind}_port")(index)
        if kind == "input" and is_vector(port):
            name = port.get_name() if node.parent is None else f"{node.path}:{port.get_name()}"
            ports[name] = node, kind, index
    return ports


def _input_values(root: Node, ports: Mapping[str, Port], context: Any) -> dict[str, Array]:
    """Return the value of each port that has a value in a Context, by its name."""
    try:
        root.system.ValidateContext(context)
    except (RuntimeError, TypeError):
        raise ParameterError(
            f"context: is no Context of {shown(root.system.get_name() or root.type_name)}; "
            f"create it by diagram.CreateDefaultContext()"
        ) from None
    values = {}
    for name, (node, _, index) in ports.items():
        port, of_node = node.system.get_input_port(index), node.context(context)
        if port.HasValue(of_node):
            values[name] = port.Eval(of_node)
    return values
