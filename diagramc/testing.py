"""Tests a leaf system, as an assertion for pytest: see `check_leaf`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from itertools import chain, pairwise
from types import MappingProxyType
from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, Variable
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import System

from .arguments import names, quoted
from .diagram_equations import ExpressionGraph
from .equations.comparison import (
    CalledLeaf,
    Evaluate,
    called_twice,
    central_differences,
    differ,
    margin_of,
    output_of,
    points_around,
    rates_of,
    update_of,
    values_and_gradients,
)
from .equations.events import reason_of, symbolic_value
from .equations.names import parameter_groups, state_names
from .equations.ports import is_vector, ports_of
from .equations.tree import Node
from .errors import CompilationError, ParameterError, shortened
from .run_data import Array

_CONVERSIONS = {"AutoDiffXd": "ToAutoDiffXdMaybe", "Expression": "ToSymbolicMaybe"}
_STEPS = (1e-3, 1e-4, 1e-5, 1e-6)
"""Steps of the differences, as shares of the spread of the points.

A jump or kink near a point spoils a long step; rounding spoils a short one. So a derivative is
wrong only if it differs from the differences at each step.
"""
_PERIOD_S = 1e-3  # in place of the sample time of a leaf that has none; short for most systems
_OUTSIDE = "the leaf keeps a state outside the Context, reads a clock or draws a random number"
_NOTHING: Mapping[str, Any] = MappingProxyType({})


def check_leaf(
    system: Any,
    ranges: Mapping[str, Any] = _NOTHING,
    *,
    units: Mapping[str, str] = _NOTHING,
    scalars: str | Iterable[str] | None = None,
) -> tuple[str, ...]:
    """Assert that a Drake leaf system keeps the rules that simulation and linearization rely on.

    Use it in a test of your leaf system, beside the tests of its numbers::

        def test_my_cylinder():
            check_leaf(MyCylinder(), {"load_flow": (-1e-5, 1e-5), "mass_kg": (1.0, 3.0)})

    At nine points in the ranges, and on the way between some of them, it checks that

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

    A point where the leaf of floats raises an error or is not finite does not count. Abstract ports
    get their model values; abstract values are not compared.

    Returns notes, one line each, which are no faults: a port without a name of its own, a
    conversion that the leaf does not have, a point or run that fails.

    Parameters
    ----------
    system
        The leaf system of floats.
    ranges
        Dictionary from a name to (low, high), or to a list of one pair for each element. A name is
        that of an input port or of a parameter, or ``time``, ``parameters``, ``continuous_state``
        or ``discrete_state``. The elements of a vector are ``name[0]``, ``name[1]`` and so on. By
        default states and inputs lie up to 10 around those of the default Context (inputs: around
        zero), and parameters within a tenth of their values. None leaves an input port open.
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
    with np.errstate(all="ignore"):  # a point that is not finite does not count
        check = _Check(system, ranges, units)
        if check.repeats():  # otherwise each comparison would fail
            check.stored_values()
            check.runs()
            for scalar in wanted:
                check.conversion(scalar, check.note if scalars is None else check.find)
    leaf = Node(system).type_name
    if check.findings:
        raise AssertionError("\n".join(f"{leaf}: {finding}" for finding in check.findings))
    return tuple(f"{leaf}: {note}" for note in check.notes)


def _attributes(system: Any) -> dict[str, Any]:
    return {name: v for name, v in vars(system).items() if not name.startswith("_pydrake")}


def _plain(value: Any) -> Any:
    """Return an attribute with numbers for scalars, and None for what cannot be compared."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(item) for item in value]
    if isinstance(value, AutoDiffXd | Expression):
        return value.value() if isinstance(value, AutoDiffXd) else value.Evaluate()
    kind: Any = type(value)
    is_drakes = kind.__module__.startswith("pydrake")
    return None if callable(value) or is_drakes or kind.__eq__ is object.__eq__ else value


def _evaluate(functions: list[Evaluate], leaf: CalledLeaf, system: Any, context: Any) -> list[Any]:
    """Return what a leaf computes, and then what its Context has, in any scalar type."""
    for port in ports_of(system, "input"):
        if not is_vector(port) and not port.HasValue(context):
            port.FixValue(context, port.Allocate())
    values = [function(system, context) for function in functions]
    vectors = [value for value in values if isinstance(value, list | np.ndarray)]  # not abstract
    return [*chain(*vectors), *leaf.point(context)]


class _Check:
    """The checks of one leaf, with their findings and notes."""

    def __init__(self, system: Any, ranges: Mapping[str, Any], units: Mapping[str, str]) -> None:
        self.system = system
        self.findings: dict[str, None] = {}  # as a set, in order
        self.notes: dict[str, None] = {}
        inputs = [port for port in ports_of(system, "input") if is_vector(port)]
        self.inputs = [port for port in inputs if ranges.get(port.get_name(), ()) is not None]
        self.leaf = self._called(system)
        self.timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
        context, node, sources = system.CreateDefaultContext(), Node(system), self.leaf.sources
        self.elements = [
            f"{s.name}[{i}]" if s.size > 1 else s.name for s in sources for i in range(s.size)
        ]
        known = chain(*parameter_groups(node, context), state_names(node, context))
        for index, name in enumerate(known, 1):  # after the time
            if name[1:].isidentifier():
                self.elements[index] = name[1:]
        self.places: dict[str, list[int]] = {port.get_name(): [] for port in inputs}  # if open
        self.places |= {name: [index] for index, name in enumerate(self.elements)}
        for source, place in zip(sources, self.leaf.places, strict=True):
            self.places[source.name] = [*range(place.start, place.stop)]
        for setting, given in (("ranges", ranges), ("units", units)):
            if unknown := [name for name in given if name not in self.places]:
                text = f"unknown {quoted(unknown[0])}; known: {', '.join(self.places)}"
                raise ParameterError(f"{setting}: {text}")
        self.units = {i: f" {unit}" for name, unit in units.items() for i in self.places[name]}
        self.points = self._points(np.array(self.leaf.point(context)), ranges)
        functions = [*self._functions(context)]
        self.computed = sum(size for _, size, _ in functions)
        self.parts = [name for name, size, _ in functions for _ in range(size)] + self.elements
        """Name of each value: first of those that the leaf computes, then of the Context's."""
        self.evaluate = partial(_evaluate, [function for *_, function in functions])
        self.function = self.leaf.function(partial(self.evaluate, self.leaf), len(self.parts))

    def find(self, text: str, wrong: Any = None) -> None:
        """Add a finding, or one about each part of which a value is ``wrong``."""
        parts = [""] if wrong is None else [f"{self.parts[i]}: " for i in np.nonzero(wrong)[0]]
        self.findings |= {part + text: None for part in parts}

    def note(self, text: str) -> None:
        """Add a note."""
        self.notes[text] = None

    def _called(self, system: Any) -> CalledLeaf:
        return CalledLeaf(system, [int(port.get_index()) for port in self.inputs])

    def _functions(self, context: Any) -> Iterator[tuple[str, int, Evaluate]]:
        """Yield what the leaf computes: name, size and function."""
        for port in ports_of(self.system, "output"):
            # Abstract ports too, of size 0: the call may change something.
            yield f"output {port.get_name()}", port.size(), output_of(int(port.get_index()))
        if size := context.num_continuous_states():
            yield "time derivatives", size, rates_of
        if self.timing:
            yield "discrete update", len(self.places["discrete_state"]), update_of
        if callable(getattr(self.system, "margin", None)):
            yield "margin", 1, margin_of

    def _points(self, default: Array, ranges: Mapping[str, Any]) -> Array:
        """Return nine points in the ranges, (9, size)."""
        random = np.random.default_rng(0)  # a fixed seed: an equal leaf passes or fails each time
        scale = np.ones((default.size, 1))
        scale[self.places.get("parameters", [])] = 0.0
        points = points_around(default, random, scale)
        points[0] = np.abs(points[0])  # the time
        for name, given in ranges.items():
            indices = self.places[name]
            try:
                low, high = np.broadcast_to(np.asarray(given, float), (len(indices), 2)).T
                points[indices] = random.uniform(low, high, (9, len(indices))).T
                is_range = bool(np.all(low <= high))
            except (TypeError, ValueError, OverflowError):
                is_range = False
            if not is_range:
                raise ParameterError(
                    f"ranges: {name} = {quoted(given)}: must be (low, high), finite, or a list of "
                    f"{len(indices)} such pairs"
                )
        return points.T

    def _at(self, point: Array) -> str:
        """Return the numbers at a point as text."""
        units = [self.units.get(index, "") for index in range(len(point))]
        texts = map("{} = {:.6g}{}".format, self.elements, point, units)
        return shortened(f"at {', '.join(texts)}", 200)

    def repeats(self) -> bool:
        """Return whether a second call of the leaf of floats gives the same values.

        Points where the leaf fails are left out of all that follows.
        """
        for port in (*self.inputs, *ports_of(self.system, "output")):
            index = int(port.get_index())
            if port.get_name() in (f"u{index}", f"y{index}"):
                self.note(f"port {port.get_name()} has only Drake's default name")
        before = {name: repr(value) for name, value in _attributes(self.system).items()}
        self.numbers, repeats = called_twice(self.function, self.function, self.points)
        if not repeats:
            after = _attributes(self.system).items()
            changed = ", ".join(f"self.{n}" for n, value in after if before.get(n) != repr(value))
            self.find(f"a second call gives other values: {_OUTSIDE}{changed and f' ({changed})'}")
        reached = ~np.isnan(self.numbers[:, self.computed])  # the time, which is never nan
        if self.leaf.error is not None:
            text = f"at {np.sum(~reached)} of {reached.size} points: {reason_of(self.leaf.error)}"
            (self.note if reached.any() else self.find)(f"fails {text}")
        self.points, self.numbers = self.points[reached], self.numbers[reached]
        nowhere = ~np.isfinite(self.numbers[:, : self.computed]).any(axis=0)
        self.find("is finite at no point; give other ranges", nowhere & reached.any())
        held = self.numbers[:, self.computed :]  # nan, as in the inertia of Drake's world, stays
        changes = ((held != self.points) & ~np.isnan(self.points)).any(axis=0)
        self.find("changes in a call", np.pad(changes, (self.computed, 0)))
        return not self.findings

    def stored_values(self) -> None:
        """Compare values that Drake stores in a Context with fresh ones, on ways between points.

        One source changes at a time.
        """
        for start, end in pairwise(self.points[::2]):
            context, point = self.leaf.context(start), start.copy()
            before = np.array(self.function(start))
            self.evaluate(self.leaf, self.system, context)
            for source, place in zip(self.leaf.sources, self.leaf.places, strict=True):
                point[place] = end[place]
                source.write(context, end[place])
                fresh = np.array(self.function(point))
                stored = fresh
                with suppress(Exception, SystemExit):  # a point that does not count
                    stored = np.array(self.evaluate(self.leaf, self.system, context))
                changes = ~np.isnan(fresh) & (fresh != before)
                text = f"its stored value stays after a change of {source.name}; add {source.name}"
                self.find(f"{text} to its prerequisites_of_calc", changes & (stored != fresh))
                before = fresh

    def runs(self) -> None:
        """Compare runs of two clones of a Context, and the discrete state between its samples."""
        period, offset = _PERIOD_S, 0.0
        if self.timing:
            period, offset = self.timing.period_sec(), self.timing.offset_sec()
        sample = offset + period * math.ceil((self.points[0, 0] - offset) / period)
        times = sample + period * (np.arange(3)[:, None] + [0.4, 0.401]).ravel()
        context = self.leaf.context(self.points[0])
        try:
            first, second = (self._run(c, times, period) for c in (context.Clone(), context))
        except (Exception, SystemExit) as error:
            self.note(f"a run fails {self._at(self.points[0])}: {reason_of(error)}")
            return
        if not np.array_equal(first, second, equal_nan=True):
            self.find(f"runs of two clones of a Context differ: {_OUTSIDE}")
        held = first[:, self.computed :][:, self.places.get("discrete_state", [])]
        if (held[::2] != held[1::2]).any():
            self.find("discrete_state: jumps between samples")

    def _run(self, context: Any, times: Array, period: float) -> Array:
        """Return all values of a run at some times, (times, values)."""
        self.evaluate(self.leaf, self.system, context)  # gives values to abstract input ports
        simulator = Simulator(self.system, context)
        ResetIntegratorFromFlags(simulator, "runge_kutta2", 0.1 * period)
        simulator.Initialize()
        rows = []
        for time in times.tolist():
            simulator.AdvanceTo(time)
            rows.append(self.evaluate(self.leaf, self.system, context))
        return np.array(rows)

    def _structure(self, system: Any) -> dict[str, Any]:
        """Return ports, sample time, default values and attributes, which conversions keep."""
        timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
        values = self._called(system).point(system.CreateDefaultContext())
        structure = {
            **{f"input {port.get_name()}": port.size() for port in ports_of(system, "input")},
            **{f"output {port.get_name()}": port.size() for port in ports_of(system, "output")},
            "sample time": timing and (timing.period_sec(), timing.offset_sec()),
            **{f"default of {n}": x for n, x in zip(self.elements, values, strict=False)},
            **{f"attribute {name}": value for name, value in _attributes(system).items()},
        }
        return {name: _plain(value) for name, value in structure.items()}

    def conversion(self, scalar: str, tell: Callable[[str], None]) -> None:
        """Compare the leaf in another scalar type with the leaf of floats.

        ``tell`` takes the line about a leaf that does not convert.
        """
        try:
            convert = getattr(self.system, _CONVERSIONS[scalar])
            converted = symbolic_value("conversion", convert, scalar)
            if converted is None:
                tell(f"does not convert to {scalar} (see Drake's TemplateSystem)")
                return
            count, own = len(self.findings), self._structure(self.system)
            other = symbolic_value("conversion", partial(self._structure, converted), scalar)
            for name in own | other:
                now, expected = (kept.get(name, "missing") for kept in (other, own))
                if now != expected and repr(now) != repr(expected):  # nan is unequal
                    texts = shortened(str(now)), shortened(str(expected))
                    self.find("as {}, {} is {}, not {}".format(scalar, name, *texts))
            if len(self.findings) == count:
                self._compare(scalar, converted)
        except CompilationError as error:
            self.find(str(error))

    def _compare(self, scalar: str, converted: Any) -> None:
        """Compare the values and gradients of a converted leaf with those of floats."""
        leaf = self._called(converted)

        def called(point: Iterable[Any]) -> Any:
            context = leaf.context(np.array([*point]))
            evaluate = partial(self.evaluate, leaf, converted, context)
            return symbolic_value("outputs, derivatives, update", evaluate, scalar)

        if scalar == "Expression":
            variables = [Variable(name) for name in self.elements]
            expressions = called(map(Expression, variables))
            found = ExpressionGraph(expressions, variables).values(self.points)
        else:
            seeds = np.eye(len(self.elements))
            rows = [called(map(AutoDiffXd, point, seeds)) for point in self.points]
            found, gradients = map(
                np.array, zip(*(values_and_gradients(row, len(seeds)) for row in rows), strict=True)
            )
            for row in range(min(1, len(rows) - 1), len(rows), 4):
                self._differentiate(self.points[row], gradients[row])
        for column in range(self.computed):
            numbers, others = self.numbers[:, [column]], found[:, [column]]
            value = partial(lambda column, point: [self.function(point)[column]], column)
            if differ(value, self.points, others, numbers):
                row = int(np.argmax(np.where(np.isfinite(numbers), abs(others - numbers), 0.0)))
                self.find(
                    f"{self.parts[column]}: {others[row, 0]:.9g} by {scalar}, "
                    f"{numbers[row, 0]:.9g} by float {self._at(self.points[row])}"
                )

    def _differentiate(self, point: Array, gradient: Array) -> None:
        """Compare gradients (values, size) at a point with central differences."""
        scale = np.nan_to_num(np.ptp(self.points, axis=0))
        scaled, wrong = gradient * scale, np.isfinite(gradient) & (scale > 0.0)
        slopes = np.zeros(scaled.shape)
        finite = np.where(np.isfinite(self.numbers), self.numbers, 0.0)
        largest = np.abs(finite).max(axis=0) + np.abs(scaled).max(axis=1)
        for step in _STEPS:
            for column in np.nonzero(wrong.any(axis=0))[0].tolist():
                change = step * scale * (np.arange(scale.size) == column)
                effects = central_differences(self.function, point, change)
                wide, half = (effect / step for effect in effects)
                slope = slopes[:, column] = half + (half - wide) / 3.0
                # Of rounding, 1e-16 of the largest term over the step, with a factor of 1000.
                # Over a jump J at the point wide is J/2, half is J and slope 7/6 J, over the step.
                slack = 1e-6 * np.abs(slope) + 1e-13 / step * largest + 4.0 * np.abs(half - wide)
                wrong[:, column] &= np.abs(scaled[:, column] - slope) > slack
        for value, column in np.argwhere(wrong).tolist():
            self.find(
                f"{self.parts[value]}: derivative with respect to {self.elements[column]} "
                f"{gradient[value, column]:.6g} by AutoDiffXd, "
                f"{slopes[value, column] / scale[column]:.6g} by differences {self._at(point)}"
            )
