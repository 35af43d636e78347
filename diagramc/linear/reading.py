"""Reads the equations of a diagram, and the values of Contexts as points of these equations."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from pydrake.systems.framework import PortDataType

from ..arguments import names, quoted
from ..diagram_equations import DiagramEquations, equations_of, require_system
from ..equations.ports import bypass as bypass_system, find_port
from ..equations.tree import Node, Port
from ..errors import CompilationError, DifferenceError, ParameterError, shown
from ..run_data import Array
from .leafwise import LeafwiseEquations, LeafwisePoint
from .point import Point


def read_point(
    diagram: Any,
    context: Any,
    inputs: Iterable[str] = (),
    outputs: Iterable[str] = (),
    bypass: Iterable[str] = (),
    setting: str = "inputs",
) -> Point:
    """Read the equations of a diagram of floats, and the values of a Context.

    The open inputs are ``inputs`` and then all other input ports of the diagram that have a value
    in the Context, those inside the diagram too: a value takes the place of a connection, as in
    Drake's simulation. Any other open input has the value zero. For the names and errors see
    `linearize`. ``setting`` is the name of ``inputs`` in the caller's
    arguments, for the message about an input that has no value.

    ``diagram`` may be a diagram with its equations, which are then not read again. The open inputs
    of these equations are then the open inputs of the point, and ports inside are not looked at.
    """
    return read_points(diagram, [context], inputs, outputs, bypass, setting)[0]


def read_points(
    diagram: Any,
    contexts: Iterable[Any],
    inputs: Iterable[str] = (),
    outputs: Iterable[str] = (),
    bypass: Iterable[str] = (),
    setting: str = "inputs",
) -> list[Point]:
    """Read the equations of a diagram once, and the values of several Contexts; see `read_point`.

    An input is open if it has a value in at least one of the Contexts.
    """
    system = system_of(diagram)
    try:
        contexts = list(contexts)
    except TypeError:
        raise ParameterError(f"contexts = {quoted(contexts)}: must be a list of Contexts") from None
    values = [_input_values(system, context) for context in contexts]
    bypass = names("bypass", bypass)
    if isinstance(diagram, DiagramEquations):
        read, first = diagram, tuple(diagram.equations.inputs)[: len(tuple(inputs))]
        if bypass or first != tuple(inputs) or not {*outputs} <= {*read.equations.outputs}:
            raise ParameterError(
                f"diagram: its equations were read with the inputs {quoted(first)} first, and with "
                f"other outputs or bypass; must be read with those of this call"
            )
    else:
        root = Node(system)
        for path in bypass:
            bypass_system(root, path)
        open_ports = dict.fromkeys([*inputs, *itertools.chain(*values)])
        in_ports = {name: find_port(root, name, "input") for name in open_ports}
        in_ports |= _fixed_ports(root, contexts, values)
        ports = map(system.get_output_port, range(system.num_output_ports()))
        exported = {port.get_name() for port in ports}
        inner = [name for name in outputs if name not in exported]
        read = _read(root, in_ports, {name: find_port(root, name, "output") for name in inner})
    sizes = read.equations.inputs
    states = [read.state(context) for context in contexts]
    points: list[Point] = []
    for context, of_port, state in zip(contexts, values, states, strict=True):
        numbers = (
            0.0 if context is None else float(context.get_time()),
            read.parameters(context),
            np.concatenate([state.continuous, state.discrete]),
            np.concatenate(
                [np.empty(0), *(of_port.get(name, np.zeros(sizes[name])) for name in sizes)]
            ),
        )
        if isinstance(read, LeafwiseEquations):
            base = system.CreateDefaultContext() if context is None else context
            point: Point = LeafwisePoint(read, *numbers, base, setting)
            point.slopes(tuple(outputs))  # so that a leaf that cannot be called is told here
        else:
            point = Point(read, *numbers)
        points.append(point)
    return points


def system_of(diagram: Any) -> Any:
    """Return the system of a diagram with its equations, or a Diagram or leaf system itself.

    Raises `CompilationError` for anything else.
    """
    if isinstance(diagram, DiagramEquations):
        return diagram.diagram
    require_system(diagram)
    return diagram


def _read(root: Node, inputs: Mapping[str, Port], outputs: Mapping[str, Port]) -> DiagramEquations:
    """Return the equations of a diagram; only their names and sizes if a leaf has no equations.

    Equations come first, because they tell more: see `advice`.
    """
    try:
        return equations_of(root, inputs, outputs)
    except DifferenceError:  # a leaf whose forms disagree has no right derivative
        raise
    except CompilationError:
        return LeafwiseEquations(root, inputs, outputs)


def _input_values(diagram: Any, context: Any) -> dict[str, Array]:
    """Return the value of each input port of vectors that has a value in a Context, by its name."""
    if context is None:
        return {}
    try:
        diagram.ValidateContext(context)
    except (RuntimeError, TypeError):
        raise ParameterError(
            f"context: is no Context of {shown(diagram.get_name() or type(diagram).__name__)}; "
            f"create it by diagram.CreateDefaultContext()"
        ) from None
    ports = (diagram.get_input_port(index) for index in range(diagram.num_input_ports()))
    return {
        port.get_name(): port.Eval(context)
        for port in ports
        if port.get_data_type() == PortDataType.kVectorValued and port.HasValue(context)
    }


def _fixed_ports(
    root: Node, contexts: Sequence[Any], values: Sequence[dict[str, Array]]
) -> dict[str, Port]:
    """Add the values of fixed ports inside a diagram to ``values``; return and cut these ports.

    Raises `ParameterError` if a port is fixed in one Context and not in another.
    """
    ports: dict[str, Port] = {}
    for context, of_port in zip(contexts, values, strict=True):
        if context is not None:
            for name, port, value in _fixed_inside(root, context):
                ports[name], of_port[name] = port, value
    for name, (node, _, index) in ports.items():
        node.fixed.add(index)
        if not all(name in of_port for of_port in values):
            raise ParameterError(
                f"contexts: {quoted(name)} has a value of its own in some of them; must have one "
                f"in all or in none"
            )
    return ports


def _fixed_inside(root: Node, context: Any) -> Iterator[tuple[str, Port, Array]]:
    """Yield name, port and value of each input port inside with a value of its own.

    Such a port is not connected, or has not the value of the port that it reads. Drake does not
    tell, so the values are compared where states and inputs have moved a little: FixValue may have
    taken the very value of the signal.
    """
    moved = context.Clone()
    random = np.random.default_rng(1)
    groups = map(moved.get_mutable_discrete_state, range(moved.num_discrete_state_groups()))
    for vector in (moved.get_mutable_continuous_state_vector(), *groups):
        vector.SetFromVector(_beside(vector.CopyToVector(), random))
    for name, value in _input_values(root.system, context).items():
        root.system.GetInputPort(name).FixValue(moved, _beside(value, random))
    for leaf in root.leaves():
        for index in range(leaf.system.num_input_ports()):
            if leaf.system.get_input_port(index).get_data_type() != PortDataType.kVectorValued:
                continue
            route = list(leaf.route(index))
            values = [_value(port, moved) for port in route]
            if route[-1][1] == "input" and route[-1][0].parent is not None:
                route, values = [*route, route[-1]], [*values, None]  # nothing before the last port
            for port, own, before in zip(route, values, values[1:], strict=False):
                node, kind, number = port
                if kind == "output" or own is None:
                    continue
                if before is None or not np.array_equal(own, before, equal_nan=True):
                    name = node.system.get_input_port(number).get_name()
                    same = " (input)" if node.system.HasOutputPort(name) else ""
                    yield f"{node.path}:{name}{same}", port, own


def _beside(values: Array, random: Any) -> Array:
    return values + 1e-3 * random.uniform(1.0, 2.0, values.size) * np.maximum(1.0, np.abs(values))


def _value(port: Port, context: Any) -> Array | None:
    """Return the value of a port in the Context of a diagram; None if there is none."""
    node, kind, index = port
    of_node = node.context(context)
    try:
        return np.asarray(getattr(node.system, f"get_{kind}_port")(index).Eval(of_node))
    except (Exception, SystemExit):
        return None  # a leaf may fail beside the point, and with it all who read the port
