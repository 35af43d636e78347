"""Elementary functions: error, edges, and the same bits in scalars and lanes."""

import ctypes
import importlib.util
import math
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from mpmath import mp, mpf

from diagramc.native import elementary
from diagramc.native.ir import Array, Module
from diagramc.native.types import DOUBLE, INT, POINTER

FIT = Path(__file__).parents[3] / "benchmarks" / "fit_elementary.py"
LANES = (1, 4, 8, 16)
NAMES = ("sin", "cos", "atan2", "atan", "asin", "acos", "exp", "log", "tanh", "power")
WORST = (1.6, 1.6, 1.5, 1.35, 1.15, 1.2, 0.85, 0.85, 1.95, 1.65)  # units in the last place
OF_TWO = ("atan2", "power")
BITS = 160  # precision of the true values
SPECIAL = [0.0, 5e-324, 1e-310, 2.3e-308, 1e-9, 0.5, 1.0, 1.5, 700.0, 1e9, 1e300, 1.7e308, math.inf]
SPECIAL = [*SPECIAL, *(-x for x in SPECIAL), math.nan]
SPECIAL += [np.nextafter(1.0, 2.0), -np.nextafter(1.0, 2.0), np.nextafter(1.0, 0.0)]


def traced(f, name, x, y):
    if name in ("sin", "cos"):
        return elementary.sincos(f, x)[name == "cos"]
    arguments = (x, y) if name in OF_TWO else (x,)
    return getattr(elementary, name)(f, *arguments)


@pytest.fixture(scope="module")
def evaluate(native):
    """``evaluate(name, x, y, lanes)``: values of a function of one or two arguments."""
    module = Module()
    arguments = {"x": POINTER, "y": POINTER, "result": POINTER, "count": INT}
    for name in NAMES:
        for width in LANES:
            f = module.function(f"{name}_{width}", arguments, internal=False)
            x, y, result = (Array(f.arguments[k], DOUBLE.of(width)) for k in ("x", "y", "result"))
            for k in f.each(f.arguments["count"]):
                result[k] = traced(f, name, x[k], y[k])
    library = native(module.text())

    def call(name, x, y=None, lanes=1):
        x = np.array(x, dtype=float)
        y = x if y is None else np.array(y, dtype=float)
        padded = -len(x) % lanes
        columns = [np.append(column, np.ones(padded)) for column in (x, y)]
        result = np.empty(len(x) + padded)
        function = library(f"{name}_{lanes}", None, *[ctypes.c_void_p] * 3, ctypes.c_int64)
        function(*(a.ctypes.data for a in (*columns, result)), len(result) // lanes)
        return result[: len(x)]

    return call


def magnitudes(generator, low, high, count=400):
    return generator.choice([-1.0, 1.0], count) * 10.0 ** generator.uniform(low, high, count)


def next_to_quarters():
    """Doubles that come closest to multiples of π/2, from best fractions of it."""
    found = []
    with mp.workprec(400):
        for exponent in range(-52, -22):
            ratio = Fraction(int(mp.ldexp(mp.pi / 2, 300 - exponent)), 2**300)
            for bits in range(43, 54):
                largest = 2**bits // math.ceil(ratio)
                if largest:
                    found.append(math.ldexp(ratio.limit_denominator(largest).numerator, exponent))
    return np.unique(found)


def points(name, count=400):
    """Arguments x and y over the whole range, and more where the error is largest."""
    generator = np.random.default_rng(NAMES.index(name))
    everywhere = magnitudes(generator, -323.3, 308.2, count)
    if name in ("sin", "cos"):
        quarters = np.round(magnitudes(generator, 0.0, 8.8, count)) * (math.pi / 2.0)
        x = [
            generator.uniform(-7.0, 7.0, count),
            generator.uniform(-1e9, 1e9, count),
            magnitudes(generator, 8.9, 9.1, count),
            quarters,
            np.nextafter(quarters, 0.0),
            quarters + math.pi / 4.0,
            next_to_quarters(),
        ]
    elif name == "atan2":
        angle = generator.uniform(-math.pi, math.pi, count)
        two = np.nextafter(2.0 - 10.0 ** generator.uniform(-6.0, -2.0, count), 0.0)
        angle = np.concatenate([angle, two, math.pi / 4.0 + 0.1 * angle, 2.0 - 0.05 * angle])
        radius = magnitudes(generator, -300.0, 300.0, len(angle))
        pairs = [
            (radius * np.sin(angle), radius * np.cos(angle)),
            (everywhere, generator.permutation(everywhere)),
            (magnitudes(generator, 307, 308.2, count), magnitudes(generator, 307, 308.2, count)),
            (
                magnitudes(generator, -323.3, -315, count),
                magnitudes(generator, -323.3, -315, count),
            ),
        ]
        return tuple(np.concatenate(column) for column in zip(*pairs, strict=True))
    elif name == "power":
        base = np.concatenate(
            [
                np.abs(magnitudes(generator, -307.6, 308.2, count)),
                generator.uniform(0.3, 3.0, count),
                math.sqrt(2.0) + magnitudes(generator, -16.0, -1.0, count),
                1.0 + magnitudes(generator, -15.0, -1.0, count),
            ]
        )
        base = base[base != 1.0]
        near = generator.uniform(-1.0, 1.0, len(base))
        far = generator.choice([-1.0, 1.0], len(base)) * generator.uniform(600.0, 705.0, len(base))
        ends = np.concatenate([share / np.log(base) for share in (near, far)])
        x, y = np.tile(base, 3), np.append(ends, generator.uniform(-2.0, 2.0, len(base)))
        normal = np.abs(y * np.log(x)) < 705.0
        return x[normal], y[normal]
    elif name == "atan":
        x = [generator.uniform(-3.0, 3.0, count), 1.0 + magnitudes(generator, -16.0, -1.0, count)]
    elif name in ("asin", "acos"):
        everywhere = magnitudes(generator, -323.3, 0.0, count)
        near_one = 1.0 - 10.0 ** generator.uniform(-16.0, -0.3, count)
        x = [
            generator.uniform(-1.0, 1.0, 2 * count),
            generator.uniform(0.8, math.sin(1.0), count),
            near_one,
            -near_one,
            generator.uniform(0.49, 0.51, count),
        ]
    elif name == "tanh":
        x = [
            generator.uniform(-1.0, 1.0, 2 * count),
            generator.uniform(-20.5, 20.5, count),
            np.arange(-60, 60) * (math.log(2.0) / 4.0),  # where the reduction changes
            0.173 + magnitudes(generator, -6.0, -1.0, count),
        ]
    elif name == "exp":
        everywhere = magnitudes(generator, -323.3, 2.8, count)
        x = [
            generator.uniform(-746.0, 709.7, count),
            generator.uniform(-1.0, 1.0, count),
            generator.uniform(-745.2, -708.0, count),
            np.arange(-40, 40) * (math.log(2.0) / 2.0),
        ]
    else:
        everywhere = np.abs(everywhere)
        x = [
            generator.uniform(0.4, 2.5, 2 * count),
            1.0 + magnitudes(generator, -16.0, -1.0, count),
            10.0 ** generator.uniform(-323.3, -307.0, count),
        ]
    x = np.concatenate([everywhere, *x])
    return x, np.ones_like(x)


@pytest.mark.parametrize(("name", "worst"), list(zip(NAMES, WORST, strict=True)))
def test_error(evaluate, name, worst):
    x, y = points(name)
    got = evaluate(name, x, y)
    assert np.isfinite(got).all()
    with mp.workprec(BITS):
        function = getattr(mp, name)
        pairs = zip(x.tolist(), y.tolist(), strict=True) if name in OF_TWO else x[:, None].tolist()
        exact = [function(*(mpf(argument) for argument in pair)) for pair in pairs]
        units = np.spacing(np.abs(np.array([float(value) for value in exact])))
        errors = [
            abs(float((mpf(value) - true) / mpf(unit)))
            for value, true, unit in zip(got.tolist(), exact, units.tolist(), strict=True)
        ]
    assert max(errors) < worst, x[np.argmax(errors)]


def assert_close(got, right):
    """Within two units, C's own error among them; zeros, infinities and nan where C has them."""
    number = ~np.isnan(right)
    np.testing.assert_array_equal(np.signbit(got)[number], np.signbit(right)[number])
    finite = np.isfinite(right) & (right != 0.0)
    np.testing.assert_array_equal(got[~finite], right[~finite])
    error = np.abs(got[finite] - right[finite]) / np.spacing(np.abs(right[finite]))
    assert error.max() <= 2.0


@pytest.mark.parametrize("name", [name for name in NAMES if name not in OF_TWO])
@pytest.mark.parametrize("lanes", LANES)
def test_edges(evaluate, name, lanes):
    inverse = {"atan": "arctan", "asin": "arcsin", "acos": "arccos"}
    with np.errstate(all="ignore"):
        right = getattr(np, inverse.get(name, name))(SPECIAL)
    assert_close(evaluate(name, SPECIAL, lanes=lanes), right)


@pytest.mark.parametrize("lanes", LANES)
def test_edges_of_atan2(evaluate, lanes):
    y, x = (grid.ravel() for grid in np.meshgrid(SPECIAL, SPECIAL))
    right = np.array([math.atan2(*pair) for pair in zip(y, x, strict=True)])
    got = evaluate("atan2", y, x, lanes=lanes)
    assert_close(got, right)
    edge = np.isinf(x) | np.isinf(y) | (x == 0.0) | (y == 0.0)
    np.testing.assert_array_equal(got[edge], right[edge])


def c_power(x, y):
    """The power as in C, which raises no error."""
    try:
        return math.pow(x, y)
    except OverflowError:
        return -math.inf if x < 0.0 and y % 2.0 == 1.0 else math.inf
    except ValueError:  # of a negative number, or a pole at zero
        odd = abs(y) % 2.0 == 1.0
        return math.nan if x else math.copysign(math.inf, x if odd else 1.0)


@pytest.mark.parametrize("lanes", LANES)
def test_edges_of_power(evaluate, lanes):
    odd = [*SPECIAL, 3.0, -3.0, 2.0]
    x, y = (grid.ravel() for grid in np.meshgrid(odd, odd))
    right = np.array([c_power(*pair) for pair in zip(x.tolist(), y.tolist(), strict=True)])
    got = evaluate("power", x, y, lanes=lanes)
    np.testing.assert_array_equal(np.isnan(got), np.isnan(right))
    assert_close(got, right)


@pytest.mark.parametrize(
    ("name", "x", "value"),
    [
        ("sin", math.pi, 1.2246467991473532e-16),
        ("cos", 0.0, 1.0),
        ("cos", math.pi, -1.0),
        ("atan", 1.0, math.pi / 4.0),
        ("asin", -1.0, -math.pi / 2.0),
        ("acos", 1.0, 0.0),
        ("acos", -1.0, math.pi),
        ("acos", 0.0, math.pi / 2.0),
        ("exp", 0.0, 1.0),
        ("exp", 1.0, math.e),
        ("tanh", 30.0, 1.0),
        ("tanh", -math.inf, -1.0),
        ("log", 1.0, 0.0),
        ("log", 2.0, math.log(2.0)),
    ],
)
def test_known_values(evaluate, name, x, value):
    assert evaluate(name, [x]) == value


def mixed(name):
    """Points with an infinite, nan, huge or zero lane among most neighbours."""
    x, y = points(name, count=150)
    generator = np.random.default_rng(0)
    for column in (x, y):
        odd = generator.random(len(column)) < 0.15
        column[odd] = generator.choice(SPECIAL, odd.sum())
    order = generator.permutation(len(x))
    return x[order], y[order]


@pytest.mark.parametrize("name", NAMES)
def test_lanes_equal_scalars(evaluate, name):
    x, y = mixed(name)
    scalar = evaluate(name, x, y)
    for lanes in LANES[1:]:
        np.testing.assert_array_equal(evaluate(name, x, y, lanes=lanes), scalar)


@pytest.mark.slow
def test_constants_are_the_fitted_ones():
    spec = importlib.util.spec_from_file_location("fit_elementary", FIT)
    fit = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fit)
    for name, (values, _) in fit.constants().items():
        assert getattr(elementary, name) == tuple(values)
