"""Reads the equations of a Drake diagram one leaf system at a time.

The diagram is cut at its ports. Each leaf is evaluated on fresh variables for time, states,
parameters and inputs, and the small expressions are joined in one `Graph`. An expression of the
whole diagram would unfold to 10⁸ nodes.

A leaf system may state three public attributes that the compiler uses:

- ``margin(context)``: a scalar. A run stops with a `SimulationError` when it falls below zero.
- ``check(context)``: a method of the leaf of floats. It raises the `SimulationError` that explains
  why the margin is below zero. Without it the error only names the leaf.
- ``parameter_names``: names of the elements of the first numeric parameter group, in their order.
  Without them the names come from Drake's accessors or are numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from pydrake.symbolic import Expression, Variable
from pydrake.systems.framework import PortDataType
from pydrake.systems.primitives import TrajectorySource

from ..errors import CompilationError
from .equations import Equations, Limit, Section, Update
from .events import refuse_witness_functions, symbolic_value, to_symbolic
from .names import numbered_names, parameter_groups, state_names
from .symbolic import Conversion, Steps, completed
from .tree import Node


class _Leaf:
    """The symbolic form of a leaf, its Context on variables, and the meaning of each variable."""

    def __init__(self, node: Node, equations: Equations, open_inputs: dict[int, int]) -> None:
        """Adds the names of parameters and states to ``equations``.

        ``open_inputs``: for each open input port of the root, its first element among all inputs.
        """
        self.node = node
        context_of_floats = node.system.CreateDefaultContext()
        refuse_witness_functions(node, context_of_floats)
        self.system = to_symbolic(node)
        self.context = context = self.system.CreateDefaultContext()
        self.meaning: dict[int, int | tuple[Node, int, int]] = {}
        """By the id of a variable: its node, or a leaf, its output port and the element there."""
        self.outputs: dict[int, list[int] | None] = {}
        """Nodes by output port; None while they are being read."""
        graph = equations.graph

        if context.num_abstract_states() or context.num_abstract_parameters():
            raise CompilationError(
                f"{node.name}: {node.type_name} has an abstract state or parameter; only vectors "
                f"compile"
            )
        context.SetTime(self._variables("time", [graph.source("time")])[0])
        for group, names in enumerate(parameter_groups(node, context_of_floats)):
            first = len(equations.parameters)
            sources = [graph.source("parameter", first + i) for i in range(len(names))]
            variables = self._variables("parameter", sources)
            context.get_mutable_numeric_parameter(group).SetFromVector(variables)
            equations.parameters += names
        size = context.num_continuous_states()
        if size:
            first = len(equations.states)
            sources = [graph.source("state", first + i) for i in range(size)]
            variables = self._variables("state", sources)
            context.get_mutable_continuous_state_vector().SetFromVector(variables)
            equations.states += state_names(node, context_of_floats)
        self.first_discrete = len(equations.discrete)
        for group in range(context.num_discrete_state_groups()):
            vector = context.get_mutable_discrete_state(group)
            first = len(equations.discrete)
            sources = [graph.source("discrete", first + i) for i in range(vector.size())]
            vector.SetFromVector(self._variables("discrete", sources))
            equations.discrete += numbered_names(node.path, group, vector.size())
        for index in range(self.system.num_input_ports()):
            port = self.system.get_input_port(index)
            driver = node.driver(index)
            if port.get_data_type() != PortDataType.kVectorValued or driver is None:
                continue
            if isinstance(driver, int):
                if driver not in open_inputs:
                    continue
                sources = [
                    graph.source("input", open_inputs[driver] + i) for i in range(port.size())
                ]
                port.FixValue(context, self._variables("input", sources))
            else:
                elements = [(*driver, i) for i in range(port.size())]
                port.FixValue(context, self._variables("input", elements))

    def _variables(self, name: str, meanings: Sequence[Any]) -> Any:
        variables = [Variable(f"{name}{i}") for i in range(len(meanings))]
        self.meaning.update(
            (variable.get_id(), meaning)
            for variable, meaning in zip(variables, meanings, strict=True)
        )
        return np.array([Expression(variable) for variable in variables])


class _Reader:
    """Reads the leaves of a tree into `Equations`.

    An output is read when another leaf needs it, so sections come in the order of feedthrough.
    """

    def __init__(self, root: Node, inputs: Sequence[str]) -> None:
        self.equations = Equations()
        open_inputs: dict[int, int] = {}
        for name in dict.fromkeys(inputs):
            port = root.system.GetInputPort(name)
            open_inputs[int(port.get_index())] = sum(self.equations.inputs.values())
            self.equations.inputs[name] = port.size()
        self.leaves: dict[str, _Leaf] = {}
        paths = set()
        for leaf in root.leaves():
            if leaf.path in paths:
                raise CompilationError(f"{leaf.path}: two systems have this path; rename one")
            paths.add(leaf.path)
            if leaf.has_equations:
                self.leaves[leaf.path] = _Leaf(leaf, self.equations, open_inputs)

    def output(self, node: Node, index: int) -> list[int]:
        """Return the nodes of an output port of a leaf."""
        return completed(self._output(node, index))

    def _output(self, node: Node, index: int) -> Steps[list[int]]:
        leaf = self.leaves[node.path]
        port = leaf.system.get_output_port(index)
        where = f"{node.name}: output port {port.get_name()}"
        if index not in leaf.outputs:
            leaf.outputs[index] = None
            if port.get_data_type() != PortDataType.kVectorValued:
                raise CompilationError(f"{where}: is not a vector; only vectors compile")
            if isinstance(node.system, TrajectorySource):
                raise CompilationError(
                    f"{where}: has no symbolic form, and pydrake hides its trajectory; export "
                    f"the input port that it feeds, keep that open by inputs=[...], and pass "
                    f"input_table(trajectory)"
                )
            values = symbolic_value(where, lambda: port.Eval(leaf.context))
            leaf.outputs[index] = yield self._section(where, leaf, values)
        nodes = leaf.outputs[index]
        if nodes is None:
            raise CompilationError(f"{where}: depends on itself (algebraic loop)")
        return nodes

    def read(self, leaf: _Leaf) -> None:
        """Add derivatives, updates and margin of one leaf."""
        equations, context, system = self.equations, leaf.context, leaf.system
        if context.num_continuous_states():
            equations.derivatives += self._evaluated(
                "time derivatives",
                leaf,
                lambda: system.EvalTimeDerivatives(context).CopyToVector().tolist(),
            )
        if context.num_discrete_state_groups():
            timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
            if timing is None:
                raise CompilationError(
                    f"{leaf.node.name}: has a discrete state but not exactly one sample period; "
                    f"split it"
                )
            nodes = self._evaluated(
                "discrete update",
                leaf,
                lambda: _discrete_values(system.EvalUniquePeriodicDiscreteUpdate(context)),
            )
            self._add_update(timing, list(enumerate(nodes, leaf.first_discrete)))
        if callable(margin := getattr(system, "margin", None)):
            (node,) = self._evaluated("margin", leaf, lambda: [margin(context)])
            equations.limits.append(Limit(leaf.node.path, node))

    def read_initial(self, leaf: _Leaf) -> None:
        """Add the discrete state after initialization; this changes the Context of the leaf."""
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
        values = _discrete_values(context.get_discrete_state())
        self.equations.initial_discrete += completed(self._section(where, leaf, values))

    def _add_update(self, timing: Any, values: list[tuple[int, int]]) -> None:
        period, offset = timing.period_sec(), timing.offset_sec()
        for number, update in enumerate(self.equations.updates):
            if (update.period_s, update.offset_s) == (period, offset):
                self.equations.updates[number] = Update(period, offset, (*update.values, *values))
                return
        self.equations.updates.append(Update(period, offset, tuple(values)))

    def _evaluated(
        self, purpose: str, leaf: _Leaf, evaluate: Callable[[], Sequence[Any]]
    ) -> list[int]:
        """Return the nodes of the expressions that ``evaluate()`` returns."""
        where = f"{leaf.node.name}: {purpose}"
        return completed(self._section(where, leaf, symbolic_value(where, evaluate)))

    def _section(self, where: str, leaf: _Leaf, values: Sequence[Any]) -> Steps[list[int]]:
        """Return the nodes of expressions, and add them as a section."""
        variable = partial(self._node_of_variable, where, leaf)
        nodes = yield Conversion(self.equations.graph, where, variable).nodes(values)
        self.equations.sections.append(Section(where, leaf.node.summary, tuple(nodes)))
        return nodes

    def _node_of_variable(self, where: str, leaf: _Leaf, variable: Any) -> Steps[int]:
        meaning = leaf.meaning.get(variable.get_id())
        if meaning is None:
            raise CompilationError(f"{where}: contains a variable of its own, {variable}")
        if isinstance(meaning, int):
            return meaning
        node, port, element = meaning
        return (yield self._output(node, port))[element]


def _discrete_values(values: Any) -> list[Any]:
    """Return the elements of all groups of Drake's DiscreteValues."""
    return [
        element
        for group in range(values.num_groups())
        for element in values.get_vector(group).CopyToVector().tolist()
    ]


def read_equations(diagram: Any, inputs: Sequence[str] = ()) -> Equations:
    """Return all equations of a diagram of floats.

    Leaves that neither a state nor a margin nor an output of the diagram depends on are left out.

    Parameters
    ----------
    diagram
        A Diagram, or a single leaf system.
    inputs
        Names of its input ports that stay open; the others count as unconnected.

    Raises
    ------
    CompilationError
        Names the subsystem and the port that cannot be converted.
    """
    if isinstance(inputs, str):
        raise CompilationError(f"inputs = {inputs!r}: must be a list of names of input ports")
    root = Node(diagram)
    reader = _Reader(root, inputs)
    for leaf in reader.leaves.values():
        reader.read(leaf)
    for index in range(root.system.num_output_ports()):
        node, port = root.output(index)
        name = root.system.get_output_port(index).get_name()
        reader.equations.outputs[name] = reader.output(node, port)
    for leaf in reader.leaves.values():
        reader.read_initial(leaf)
    return reader.equations
