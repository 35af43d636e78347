"""Reads the equations of a Drake diagram into a graph, one leaf system at a time.

The diagram is cut at its ports. Each leaf is evaluated on fresh variables for time, states,
parameters and inputs, and the small expressions are joined in one `Graph`. An expression of the
whole diagram would unfold to 10⁸ nodes.

A leaf system may state three public attributes that the compiler uses:

- ``margin(context)``: a method that returns a scalar, the distance from a limit. A run stops with a
  `SimulationError` when this margin falls below zero.
- ``check(context)``: a method of the leaf of floats. It raises the `SimulationError` that explains
  why the margin is below zero. Without this method the error only names the leaf.
- ``parameter_names``: names of the elements of the first numeric parameter group, in their order.
  Without this attribute the names come from Drake's accessors or are numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
from pydrake.symbolic import Expression, Variable
from pydrake.systems.primitives import TrajectorySource

from ..errors import CompilationError, DifferenceError
from ..run_data import Array
from .comparison import (
    CalledLeaf,
    Evaluate,
    called_twice,
    differ,
    is_compared,
    margin_of,
    output_of,
    points_around,
    rates_of,
    update_of,
)
from .contexts import discrete_values, parameters_of, state_of
from .equations import Equations, Limit, Section
from .events import refuse_witness_functions, symbolic_value, to_symbolic
from .graph_values import values_at
from .names import discrete_names, parameter_groups, state_names
from .periods import timing_of
from .ports import find_port, is_vector, open_inputs, output_routes, ports_of, size_of
from .symbolic import Conversion, Steps, completed
from .tree import Node, Port


class _Leaf:
    """A leaf in symbolic form, a Context whose values are variables, and the variables' meaning."""

    def __init__(self, node: Node, equations: Equations, open_inputs: dict[Port, int]) -> None:
        """Convert a leaf, and add the names of its parameters and states to ``equations``.

        ``open_inputs`` maps each open input to the index of its first element among the elements of
        all open inputs. An open input is an input port of the root, or a port inside whose signal
        is perturbed.
        """
        self.node = node
        context_of_floats = node.system.CreateDefaultContext()
        refuse_witness_functions(node, context_of_floats)
        self.system = to_symbolic(node)
        self.outputs: dict[int, list[int] | None] = {}
        """Dictionary from the index of an output port to its nodes, or to None during reading."""
        self.inputs: dict[int, list[int]] = {}
        """Dictionary from the index of an input port to its nodes; only ports read so far."""
        self.parts: dict[str, tuple[Evaluate, list[int]]] = {}
        """What was read of the leaf, by its name: a function of leaf and Context, and the nodes."""
        graph = equations.graph
        if self.system.num_abstract_states() or context_of_floats.num_abstract_parameters():
            raise CompilationError(
                f"{node.name}: {node.type_name} has an abstract state or parameter; only vectors "
                f"compile"
            )

        def added(kind: str, names: list[str], known: list[str]) -> list[int]:
            """Return new sources of a kind, and add their names to all ``known``."""
            known += names
            return [graph.source(kind, i) for i in range(len(known) - len(names), len(known))]

        parameters = list(chain(*parameter_groups(node, context_of_floats)))
        self.first_discrete = len(equations.discrete)
        self.own = [
            graph.source("time"),
            *added("parameter", parameters, equations.parameters),
            *added("state", state_names(node, context_of_floats), equations.states),
            *added("discrete", discrete_names(node, context_of_floats), equations.discrete),
        ]
        """Nodes of the time, of all parameters and of all states of the leaf, in this order."""
        meanings: list[Any] = [*self.own]
        known = []
        for index, port in enumerate(ports_of(self.system, "input")):
            *inner, source = node.route(index)
            is_open = source[1] == "input" and source in open_inputs
            if not is_vector(port) or not (is_open or source[1] == "output"):
                continue
            elements: list[Any] = [(index, i) for i in range(port.size())]
            if is_open and open_inputs.keys().isdisjoint(inner):
                first = open_inputs[source]
                elements = [graph.source("input", first + i) for i in range(port.size())]
                self.inputs[index] = elements
            meanings += elements
            known.append(index)
        variables = [Variable(f"v{i}") for i in range(len(meanings))]
        ids = [variable.get_id() for variable in variables]
        self.meaning: dict[int, int | tuple[int, int]] = dict(zip(ids, meanings, strict=True))
        """Dictionary from the id of a variable to its meaning: the node of a source, or an element
        of an input port of the leaf, as (index of the port, index of the element)."""
        point = np.array([*map(Expression, variables)])
        self.context = CalledLeaf(self.system, known).context(point)


class _Reader:
    """Reads the equations of all leaf systems of a diagram into one object `Equations`.

    The reader reads an output port when another leaf first needs its nodes. So each section, which
    has the nodes of one leaf for one purpose, comes after the sections that it depends on.
    """

    def __init__(self, root: Node, inputs: Mapping[str, Port]) -> None:
        self.equations = Equations()
        self._open_inputs = open_inputs(self.equations, inputs)
        self.leaves: dict[str, _Leaf] = {}
        paths = set()
        for leaf in root.leaves():
            if leaf.path in paths:
                raise CompilationError(f"{leaf.path}: two systems have this path; rename one")
            paths.add(leaf.path)
            if leaf.has_equations:
                self.leaves[leaf.path] = _Leaf(leaf, self.equations, self._open_inputs)

    def signal(self, route: list[Port]) -> Steps[list[int]]:
        """Return the nodes of a signal: the source's signal plus the perturbations on the way."""
        graph = self.equations.graph
        leaf, kind, index = source = route[-1]
        added = [self._open_inputs[port] for port in route[::-1] if port in self._open_inputs]
        nodes = [graph.zero] * size_of(source)
        if kind == "output":
            nodes = yield self._output(leaf, index)
        elif source not in self._open_inputs:
            raise CompilationError(f"{leaf.name}: input port {index} is not connected")
        if not added:
            return nodes
        return [
            graph.add(node, *(graph.source("input", first + element) for first in added))
            for element, node in enumerate(nodes)
        ]

    def _output(self, node: Node, index: int) -> Steps[list[int]]:
        leaf = self.leaves[node.path]
        port = leaf.system.get_output_port(index)
        where = f"{node.name}: output port {port.get_name()}"
        if index not in leaf.outputs:
            leaf.outputs[index] = None
            if not is_vector(port):
                raise CompilationError(f"{where}: is not a vector; only vectors compile")
            if isinstance(node.system, TrajectorySource):
                raise CompilationError(
                    f"{where}: has no symbolic form, and pydrake hides its trajectory; export "
                    f"the input port that it feeds, keep that open by inputs=[...], and pass "
                    f"input_table(trajectory)"
                )
            purpose = f"output port {port.get_name()}"
            leaf.outputs[index] = yield self._evaluated(purpose, leaf, output_of(index))
        nodes = leaf.outputs[index]
        if nodes is None:
            raise CompilationError(f"{where}: depends on itself (algebraic loop)")
        return nodes

    def read(self, leaf: _Leaf) -> None:
        """Add the derivatives, discrete updates and margin of one leaf to the equations."""
        equations, context = self.equations, leaf.context
        if context.num_continuous_states():
            equations.derivatives += completed(self._evaluated("time derivatives", leaf, rates_of))
        if context.num_discrete_state_groups():
            timing = timing_of(leaf.node)
            nodes = completed(self._evaluated("discrete update", leaf, update_of))
            equations.add_update(timing, enumerate(nodes, leaf.first_discrete))
        if callable(getattr(leaf.system, "margin", None)):
            (node,) = completed(self._evaluated("margin", leaf, margin_of))
            equations.limits.append(Limit(leaf.node.path, node))

    def read_initial(self, leaf: _Leaf) -> None:
        """Add the nodes of a leaf's initial discrete states to the equations.

        Initialization events compute these states. The events change the Context of the leaf, so
        call this method after all other reading.
        """
        if not leaf.context.num_discrete_state_groups() + leaf.context.num_continuous_states():
            return
        context = leaf.context

        def initialized() -> Any:
            before = context.get_continuous_state_vector().CopyToVector()
            leaf.system.ExecuteInitializationEvents(context)
            after = context.get_continuous_state_vector().CopyToVector()
            return before, after

        where = f"{leaf.node.name}: initialization"
        before, after = symbolic_value(where, initialized)
        if not all(a.EqualTo(b) for a, b in zip(before, after, strict=True)):
            raise CompilationError(f"{where}: changes the continuous state; only discrete ones may")
        values = discrete_values(context.get_discrete_state())
        self.equations.initial_discrete += completed(self._section(where, leaf, values))

    def _evaluated(self, purpose: str, leaf: _Leaf, evaluate: Evaluate) -> Steps[list[int]]:
        """Add the expressions that ``evaluate`` returns as a `Section`; return their nodes.

        ``purpose``: text that the section and error messages use as the name of the expressions.
        """
        where = f"{leaf.node.name}: {purpose}"
        values = symbolic_value(where, lambda: evaluate(leaf.system, leaf.context))
        nodes = yield self._section(where, leaf, values)
        leaf.parts[purpose] = evaluate, nodes
        return nodes

    def _section(self, where: str, leaf: _Leaf, values: Sequence[Any]) -> Steps[list[int]]:
        """Add the expressions ``values`` to the equations as a `Section`; return their nodes."""
        variable = partial(self._node_of_variable, where, leaf)
        nodes = yield Conversion(self.equations.graph, where, variable).nodes(values)
        self.equations.sections.append(
            Section(where, leaf.node.summary, tuple(nodes), leaf.node.source)
        )
        return nodes

    def _node_of_variable(self, where: str, leaf: _Leaf, variable: Any) -> Steps[int]:
        meaning = leaf.meaning.get(variable.get_id())
        if meaning is None:
            raise CompilationError(f"{where}: contains a variable of its own, {variable}")
        if isinstance(meaning, int):
            return meaning
        index, element = meaning
        if index not in leaf.inputs:
            leaf.inputs[index] = yield self.signal(list(leaf.node.route(index)))
        return leaf.inputs[index][element]

    def compare(self, root: Node) -> None:
        """Compare the equations of each leaf that is written in Python with the leaf of floats.

        The leaf of floats is called in a new Context at each point. A point where it fails or is
        not finite does not count. Raises `DifferenceError`, which names the leaf and the port.
        """
        leaves = [v for v in self.leaves.values() if is_compared(v.node.system)]
        if not leaves:
            return
        # A fixed seed: an equal diagram compiles each time, or never.
        random = np.random.default_rng(0)
        context = root.system.CreateDefaultContext()
        state = state_of(root, context)
        sources = {
            "parameter": points_around(parameters_of(root, context), random, scale=0.0),
            "time": np.abs(points_around(np.zeros(1), random)),
            "state": points_around(state.continuous, random),
            "discrete": points_around(state.discrete, random),
            "input": points_around(np.zeros(sum(self.equations.inputs.values())), random),
        }

        def values(nodes: Iterable[int]) -> Array:
            return values_at(sources["time"].size, self.equations.graph, nodes, sources)

        for leaf in leaves:
            points = values([*leaf.own, *chain(*leaf.inputs.values())])
            called = CalledLeaf(leaf.node.system, leaf.inputs)
            for purpose, (evaluate, nodes) in leaf.parts.items():
                function = called.function(evaluate, len(nodes))
                numbers, repeats = called_twice(function, function, points)
                if not repeats or differ(function, points, values(nodes), numbers):
                    raise DifferenceError(
                        f"{leaf.node.name}: {purpose}: the equations that were read off differ "
                        f"from {leaf.node.type_name} called with numbers; its symbolic form must "
                        f"compute the same, from states and parameters alone"
                    )


def read_equations(diagram: Any, inputs: Sequence[str] = ()) -> Equations:
    """Return all equations of a diagram of floats.

    A leaf is left out if no state, no margin and no output port of the diagram depends on it.

    Parameters
    ----------
    diagram
        A Diagram, or a single leaf system.
    inputs
        Names of the diagram's input ports that stay open, which means that a run gives their
        values. All other input ports of the diagram count as unconnected.

    Raises
    ------
    CompilationError
        Part of the diagram cannot be converted; the message names the subsystem and the port.
    """
    if isinstance(inputs, str):
        raise CompilationError(f"inputs = {inputs!r}: must be a list of names of input ports")
    root = Node(diagram)
    return read_tree(root, {name: find_port(root, name, "input") for name in inputs}, {})


def read_tree(root: Node, inputs: Mapping[str, Port], outputs: Mapping[str, Port]) -> Equations:
    """Return all equations of the diagram at the root of a tree.

    Parameters
    ----------
    root
        The tree.
    inputs
        Dictionary from name to port of the open inputs. An input port of the root has the values
        that a run gives. At any other port, a run gives a perturbation, which adds to the signal
        for all systems that read the signal through this port.
    outputs
        Dictionary from name to port of more outputs, besides the output ports of the root. The
        signal of a port includes the perturbations at this port and on the way to it.

    Errors: see `read_equations`.
    """
    routes = output_routes(root, outputs)
    reader = _Reader(root, inputs)
    # Exported C has the statements in the order of reading: first those of the leaves, in the order
    # of the diagram, then the outputs that no leaf has read.
    for leaf in reader.leaves.values():
        reader.read(leaf)
    for name, route in routes.items():
        reader.equations.outputs[name] = completed(reader.signal(route))
    reader.compare(root)
    for leaf in reader.leaves.values():
        reader.read_initial(leaf)
    return reader.equations
