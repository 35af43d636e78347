"""Finds periodic orbits of diagrams, and their linear models over one period."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arguments import names, positive
from ..diagram_equations import equations_key
from ..equations.contexts import set_state
from ..equations.equations import Equations, Update
from ..equations.gradients import gradients
from ..equations.graph import Graph
from ..errors import LinearizationError, ParameterError, SimulationError
from ..model import CompiledModel
from ..native.machine_code import MachineCode
from ..native.runner import STEP_S
from ..run_data import Array, InputTable, State
from .linearize import events
from .model import Complex, LinearModel, OperatingPoint
from .newton import newton
from .point import Point, read_point

_TOLERANCE = 1e-8
_TRANSIENT = 30  # periods of a run from the start, after Newton's method fails there


@dataclass(frozen=True, repr=False)
class PeriodicOrbit:
    """A periodic orbit of a diagram, made by `periodic_orbit`.

    ``context`` is the Context at the begin of the period, at t = 0, before the updates at that
    time. ``model`` is the linear model over the period, for deviations from the orbit.
    """

    context: Any
    model: LinearModel
    autonomous: bool
    """Whether neither the time nor sample periods fix the phase of the orbit."""

    @property
    def period_s(self) -> float:
        """The period in s."""
        return float(self.model.period_s or 0.0)

    @property
    def multipliers(self) -> Complex:
        """The Floquet multipliers, which are the eigenvalues of A, by falling magnitude.

        One multiplier of an autonomous orbit is 1, because the orbit can be shifted in time.
        """
        return self.model.eigenvalues

    @property
    def stable(self) -> bool:
        """Whether all multipliers lie inside the unit circle, except for 1 if autonomous."""
        values = self.multipliers
        if self.autonomous:
            values = np.delete(values, np.argmin(np.abs(values - 1.0)))
        return bool((np.abs(values) < 1.0).all())

    def __repr__(self) -> str:
        """Return a text with the period and the largest multiplier."""
        kind = "autonomous" if self.autonomous else "forced"
        return f"PeriodicOrbit({kind}, period_s={self.period_s:.6g}, stable={self.stable})"


def periodic_orbit(
    diagram: Any,
    context: Any = None,
    *,
    period_s: float | None = None,
    inputs: Iterable[str] = (),
    outputs: Iterable[str] = (),
    step_s: float = STEP_S,
) -> PeriodicOrbit:
    """Find a periodic orbit of a diagram of floats by shooting, and linearize the diagram along it.

    A run of compiled code gives the state after a period, and the derivatives of this state by the
    state before the period and by the inputs. RK4 integrates the variational equations together
    with the states. Newton's method makes the two states equal. It begins at the state in
    ``context``. If it fails, it begins again after a run of some periods, which tends to a stable
    orbit.

    If the equations depend on the time, or if the diagram has sample periods, the orbit has the
    period ``period_s``. Otherwise the orbit is autonomous and its period is unknown. The search for
    the period begins at ``period_s``. The state at the begin of an autonomous orbit lies on the
    plane through the start that is normal to the motion at the start.

    The effect of a small deviation on the time of a switch is not part of the model. So the rates
    of the diagram must not jump on the orbit. They can have corners, such as a saturation.

    Parameters
    ----------
    diagram, context, inputs, outputs
        As in `linearize`. The orbit begins at t = 0, whatever the time of the Context. Without
        ``outputs`` the model has none.
    period_s
        Period in s, a multiple of all sample periods and of the periods of all sources. By default
        the least common multiple of the sample periods.
    step_s
        Largest step of RK4 in s, above zero.

    Raises
    ------
    LinearizationError
        There is no periodic orbit near the start, or it is an equilibrium. The message names the
        state that changes most over the period.
    ParameterError
        As in `linearize`. Also if ``period_s`` is missing for a diagram without sample periods, or
        ``step_s`` is not finite and positive.
    """
    in_names, out_names = names("inputs", inputs), names("outputs", outputs)
    step_s = positive("step_s", step_s, "s")
    point = replace(read_point(diagram, context, in_names, out_names), time_s=0.0)
    if not point.state.size:
        raise LinearizationError("the diagram has no states: it has no periodic orbit")
    columns = len(point.element_names(in_names))
    search = _Search(point, columns, period_s, step_s)
    state, period = search.solution()
    _, matrix = search.after_period(state, period)
    n = state.size
    point = point.at(state)
    slopes = point.slopes(out_names)
    model = LinearModel(
        *(matrix[:, :n], matrix[:, n:]),
        *(slopes.outputs_jacobian[:, :n], slopes.outputs_jacobian[:, n : n + columns]),
        period_s=period,
        state_names=point.state_names,
        input_names=point.element_names(in_names),
        output_names=point.element_names(out_names),
        operating_point=OperatingPoint(0.0, state, point.inputs[:columns], slopes.outputs),
    )
    start = diagram.CreateDefaultContext() if context is None else context.Clone()
    start.SetTime(0.0)
    count = len(point.read.state_names)
    set_state(point.read.root, start, State(state[:count], state[count:]))
    return PeriodicOrbit(start, model, search.autonomous)


class _Search:
    """The search for the state and the period of an orbit."""

    def __init__(self, point: Point, inputs: int, period_s: float | None, step_s: float) -> None:
        """The first ``inputs`` elements of the open inputs are variables of the derivatives."""
        equations = point.read.equations
        nodes = [*equations.derivatives]
        nodes += [node for update in equations.updates for _, node in update.values]
        timed = any("time" in equations.graph.depends[node] for node in nodes)
        self.autonomous = not (timed or equations.updates)
        if period_s is None and not equations.updates:
            raise ParameterError("period_s: is missing; the diagram has no sample period")
        _, self._period = events(equations.updates, period_s)
        self._sampled = bool(equations.updates)
        self._point, self._step_s = point, step_s
        self._size = point.state.size, point.state.size + inputs
        extended = with_sensitivities(equations, inputs)
        self._model = CompiledModel(MachineCode(equations_key(extended), extended))
        values = point.inputs if point.inputs.size else np.zeros(1)
        self._table = InputTable(np.empty(0), values[None, :, None])

    def solution(self) -> tuple[Array, float]:
        """Return the state at the begin of the orbit, and the period."""
        state = self._point.state
        text = ""
        for periods in (0, 1 if self.autonomous else _TRANSIENT):
            for _ in range(periods):
                state, _ = self.after_period(state, self._period)
            begin = np.append(state, [self._period] if self.autonomous else [])
            unknowns, _ = newton(self._changes(state), begin, relative=True)
            orbit, period = unknowns[: state.size], self._period
            if self.autonomous:
                period = float(unknowns[-1])
            fault = self._fault(orbit, period)
            if not fault:
                return orbit, period
            text = text or fault
        raise LinearizationError(
            f"no periodic orbit near the start: {text}; start nearer, or check period_s"
        )

    def _changes(self, start: Array) -> Any:
        """Return the function whose zero is the orbit, with its Jacobian, for `newton`."""
        n = start.size
        normal = self._rates(start)

        def function(unknowns: Array) -> tuple[Array, Array]:
            state = unknowns[:n]
            period = float(unknowns[n]) if self.autonomous else self._period
            after, matrix = self.after_period(state, period)
            changes, jacobian = after - state, matrix[:, :n] - np.eye(n)
            if self.autonomous:
                changes = np.append(changes, normal @ (state - start))
                jacobian = np.block([[jacobian, self._rates(after)[:, None]], [normal[None], 0.0]])
            return changes, jacobian

        return function

    def _rates(self, state: Array) -> Array:
        return self._point.at(state).slopes().rates

    def _fault(self, state: Array, period: float) -> str:
        """Return why a state does not begin an orbit, or an empty text if it does."""
        if not 0.0 < period < np.inf:
            return f"the period of the search ends at {max(period, 0.0):g} s"
        after, _ = self.after_period(state, period)
        change = after - state
        wrong = ~(np.abs(change) <= _TOLERANCE * (1.0 + np.abs(state)))
        if wrong.any():
            if not np.isfinite(after).all():
                return f"the run over {period:g} s is not finite"
            index = int(np.argmax(np.where(wrong, np.abs(change), -1.0)))
            name = self._point.state_names[index]
            return f"in {period:g} s {name} changes by {change[index]:.6g}"
        if self.autonomous and np.abs(self._rates(state)).max(initial=0.0) < _TOLERANCE:
            return "the search ends at an equilibrium"
        return ""

    def after_period(self, state: Array, period: float) -> tuple[Array, Array]:
        """Return the state after a period (n,), and its derivatives (n, n + inputs).

        The variables of the derivatives are the state before the period and the first ``inputs``
        elements of the open inputs. All numbers are nan if the run fails, or if the period is not
        positive and finite.
        """
        n, columns = self._size
        count = len(self._point.read.state_names)
        failed = np.full(n, np.nan), np.full((n, columns), np.nan)
        if not 0.0 < period < np.inf:
            return failed
        unit = np.eye(n, columns)
        start = State(
            np.append(state[:count], unit[:count]), np.append(state[count:], unit[count:])
        )
        try:
            final = self._model.simulate(
                self._point.parameters,
                start,
                period,
                outputs=(),
                record_period_s=None if self._sampled else period,
                inputs=self._table,
                integrator="rk4",
                step_s=self._step_s,
            ).final
        except SimulationError:
            return failed
        after = np.append(final.continuous[:count], final.discrete[: n - count])
        rows = np.append(final.continuous[count:], final.discrete[n - count :])
        return after, rows.reshape(n, columns)


def with_sensitivities(equations: Equations, inputs: int) -> Equations:
    """Return equations whose further states are the derivatives of the states by their start.

    The state z has n elements, continuous and then discrete. The further states are the rows of the
    matrix S = ∂z/∂(z₀, u), for constant values u of the first ``inputs`` elements of the open
    inputs. With dz/dt = f(z, u) follows dS/dt = f_z S + (0, f_u), and likewise at an update. The
    rows of continuous states are continuous states.
    """
    matrix = _Sensitivities(
        equations.graph.copy(), len(equations.states), len(equations.discrete), inputs
    )
    updates = []
    for update in equations.updates:
        values = list(update.values)
        rows = matrix.changes([node for _, node in update.values])
        for (element, _), row in zip(update.values, rows, strict=True):
            values += enumerate(row, matrix.first("discrete", element))
        updates.append(Update(update.period_s, update.offset_s, tuple(values)))
    columns = range(matrix.columns)
    names = [
        [f"{name} by {column}" for name in states for column in columns]
        for states in (equations.states, equations.discrete)
    ]
    unchanged = [
        matrix.node("discrete", element, column)
        for element in range(matrix.discrete)
        for column in columns
    ]
    rates = [node for row in matrix.changes(equations.derivatives) for node in row]
    return replace(
        equations,
        graph=matrix.graph,
        states=equations.states + names[0],
        discrete=equations.discrete + names[1],
        derivatives=equations.derivatives + rates,
        initial_discrete=equations.initial_discrete + unchanged,
        updates=updates,
        outputs={},
        sections=[],
    )


@dataclass(frozen=True)
class _Sensitivities:
    """The matrix S of `with_sensitivities` as states of a graph."""

    graph: Graph
    states: int
    discrete: int
    inputs: int

    @property
    def columns(self) -> int:
        return self.states + self.discrete + self.inputs

    def first(self, kind: str, element: int) -> int:
        """Return the index of the state that is the first element of a row of S."""
        size = self.states if kind == "state" else self.discrete
        return size + element * self.columns

    def node(self, kind: str, element: int, column: int) -> int:
        """Return the node of an element of S."""
        return self.graph.source(kind, self.first(kind, element) + column)

    def changes(self, roots: list[int]) -> list[list[int]]:
        """Return for each root, a rate or an updated state, its derivatives by (z₀, u)."""
        graph, first_input = self.graph, self.states + self.discrete
        slopes = {kind: gradients(graph, roots, kind) for kind in ("state", "discrete", "input")}
        rows = []
        for number in range(len(roots)):
            row = []
            for column in range(self.columns):
                terms = [
                    graph.multiply(slope, self.node(kind, element, column))
                    for kind in ("state", "discrete")
                    for element, slope in slopes[kind][number].items()
                ]
                if column - first_input in slopes["input"][number]:
                    terms.append(slopes["input"][number][column - first_input])
                row.append(graph.add(*terms))
            rows.append(row)
        return rows
