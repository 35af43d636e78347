"""IR text by tracing: the compiled code does what the same Python does to numbers."""

import ctypes
import math
import operator

import numpy as np
import pytest

from diagramc.native.ir import UNROLLED, Array, Module
from diagramc.native.types import BYTE, DOUBLE, INT, POINTER

INT64 = ctypes.c_int64
LANES = (1, 4, 8, 16)
DOUBLES = np.array([1.5, -2.0, 0.0, -0.0, 3.25, math.inf, -1e300, math.nan] * 2)
OTHERS = np.array([2.0, 3.0, -0.0, 0.0, math.nan, 1.0, 1e300, math.nan, -1.0] + [2.0] * 7)
WHOLE = np.array([5, -7, 0, 1, 2**40, -1, 6, 63] * 2)
SMALL = np.array([1, 3, 5, 7, 9, 11, 2, 4] * 2)


@pytest.fixture
def evaluate(native):
    """``evaluate(trace, *inputs, lanes)``: the result for each vector of the inputs' elements."""

    def run(trace, *inputs, lanes=1):
        module = Module()
        names = [f"x{k}" for k in range(len(inputs))]
        arguments = {**dict.fromkeys([*names, "result"], POINTER), "count": INT}
        f = module.function("run", arguments, internal=False)
        types = [DOUBLE if column.dtype == float else INT for column in inputs]
        columns = [
            Array(f.arguments[name], type_.of(lanes))
            for name, type_ in zip(names, types, strict=True)
        ]
        for k in f.each(f.arguments["count"]):
            value = trace(f, *(column[k] for column in columns))
            if value.type.element == "i1":
                value = f.flags(value)
            Array(f.arguments["result"], value.type)[k] = value
        result = np.empty(len(inputs[0]), float if value.type.element == "double" else np.int64)
        call = native(module.text())("run", None, *[ctypes.c_void_p] * (len(arguments) - 1), INT64)
        call(*(column.ctypes.data for column in (*inputs, result)), len(result) // lanes)
        return result

    return run


@pytest.fixture
def check(evaluate):
    """``check(trace, right, *inputs)``: in any number of lanes the bits, but for those of NaN."""

    def run(trace, right, *inputs):
        number = ~np.isnan(right)
        for lanes in LANES:
            got = evaluate(trace, *inputs, lanes=lanes)
            np.testing.assert_array_equal(got, right)
            np.testing.assert_array_equal(np.signbit(got[number]), np.signbit(right[number]))

    return run


@pytest.fixture
def scalar(native):
    """``scalar(trace, *numbers)``: what a function of integers leaves as its result."""

    def run(trace, *numbers):
        module = Module()
        f = module.function("run", {f"n{k}": INT for k in range(len(numbers))}, INT, internal=False)
        value = trace(f, *f.arguments.values())
        if value is not None:
            f.return_(f.coerce(value, INT))
        return native(module.text())("run", INT64, *[INT64] * len(numbers))(*numbers)

    return run


# ------------------------------------------------------------------------------- values


@pytest.mark.parametrize(
    "of", [operator.add, operator.sub, operator.mul, operator.truediv, lambda a, b: 3.0 / a - b]
)
def test_arithmetic_of_doubles(check, of):
    with np.errstate(all="ignore"):
        right = of(DOUBLES, OTHERS)
    check(lambda f, a, b: of(a, b), right, DOUBLES, OTHERS)


@pytest.mark.parametrize(
    "of",
    [
        lambda a, b: a + 3 * b,
        lambda a, b: 1 - a - b,
        lambda a, b: a << b,
        lambda a, b: (a & b) | (a ^ 5),
        lambda a, b: ~a,
        lambda a, b: (a & 255) >> b,
    ],
)
def test_arithmetic_of_integers(check, of):
    check(lambda f, a, b: of(a, b), of(WHOLE, SMALL), WHOLE, SMALL)


def test_remainder_has_the_sign_of_the_dividend(evaluate):
    np.testing.assert_array_equal(
        evaluate(lambda f, a, b: a % b, WHOLE, SMALL), np.fmod(WHOLE, SMALL)
    )


def test_right_shift_fills_with_zeros(evaluate):
    assert evaluate(lambda f, a: a >> 60, np.array([-1]))[0] == 15


@pytest.mark.parametrize(
    ("of", "same"),
    [
        (operator.lt, operator.lt),
        (operator.le, operator.le),
        (operator.gt, operator.gt),
        (operator.ge, operator.ge),
        (lambda a, b: a.equals(b), operator.eq),
        (lambda a, b: a.differs(b), operator.ne),
        (lambda a, b: ~(a < b) ^ (a > b), lambda a, b: ~(a < b) ^ (a > b)),
    ],
)
def test_comparisons(check, of, same):
    for operands in ((DOUBLES, OTHERS), (WHOLE, SMALL)):
        check(lambda f, a, b: of(a, b), same(*operands), *operands)


@pytest.mark.parametrize(
    ("of", "same"),
    [
        (lambda f, a: -a, np.negative),
        (lambda f, a: f.absolute(a), np.abs),
        (lambda f, a: f.sqrt(f.absolute(a)), lambda a: np.sqrt(np.abs(a))),
        (lambda f, a: f.floor(a), np.floor),
        (lambda f, a: f.ceil(a), np.ceil),
        (lambda f, a: f.copysign(2.0, a), lambda a: np.copysign(2.0, a)),
        (lambda f, a: f.from_bits(f.bits(a)), np.positive),
        (lambda f, a: f.select(a > 0.0, a, 7.0), lambda a: np.where(a > 0.0, a, 7.0)),
        (lambda f, a: f.select(a > 0.0, 1.0, 7.0), lambda a: np.where(a > 0.0, 1.0, 7.0)),
    ],
)
def test_functions_of_doubles(check, of, same):
    x = np.concatenate(
        [DOUBLES[:-1], [0.5, 1.5, 2.5, -0.5, -1.7, 1e-310, -5e-324, 2.0**52 + 1.0, 1.2]]
    )
    x = x[:16]
    with np.errstate(all="ignore"):
        right = same(x)
    check(of, right, x)


def test_conversions(check):
    check(lambda f, n: f.to_double(n), WHOLE.astype(float), WHOLE)
    x = np.array([1.9, -1.9, 0.0, 3e9] * 4)
    check(lambda f, a: f.to_int(a), np.trunc(x).astype(np.int64), x)
    check(lambda f, a: f.bits(a), DOUBLES.view(np.int64), DOUBLES)


def test_the_c_library_lane_by_lane(check):
    x, y = np.linspace(-2.0, 2.0, 16), np.linspace(1.0, 3.0, 16)
    check(lambda f, a: f.library("sinh", a), np.array([math.sinh(a) for a in x]), x)
    powers = np.array([math.pow(*pair) for pair in zip(y, x, strict=True)])
    check(lambda f, a, b: f.library("pow", a, b), powers, y, x)


def test_values_of_other_kinds_do_not_mix():
    f = Module().function("run", {"x": DOUBLE, "n": INT, "pair": DOUBLE.of(2)})
    x, n, pair = f.arguments.values()
    with pytest.raises(AssertionError):
        x + n
    with pytest.raises(AssertionError):
        f.coerce(pair, DOUBLE)


# -------------------------------------------------------------------------------- lanes


@pytest.mark.parametrize("lanes", LANES)
def test_lanes_apart_and_gathered(evaluate, lanes):
    x = np.arange(16.0)
    turned = evaluate(
        lambda f, a: f.gathered(lanes, lambda k: 2.0 * f.lane(a, lanes - 1 - k)), x, lanes=lanes
    )
    np.testing.assert_array_equal(turned, 2.0 * x.reshape(-1, lanes)[:, ::-1].ravel())
    numbers = evaluate(lambda f, a: f.lane_numbers(lanes), x, lanes=lanes)
    np.testing.assert_array_equal(numbers, np.arange(16) % lanes)


@pytest.mark.parametrize("lanes", LANES)
def test_any_lane(evaluate, lanes):
    x = np.zeros(64)
    x[[3, 20, 21, 47]] = 1.0
    got = evaluate(
        lambda f, a: f.coerce(f.select(f.any_lane(a > 0.5), 1.0, 2.0), DOUBLE.of(lanes)),
        x,
        lanes=lanes,
    )
    any_ = (x.reshape(-1, lanes) > 0.5).any(axis=1)
    np.testing.assert_array_equal(got, np.repeat(np.where(any_, 1.0, 2.0), lanes))


# ------------------------------------------------------------------------------ control


@pytest.mark.parametrize("count", [0, 1, UNROLLED, UNROLLED + 1, 40])
@pytest.mark.parametrize("kind", ["number", "value", "loop"])
def test_loops(scalar, count, kind):
    texts = []

    def trace(f, n):
        total = f.variable(f.constant(0, INT))
        ways = {
            "number": lambda: f.each(count),
            "value": lambda: f.each(n),
            "loop": lambda: f.loop(count),
        }
        for k in ways[kind]():
            total.set(total.get() + k * f.coerce(k, INT) + 1)
        texts.append(f.text())
        return total.get()

    assert scalar(trace, count) == sum(k * k + 1 for k in range(count))
    unrolled = kind == "number" and count <= UNROLLED
    assert ("br " in texts[0]) != unrolled


def test_loops_within_loops(scalar):
    def trace(f, n):
        total = f.variable(f.constant(0, INT))
        for i in f.each(n):
            for k in f.each(i):
                total.set(total.get() + i * k)
        return total.get()

    assert scalar(trace, 12) == sum(i * k for i in range(12) for k in range(i))


def test_leaving_a_loop(scalar):
    def trace(f, n):
        number, total = (f.variable(f.constant(start, INT)) for start in (0, 0))
        with f.forever() as loop:
            k = number.get()
            loop.stop_if(k >= n)
            number.set(k + 1)
            total.set(total.get() + k)
        return total.get()

    assert [scalar(trace, n) for n in (0, 1, 2, 10)] == [0, 0, 1, 45]


def test_when(scalar):
    def trace(f, n):
        result = f.variable(n)
        with f.when(n > 3):
            result.set(n * 10)
            with f.when(n > 5):
                result.set(result.get() + 1)
        return result.get()

    assert [scalar(trace, n) for n in (3, 4, 6)] == [3, 40, 61]


def test_returning_early(scalar):
    def trace(f, n):
        f.return_if(n < 0, f.constant(-1, INT))
        with f.when(n.equals(7)):
            f.return_(f.constant(70, INT))
        f.return_(n)

    assert [scalar(trace, n) for n in (-5, 7, 8)] == [-1, 70, 8]


def test_returning_early_without_a_result(native):
    module = Module()
    f = module.function("run", {"n": INT, "result": POINTER}, internal=False)
    result = Array(f.arguments["result"], INT)
    result[0] = 1
    f.return_if(f.arguments["n"] > 0)
    result[0] = 2
    found = np.zeros(1, np.int64)
    run = native(module.text())("run", None, INT64, ctypes.c_void_p)
    for n, right in ((1, 1), (0, 2)):
        run(n, found.ctypes.data)
        assert found[0] == right


def test_calls(scalar):
    def trace(f, n):
        module = f.module

        def make():
            g = module.function("square", {"n": INT}, INT)
            g.return_(g.arguments["n"] * g.arguments["n"])
            return g

        store = module.function("store", {"place": POINTER, "n": INT})
        Array(store.arguments["place"], INT)[1] = store.arguments["n"]
        assert module.shared("square", make) is module.shared("square", make)
        memory = f.array(2, INT)
        memory[0] = f.call(module.shared("square", make), n)
        f.call(store, memory.pointer, n + 1)
        return memory[0] * 100 + memory[1]

    assert scalar(trace, 6) == 3607


# ------------------------------------------------------------------------------- memory


@pytest.mark.parametrize("lanes", LANES)
def test_arrays(evaluate, lanes):
    def trace(f, a):
        memory = f.array(12, DOUBLE.of(lanes))
        for k in f.each(12):
            memory[k] = a + f.to_double(f.coerce(k, INT))
        memory.shifted(3)[0] = 100.0
        single = memory.cast(DOUBLE)  # the lanes one after the other
        return memory[2] + memory[3] * memory.shifted(1)[10] + single[2 * lanes]

    x = np.arange(16.0)
    first = np.repeat(x.reshape(-1, lanes)[:, 0], lanes)
    np.testing.assert_array_equal(
        evaluate(trace, x, lanes=lanes), (x + 2.0) + 100.0 * (x + 11.0) + (first + 2.0)
    )


def test_memory_of_the_caller(native):
    module = Module()
    arguments = {"bytes": POINTER, "address": INT}
    f = module.function("run", arguments, internal=False)
    flags = Array(f.arguments["bytes"], BYTE)
    numbers = Array(f.pointer(f.arguments["address"]), DOUBLE.of(4))
    flags[1] = 5
    flags[3] = flags[0]
    numbers[1] = numbers[0] * 2.0
    flags_, numbers_ = np.array([9, 0, 0, 0], np.uint8), np.arange(1.0, 10.0)
    beside = numbers_[1:]  # aligned to 8 bytes alone
    native(module.text())("run", None, ctypes.c_void_p, INT64)(
        flags_.ctypes.data, beside.ctypes.data
    )
    assert flags_.tolist() == [9, 5, 0, 9]
    assert numbers_.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 4.0, 6.0, 8.0, 10.0]


def test_variables(check):
    def trace(f, a):
        variable = f.variable(a)
        for _ in f.each(f.constant(3, INT)):
            variable.set(variable.get() * 2.0)
        with f.when(f.any_lane(a > 1e9)):
            variable.set(0.0)
        return variable.get()

    check(trace, 8.0 * np.arange(16.0), np.arange(16.0))
