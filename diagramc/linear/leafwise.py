"""Derivatives of diagrams without symbolic equations, one leaf system at a time.

A linear model needs values and derivatives at one point only. Each leaf system is called in a
Context of its own, first with floats, then with Drake's AutoDiffXd, whose values must be those of
the floats. A leaf without an AutoDiffXd form has central differences instead, so that one leaf of
floats does not spoil the derivatives of the others. The chain rule joins the leaves at their ports.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import PortDataType

from ..arguments import quoted
from ..diagram_equations import DiagramEquations
from ..equations.comparison import Evaluate, rates_of, update_of
from ..equations.equations import Equations, Update
from ..equations.events import reason_of, refuse_witness_functions
from ..equations.names import numbered_names, state_names
from ..equations.periods import timing_of
from ..equations.ports import route_of, size_of
from ..equations.symbolic import Steps, completed
from ..equations.tree import Node, Port
from ..errors import CompilationError, DifferenceError
from ..run_data import Array
from .point import Obstacle, Point, Slopes

_EQUAL = 1e-9  # relative difference of values of floats and of AutoDiffXd that counts as none
_STEP = 1e-3
# The error of central differences with one extrapolation is about _STEP⁴ by truncation and
# 1e-16/_STEP by rounding, so that both are about 1e-12.
_JUMP = 1e-2  # relative difference of two differences that no smooth function has
_FLAT_STEPS = (1e-6, 1e-5, 1e-3, 1e-2, 0.1, 1.0)
"""Relative changes at which a value with the derivative zero is asked whether it changes."""


class LeafwiseEquations(DiagramEquations):
    """A diagram without symbolic equations, of which a linear model can be made nevertheless.

    `equations` has only names, sizes and sample periods. The nodes in it are placeholders. For the
    arguments of the constructor see `read_tree`.
    """

    def __init__(self, root: Node, inputs: Mapping[str, Port], outputs: Mapping[str, Port]) -> None:
        exported = map(root.system.get_output_port, range(root.system.num_output_ports()))
        self.routes = {
            port.get_name(): list(root.output_route(int(port.get_index())))
            for port in exported
            if port.get_data_type() == PortDataType.kVectorValued
        } | {name: list(route_of(port)) for name, port in outputs.items()}
        """Ports from each output of the model back to the source of its signal."""
        ends = [route[-1] for route in self.routes.values()]
        root.observed = [node for node, kind, _ in ends if kind == "output"]
        equations = Equations()
        self.open_inputs: dict[Port, int] = {}
        """Index of the first element of each open input among the elements of all open inputs."""
        for name, port in inputs.items():
            self.open_inputs[port] = sum(equations.inputs.values())
            equations.inputs[name] = size_of(port)
        self.leaves: dict[Node, _Leaf] = {}
        updates: dict[tuple[float, float], list[int]] = {}
        for node in root.equation_leaves:
            context = node.system.CreateDefaultContext()
            refuse_witness_functions(node, context)
            states, discrete = len(equations.states), len(equations.discrete)
            if context.num_continuous_states():
                equations.states += state_names(node, context)
            for group in range(context.num_discrete_state_groups()):
                size = context.get_discrete_state(group).size()
                equations.discrete += numbered_names(node.path, group, size)
            leaf = self.leaves[node] = _Leaf(
                node,
                range(states, len(equations.states)),
                range(discrete, len(equations.discrete)),
            )
            if leaf.discrete:
                _refuse_abstract_state(node)
                timing = timing_of(node)
                key = timing.period_sec(), timing.offset_sec()
                updates.setdefault(key, []).extend(leaf.discrete)
        equations.updates = [
            Update(*key, tuple((index, 0) for index in indices)) for key, indices in updates.items()
        ]
        equations.outputs = {name: [0] * size_of(route[0]) for name, route in self.routes.items()}
        super().__init__(root.system, equations, root)


class _Leaf(NamedTuple):
    """A leaf system with the indices of its states among all states of each kind."""

    node: Node
    continuous: range
    discrete: range


class _Signal(NamedTuple):
    """Values (size,) and their derivatives (size, n + m) by n states and m inputs."""

    values: Array
    derivatives: Array


@dataclass(frozen=True)
class LeafwisePoint(Point):
    """A point of a diagram of `LeafwiseEquations`."""

    read: LeafwiseEquations
    context: Any
    """Context of the diagram, with parameters and abstract values."""
    setting: str
    """Name of the open inputs in the caller's arguments, for messages."""
    gaps: dict[tuple[str, str], Obstacle] = field(default_factory=dict, init=False)
    """What `slopes` has found out, by path and port."""
    _known: dict[tuple[str, ...], Slopes] = field(default_factory=dict, init=False)

    def slopes(self, outputs: Sequence[str] = ()) -> Slopes:
        """Return values and derivatives of the diagram at the point; see `Point.slopes`."""
        key = tuple(outputs)
        if key not in self._known:
            self._known[key] = self._slopes(key)
        return self._known[key]

    def _slopes(self, outputs: tuple[str, ...]) -> Slopes:
        evaluation = _Evaluation(self)
        rates, updates = [], []
        for leaf in self.read.leaves.values():
            if leaf.continuous:
                steps = evaluation.result(leaf.node, "time derivatives", rates_of)
                rates.append(completed(steps))
            if leaf.discrete:
                steps = evaluation.result(leaf.node, "discrete update", update_of)
                updates.append(completed(steps))
        signals = [completed(evaluation.signal(self.read.routes[name])) for name in outputs]
        return Slopes(*_joined([*rates, *updates], self.width), *_joined(signals, self.width))

    def time_varying(self, outputs: Sequence[str] = ()) -> list[str]:
        """Return the names of rates, updates and outputs whose derivatives change with the time.

        The derivatives at this point are compared with the derivatives at two later times.
        """
        here = self.slopes(outputs)
        names = (*self.rate_names, *self.element_names(outputs))
        jacobian = np.vstack([here.rates_jacobian, here.outputs_jacobian])
        varies = np.zeros(len(names), dtype=bool)
        for later_s in (0.1, 1.0 / 3.0):
            other = self._at_time(self.time_s + later_s).slopes(outputs)
            change = np.vstack([other.rates_jacobian, other.outputs_jacobian]) - jacobian
            largest = np.abs(jacobian).max(axis=1, initial=0.0)
            varies |= np.abs(change).max(axis=1, initial=0.0) > _EQUAL * (1.0 + largest)
        return [name for name, does in zip(names, varies, strict=True) if does]

    @property
    def width(self) -> int:
        """Number of states and inputs."""
        return self.state.size + self.inputs.size

    def is_known(self, route: Sequence[Port]) -> bool:
        """Return whether the signal of a route has a source."""
        return route[-1][1] == "output" or route[-1] in self.read.open_inputs

    def no_value(self, source: Port) -> CompilationError:
        """Return the error for an input port without a value."""
        node, _, index = source
        name = quoted(node.system.get_input_port(index).get_name())
        if node.parent is not None:
            return CompilationError(
                f"{node.name}: input port {name} is not connected; connect it, or name the "
                f"diagram's port in inputs"
            )
        return CompilationError(
            f"input port {name} has no value: FixValue it in the Context, or name it in "
            f"{self.setting}"
        )

    def _at_time(self, time_s: float) -> LeafwisePoint:
        context = self.context.Clone()
        context.SetTime(time_s)
        return replace(self, time_s=time_s, context=context)


class _Evaluation:
    """Computes the signals of a diagram at a point. Each leaf system is called only if required."""

    def __init__(self, point: LeafwisePoint) -> None:
        self.point = point
        self._calls: dict[Node, _Call] = {}
        self._signals: dict[Port, _Signal | None] = {}
        """Signal of each output port, or None while it is computed."""

    def signal(self, route: Sequence[Port]) -> Steps[_Signal]:
        """Return the signal at the first port of a route.

        The signal is that of the source at the end of the route, plus the open inputs at the ports
        of the route.
        """
        point, open_inputs = self.point, self.point.read.open_inputs
        size, source = size_of(route[0]), route[-1]
        values, derivatives = np.zeros(size), np.zeros((size, point.width))
        if source[1] == "output":
            of_source = yield self._output(source)
            values, derivatives = (part.copy() for part in of_source)
        elif source not in open_inputs:
            raise point.no_value(source)
        for port in route:
            if port in open_inputs:
                first = open_inputs[port]
                values += point.inputs[first : first + size]
                column = point.state.size + first
                derivatives[:, column : column + size] += np.eye(size)
        return _Signal(values, derivatives)

    def _output(self, port: Port) -> Steps[_Signal]:
        node, _, index = port
        where = f"output port {node.system.get_output_port(index).get_name()}"
        if port not in self._signals:
            self._signals[port] = None
            self._signals[port] = yield self.result(node, where, _output(index), index)
        found = self._signals[port]
        if found is None:
            raise CompilationError(f"{node.name}: {where}: depends on itself (algebraic loop)")
        return found

    def result(
        self, node: Node, purpose: str, evaluate: Evaluate, output: int | None = None
    ) -> Steps[_Signal]:
        """Return values and derivatives of ``evaluate``, a function of a leaf and its Context.

        ``output`` is the index of the output port that the function computes. Only the inputs on
        which this port depends are computed. None: the function may depend on all inputs.
        """
        if node not in self._calls:
            self._calls[node] = _Call(self.point, self.point.read.leaves[node])
        call = self._calls[node]
        for index, route in _routes(node, purpose, output):
            if index not in call.inputs and self.point.is_known(route):
                call.inputs[index] = yield self.signal(route)
        return call.result(purpose, evaluate)


class _Call:
    """Calls of one leaf at a point: Contexts of floats and of AutoDiffXd, with states and inputs.

    The variables of the leaf are its states, and then all elements of its vector inputs.
    """

    def __init__(self, point: LeafwisePoint, leaf: _Leaf) -> None:
        node, system = leaf.node, leaf.node.system
        self.point, self.node, self.system = point, node, system
        _refuse_abstract_state(node)
        count = len(point.read.state_names)
        rows = [*leaf.continuous, *(count + index for index in leaf.discrete)]
        self._states, self._continuous = point.state[rows], len(leaf.continuous)
        self._of_states = np.eye(point.state.size, point.width)[rows]
        ports = [system.get_input_port(index) for index in range(system.num_input_ports())]
        self._first: dict[int, int] = {}
        """Index of the first variable of each vector input."""
        self.size = self._states.size
        for index, port in enumerate(ports):
            if port.get_data_type() == PortDataType.kVectorValued:
                self._first[index] = self.size
                self.size += port.size()
        self.inputs: dict[int, _Signal] = {}
        """Signal of each vector input that has a source, as far as it is needed."""
        self._floats = system.CreateDefaultContext()
        self._floats.SetTimeStateAndParametersFrom(node.context(point.context))
        self._auto: tuple[Any, Any] | None = None
        try:
            converted = system.ToAutoDiffXdMaybe()
        except Exception as error:  # a user's conversion may raise any error
            self._why = f"does not convert to AutoDiffXd ({reason_of(error)})"
            return
        self._why = "does not convert to AutoDiffXd"
        if converted is not None:
            context = converted.CreateDefaultContext()
            context.SetTimeStateAndParametersFrom(self._floats)
            self._auto = converted, context

    def result(self, purpose: str, evaluate: Evaluate) -> _Signal:
        """Return the values of ``evaluate``, a function of the leaf and its Context.

        The result also has their derivatives by the states and inputs of the whole diagram.
        ``purpose`` names the values in messages.
        """
        where = f"{self.node.name}: {purpose}"
        variables = self._variables()
        try:
            values = self._called(evaluate, variables)
        except (Exception, SystemExit) as error:
            self._require_inputs(str(error))
            raise CompilationError(f"{where}: fails at this point ({reason_of(error)})") from error
        local = self._gradients(where, evaluate, variables, values)
        if local is None:
            local = self._differences(where, evaluate, variables, values)
            self._note(
                self.node.type_name,
                f"{self._why}: its derivatives are central differences",
                _TEMPLATE,
            )
        self._note_flat(purpose, evaluate, variables, values, local)
        if isinstance(self.system, MultibodyPlant) and (
            self.system.num_positions() != self.system.num_velocities()
        ):
            self._note(
                "state",
                "has a quaternion: the model has one more eigenvalue for its length",
                "leave out the eigenvalue 0 of a continuous or 1 of a sampled model",
            )
        derivatives = local[:, : self._states.size] @ self._of_states
        for index, signal in self.inputs.items():
            first = self._first[index]
            derivatives += local[:, first : first + signal.values.size] @ signal.derivatives
        return _Signal(values, derivatives)

    def _variables(self) -> Array:
        values = np.zeros(self.size)
        values[: self._states.size] = self._states
        for index, signal in self.inputs.items():
            first = self._first[index]
            values[first : first + signal.values.size] = signal.values
        return values

    def _called(self, evaluate: Evaluate, variables: Any, auto: bool = False) -> Any:
        """Return the values of ``evaluate`` at these ``variables`` of the leaf.

        ``auto``: the variables and the values are AutoDiffXd.
        """
        system, context = (self.system, self._floats) if not auto else self._auto  # type: ignore[misc]
        end = self._continuous
        if end:
            context.SetContinuousState(variables[:end])
        for group in range(context.num_discrete_state_groups()):
            vector = context.get_mutable_discrete_state(group)
            vector.SetFromVector(variables[end : end + vector.size()])
            end += vector.size()
        for index, signal in self.inputs.items():
            first = self._first[index]
            port = system.get_input_port(index)
            port.FixValue(context, variables[first : first + signal.values.size])
        values = evaluate(system, context)
        return values if auto else np.array(values, dtype=float).reshape(-1)

    def _gradients(
        self, where: str, evaluate: Evaluate, variables: Array, values: Array
    ) -> Array | None:
        """Return the derivatives by AutoDiffXd; None if the leaf has none at this point.

        Raises `DifferenceError` if the values are not those of floats.
        """
        if self._auto is None:
            return None
        seeds = np.eye(variables.size)
        seeded = np.array([AutoDiffXd(v, s) for v, s in zip(variables, seeds, strict=True)])
        try:
            results = list(np.ravel(self._called(evaluate, seeded, auto=True)))
        except (Exception, SystemExit) as error:
            self._why = f"fails with AutoDiffXd ({reason_of(error)})"
            return None
        found = np.array([result.value() for result in results])
        if not np.allclose(found, values, _EQUAL, _EQUAL, equal_nan=True):
            element = int(np.argmax(~np.isclose(found, values, _EQUAL, _EQUAL, equal_nan=True)))
            raise DifferenceError(
                f"{where}: AutoDiffXd gives {found[element]:.9g} where floats give "
                f"{values[element]:.9g}; the conversion of {self.node.type_name} must keep "
                f"attributes and parameters"
            )
        rows = [result.derivatives() for result in results]
        rows = [row if row.size else np.zeros(variables.size) for row in rows]
        return np.array(rows).reshape(values.size, variables.size)

    def _differences(
        self, where: str, evaluate: Evaluate, variables: Array, values: Array
    ) -> Array:
        """Return the derivatives by central differences, extrapolated once (Richardson)."""
        columns = []
        for index, value in enumerate(variables):
            step = _STEP * max(1.0, abs(value))
            up, down, near_up, near_down = (
                self._moved(evaluate, variables, index, change)
                for change in (step, -step, step / 2.0, -step / 2.0)
            )
            wide, narrow = (up - down) / (2.0 * step), (near_up - near_down) / step
            far_bend, near_bend = up + down - 2.0 * values, near_up + near_down - 2.0 * values
            # At a jump the two differ. At a corner they do not, but the bend is halved with the
            # step, where that of a smooth function is a quarter.
            jumps = np.abs(wide - narrow)
            corners = np.where(np.abs(near_bend) > 0.4 * np.abs(far_bend), near_bend / step, 0.0)
            change = np.maximum(jumps, np.abs(corners))
            if (change > _JUMP * np.maximum(np.abs(wide), np.abs(narrow)) + _EQUAL).any():
                purpose = where.removeprefix(f"{self.node.name}: ")
                self._note(purpose, "jumps or bends near this point", "choose another point")
            columns.append((4.0 * narrow - wide) / 3.0)
        return np.array(columns).T.reshape(values.size, variables.size)

    def _moved(self, evaluate: Evaluate, variables: Array, index: int, change: float) -> Array:
        moved = variables.copy()
        moved[index] += change
        try:
            return np.asarray(self._called(evaluate, moved))
        except (Exception, SystemExit) as error:
            raise CompilationError(
                f"{self.node.name}: cannot be called beside this point, for differences "
                f"({reason_of(error)})"
            ) from error

    def _note_flat(
        self, purpose: str, evaluate: Evaluate, variables: Array, values: Array, local: Array
    ) -> None:
        """Note a value that changes although its derivatives are zero, as that of a quantizer.

        A smooth value with the derivative zero, such as a cosine at 0, changes with the square of a
        small step. A quantizer does not change at all, or jumps.
        """
        flat = ~local.any(axis=1)
        if not flat.any():
            return
        changes = np.zeros((len(_FLAT_STEPS), values.size))
        for number, step in enumerate(_FLAT_STEPS):
            for index, value in enumerate(variables):
                for change in (step * max(1.0, abs(value)), -step * max(1.0, abs(value))):
                    with suppress(Exception):  # such as for a quaternion of length 0
                        moved = self._moved(evaluate, variables, index, change)
                        changes[number] = np.fmax(changes[number], np.abs(moved - values))
        least, next_, *_ = changes
        rests = (least == 0.0) & (changes > 0.0).any(axis=0)
        jumps = (least > 0.0) & (next_ < 5.0 * least)
        if (flat & (rests | jumps)).any():
            self._note(
                purpose,
                "changes without a derivative, as a quantizer or at a limit",
                "choose another operating point",
            )

    def _note(self, port: str, reason: str, remedy: str) -> None:
        key = self.node.name, port
        self.point.gaps.setdefault(key, Obstacle(*key, reason, remedy))

    def _require_inputs(self, text: str) -> None:
        """Raise `CompilationError` if an input without a value can be why a call failed.

        ``text`` is the message of the failure.
        """
        for index in range(self.system.num_input_ports()):
            route = list(self.node.route(index))
            if f"InputPort[{index}]" in text and not self.point.is_known(route):
                raise self.point.no_value(route[-1])


_TEMPLATE = "their error is about 1e-11; write the leaf with Drake's TemplateSystem for exact ones"


def _refuse_abstract_state(node: Node) -> None:
    """Raise `CompilationError` if a leaf has an abstract state."""
    if node.system.num_abstract_states():
        is_plant = isinstance(node.system, MultibodyPlant)
        remedy = "; call SetUseSampledOutputPorts(False) before its Finalize()"
        raise CompilationError(
            f"{node.name or node.type_name}: has an abstract state, which has no derivative"
            f"{remedy if is_plant else ''}"
        )


def _output(index: int) -> Evaluate:
    return lambda system, context: system.get_output_port(index).Eval(context)


def _routes(
    node: Node, purpose: str, output: int | None = None
) -> Iterator[tuple[int, list[Port]]]:
    """Yield index and route of each vector input that an output port, or anything, depends on.

    Raises `CompilationError` if the output port, or a signal that it can depend on, is no vector.
    """
    system, where = node.system, f"{node.name}: {purpose}"
    if output is not None:
        _require_vector(system.get_output_port(output), where)
    for index in range(system.num_input_ports()):
        port, route = system.get_input_port(index), list(node.route(index))
        if output is not None and not system.HasDirectFeedthrough(index, output):
            continue
        if port.get_data_type() == PortDataType.kVectorValued:
            yield index, route
        elif route[-1][1] == "output" and not _is_without_contact(system, port):
            _require_vector(port, f"{where}: its input {port.get_name()}")


def _require_vector(port: Any, where: str) -> None:
    if port.get_data_type() != PortDataType.kVectorValued:
        raise CompilationError(f"{where}: is no vector and has no derivative")


def _is_without_contact(system: Any, port: Any) -> bool:
    """Return whether a port is the geometry query of a plant that has nothing to collide."""
    return (
        isinstance(system, MultibodyPlant)
        and port.get_name() == system.get_geometry_query_input_port().get_name()
        and not system.num_collision_geometries()
    )


def _joined(signals: Sequence[_Signal], width: int) -> tuple[Array, Array]:
    values = np.concatenate([np.empty(0), *(signal.values for signal in signals)])
    return values, np.vstack([np.empty((0, width)), *(signal.derivatives for signal in signals)])
