"""Tests a leaf system, as an assertion for pytest: see `check_leaf`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, Variable
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import PortDataType, System

from .arguments import names, quoted
from .equations.comparison import (
    CalledLeaf,
    Evaluate,
    called_twice,
    differ,
    margin_of,
    points_around,
    rates_of,
    update_of,
)
from .equations.contexts import parameters_of, state_of
from .equations.events import symbolic_value
from .equations.names import parameter_groups, state_names
from .equations.tree import Node
from .errors import CompilationError, ParameterError, shortened
from .run_data import Array

_CONVERSIONS = {"AutoDiffXd": "ToAutoDiffXdMaybe", "Expression": "ToSymbolicMaybe"}
_STEPS = (1e-3, 1e-4, 1e-5, 1e-6)
"""Steps of the differences, as shares of the spread of the points.

A jump or kink near a point spoils a long step; rounding spoils a short one. So a derivative is
wrong only if it differs from the differences at each step.
"""
_STEP_S = 1e-3  # of the run of a leaf that tells no sample time: short for most systems
_NO_RANGES: Mapping[str, Any] = MappingProxyType({})


def check_leaf(
    system: Any,
    ranges: Mapping[str, Any] = _NO_RANGES,
    *,
    units: Mapping[str, str] = _NO_RANGES,
    scalars: str | Iterable[str] | None = None,
) -> tuple[str, ...]:
    """Assert that a Drake leaf system keeps the rules that simulation and linearization rely on.

    Use it in a test of your leaf system, beside the tests of its numbers::

        def test_my_cylinder():
            check_leaf(MyCylinder(), {"load_flow": (-1e-5, 1e-5), "mass_kg": (1.0, 3.0)})

    At nine points in the ranges, and on the way between some of them, it checks that

    - each port has a name;
    - a conversion to AutoDiffXd or Expression keeps ports, sizes, sample time, default values and
      attributes, and gives the outputs, time derivatives, discrete update and ``margin`` of the
      leaf of floats;
    - the derivatives of AutoDiffXd are those of central differences, with one step of Richardson's
      extrapolation;
    - an output that Drake has stored is computed anew after a change of whatever it depends on. So
      ``prerequisites_of_calc`` lacks nothing;
    - a second call gives the same values, and no call changes the Context. So the leaf keeps no
      state outside the Context, reads no clock and draws no random number;
    - runs from two clones of one Context are equal, and the discrete state stays between samples.

    A point where the leaf of floats raises an error or is not finite does not count. Returns notes,
    one line each, which are no faults: a conversion that the leaf does not have, an input that an
    output is declared to feel and does not, what follows from an input of nan, an attribute that
    changes during calls. Abstract ports get their model values, and are not compared.

    Parameters
    ----------
    system
        The leaf system of floats.
    ranges
        Dictionary from a name to (low, high), or to a list of one pair for each element. A name is
        that of an input port or of a parameter, or ``time``, ``parameters``, ``continuous_state``
        or ``discrete_state``. The elements of a vector are ``name[0]``, ``name[1]`` and so on. By
        default states and inputs lie up to 10 around those of the default Context (inputs: around
        zero), and parameters within a tenth of their values.
    units
        Dictionary from such names to units, for the messages.
    scalars
        Scalar types that the leaf must have, of ``"AutoDiffXd"`` and ``"Expression"``; others are
        not checked. By default those to which the leaf converts are checked.

    Raises
    ------
    AssertionError
        The leaf breaks a rule. The message has one line for each finding.
    ParameterError
        The system is no leaf, or ``ranges``, ``units`` or ``scalars`` has an unknown name or a
        wrong range.
    """
    __tracebackhide__ = True  # pytest shows the test that calls
    if not isinstance(system, System) or hasattr(system, "connection_map"):
        raise ParameterError(
            f"system = {quoted(system)}: must be a leaf system of floats; check the leaves of a "
            f"diagram one by one"
        )
    wanted = tuple(_CONVERSIONS) if scalars is None else names("scalars", scalars)
    if unknown := [scalar for scalar in wanted if scalar not in _CONVERSIONS]:
        raise ParameterError(
            f"scalars: unknown {quoted(unknown[0])}; known: {', '.join(_CONVERSIONS)}"
        )
    check = _Check(system, ranges, units)
    check.names_of_ports()
    check.calls()
    check.stored_outputs()
    check.runs()
    for scalar in wanted:
        check.conversion(scalar, scalars is not None)
    check.nan_inputs()
    if check.findings:
        raise AssertionError("\n".join(check.findings))
    return tuple(check.notes)


class _Part(NamedTuple):
    """Something that a leaf computes."""

    name: str
    evaluate: Evaluate
    slice: slice  # of all values


def _ports(system: Any, kind: str) -> list[Any]:
    return [
        getattr(system, f"get_{kind}_port")(index)
        for index in range(getattr(system, f"num_{kind}_ports")())
    ]


def _is_vector(port: Any) -> bool:
    return bool(port.get_data_type() == PortDataType.kVectorValued)


def _output(index: int, system: Any, context: Any) -> Any:
    port = system.get_output_port(index)
    value = port.Eval(context)  # of an abstract port too, because of what the call may change
    return value.tolist() if _is_vector(port) else []


def _context(system: Any, context: Any) -> list[Any]:
    root = Node(system)
    state = state_of(root, context)
    return [
        *(context.get_time(), *parameters_of(root, context), *state.continuous, *state.discrete)
    ]


def _number(value: Any) -> Any:
    """Return the number of a scalar of Drake, and anything else unchanged."""
    if isinstance(value, AutoDiffXd):
        return value.value()
    return value.Evaluate() if isinstance(value, Expression) else value


def _evaluated(expression: Any, environment: Mapping[Any, float]) -> float:
    """Return the number of an expression; nan where Drake refuses one, as for the root of −1."""
    try:
        return expression.Evaluate(environment) if isinstance(expression, Expression) else expression
    except RuntimeError:
        return math.nan


def _gradient_of(dual: Any, size: int) -> Array:
    derivatives = dual.derivatives() if isinstance(dual, AutoDiffXd) else np.empty(0)
    return derivatives if derivatives.size else np.zeros(size)


def _reason(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _structure(system: Any, elements: Sequence[str]) -> dict[str, Any]:
    """Return the ports, sample time and default values that conversions keep."""
    context = system.CreateDefaultContext()
    kinds = ("input", "output")
    sizes = {f"{k} {p.get_name()}": p.size() for k in kinds for p in _ports(system, k)}
    timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
    times = {} if timing is None else {
        "sample time": timing.period_sec(), "offset of the sample time": timing.offset_sec()
    }  # fmt: skip
    values = map(_number, _context(system, context))
    return sizes | times | {f"default of {n}": v for n, v in zip(elements, values, strict=False)}


def _are_equal(first: Any, second: Any) -> bool:
    """Return whether two attributes are equal, as far as they can be compared."""
    first, second = _number(first), _number(second)
    if first is second or callable(first) or type(first).__module__.startswith("pydrake"):
        return True
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        return first.keys() == second.keys() and all(_are_equal(first[k], second[k]) for k in first)
    if isinstance(first, list | tuple | np.ndarray) and type(first) is type(second):
        return len(first) == len(second) and all(map(_are_equal, first, second))
    if type(first) is type(second) and type(first).__eq__ is object.__eq__:
        return not hasattr(first, "__dict__") or _are_equal(vars(first), vars(second))
    return bool(first == second)


def _attributes(system: Any) -> dict[str, Any]:
    return {name: v for name, v in vars(system).items() if not name.startswith("_pydrake")}


class _Check:
    """The checks of one leaf, with their findings and notes."""

    def __init__(self, system: Any, ranges: Mapping[str, Any], units: Mapping[str, str]) -> None:
        self.system = system
        self.findings: dict[str, None] = {}  # a set in its order
        self.notes: dict[str, None] = {}
        self.inputs = [p for p in _ports(system, "input") if _is_vector(p)]
        self.leaf = CalledLeaf(system, [int(p.get_index()) for p in self.inputs])
        context = system.CreateDefaultContext()
        node = Node(system)
        known = [name for group in parameter_groups(node, context) for name in group]
        known = ["", *known, *state_names(node, context)]
        self.elements: list[str] = []
        for source in self.leaf.sources:
            for index in range(source.default.size):
                name = f"{source.name}[{index}]" if source.default.size > 1 else source.name
                own = known[len(self.elements)][1:] if len(self.elements) < len(known) else ""
                self.elements.append(own if own.isidentifier() else name)
        self.units = {i: unit for n, unit in units.items() for i in self._indices("units", n)}
        self.points = self._points(ranges)
        self.parts: list[_Part] = []
        for index, port in enumerate(_ports(system, "output")):
            size = port.size() if _is_vector(port) else 0
            self._add(f"output {port.get_name()}", partial(_output, index), size)
        if context.num_continuous_states():
            self._add("time derivatives", rates_of, context.num_continuous_states())
        if context.num_discrete_state_groups():
            if system.GetUniquePeriodicDiscreteUpdateAttribute() is None:
                self._note("has not exactly one sample time, so its update is not compared")
            else:
                self._add("discrete update", update_of, state_of(node, context).discrete.size)
        if callable(getattr(system, "margin", None)):
            self._add("margin", margin_of, 1)
        self._add("Context", _context, len(_context(system, context)))
        self.function = self.leaf.function(self._evaluate, self.parts[-1].slice.stop)
        self.numbers = np.empty((0, 0))

    def _add(self, name: str, evaluate: Evaluate, size: int) -> None:
        start = self.parts[-1].slice.stop if self.parts else 0
        self.parts.append(_Part(name, evaluate, slice(start, start + size)))

    def _find(self, text: str) -> None:
        self.findings[f"{self.system.get_name() or Node(self.system).type_name}: {text}"] = None

    def _note(self, text: str) -> None:
        self.notes[f"{self.system.get_name() or Node(self.system).type_name}: {text}"] = None

    def _indices(self, setting: str, name: str) -> list[int]:
        """Return the indices in a point of what has a name."""
        starts = np.cumsum([0, *(source.default.size for source in self.leaf.sources)])
        for source, start in zip(self.leaf.sources, starts, strict=False):
            if source.name == name:
                return [*range(start, start + source.default.size)]
        if name not in self.elements:
            known = dict.fromkeys([*(source.name for source in self.leaf.sources), *self.elements])
            raise ParameterError(f"{setting}: unknown {quoted(name)}; known: {', '.join(known)}")
        return [self.elements.index(name)]

    def _points(self, ranges: Mapping[str, Any]) -> Array:
        """Return nine points in the ranges, (9, size)."""
        random = np.random.default_rng(0)  # a fixed seed: an equal leaf passes or fails each time
        around = [
            points_around(source.default, random, 0.0 if source.name == "parameters" else 1.0)
            for source in self.leaf.sources
        ]
        points = np.concatenate(around)
        points[0] = np.abs(points[0])  # the time
        for name, given in ranges.items():
            indices = self._indices("ranges", name)
            try:
                low, high = np.broadcast_to(np.asarray(given, float), (len(indices), 2)).T
            except (TypeError, ValueError):
                low, high = np.array([[math.nan], [math.nan]])
            if not (np.isfinite(low) & np.isfinite(high) & (low <= high)).all():
                raise ParameterError(
                    f"ranges: {name} = {quoted(given)}: must be (low, high), finite, or a list of "
                    f"{len(indices)} such pairs"
                )
            points[indices] = random.uniform(low[:, None], high[:, None], (len(indices), 9))
        return points.T

    def _evaluate(self, system: Any, context: Any) -> list[Any]:
        self._fix_abstract(system, context)
        return [value for part in self.parts for value in part.evaluate(system, context)]

    def _fix_abstract(self, system: Any, context: Any) -> None:
        for port in _ports(system, "input"):
            if not _is_vector(port):
                port.FixValue(context, port.Allocate())

    def _at(self, point: Array) -> str:
        """Return the numbers at a point as text."""
        units = [f" {self.units[i]}" if i in self.units else "" for i in range(point.size)]
        texts = map("{} = {:.6g}{}".format, self.elements, point, units)
        return shortened(f"at {', '.join(texts)}", 200)

    def names_of_ports(self) -> None:
        """Find ports without a name of their own."""
        for kind, letter in (("input", "u"), ("output", "y")):
            for index, port in enumerate(_ports(self.system, kind)):
                if port.get_name() == f"{letter}{index}":
                    self._find(f"{kind} port {index} has Drake's default name {letter}{index}")

    def calls(self) -> None:
        """Call the leaf of floats twice at each point, and on the way between some of them."""
        before = {name: repr(value) for name, value in _attributes(self.system).items()}
        way = [point for _, _, point in self._way()]
        points = np.concatenate([self.points, way])
        numbers, repeats = called_twice(self.function, self.function, points)
        self.numbers = numbers[: len(self.points)]
        after = _attributes(self.system).items()
        changed = [f"self.{name}" for name, value in after if before.get(name) != repr(value)]
        if not repeats:
            hint = f" ({', '.join(changed)})" if changed else ""
            self._find(
                f"gives other values when it is called again at the same points: it keeps a state "
                f"in an attribute{hint}, reads a clock or draws a random number"
            )
        elif changed:
            self._note(f"changes {', '.join(changed)} while it is called")
        if np.isnan(numbers[:, self.parts[-1].slice]).all():
            try:
                self._evaluate(self.system, self.leaf.context(self.points[0]))
            except (Exception, SystemExit) as error:
                self._find(
                    f"fails at each point of its ranges; {self._at(self.points[0])}: {_reason(error)}"
                )
            return
        context = self.parts[-1].slice
        held = self.points[:, : context.stop - context.start]
        for column in range(held.shape[1]):
            found = self.numbers[:, context.start + column]
            if np.any(~np.isnan(found) & (found != held[:, column])):
                self._find(f"changes {self.elements[column]} of its Context outside an update")

    def _way(self) -> Iterator[tuple[int, int, Array]]:
        """Yield steps from point to point: number of the way, index of the source, the point."""
        bounds = [0, *self.leaf.ends]
        for number, (start, end) in enumerate(zip((0, 4, 5), (4, 5, 8), strict=True)):
            point = self.points[start].copy()
            yield number, -1, point.copy()
            for index in range(len(self.leaf.sources)):
                part = slice(bounds[index], bounds[index + 1])
                point[part] = self.points[end][part]
                yield number, index, point.copy()

    def stored_outputs(self) -> None:
        """Compare values that Drake stores in a Context, on the way between points, with fresh."""
        felt, stale = set(), set()
        context, before, ends = None, np.empty(0), [0, *self.leaf.ends]
        for _, index, point in self._way():
            fresh = np.array(self.function(point))
            if index < 0:
                context = self.leaf.context(point)
                context.EnableCaching()
                self._fix_abstract(self.system, context)
            else:
                self.leaf.sources[index].write(context, point[ends[index] : ends[index + 1]])
            for part in self.parts[:-1]:
                try:
                    stored = np.array(part.evaluate(self.system, context))
                except (Exception, SystemExit):
                    continue
                now = fresh[part.slice]
                if index < 0 or np.isnan(now).any() or np.array_equal(now, before[part.slice]):
                    continue
                felt.add((part.name, index))
                if not np.array_equal(stored, now):
                    stale.add((part.name, index))
            before = fresh
        for name, index in sorted(stale):
            source = self.leaf.sources[index].name
            self._find(
                f"{name}: keeps its stored value when {source} changes; add {source} to its "
                f"prerequisites_of_calc"
            )
        first = len(self.leaf.sources) - len(self.inputs)
        for index, port in enumerate(self.inputs):
            for output, part in enumerate(self.parts[: self.system.num_output_ports()]):
                declared = self.system.HasDirectFeedthrough(int(port.get_index()), output)
                if declared and (part.name, first + index) not in felt:
                    self._note(f"{part.name}: is declared to feel {port.get_name()}, and does not")

    def runs(self) -> None:
        """Run two clones of one Context, with short steps between samples."""
        timing = self.system.GetUniquePeriodicDiscreteUpdateAttribute()
        period, offset = _STEP_S, 0.0
        if timing is not None:
            period, offset = timing.period_sec(), timing.offset_sec()
        usable = np.nonzero(np.isfinite(self.numbers).all(axis=1))[0]
        if not usable.size:
            return
        point = self.points[usable[0]]
        context = self.leaf.context(point)
        context.EnableCaching()
        self._fix_abstract(self.system, context)
        sample = offset + period * math.ceil((point[0] - offset) / period)
        times = [sample + (k + 0.4 + n * 1e-3) * period for k in range(3) for n in range(4)]
        first, second = context.Clone(), context.Clone()
        try:
            rows = [self._run(each, times, 0.1 * period) for each in (first, second)]
        except (Exception, SystemExit) as error:
            self._note(f"fails in a run {self._at(point)}: {_reason(error)}")
            return
        if not np.array_equal(*rows, equal_nan=True):
            self._find(
                "runs from two clones of one Context differ: an update keeps a state outside the "
                "Context, reads a clock or draws a random number"
            )
        held = self.parts[-1].slice.stop - state_of(Node(self.system), context).discrete.size
        short = rows[0][:, held:].reshape(3, 4, -1)
        for column in np.nonzero((short != short[:, :1]).any(axis=(0, 1)))[0].tolist():
            self._find(
                f"discrete state {column} changes between samples: update it in a periodic "
                f"discrete update alone"
            )

    def _run(self, context: Any, times: Sequence[float], step: float) -> Array:
        """Return all values of a run at some times, (times, values)."""
        simulator = Simulator(self.system, context)
        ResetIntegratorFromFlags(simulator, "runge_kutta2", step)
        simulator.Initialize()
        rows = []
        for time in times:
            simulator.AdvanceTo(time)
            rows.append([v for part in self.parts for v in part.evaluate(self.system, context)])
        return np.array(rows)

    def conversion(self, scalar: str, is_demanded: bool) -> None:
        """Compare the leaf of another scalar type with the leaf of floats."""
        try:
            converted = symbolic_value(
                "conversion", getattr(self.system, _CONVERSIONS[scalar]), scalar
            )
        except CompilationError as error:
            return self._find(str(error))
        if converted is None:
            tell = self._find if is_demanded else self._note
            return tell(f"does not convert to {scalar} (see Drake's TemplateSystem)")
        own, other = (_structure(s, self.elements) for s in (self.system, converted))
        for name in [*own, *(name for name in other if name not in own)]:
            if name not in own or name not in other or own[name] != other[name]:
                values = f"{other.get(name, 'missing')}, not {own.get(name, 'missing')}"
                self._find(f"conversion to {scalar}: {name} is {values}")
        own, other = map(_attributes, (self.system, converted))
        for name, value in own.items():
            if name not in other or not _are_equal(value, other[name]):
                text = shortened(repr(other[name])) if name in other else "missing"
                self._find(
                    f"conversion to {scalar}: the attribute {name} is {text}, not "
                    f"{shortened(repr(value))}"
                )
        leaf = CalledLeaf(converted, [int(p.get_index()) for p in self.inputs])
        if [s.default.size for s in leaf.sources] != [s.default.size for s in self.leaf.sources]:
            return None
        found = np.full(self.numbers.shape, math.nan)
        gradients = np.full((*found.shape, self.points.shape[1]), math.nan)
        for part in self.parts[:-1]:
            where, numbers = part.slice, self.numbers[:, part.slice]
            try:
                found[:, where], gradients[:, where] = self._converted(scalar, leaf, part)
            except CompilationError as error:
                self._find(str(error))
                continue
            if differ(lambda p, s=where: np.array(self.function(p)[s]), self.points, found[:, where], numbers):  # noqa
                far = ~np.isclose(found[:, where], numbers, 1e-9, 1e-9) & np.isfinite(numbers)
                row = int(np.argmax(far.sum(axis=1)))
                self._find(
                    f"{part.name}: {scalar} gives {found[row, where].tolist()}, float "
                    f"{numbers[row].tolist()} {self._at(self.points[row])}"
                )
        for row in (1, 4, 7):
            self._gradient(self.points[row], self.numbers[row], gradients[row])
        return None

    def _converted(self, scalar: str, leaf: CalledLeaf, part: _Part) -> tuple[Array, Array]:
        """Return values and gradients of a part in another scalar type; nan for no gradient."""

        def values(point: Sequence[Any]) -> Any:
            context = leaf.context(np.array(point))
            self._fix_abstract(leaf.system, context)
            return part.evaluate(leaf.system, context)

        def called(point: Sequence[Any]) -> Any:
            return symbolic_value(part.name, partial(values, point), scalar)

        size, rows, gradients = self.points.shape[1], [], []
        variables = [Variable(name) for name in self.elements]
        expressions = called([*map(Expression, variables)]) if scalar == "Expression" else []
        for point, number in zip(self.points, self.numbers, strict=True):
            nothing = np.full(len(number[part.slice]), math.nan)
            if np.isnan(number).all():
                rows.append(nothing)
                gradients.append(np.full((nothing.size, size), math.nan))
            elif scalar == "Expression":
                here = dict(zip(variables, point, strict=True))
                rows.append([_evaluated(each, here) for each in expressions])
                gradients.append(np.full((nothing.size, size), math.nan))
            else:
                duals = called([AutoDiffXd(x, e) for x, e in zip(point, np.eye(size), strict=True)])
                rows.append([_number(dual) for dual in duals])
                gradients.append([_gradient_of(dual, size) for dual in duals])
        return np.array(rows), np.array(gradients)

    def _gradient(self, point: Array, number: Array, gradient: Array) -> None:
        """Compare the gradients (values, size) at a point with central differences."""
        scale = np.ptp(self.points, axis=0)
        scaled = gradient * scale
        largest = np.abs(number) + np.abs(scaled).max(axis=1)
        for column in np.nonzero(scale)[0].tolist():
            wrong = np.isfinite(scaled[:, column])
            for step in _STEPS:
                if not wrong.any():
                    break
                change = step * scale[column] * np.eye(len(point))[column]
                one, half = (
                    (np.array(self.function(point + s * change)) - self.function(point - s * change))
                    / (2.0 * s * step)
                    for s in (1.0, 0.5)
                )
                difference = half + (half - one) / 3.0
                # Of rounding, 1e-16 of the largest term over the step, with a factor of 1000.
                slack = 1e-6 * np.abs(difference) + 1e-13 / step * largest + np.abs(half - one)
                wrong &= np.abs(scaled[:, column] - difference) > slack
            for row in np.nonzero(wrong)[0].tolist():
                (part,) = (p for p in self.parts if p.slice.start <= row < p.slice.stop)
                self._find(
                    f"{part.name}[{row - part.slice.start}]: its derivative with respect to "
                    f"{self.elements[column]} is {gradient[row, column]:.6g} by AutoDiffXd and "
                    f"{difference[row] / scale[column]:.6g} by differences {self._at(point)}"
                )

    def nan_inputs(self) -> None:
        """Note what follows from an input of nan."""
        ends = [0, *self.leaf.ends][-len(self.inputs) - 1 :]
        for port, start, end in zip(self.inputs, ends, ends[1:], strict=False):
            point = self.points[0].copy()
            point[start:end] = math.nan
            context = self.leaf.context(point)
            self._fix_abstract(self.system, context)
            try:
                reached = [
                    part.name
                    for part in self.parts[:-1]
                    if np.isnan(np.array(part.evaluate(self.system, context), float)).any()
                ]
                text = f"reaches {', '.join(reached)}" if reached else "reaches nothing"
            except (Exception, SystemExit) as error:
                text = f"raises {_reason(error)}"
            self._note(f"nan at {port.get_name()} {text}")
