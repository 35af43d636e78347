"""Derivatives of diagrams without symbolic equations, one leaf system at a time.

A linear model needs values and derivatives at one point only. Each leaf system is called in a
Context of its own, first with floats, then with Drake's AutoDiffXd, whose values must be those of
the floats. A leaf without an AutoDiffXd form has central differences instead, so that one leaf of
floats does not spoil the derivatives of the others. The signals between the leaves are AutoDiffXd
too, so the chain rule joins the leaves at their ports.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.multibody.plant import MultibodyPlant

from ..arguments import quoted
from ..diagram_equations import DiagramEquations
from ..equations.comparison import (
    CalledLeaf,
    Evaluate,
    Function,
    central_differences,
    output_of,
    rates_of,
    update_of,
    values_and_gradients,
)
from ..equations.equations import Equations
from ..equations.events import reason_of, refuse_witness_functions
from ..equations.names import discrete_names, parameter_groups, state_names
from ..equations.periods import timing_of
from ..equations.ports import is_vector, open_inputs, output_routes, size_of
from ..equations.symbolic import Steps, completed
from ..equations.tree import Node, Port
from ..errors import CompilationError, DifferenceError
from ..run_data import Array
from .point import Obstacle, Point, Slopes

_EQUAL = 1e-9  # relative difference of values of floats and of AutoDiffXd that counts as none
_STEPS = (1e-3, 1e-4, 1e-5, 1e-6)
"""Relative changes of a variable for central differences; the last one is for comparison.

The error of central differences with one extrapolation is about h⁴ by truncation and 1e-16/h by
rounding for a step h, so that the largest step is the best for a variable of order one. A smaller
step is better for a function that bends within less, such as the friction near v = 0.
"""
_ROUGH_STEPS = (1e-6, 1e-5, 1e-3, 1e-2, 0.1, 1.0)
"""Relative changes of variables at which a value is compared with its linear model."""


class LeafwiseEquations(DiagramEquations):
    """A diagram of which only the names, sizes and sample periods are known as equations.

    The nodes in `equations` are placeholders.
    """

    def __init__(self, root: Node, inputs: Mapping[str, Port], outputs: Mapping[str, Port]) -> None:
        self.routes = output_routes(root, outputs)
        """Ports from each output of the model back to the source of its signal."""
        equations = Equations()
        self.open_inputs = open_inputs(equations, inputs)
        """Index of the first element of each open input among the elements of all open inputs."""
        self.leaves: dict[Node, _Leaf] = {}
        for node in root.equation_leaves:
            context = node.system.CreateDefaultContext()
            refuse_witness_functions(node, context)
            states, discrete = len(equations.states), len(equations.discrete)
            equations.parameters += chain(*parameter_groups(node, context))
            equations.states += state_names(node, context)
            equations.discrete += discrete_names(node, context)
            leaf = self.leaves[node] = _Leaf(
                node,
                range(states, len(equations.states)),
                range(discrete, len(equations.discrete)),
            )
            if leaf.discrete:
                _refuse_abstract_state(node)
                equations.add_update(timing_of(node), [(index, 0) for index in leaf.discrete])
        equations.outputs = {name: [0] * size_of(route[0]) for name, route in self.routes.items()}
        super().__init__(root.system, equations, root)


@dataclass
class _Leaf:
    """A leaf system with the indices of its states among all states of each kind."""

    node: Node
    continuous: range
    discrete: range

    @cached_property
    def converted(self) -> Any:
        """The leaf of AutoDiffXd, or None."""
        return self.node.system.ToAutoDiffXdMaybe()


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
        rates, updates = [np.empty(0)], []
        for leaf in self.read.leaves.values():
            if size := len(leaf.continuous):
                rates.append(completed(evaluation.result(leaf, "time derivatives", rates_of, size)))
            if size := len(leaf.discrete):
                steps = evaluation.result(leaf, "discrete update", update_of, size)
                updates.append(completed(steps))
        signals = [completed(evaluation.signal(self.read.routes[name])) for name in outputs]
        parts = ([*rates, *updates], [np.empty(0), *signals])
        slopes = [values_and_gradients(np.concatenate(part), self.width) for part in parts]
        return Slopes(*slopes[0], *slopes[1])

    def time_varying(self, outputs: Sequence[str] = ()) -> list[str]:
        """Return the names of rates, updates and outputs whose derivatives change with the time.

        The derivatives at this point are compared with the derivatives at a later time.
        """
        context = self.context.Clone()
        context.SetTime(self.time_s + 1.0 / math.pi)  # no whole period of a sine of so many Hz
        later = replace(self, time_s=context.get_time(), context=context)
        here, there = (
            np.vstack([slopes.rates_jacobian, slopes.outputs_jacobian])
            for slopes in (self.slopes(outputs), later.slopes(outputs))
        )
        varying = np.flatnonzero(~np.isclose(here, there, _EQUAL, _EQUAL).all(axis=1))
        names = (*self.rate_names, *self.element_names(outputs))
        return [names[index] for index in varying.tolist()]

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
        where = node.path and f"{node.path}: "
        name = quoted(node.system.get_input_port(index).get_name())
        return CompilationError(
            f"{where}input port {name} has no value: FixValue it in the Context, or name it in "
            f"{self.setting}"
        )


class _Evaluation:
    """Computes the signals of a diagram at a point. Each leaf system is called only if required.

    The signals are arrays of AutoDiffXd, whose derivatives are by all states and open inputs.
    """

    def __init__(self, point: LeafwisePoint) -> None:
        self.point = point
        variables = zip([*point.state, *point.inputs], np.eye(point.width), strict=True)
        self._variables = np.array([AutoDiffXd(*pair) for pair in variables], dtype=object)
        """The states, and then the elements of all open inputs."""
        self._signals: dict[Port, Any] = {}
        """Signal of each output port, or None while it is computed."""

    def signal(self, route: Sequence[Port]) -> Steps[Any]:
        """Return the signal at the first port of a route.

        The signal is that of the source at the end of the route, plus the open inputs at the ports
        of the route.
        """
        open_inputs, source = self.point.read.open_inputs, route[-1]
        signal = np.zeros(size_of(route[0]))
        if source[1] == "output":
            signal = yield self._output(source)
        elif source not in open_inputs:
            raise self.point.no_value(source)
        for port in route:
            if port in open_inputs:
                first = self.point.state.size + open_inputs[port]
                signal = signal + self._variables[first : first + signal.size]
        return signal

    def _output(self, source: Port) -> Steps[Any]:
        node, _, index = source
        port = node.system.get_output_port(index)
        where = f"output port {port.get_name()}"
        if source not in self._signals:
            self._signals[source] = None
            leaf = self.point.read.leaves[node]
            _require_vector(port, f"{node.name}: {where}")
            self._signals[source] = yield self.result(
                leaf, where, output_of(index), port.size(), index
            )
        found = self._signals[source]
        if found is None:
            raise CompilationError(f"{node.name}: {where}: depends on itself (algebraic loop)")
        return found

    def result(
        self, leaf: _Leaf, purpose: str, evaluate: Evaluate, size: int, output: int | None = None
    ) -> Steps[Any]:
        """Return the values (size,) of a function of leaf and Context, as AutoDiffXd.

        They depend on the inputs of an output port, or on all if ``output`` is None.
        """
        _refuse_abstract_state(leaf.node)
        signals = {}
        for index, route in _routes(leaf.node, purpose, output):
            if self.point.is_known(route):
                signals[index] = yield self.signal(route)
        count = len(self.point.read.state_names)
        rows = [*leaf.continuous, *(count + index for index in leaf.discrete)]
        variables = np.concatenate([self._variables[rows], *signals.values()])
        call = _Call(self.point, leaf, purpose, [*signals], variables)
        return call.result(evaluate, size)


class _Call:
    """A call of one leaf at a point, of floats, and its derivatives.

    The variables of the leaf are its states, and then the elements of its inputs.
    """

    def __init__(
        self, point: LeafwisePoint, leaf: _Leaf, purpose: str, inputs: list[int], variables: Array
    ) -> None:
        self.point, self.leaf, self.node, self.purpose = point, leaf, leaf.node, purpose
        self.inputs, self.variables = inputs, variables
        self.numbers, self.gradients = values_and_gradients(variables, point.width)
        self.moving = np.diag(np.maximum(1.0, np.abs(self.numbers)))[self.gradients.any(axis=1)]
        """Changes of each variable that has a derivative, as large as the variable."""

    def _leaf(self, system: Any) -> CalledLeaf:
        return CalledLeaf(system, self.inputs, self.node.context(self.point.context))

    def result(self, evaluate: Evaluate, size: int) -> Any:
        """Return the values (size,) of a function of leaf and Context, as AutoDiffXd."""
        where, floats = f"{self.node.name}: {self.purpose}", self._leaf(self.node.system)
        function = floats.function(evaluate, size)
        values = np.array(function(self.numbers))
        self._require_called(floats, "at this point")
        gradients, why = self._gradients(where, evaluate, values)
        local = np.zeros((size, self.numbers.size))
        if gradients is None:
            local = self._differences(function, local)
            self._require_called(floats, "beside this point, for differences")
            self._note(
                self.node.type_name, f"{why}: its derivatives are central differences", _TEMPLATE
            )
            gradients = local @ self.gradients
            self._note_rough(function, values, local, np.full(size, True))
        else:
            self._note_rough(function, values, local, ~gradients.any(axis=1))
        plant = self.node.system
        if isinstance(plant, MultibodyPlant) and plant.num_positions() != plant.num_velocities():
            self._note(
                "state",
                "has a quaternion: the model has one more eigenvalue for its length",
                "leave out the eigenvalue 0 of a continuous or 1 of a sampled model",
            )
        return np.array([*map(AutoDiffXd, values, gradients)], dtype=object)

    def _gradients(self, where: str, evaluate: Evaluate, values: Array) -> tuple[Any, str]:
        """Return the derivatives by AutoDiffXd, or None and why the leaf has none at this point.

        Raises `DifferenceError` if the values are not those of floats.
        """
        try:
            if (converted := self.leaf.converted) is None:
                return None, "does not convert to AutoDiffXd"
            results = evaluate(converted, self._leaf(converted).context(self.variables))
        except (Exception, SystemExit) as error:  # a user's code may raise any; Drake exits
            return None, f"fails with AutoDiffXd ({reason_of(error)})"
        found, gradients = values_and_gradients(results, self.point.width)
        are_close = np.isclose(found, values, _EQUAL, _EQUAL, equal_nan=True)
        if not are_close.all():
            element = int(np.argmin(are_close))
            raise DifferenceError(
                f"{where}: AutoDiffXd gives {found[element]:.9g} where floats give "
                f"{values[element]:.9g}; the conversion of {self.node.type_name} must keep "
                f"attributes and parameters"
            )
        return gradients, ""

    def _differences(self, function: Function, local: Array) -> Array:
        """Return the derivatives by central differences, extrapolated once (Richardson).

        Each derivative takes the step whose result differs least from that of the next smaller step
        (Ridders). A result of zero beside others is a step of a table or of rounding, and no zero.
        """
        local = local.copy()
        for change in self.moving:
            columns = []
            for step in _STEPS:
                wide, half = central_differences(function, self.numbers, step * change)
                columns.append((4.0 * half - wide) / (3.0 * step * change.max()))
            found = np.array(columns)
            # The difference contains the truncation of the larger step and the rounding of both.
            differs = np.nan_to_num(np.abs(np.diff(found, axis=0)), nan=np.inf)
            differs[(found[1:] == 0.0) & (found != 0.0).any(axis=0)] = np.inf
            best = differs.argmin(axis=0)
            local[:, change.argmax()] = np.take_along_axis(found, best[None], axis=0)[0]
        return local

    def _note_rough(self, function: Function, values: Array, local: Array, rows: Array) -> None:
        """Note values in ``rows`` that have no derivative near the point, as those of a quantizer.

        The error of the linear model with the derivatives ``local`` grows with the square of the
        change for a smooth value, in proportion to the change at a corner, and not at all after a
        jump. A quantizer does not change at first, and jumps then.
        """
        if not rows.any() or not self.moving.size:
            return
        largest = []
        for step in _ROUGH_STEPS:
            changes = np.vstack([step * self.moving, -step * self.moving])
            moved = [function(self.numbers + change) - values for change in changes]
            # A leaf can fail beside the point, such as for a quaternion of length 0.
            errors = np.abs(moved - changes @ local.T)
            largest.append(np.fmax.reduce(errors))
        near, next_, *far = largest
        scale = 1.0 + np.abs(values) + np.abs(local) @ np.maximum(1.0, np.abs(self.numbers))
        jumps = (near > _EQUAL * scale) & (next_ < 50.0 * near)
        rests = (near == 0.0) & ~local.any(axis=1) & (np.array(far) > 0.0).any(axis=0)
        if (rows & (jumps | rests)).any():
            self._note(
                self.purpose,
                "has no derivative near this point, as a quantizer, at a limit or at a corner",
                "choose another operating point",
            )

    def _note(self, port: str, reason: str, remedy: str) -> None:
        key = self.node.name, port
        self.point.gaps.setdefault(key, Obstacle(*key, reason, remedy))

    def _require_called(self, floats: CalledLeaf, where: str) -> None:
        """Raise `CompilationError` if a call of the leaf has failed.

        The message names an input without a value if this can be why.
        """
        if (error := floats.error) is None:
            return
        for index in range(self.node.system.num_input_ports()):
            route = list(self.node.route(index))
            if f"InputPort[{index}]" in str(error) and not self.point.is_known(route):
                raise self.point.no_value(route[-1])
        reason = f"fails {where} ({reason_of(error)})"
        raise CompilationError(f"{self.node.name}: {self.purpose}: {reason}") from error


_TEMPLATE = (
    "their error is about 1e-11 if the leaf is smooth over 0.1 % of each variable; write the leaf "
    "with Drake's TemplateSystem for exact ones"
)


def _refuse_abstract_state(node: Node) -> None:
    """Raise `CompilationError` if a leaf has an abstract state."""
    if node.system.num_abstract_states():
        raise CompilationError(
            f"{node.name or node.type_name}: has an abstract state, which has no derivative; for a "
            f"MultibodyPlant call SetUseSampledOutputPorts(False) before its Finalize()"
        )


def _routes(node: Node, purpose: str, output: int | None) -> Iterator[tuple[int, list[Port]]]:
    """Yield index and route of each vector input that an output port, or anything, depends on.

    Raises `CompilationError` if a signal that it can depend on is no vector.
    """
    system, where = node.system, f"{node.name}: {purpose}"
    for index in range(system.num_input_ports()):
        port, route = system.get_input_port(index), list(node.route(index))
        if output is not None and not system.HasDirectFeedthrough(index, output):
            continue
        if is_vector(port):
            yield index, route
        elif route[-1][1] == "output" and not (
            # Nothing can collide.
            isinstance(system, MultibodyPlant)
            and port.get_name() == system.get_geometry_query_input_port().get_name()
            and not system.num_collision_geometries()
        ):
            _require_vector(port, f"{where}: its input {port.get_name()}")


def _require_vector(port: Any, where: str) -> None:
    if not is_vector(port):
        raise CompilationError(f"{where}: is no vector and has no derivative")
