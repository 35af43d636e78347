"""Reads the equations of a diagram, and the values of a Context as vectors, without compiling."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from functools import cached_property
from importlib.metadata import version
from typing import Any

from pydrake.systems.framework import System

from .arguments import names, quoted
from .equations.contexts import parameters_of, set_parameters, state_of
from .equations.equations import Equations
from .equations.graph import Graph
from .equations.graph_values import values_at
from .equations.ports import bypass as bypass_system, find_port
from .equations.reader import read_tree
from .equations.symbolic import Conversion, Steps, completed
from .equations.tree import Node, Port
from .errors import CompilationError
from .run_data import Array, State


class DiagramEquations:
    """A diagram of floats, its equations, and the names of its parameters and states.

    Parameters
    ----------
    diagram
        The diagram.
    equations
        Its equations.
    root
        The tree of subsystems from which the equations were read. None: a new tree.
    """

    def __init__(self, diagram: Any, equations: Equations, root: Node | None = None) -> None:
        self.diagram, self.equations = diagram, equations
        self.root = Node(diagram) if root is None else root
        self.parameter_names: tuple[str, ...] = tuple(equations.parameters)
        self.state_names: tuple[str, ...] = tuple(equations.states)
        self.discrete_names: tuple[str, ...] = tuple(equations.discrete)
        self.derivatives: dict[tuple[int, ...], Any] = {}
        """Machine code of the derivatives of nodes, by these nodes: see `linear.point.Point`."""

    @cached_property
    def key(self) -> str:
        """Hash of the equations: see `equations_key`."""
        return equations_key(self.equations)

    def parameters(self, context: Any | None = None) -> Array:
        """Return the parameters in ``context``, by default in the diagram's default Context."""
        context = self.diagram.CreateDefaultContext() if context is None else context
        return parameters_of(self.root, context)

    def set_parameters(self, context: Any, parameters: Array) -> None:
        """Write the parameters, in the order of ``parameter_names``, into a Context."""
        set_parameters(self.root, context, parameters)

    def state(self, context: Any | None = None) -> State:
        """Return the state in ``context``, by default in the diagram's default Context.

        The state is the state before the initialization events: see `ModelBase.initialized`.
        """
        context = self.diagram.CreateDefaultContext() if context is None else context
        return state_of(self.root, context)


def read_diagram(
    diagram: Any,
    *,
    inputs: Iterable[str] = (),
    outputs: Iterable[str] = (),
    bypass: Iterable[str] = (),
) -> DiagramEquations:
    """Return the equations of a diagram of floats.

    Parameters
    ----------
    diagram
        A Diagram or leaf system: see `compile_diagram`.
    inputs
        Names of the diagram's input ports that stay open. A name ``path/of/system:port`` stands for
        a port inside the diagram. A run then gives a perturbation that adds to the signal of this
        port, for all systems that read the signal through this port.
    outputs
        Names ``path/of/system:port`` of ports inside the diagram that become outputs, besides the
        output ports of the diagram. The signal includes the perturbations of the same port.
    bypass
        Paths of systems, such as quantizers, whose output becomes their first input.

    Errors: see `compile_diagram`.
    """
    require_system(diagram)
    root = Node(diagram)
    in_names, out_names = names("inputs", inputs), names("outputs", outputs)
    for path in names("bypass", bypass):
        bypass_system(root, path)
    return equations_of(
        root,
        {port: find_port(root, port, "input") for port in in_names},
        {port: find_port(root, port, "output") for port in out_names},
    )


def equations_of(
    root: Node, inputs: Mapping[str, Port], outputs: Mapping[str, Port]
) -> DiagramEquations:
    """Return the equations of the diagram at the root of a tree: see `read_tree`."""
    name = root.system.get_name() or type(root.system).__name__
    try:
        equations = read_tree(root, inputs, outputs)
    except CompilationError as error:
        # The path of a single leaf system is empty, and a user may not know of `inputs`.
        text = f"{name}{error}" if str(error).startswith(": ") else str(error)
        if "is not connected" in text:
            text += "; connect it, or name the diagram's port in inputs"
        raise type(error)(text) from error
    return DiagramEquations(root.system, equations, root)


def require_system(diagram: Any) -> None:
    """Raise `CompilationError` unless ``diagram`` is a Diagram or leaf system of floats."""
    if not isinstance(diagram, System):
        raise CompilationError(
            f"{type(diagram).__name__} {quoted(diagram)}: cannot be compiled; must be a Diagram or "
            f"leaf system of floats"
        )


class ExpressionGraph:
    """Symbolic expressions as a graph, to evaluate them at points and to tell equal functions.

    Each part that several expressions share is one node of the graph.

    Parameters
    ----------
    expressions
        The expressions.
    variables
        All variables of the expressions.

    Raises
    ------
    CompilationError
        An expression is too large or does not compile.
    """

    def __init__(self, expressions: Sequence[Any], variables: Sequence[Any]) -> None:
        self._expressions, self._variables = expressions, variables
        self._graph = graph = Graph()
        places = {variable.get_id(): place for place, variable in enumerate(variables)}

        def node_of_variable(variable: Any) -> Steps[int]:
            return graph.source("input", places[variable.get_id()])
            yield  # makes this function a generator, as `Conversion` requires

        conversion = Conversion(graph, "expression", node_of_variable)
        self._nodes = completed(conversion.nodes(expressions))
        self._is_large = conversion.is_large

    def is_of(self, expressions: Sequence[Any]) -> bool:
        """Return whether this is the graph of other expressions of the same variables."""
        if self._is_large:  # Drake compares trees, which can be as large as 2ⁿ for n operations
            return self.key == ExpressionGraph(expressions, self._variables).key
        pairs = zip(self._expressions, expressions, strict=True)
        return all(one.EqualTo(other) for one, other in pairs)

    @cached_property
    def key(self) -> str:
        """Hash (SHA-256) of the graph and the version of Drake; equal functions have one key."""
        names = [variable.get_name() for variable in self._variables]
        return _hash((names, self._nodes, self._graph.nodes))

    def values(self, points: Array) -> Array:
        """Return the values of the expressions at points of the variables, (points, expressions).

        ``points`` has the shape (points, variables). An undefined value is nan or inf.
        """
        return values_at(len(points), self._graph, self._nodes, {"input": points.T})


def equations_key(equations: Equations) -> str:
    """Return a hash (SHA-256) of the equations and the version of Drake."""
    named = [(field.name, getattr(equations, field.name)) for field in fields(equations)]
    content = [value.nodes if name == "graph" else value for name, value in named]
    return _hash(content)


def _hash(content: Any) -> str:
    # The version of Drake, because another version can convert equal leaves to other equations.
    return hashlib.sha256(repr((version("drake"), content)).encode()).hexdigest()
