"""The equations of a Drake diagram, read off its symbolic form one leaf system at a time.

The diagram is cut at its ports: each leaf is evaluated on fresh variables for time, states,
parameters and inputs, and its small trees are joined in one `Graph`. An expression of the whole
diagram would unfold to 10⁸ nodes.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from threading import RLock
from typing import Any, TypeAlias, TypeVar

import numpy as np
from pydrake.symbolic import Expression, ExpressionKind, FormulaKind, Variable
from pydrake.systems.framework import (
    BasicVector,
    InputPortIndex,
    LeafSystem_,
    OutputPortIndex,
    PortDataType,
    UnrestrictedUpdateEvent_,
)
from pydrake.systems.primitives import TrajectorySource

from ..errors import CompilationError
from .graph import Graph

T = TypeVar("T")

LARGEST_TREE = 20_000
"""Nodes of one expression beyond which a leaf is refused; shared values belong in ports."""

_UNARY = {
    getattr(ExpressionKind, name): name.lower()
    for name in (
        *("Log", "Abs", "Exp", "Sqrt", "Sin", "Cos", "Tan", "Asin", "Acos", "Atan"),
        *("Sinh", "Cosh", "Tanh", "Ceil", "Floor"),
    )
}
_BINARY = {
    ExpressionKind.Min: "min",
    ExpressionKind.Max: "max",
    ExpressionKind.Atan2: "atan2",
}
_COMPARISONS = {
    FormulaKind.Gt: "gt",
    FormulaKind.Geq: "ge",
    FormulaKind.Lt: "lt",
    FormulaKind.Leq: "le",
    FormulaKind.Eq: "eq",
    FormulaKind.Neq: "ne",
}
_LOGIC = {FormulaKind.And: "and", FormulaKind.Or: "or", FormulaKind.Not: "not"}


@dataclass(frozen=True)
class Update:
    """What one sample period changes: pairs of discrete state and its next value."""

    period_s: float
    offset_s: float
    values: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Limit:
    """A leaf that stops the run when its ``margin`` falls below zero."""

    system: str
    margin: int


@dataclass(frozen=True)
class Section:
    """What one leaf system computes, for who reads the equations."""

    where: str
    """Path of the leaf, and which of its outputs, or its update."""
    equation: str
    """Class of the leaf and the first line of its documentation."""
    nodes: tuple[int, ...]


@dataclass
class Equations:
    """All equations of a diagram as nodes of one graph."""

    graph: Graph = field(default_factory=Graph)
    parameters: list[str] = field(default_factory=list)
    states: list[str] = field(default_factory=list)
    held: list[str] = field(default_factory=list)
    inputs: dict[str, int] = field(default_factory=dict)
    """Sizes of the inputs that stay open."""
    derivatives: list[int] = field(default_factory=list)
    initial_held: list[int] = field(default_factory=list)
    """Discrete state after ``Simulator.Initialize()``."""
    updates: list[Update] = field(default_factory=list)
    outputs: dict[str, list[int]] = field(default_factory=dict)
    limits: list[Limit] = field(default_factory=list)
    sections: list[Section] = field(default_factory=list)
    """All that was read, in an order of evaluation."""


# ------------------------------------------------------------------------- tree of systems


class Node:
    """A system within a diagram; paths are names joined by ``/``, empty for the root."""

    def __init__(self, system: Any, parent: Node | None = None, number: int = 0) -> None:
        self.system = system
        self.parent = parent
        prefix = f"{parent.path}/" if parent is not None and parent.path else ""
        self.path: str = "" if parent is None else prefix + _label(system, number)
        self.children: dict[str, Node] = {}
        self._drivers: dict[tuple[str, int], tuple[str, int]] = {}
        self._exported: dict[tuple[str, int], int] = {}
        if not hasattr(system, "connection_map"):
            return
        systems = enumerate(system.GetSystems())
        self.children = {s.get_name(): Node(s, self, number) for number, s in systems}
        for (target, port), (source, output) in system.connection_map().items():
            self._drivers[target.get_name(), int(port)] = (source.get_name(), int(output))
        for index in range(system.num_input_ports()):
            for target, port in system.GetInputPortLocators(InputPortIndex(index)):
                self._exported[target.get_name(), int(port)] = index

    @property
    def name(self) -> str:
        """The path, or the system's own name for the root."""
        return self.path or str(self.system.get_name())

    @property
    def type_name(self) -> str:
        """The class of the system, without the scalar of a template."""
        return type(self.system).__name__.partition("_𝓣")[0]

    @property
    def has_equations(self) -> bool:
        """Whether a leaf counts: log sinks and what feeds only viewers do not."""
        root = self
        while root.parent is not None:
            root = root.parent
        return self in root._needed

    @cached_property
    def _needed(self) -> set[Node]:
        """The leaves with a state or a margin, and those that they or the outputs depend on."""
        pending = [leaf for leaf in self.leaves() if _has_state_or_margin(leaf.system)]
        pending += [self.output(index)[0] for index in range(self.system.num_output_ports())]
        needed: set[Node] = set()
        while pending:
            leaf = pending.pop()
            if leaf not in needed:
                needed.add(leaf)
                drivers = map(leaf.driver, range(leaf.system.num_input_ports()))
                pending += [driver[0] for driver in drivers if isinstance(driver, tuple)]
        return needed

    def leaves(self) -> Iterator[Node]:
        """The leaf systems, in the order of the diagram."""
        if not hasattr(self.system, "connection_map"):
            yield self
        for child in self.children.values():
            yield from child.leaves()

    def context(self, root: Any) -> Any:
        """The Context of this system within that of the root of the tree."""
        if self.parent is None:
            return root
        return self.parent.system.GetMutableSubsystemContext(self.system, self.parent.context(root))

    def driver(self, index: int) -> tuple[Node, int] | int | None:
        """What feeds input port ``index``: a leaf's output, an input of the root, or nothing."""
        if self.parent is None:
            return index
        key = (self.system.get_name(), index)
        if (source := self.parent._drivers.get(key)) is not None:
            return self.parent.children[source[0]].output(source[1])
        exported = self.parent._exported.get(key)
        return None if exported is None else self.parent.driver(exported)

    def output(self, index: int) -> tuple[Node, int]:
        """The leaf and its output port behind output port ``index``."""
        if not hasattr(self.system, "connection_map"):
            return self, index
        system, port = self.system.get_output_port_locator(OutputPortIndex(index))
        return self.children[system.get_name()].output(int(port))


def parameter_groups(leaf: Node, context: Any) -> list[list[str]]:
    """Names of the elements of each numeric parameter group of a leaf of floats."""
    named = getattr(getattr(leaf.system, "_values", None), "_fields", ())
    groups = []
    for group in range(context.num_numeric_parameter_groups()):
        vector = context.get_numeric_parameter(group)
        if group == 0 and len(named) == vector.size():
            groups.append([f"{leaf.path}.{name}" for name in named])
        else:
            groups.append(_element_names(leaf.path, group, vector))
    return groups


def _element_names(path: str, group: int | str, vector: Any) -> list[str]:
    """Names of the elements of a vector: their numbers, or what Drake calls them.

    Only the first group of parameters and the continuous state take Drake's names, which are those
    of accessors: ``PendulumParams`` has ``mass()`` and ``set_mass()``.
    """
    size = vector.size()
    names = [f"{path}.{group}[{i}]" for i in range(size)]
    if group in (0, "x"):
        numbered = vector.Clone()
        numbered.SetFromVector(range(size))
        for name in dir(vector):
            if hasattr(vector, f"set_{name}") and not hasattr(BasicVector, name):
                names[int(getattr(numbered, name)())] = f"{path}.{name}"
    return names


# ----------------------------------------------------------------------------- extraction

Steps: TypeAlias = Generator[Any, Any, T]
"""A computation that yields the computations it waits for; ``_completed`` runs it."""


def _completed(steps: Steps[T]) -> T:
    """The result of ``steps``, without recursion: chains of blocks and expressions may be deep."""
    pending: list[Steps[Any]] = [steps]
    value: Any = None
    while pending:
        try:
            pending.append(pending[-1].send(value))
            value = None
        except StopIteration as finished:
            pending.pop()
            value = finished.value
    result: T = value
    return result


class _Leaf:
    """The symbolic form of a leaf, its context on variables, and what each variable stands for."""

    def __init__(self, node: Node, equations: Equations, open_inputs: dict[int, int]) -> None:
        self.node = node
        of_floats = node.system.CreateDefaultContext()
        _refuse_witness_functions(node, of_floats)
        self.system = to_symbolic(node)
        self.context = context = self.system.CreateDefaultContext()
        self.meaning: dict[int, int | tuple[Node, int, int]] = {}
        self.outputs: dict[int, list[int] | None] = {}
        graph = equations.graph

        if context.num_abstract_states() or context.num_abstract_parameters():
            raise CompilationError(
                f"{node.name}: {node.type_name} has an abstract state or parameter; only vectors "
                f"compile"
            )
        context.SetTime(self._variables("time", [graph.source("time")])[0])
        for group, names in enumerate(parameter_groups(node, of_floats)):
            first = len(equations.parameters)
            sources = [graph.source("parameter", first + i) for i in range(len(names))]
            variables = self._variables("parameter", sources)
            context.get_mutable_numeric_parameter(group).SetFromVector(variables)
            equations.parameters += names
        self.first_state = len(equations.states)
        size = context.num_continuous_states()
        if size:
            sources = [graph.source("state", self.first_state + i) for i in range(size)]
            variables = self._variables("state", sources)
            context.get_mutable_continuous_state_vector().SetFromVector(variables)
            vector = of_floats.get_continuous_state_vector()
            equations.states += _element_names(node.path, "x", vector)
        self.first_held = len(equations.held)
        for group in range(context.num_discrete_state_groups()):
            vector = context.get_mutable_discrete_state(group)
            first = len(equations.held)
            sources = [graph.source("held", first + i) for i in range(vector.size())]
            vector.SetFromVector(self._variables("held", sources))
            equations.held += [f"{node.path}.{group}[{i}]" for i in range(vector.size())]
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
                there = [(*driver, i) for i in range(port.size())]
                port.FixValue(context, self._variables("input", there))

    def _variables(self, name: str, meaning: Sequence[Any]) -> Any:
        variables = [Variable(f"{name}{i}") for i in range(len(meaning))]
        self.meaning.update(
            (variable.get_id(), what) for variable, what in zip(variables, meaning, strict=True)
        )
        return np.array([Expression(variable) for variable in variables])


class _Reader:
    """Reads the leaves of a tree into `Equations`; outputs on demand, so in feedthrough order."""

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
        """The nodes of an output port of a leaf."""
        return _completed(self._output(node, index))

    def _output(self, node: Node, index: int) -> Steps[list[int]]:
        leaf = self.leaves[node.path]
        port = leaf.system.get_output_port(index)
        where = f"{node.name}: output port {port.get_name()}"
        if index not in leaf.outputs:
            leaf.outputs[index] = None  # being read
            if port.get_data_type() != PortDataType.kVectorValued:
                raise CompilationError(f"{where}: is not a vector; only vectors compile")
            if isinstance(node.system, TrajectorySource):
                raise CompilationError(
                    f"{where}: has no symbolic form, and pydrake hides its trajectory; export "
                    f"the input port that it feeds, keep that open by inputs=[...], and pass "
                    f"input_table(trajectory)"
                )
            values = _symbolic(where, lambda: port.Eval(leaf.context))
            nodes = yield self._nodes(where, leaf, values)
            leaf.outputs[index] = nodes
            self._note(where, leaf, nodes)
        result = leaf.outputs[index]
        if result is None:
            raise CompilationError(f"{where}: depends on itself (algebraic loop)")
        return result

    def read(self, leaf: _Leaf) -> None:
        """Add derivatives, updates, initial values and limits of one leaf."""
        equations, context, system = self.equations, leaf.context, leaf.system
        name = leaf.node.name
        if context.num_continuous_states():
            where = f"{name}: time derivatives"
            values = _symbolic(
                where, lambda: system.EvalTimeDerivatives(context).CopyToVector().tolist()
            )
            equations.derivatives += self._convert(where, leaf, values)
        if context.num_discrete_state_groups():
            timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
            if timing is None:
                raise CompilationError(
                    f"{name}: has a discrete state but not exactly one sample period; split it"
                )
            where = f"{name}: discrete update"
            values = _symbolic(
                where, lambda: _discrete(system.EvalUniquePeriodicDiscreteUpdate(context))
            )
            nodes = self._convert(where, leaf, values)
            self._update(timing, list(enumerate(nodes, leaf.first_held)))
        if callable(margin := getattr(system, "margin", None)):
            where = f"{name}: margin"
            (node,) = self._convert(where, leaf, [_symbolic(where, lambda: margin(context))])
            equations.limits.append(Limit(leaf.node.path, node))

    def read_initial(self, leaf: _Leaf) -> None:
        """Add the discrete state after initialization; this changes the leaf's context."""
        if not leaf.context.num_discrete_state_groups() + leaf.context.num_continuous_states():
            return
        where = f"{leaf.node.name}: initialization"
        before = leaf.context.get_continuous_state_vector().CopyToVector()
        _symbolic(where, lambda: leaf.system.ExecuteInitializationEvents(leaf.context))
        now = leaf.context.get_continuous_state_vector().CopyToVector()
        if not all(a.EqualTo(b) for a, b in zip(before, now, strict=True)):
            raise CompilationError(f"{where}: changes the continuous state; only discrete ones may")
        after = _discrete(leaf.context.get_discrete_state())
        self.equations.initial_held += self._convert(where, leaf, after)

    def _update(self, timing: Any, values: list[tuple[int, int]]) -> None:
        period, offset = timing.period_sec(), timing.offset_sec()
        for number, update in enumerate(self.equations.updates):
            if (update.period_s, update.offset_s) == (period, offset):
                self.equations.updates[number] = Update(period, offset, (*update.values, *values))
                return
        self.equations.updates.append(Update(period, offset, tuple(values)))

    # ------------------------------------------------------------------- trees to nodes

    def _convert(self, where: str, leaf: _Leaf, values: Sequence[Any]) -> list[int]:
        nodes = _completed(self._nodes(where, leaf, values))
        self._note(where, leaf, nodes)
        return nodes

    def _note(self, where: str, leaf: _Leaf, nodes: Sequence[int]) -> None:
        self.equations.sections.append(Section(where, _equation(leaf.node), tuple(nodes)))

    def _nodes(self, where: str, leaf: _Leaf, values: Sequence[Any]) -> Steps[list[int]]:
        nodes = []
        for value in values:
            self._size = 0
            nodes.append((yield self._node(where, leaf, value)))
        return nodes

    def _node(self, where: str, leaf: _Leaf, tree: Any) -> Steps[int]:
        graph = self.equations.graph
        if isinstance(tree, float | int):
            return graph.constant(tree)
        self._size += 1
        if self._size > LARGEST_TREE:
            raise CompilationError(
                f"{where}: its expression has more than {LARGEST_TREE} nodes; give shared "
                f"intermediate results a port of their own"
            )
        kind = tree.get_kind()
        if kind == ExpressionKind.Var:
            (variable,) = tree.GetVariables()
            return (yield self._meaning(where, leaf, variable))
        if kind == ExpressionKind.Constant:
            return graph.constant(tree.Evaluate())
        _, arguments = tree.Unapply()
        if kind == ExpressionKind.IfThenElse:
            condition = yield self._condition(where, leaf, arguments[0])
            positive = yield self._node(where, leaf, arguments[1])
            otherwise = yield self._node(where, leaf, arguments[2])
            return graph.where(condition, positive, otherwise)
        nodes = []
        for argument in arguments:
            nodes.append((yield self._node(where, leaf, argument)))
        if kind == ExpressionKind.Add:
            return graph.add(*nodes)
        if kind == ExpressionKind.Mul:
            return graph.multiply(*nodes)
        if kind == ExpressionKind.Div:
            return graph.divide(*nodes)
        if kind == ExpressionKind.Pow:
            return graph.power(*nodes)
        if kind in _UNARY:
            return graph.unary(_UNARY[kind], nodes[0])
        if kind in _BINARY:
            return graph.binary(_BINARY[kind], *nodes)
        raise CompilationError(f"{where}: {kind} does not compile")

    def _condition(self, where: str, leaf: _Leaf, formula: Any) -> Steps[int]:
        graph = self.equations.graph
        kind = formula.get_kind()
        if kind in (FormulaKind.True_, FormulaKind.False_):
            holds = 1.0 if kind == FormulaKind.True_ else 0.0
            return graph.compare("gt", graph.constant(holds), graph.zero)
        if kind not in _COMPARISONS and kind not in _LOGIC:
            raise CompilationError(f"{where}: the condition {kind} does not compile")
        _, arguments = formula.Unapply()
        read = self._node if kind in _COMPARISONS else self._condition
        nodes = []
        for argument in arguments:
            nodes.append((yield read(where, leaf, argument)))
        if kind in _COMPARISONS:
            return graph.compare(_COMPARISONS[kind], *nodes)
        return graph.logic(_LOGIC[kind], *nodes)

    def _meaning(self, where: str, leaf: _Leaf, variable: Any) -> Steps[int]:
        meaning = leaf.meaning.get(variable.get_id())
        if meaning is None:
            raise CompilationError(f"{where}: contains a variable of its own, {variable}")
        if isinstance(meaning, int):
            return meaning
        node, port, element = meaning
        size = self._size
        values = yield self._output(node, port)
        self._size = size
        return values[element]


def _label(system: Any, number: int) -> str:
    """A system's name; the address in that of a nameless one becomes its number in the diagram."""
    return re.sub("@[0-9a-f]{16}$", f"_{number}", str(system.get_name()))


def _equation(leaf: Node) -> str:
    """Class of a leaf, and the first line of its documentation unless Drake wrote it."""
    binding = ("pydrake", "pybind11", "builtins")
    kinds = (k for k in type(leaf.system).__mro__ if not k.__module__.startswith(binding))
    texts = ((vars(kind).get("__doc__") or "").strip() for kind in kinds)
    first = next((text.splitlines()[0].strip() for text in texts if text), "")
    return f"{leaf.type_name}: {first}" if first else f"{leaf.type_name}."


def _has_state_or_margin(system: Any) -> bool:
    return bool(
        system.num_continuous_states()
        or system.num_discrete_state_groups()
        or system.num_abstract_states()
        or callable(getattr(system, "margin", None))
    )


def _discrete(values: Any) -> list[Any]:
    return [
        element
        for group in range(values.num_groups())
        for element in values.get_vector(group).CopyToVector().tolist()
    ]


def _symbolic(where: str, evaluate: Callable[[], Any]) -> Any:
    """What ``evaluate()`` returns; `CompilationError` when it has no symbolic value."""
    try:
        return evaluate()
    except (Exception, SystemExit) as error:  # a leaf of the user may raise any error
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise CompilationError(f"{where}: has no symbolic form ({reason})") from error


# ------------------------------------------------------------------------------- events


def _refuse_witness_functions(leaf: Node, context: Any) -> None:
    """Raise `CompilationError` for a leaf that has witness functions in its default context."""
    witnesses = leaf.system.GetWitnessFunctions(context)
    if not witnesses:
        return
    # The leaf holds its witness functions, yet pydrake deletes them with their Python objects. An
    # extra reference to these, and to the leaf, keeps both until the process ends.
    for immortal in (leaf.system, *witnesses):
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(immortal))
    raise CompilationError(
        f"{leaf.name}: {leaf.type_name} has a witness function; only sampled events compile"
    )


_DECLARATIONS = (
    "DeclarePerStepEvent",
    "DeclarePerStepDiscreteUpdateEvent",
    "DeclarePerStepUnrestrictedUpdateEvent",
    "DeclarePeriodicEvent",
    "DeclarePeriodicUnrestrictedUpdateEvent",
)
_declarations_lock = RLock()


@contextmanager
def _recorded_declarations() -> Iterator[list[tuple[Any, str, Sequence[Any]]]]:
    """Symbolic leaf, method and arguments of each event that Python code declares meanwhile.

    Drake lists the events of a leaf in C++ only. So the events of a leaf written in Python are
    recorded as its symbolic form declares them. The events of a leaf written in C++ stay unknown,
    but for witness functions and periodic discrete updates.
    """
    declarations: list[tuple[Any, str, Sequence[Any]]] = []
    leaf_type = LeafSystem_[Expression]

    def recorded(method: str, declare: Any) -> Any:
        def record(leaf: Any, *args: Any, **kwargs: Any) -> Any:
            declarations.append((leaf, method, (*args, *kwargs.values())))
            return declare(leaf, *args, **kwargs)

        return record

    with _declarations_lock:
        originals = {method: getattr(leaf_type, method) for method in _DECLARATIONS}
        try:
            for method, declare in originals.items():
                setattr(leaf_type, method, recorded(method, declare))
            yield declarations
        finally:
            for method, declare in originals.items():
                setattr(leaf_type, method, declare)


def _unfit_update(method: str, arguments: Sequence[Any]) -> str | None:
    """What a declaration adds if neither a publish event nor a periodic discrete update.

    In Python a DiscreteUpdateEvent has no constructor, so only methods declare discrete updates.
    """
    trigger = "per-step" if "PerStep" in method else "periodic"
    event_type = UnrestrictedUpdateEvent_[Expression]
    if "Unrestricted" in method or any(isinstance(a, event_type) for a in arguments):
        return f"a {trigger} unrestricted update"
    return "a per-step discrete update" if "PerStepDiscrete" in method else None


def to_symbolic(leaf: Node) -> Any:
    """The symbolic form of a leaf; `CompilationError` when it has none, or unfit events."""
    with _recorded_declarations() as declarations:
        symbolic = _symbolic(leaf.name, leaf.system.ToSymbolicMaybe)
    if symbolic is None:
        raise CompilationError(
            f"{leaf.name}: {leaf.type_name} does not convert to symbolic Expression (see Drake's "
            f"TemplateSystem)"
        )
    for system, method, arguments in declarations:
        if system is symbolic and (update := _unfit_update(method, arguments)):
            raise CompilationError(
                f"{leaf.name}: {leaf.type_name} has {update}; of updates only periodic discrete "
                f"ones compile"
            )
    return symbolic


def read_equations(diagram: Any, inputs: Sequence[str] = ()) -> Equations:
    """All equations of a diagram of floats, by the symbolic form of its leaf systems.

    Leaves that neither a state nor an output of the diagram depends on are left out.

    Parameters
    ----------
    diagram
        A Diagram, or a single leaf system.
    inputs
        Its input ports that stay inputs; the others count as unconnected.

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
