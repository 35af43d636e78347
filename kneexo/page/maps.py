"""Finds formulas by which a page turns a user's numbers into the parameters of a web module.

Python computes the parameters of a module from a scenario. A page has no Python, so it needs this
computation as data. The functions here evaluate the computation at points, fit a formula to each
parameter, and check the formulas at further points.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import product
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from kneexo.common.result import Array
from kneexo.errors import KneexoError, ParameterError

Map = dict[str, Any]
"""A formula as data for JSON; `map_value` evaluates the formula."""

Ranges = Mapping[str, tuple[float, float]]
"""Dictionary from the name of a number to the number's lowest and highest value."""

TOLERANCE = 1e-12
"""Largest error of a formula, relative to the largest magnitude of the parameter."""

_POINTS = 32
"""Number of points at which each formula is checked."""

_NODES = (24, 48, 96)
"""Numbers of Chebyshev nodes, tried in this order until `TOLERANCE` is met."""

_MOST_FACTORS = 5
"""Largest number of numbers that are linear in a Chebyshev formula, beside the curved one."""


def map_value(formula: Map, values: Mapping[str, float]) -> float:
    """Return the value of a formula for numbers with the ``values``, by name.

    The formula depends on the numbers q[0], q[1], …, whose names are in ``of``. Its ``kind`` is one
    of the following.

    - ``affine``: ``offset`` plus the sum of all f[i] q[i], with the ``factors`` f.
    - ``power``: ``factor`` times the product of all q[i]^e[i], with the ``exponents`` e.
    - ``least``: the least of ``limit`` (unless None) and all f[i] q[i], with the ``factors`` f. If
      ``unit`` is present, the value is rounded down to whole units.
    - ``chebyshev``: the sum of all c T_n[0](u[0]) T_n[1](u[1]) …, with the ``terms`` [c, n[0],
      n[1], …] and the Chebyshev polynomials T. Each u[i] = (2 q[i] − low − high)/(high − low) is
      q[i] scaled from its ``domain`` [low, high] to −1 … 1.

    If ``at_least`` is present, no value of the formula is below this number.
    """
    return max(_unbounded(formula, values), formula.get("at_least", -math.inf))


def _unbounded(formula: Map, values: Mapping[str, float]) -> float:
    q = [values[name] for name in formula["of"]]
    if formula["kind"] == "affine":
        return formula["offset"] + sum(k * x for k, x in zip(formula["factors"], q, strict=True))
    if formula["kind"] == "power":
        powers = (x**n for x, n in zip(q, formula["exponents"], strict=True))
        return formula["factor"] * math.prod(powers)
    if formula["kind"] == "least":
        limit = math.inf if formula["limit"] is None else formula["limit"]
        least = min(limit, *(k * x for k, x in zip(formula["factors"], q, strict=True)))
        unit = formula.get("unit")
        return least if unit is None else unit * math.floor(least / unit * (1.0 + 1e-12))
    u = [
        (2.0 * x - low - high) / (high - low)
        for x, (low, high) in zip(q, formula["domain"], strict=True)
    ]
    size = 1 + max(max(n) for _, *n in formula["terms"])
    rows = chebyshev.chebvander(np.array(u), size - 1)
    return float(
        sum(c * math.prod(rows[i][k] for i, k in enumerate(n)) for c, *n in formula["terms"])
    )


def fit_maps(
    evaluate: Callable[[Mapping[str, float]], Array],
    ranges: Ranges,
    values: Mapping[str, float],
    required: Sequence[str] = (),
    unit: float = 0.0,
) -> tuple[dict[int, Map], tuple[str, ...]]:
    """Return a formula for each parameter that depends on the numbers, and the usable numbers.

    Parameters
    ----------
    evaluate
        Function of a dictionary from the name of each number to its value; returns the vector of
        all parameters. It raises `KneexoError` for values that do not fit each other.
    ranges
        The numbers, the most important first. A number is not usable if an end of its range is
        refused, or if no formula represents a parameter that depends on it.
    values
        Present value of each number, which a number that is not usable keeps.
    required
        Names of numbers that must be usable.
    unit
        Step of a parameter that is rounded down; zero: no parameter is rounded.

    Returns
    -------
        A dictionary from the index of a parameter to its formula, and the names of the usable
        numbers. All other numbers must keep their values.

    Raises `ParameterError` if a required number is not usable.
    """
    probe = _Probe(evaluate, ranges)
    names = [*ranges]
    for name in ranges:
        if name not in required and not probe.accepts(name):
            probe.fix(names.pop(names.index(name)), values)
    while True:
        maps, failed = _fits(probe, names, unit)
        if failed is None:
            _check_together(probe, maps, names)
            return maps, tuple(names)
        index, numbers = failed
        droppable = [name for name in numbers if name not in required]
        if not droppable:
            raise ParameterError(
                f"{', '.join(numbers)}: no formula represents the effect on the model; a page "
                f"cannot vary it"
            )
        dropped = _dropped(probe, index, numbers, droppable, values, unit)
        names.remove(dropped)
        probe.fix(dropped, values)


def _dropped(
    probe: _Probe,
    index: int,
    numbers: list[str],
    droppable: list[str],
    values: Mapping[str, float],
    unit: float,
) -> str:
    """Choose a number to give up, because no formula represents the parameter ``index``.

    Return the least important of the ``droppable`` numbers without which there is a formula. If
    there is none, return the least important number.
    """
    for name in reversed(droppable):
        centre = probe.centre.copy()
        probe.fix(name, values)
        formula = _fit(probe, index, [other for other in numbers if other != name], unit)
        probe.centre = centre
        if formula is not None:
            return name
    return droppable[-1]


class _Probe:
    """Evaluates the parameters at points, each point once."""

    def __init__(self, evaluate: Callable[[Mapping[str, float]], Array], ranges: Ranges) -> None:
        self.ranges = ranges
        self._evaluate = evaluate
        self._known: dict[tuple[float, ...], Array] = {}
        self._points: dict[tuple[str, ...], list[dict[str, float]]] = {}
        self._random = np.random.default_rng(0)
        share = self._random.uniform(0.2, 0.8, len(ranges)).tolist()
        self.centre = {
            name: low + part * (high - low)
            for part, (name, (low, high)) in zip(share, ranges.items(), strict=True)
        }
        """Value of each number that a point does not have: random, in the middle 60 % of its range.

        ``fix`` replaces the random value by the present value of the number.
        """

    def __call__(self, point: Mapping[str, float]) -> Array:
        """Return the vector of all parameters for a point, which is evaluated at most once.

        ``point`` is a dictionary from the name of a number to its value. A number that is not in
        ``point`` gets its value in ``centre``.
        """
        values = {**self.centre, **point}
        key = tuple(values.values())
        if key not in self._known:
            self._known[key] = self._evaluate(values)
        return self._known[key]

    def fix(self, name: str, values: Mapping[str, float]) -> None:
        """Give the number ``name`` its value in ``values`` at all points without this number."""
        self.centre[name] = values[name]

    def accepts(self, name: str) -> bool:
        """Return whether the parameters can be evaluated at both ends of a number's range."""
        with suppress(KneexoError):
            for end in self.ranges[name]:
                self({name: end})
            return True
        return False

    def affected(self, name: str) -> list[int]:
        """Return the indices of the parameters that depend on a number."""
        before = self({})
        return np.flatnonzero(
            np.any([self({name: end}) != before for end in self.ranges[name]], axis=0)
        ).tolist()

    def points(self, names: Sequence[str]) -> list[dict[str, float]]:
        """Return the random points at which a formula of the numbers ``names`` is checked.

        The same names get the same points. Half of the coordinates lie at the ends of their ranges.
        """
        if (key := tuple(names)) not in self._points:
            shares = self._random.uniform(-0.5, 1.5, (_POINTS, len(names))).clip(0.0, 1.0)
            ends = [self.ranges[name] for name in names]
            self._points[key] = [
                {
                    name: low * (1.0 - part) + high * part
                    for name, (low, high), part in zip(names, ends, share, strict=True)
                }
                for share in shares.tolist()
            ]
        return self._points[key]


def _fits(
    probe: _Probe, names: Sequence[str], unit: float
) -> tuple[dict[int, Map], tuple[int, list[str]] | None]:
    """Fit a formula to each parameter that depends on one of the numbers ``names``.

    Returns the formulas by the index of the parameter, and None. If a parameter has no formula, the
    second value is the index of this parameter and the names of the numbers on which it depends.
    """
    numbers_of: dict[int, list[str]] = {}
    for name in names:
        for index in probe.affected(name):
            numbers_of.setdefault(index, []).append(name)
    maps: dict[int, Map] = {}
    for index, numbers in numbers_of.items():
        formula = _fit(probe, index, numbers, unit)
        if formula is None:
            return {}, (index, numbers)
        maps[index] = formula
    return maps, None


def _check_together(probe: _Probe, maps: Mapping[int, Map], names: Sequence[str]) -> None:
    """Raise `ParameterError` if formulas are wrong where all numbers change together."""
    at_centre = probe({})
    mapped, expected = [at_centre], [at_centre]
    for point in probe.points(names):
        with suppress(KneexoError):  # the scenario refuses these values together
            expected.append(probe(point))
            mapped.append(at_centre.copy())
            for index, formula in maps.items():
                mapped[-1][index] = map_value(formula, point)
    bound = TOLERANCE * np.abs(expected).max(axis=0)
    with np.errstate(invalid="ignore"):  # a limit that is inf everywhere
        wrong = np.abs(np.array(mapped) - expected) > bound
    if wrong.any():
        raise ParameterError(f"{', '.join(names)}: no formula represents their joint effect")


def _fit(probe: _Probe, index: int, numbers: list[str], unit: float) -> Map | None:
    """Return the first formula that represents a parameter by ``numbers``, or None."""
    ranges = {name: probe.ranges[name] for name in numbers}

    def value(point: Mapping[str, float]) -> float:
        return float(probe(point)[index])

    if not numbers:
        return None
    with suppress(KneexoError):  # the scenario refuses some values together
        points = probe.points(numbers)
        expected = np.array([value(point) for point in points])
        # `_check_together` checks other points, where the error may be somewhat larger.
        bound = 0.2 * TOLERANCE * np.abs(expected).max()
        # From few operations to many, because the page evaluates each formula whenever a slider
        # moves.
        for fit in (_affine, _power, _least, _chebyshev):
            for formula in fit(value, ranges, unit):
                mapped = np.array([map_value(formula, point) for point in points])
                if np.all(np.abs(mapped - expected) <= bound):
                    return formula
    return None


_Value = Callable[[Mapping[str, float]], float]
"""Type of a function that returns one parameter at a point."""


def _affine(value: _Value, ranges: Ranges, unit: float) -> list[Map]:
    """Return a sum of multiples of the numbers, right at the low ends and one high end each.

    The formula is the plane through the value with all numbers at their low ends, and through each
    value with one number at its high end.
    """
    lows = {name: low for name, (low, _) in ranges.items()}
    value_at_lows = value(lows)
    if len(ranges) == 1:
        ((name, ends),) = ranges.items()
        if all(value({name: end}) == end for end in ends):  # the number itself, without rounding
            return [{"kind": "affine", "of": [name], "offset": 0.0, "factors": [1.0]}]
    factors = [
        (value(lows | {name: high}) - value_at_lows) / (high - low)
        for name, (low, high) in ranges.items()
    ]
    offset = value_at_lows - sum(k * low for k, low in zip(factors, lows.values(), strict=True))
    return [{"kind": "affine", "of": [*ranges], "offset": offset, "factors": factors}]


def _power(value: _Value, ranges: Ranges, unit: float) -> list[Map]:
    """Return the product of powers through the values at the ends; exponents are halves of n."""
    highs = {name: high for name, (_, high) in ranges.items()}
    value_at_highs = value(highs)
    exponents = []
    for name, (low, high) in ranges.items():
        value_at_low = value({**highs, name: low})
        if low <= 0.0 or value_at_highs * value_at_low <= 0.0:
            return []
        exponent = math.log(value_at_highs / value_at_low) / math.log(high / low)
        exponents.append(round(2.0 * exponent) / 2.0)
    powers = (x**n for x, n in zip(highs.values(), exponents, strict=True))
    factor = value_at_highs / math.prod(powers)
    return [{"kind": "power", "of": [*ranges], "factor": factor, "exponents": exponents}]


def _least(value: _Value, ranges: Ranges, unit: float) -> list[Map]:
    """Return the least of multiples of the numbers and of a limit, with and without rounding."""
    highs = {name: high for name, (_, high) in ranges.items()}
    value_at_highs = value(highs)
    formulas: list[Map] = []
    for step in (0.0, unit) if unit else (0.0,):
        factors = []
        for name, (low, _) in ranges.items():
            # At its low end a number alone decides, if it decides anywhere.
            value_at_low = value({**highs, name: low})
            factors.append(1.0 if step else value_at_low / low if low else math.nan)
        # If no number explains the value where all are high, a limit does.
        largest = [k * x for k, x in zip(factors, highs.values(), strict=True)]
        limit = None if any(x <= value_at_highs for x in largest) else value_at_highs
        formula = {"kind": "least", "of": [*ranges], "factors": factors, "limit": limit}
        if np.isfinite(factors).all():
            formulas.append(formula | ({"unit": step} if step else {}))
    return formulas


def _chebyshev(value: _Value, ranges: Ranges, unit: float) -> Any:
    """Yield longer and longer Chebyshev series in one number. Other numbers may enter linearly."""
    curved = [name for name in ranges if not _is_linear(value, name, ranges[name])]
    straight = [name for name in ranges if name not in curved]
    if len(curved) > 1 or len(straight) > _MOST_FACTORS:
        return
    order = [*curved, *straight]
    for count in _NODES if curved else (1,):
        axes = [_nodes(*ranges[name], count) for name in curved]
        axes += [np.array(ranges[name]) for name in straight]
        shape = [len(axis) for axis in axes]
        points = (dict(zip(order, map(float, x), strict=True)) for x in product(*axes))
        c = np.array([value(point) for point in points]).reshape(shape)
        # One axis after the other, the values at the nodes become coefficients.
        for axis, name in enumerate(order):
            if name in straight:
                matrix = np.array([[0.5, 0.5], [-0.5, 0.5]])
            else:
                matrix = np.linalg.inv(chebyshev.chebvander(_nodes(-1.0, 1.0, count), count - 1))
            c = np.moveaxis(np.tensordot(matrix, c, axes=(1, axis)), 0, axis)
        not_negligible = np.argwhere(np.abs(c) > 1e-16 * np.abs(c).max())
        yield {
            "kind": "chebyshev",
            "of": order,
            "domain": [list(ranges[name]) for name in order],
            "terms": [[float(c[tuple(degrees)]), *degrees.tolist()] for degrees in not_negligible],
        }


def _is_linear(value: _Value, name: str, ends: tuple[float, float]) -> bool:
    low, high = ends
    share = 0.37  # any place that is no symmetry of a curve
    at_low, between, at_high = (
        value({name: low + part * (high - low)}) for part in (0.0, share, 1.0)
    )
    expected = at_low + share * (at_high - at_low)
    return abs(between - expected) <= TOLERANCE * max(abs(at_low), abs(between), abs(at_high))


def _nodes(low: float, high: float, count: int) -> Array:
    return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * chebyshev.chebpts1(count))
