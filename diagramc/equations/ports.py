"""Finds ports of a diagram by name, ports inside the diagram too."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Any

from pydrake.systems.framework import PortDataType

from ..arguments import quoted
from ..errors import CompilationError, shown
from .equations import Equations
from .tree import Node, Port


def find_port(root: Node, name: str, kind: str) -> Port:
    """Return the port of a diagram that has the name ``name``.

    Parameters
    ----------
    root
        The tree of the diagram.
    name
        Name of a port of the diagram, or ``path/of/system:port`` for a port inside. If a system has
        an input port and an output port of the same name, this name stands for the output port.
    kind
        ``input`` or ``output``. A port of the diagram itself must be of this kind.

    Raises
    ------
    CompilationError
        The diagram has no such port, or the port is not a vector.
    """
    index = _ports(root.system, kind).get(name)
    port = _inner_port(root, name) if index is None else (root, kind, index)
    if port is None:
        raise CompilationError(_unknown(root, name, kind))
    if not is_vector(_drake_port(port)):
        raise CompilationError(f"{kind} {quoted(name)}: is not a vector; only vectors compile")
    return port


def bypass(root: Node, path: str) -> None:
    """Mark a system as a wire, whose output is its first input when the equations are read.

    Raises `CompilationError` if there is no system at ``path``, or if the system has a state, or
    ports that `can_bypass` refuses.
    """
    systems = {node.path: node for node in _systems(root)}
    if path not in systems:
        similar = get_close_matches(path, systems, n=3, cutoff=0.6)
        hint = f"; did you mean {' or '.join(similar)}?" if similar else ""
        raise CompilationError(f"bypass: {_title(root)} has no system {quoted(path)}{hint}")
    if not can_bypass(root, path):
        raise CompilationError(
            f"bypass: {quoted(path)}: has a state, or ports that do not fit; must have no state, "
            f"one output port, and a first input port of the same size"
        )
    systems[path].is_bypassed = True


def can_bypass(root: Node, path: str) -> bool:
    """Return whether the system at a path can count as a wire.

    The system must have no state, one output port, and a first input port of the same size. Both
    ports must be vectors.
    """
    node = next((node for node in _systems(root) if node.path == path), None)
    if node is None or node.system.num_input_ports() < 1 or node.system.num_output_ports() != 1:
        return False
    ports = node.system.get_input_port(0), node.system.get_output_port(0)
    if not all(map(is_vector, ports)):
        return False
    return ports[0].size() == ports[1].size() and node.system.CreateDefaultContext().is_stateless()


def route_of(port: Port) -> Iterator[Port]:
    """Yield the ports from a port back to the source of its signal: see `Node.route`."""
    node, kind, index = port
    return node.route(index) if kind == "input" else node.output_route(index)


def output_routes(root: Node, outputs: Mapping[str, Port]) -> dict[str, list[Port]]:
    """Return the routes from the outputs of a model back to their sources, by name.

    The outputs are the output ports of the root that are vectors, and then ``outputs``, whose
    sources become leaves with equations: see `Node.observed`.
    """
    more = {name: list(route_of(port)) for name, port in outputs.items()}
    root.observed = [route[-1][0] for route in more.values() if route[-1][1] == "output"]
    ports = enumerate(ports_of(root.system, "output"))
    own = {p.get_name(): list(root.output_route(i)) for i, p in ports if is_vector(p)}
    return own | more


def open_inputs(equations: Equations, inputs: Mapping[str, Port]) -> dict[Port, int]:
    """Add open inputs to equations.

    Returns the index of the first element of each among the elements of all open inputs.
    """
    first = {}
    for name, port in inputs.items():
        first[port] = sum(equations.inputs.values())
        equations.inputs[name] = size_of(port)
    return first


def ports_of(system: Any, kind: str) -> list[Any]:
    """Return a system's ``input`` or ``output`` ports, as ``kind`` says."""
    count = getattr(system, f"num_{kind}_ports")()
    return [getattr(system, f"get_{kind}_port")(index) for index in range(count)]


def is_vector(port: Any) -> bool:
    """Return whether the signal of one of Drake's ports is a vector."""
    return bool(port.get_data_type() == PortDataType.kVectorValued)


def vector_names(system: Any, kind: str) -> tuple[str, ...]:
    """Return the names of a system's ``input`` or ``output`` ports that are vectors."""
    return tuple(port.get_name() for port in ports_of(system, kind) if is_vector(port))


def size_of(port: Port) -> int:
    """Return the number of elements of a port."""
    return int(_drake_port(port).size())


def _drake_port(port: Port) -> Any:
    node, kind, index = port
    return getattr(node.system, f"get_{kind}_port")(index)


def _ports(system: Any, kind: str) -> dict[str, int]:
    """Return {name: index} of a system's input ports, or of its output ports, as ``kind`` says."""
    return {port.get_name(): index for index, port in enumerate(ports_of(system, kind))}


def _systems(node: Node) -> Iterator[Node]:
    """Yield all systems below a node."""
    for child in node.children.values():
        yield child
        yield from _systems(child)


def _inner_port(root: Node, name: str) -> Port | None:
    for node in _systems(root):
        if name.startswith(f"{node.path}:"):
            port = name[len(node.path) + 1 :]
            for kind in ("output", "input"):
                if (index := _ports(node.system, kind).get(port)) is not None:
                    return node, kind, index
    return None


def _unknown(root: Node, name: str, kind: str) -> str:
    """Return the error message for a port that does not exist.

    It suggests all ports of the same system, or else similar names of ports inside.
    """
    inner = [
        f"{node.path}:{port}"
        for node in _systems(root)
        for some_kind in ("output", "input")
        for port in _ports(node.system, some_kind)
    ]
    same_system = [port for port in inner if port.startswith(f"{name.rpartition(':')[0]}:")]
    similar = same_system or get_close_matches(name, inner, n=2, cutoff=0.6)
    hint = f"; did you mean {' or '.join(similar)}?" if similar else ""
    if ":" in name:
        systems = ", ".join(node.path for node in _systems(root))
        hint = hint or (f"; its systems are {shown(systems)}" if systems else "; it is one system")
        return f"{_title(root)}: has no port {quoted(name)} inside{hint}"
    ports = ", ".join(_ports(root.system, kind)) or "none"
    return f"{_title(root)}: has no {kind} port {quoted(name)}; it has {shown(ports)}{hint}"


def _title(root: Node) -> str:
    """Return the name of a diagram, or that of its class if its name is empty."""
    return shown(root.system.get_name() or type(root.system).__name__)
