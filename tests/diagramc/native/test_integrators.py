"""Fixed-step integrators over one tick, against the same methods in plain Python."""

import numpy as np
import pytest

from diagramc.native.integrators import Tick, advance_rk4, advance_runge_kutta3
from diagramc.native.ir import Array, Module
from diagramc.native.llvm import Library, compile_text
from diagramc.native.types import BOOL, BYTE, DOUBLE, INT, POINTER

LANES = 2


@pytest.fixture(scope="module", params=[advance_rk4, advance_runge_kutta3], ids=["rk4", "rk3"])
def method(request):
    """Name, and ``advance(x, start, end, step, running)``: x (2, lanes) at the end, rates by step.

    The system is x₀' = x₁, x₁' = t - x₀; two lanes.
    """
    module, type_ = Module(), DOUBLE.of(LANES)
    names = ("x", "times", "running", "count")
    f = module.function("tick", dict.fromkeys(names, POINTER), internal=False)
    x = Array(f.arguments["x"], type_)
    times, count = (Array(f.arguments[name], DOUBLE) for name in ("times", "count"))

    def rate(t, x, out):
        count[0] = count[0] + 1.0
        out[0] = x[1]
        out[1] = f.coerce(t, type_) - x[0]

    running = Array(f.arguments["running"], BYTE.of(LANES))[0].differs(0)
    request.param(Tick(f, 2, type_, times[0], times[1], x, running, rate, times[2]))
    function = Library(compile_text(module.text())).function("tick", len(names))

    def advance(x, start, end, step, running=(1, 1)):
        x, count = np.array(x), np.zeros(1)
        arrays = (x, np.array([start, end, step]), np.array(running, dtype=np.uint8), count)
        function(*(array.ctypes.data for array in arrays))
        return x, round(count[0])

    return {advance_rk4: 4, advance_runge_kutta3: 3}[request.param], advance


def exact(t, start, x):
    """x₀ - t and x₁ - 1 turn as a point on a circle."""
    offset, speed = x[0] - start, x[1] - 1.0
    c, s = np.cos(t - start), np.sin(t - start)
    return np.array([t + c * offset + s * speed, 1.0 - s * offset + c * speed])


STARTS = np.array([[1.0, -0.3], [0.5, 2.0]])


def test_errors_have_the_order_of_the_method(method):
    order, advance = method
    errors = [
        np.abs(advance(STARTS, 0.2, 1.2, step)[0] - exact(1.2, 0.2, STARTS)).max()
        for step in (0.1, 0.05)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.15)
    assert errors[0] < 1e-3


def test_lanes_that_do_not_run_stay(method):
    _, advance = method
    x, _ = advance(STARTS, 0.0, 1.0, 0.1, running=(0, 1))
    np.testing.assert_array_equal(x[:, 0], STARTS[:, 0])
    np.testing.assert_allclose(x[:, 1], exact(1.0, 0.0, STARTS)[:, 1], rtol=0, atol=1e-3)


@pytest.mark.parametrize(
    ("step", "rk4_steps", "rk3_steps"),
    [
        (0.25, 4, 4),
        (0.3, 4, 4),
        (5.0, 1, 1),
        (1.0 / 1.005, 2, 1),  # the last step of the third order stretches by 1 %
        (1.0 / 1.02, 2, 2),
        (1.0 - 1e-12, 1, 1),  # rounding makes no step
    ],
)
def test_number_of_steps(method, step, rk4_steps, rk3_steps):
    order, advance = method
    _, rates = advance(STARTS, 0.0, 1.0, step)
    assert rates == (4 * rk4_steps if order == 4 else 3 * rk3_steps)


def logged_tick(method, grows):
    """``run(per_s, step, x)``: lanes reported in a second, and their ratio, start, end, h and x.

    The system is x₀' = w x₁, x₁' = -w x₀, with another w in each of two lanes. If it ``grows``, w
    is ``per_s`` times (time + 0.1 s), and only the first of each 100 steps is checked.
    """
    module, type_ = Module(), DOUBLE.of(LANES)
    f = module.function("tick", dict.fromkeys(("x", "w", "step", "log"), POINTER), internal=False)
    x, w, log = (Array(f.arguments[name], type_) for name in ("x", "w", "log"))

    def rate(t, x, out):
        rate = w[0] * f.coerce(t + 0.1, type_) if grows else w[0]
        out[0], out[1] = rate * x[1], -(rate * x[0])

    def report(lanes, step):
        log[0] = f.to_double(f.flags(lanes))
        for i, array in enumerate(step):  # ratio, start, end, h, x
            log[i + 1] = array[0]
        log[6] = step[-1][1]

    start, running = f.constant(0.0), f.constant(1, BOOL.of(LANES))
    step = Array(f.arguments["step"], DOUBLE)[0]
    number = f.constant(0, INT) if grows else None
    method(Tick(f, 2, type_, start, f.constant(1.0), x, running, rate, step, report, number))
    function = Library(compile_text(module.text())).function("tick", 4)

    def run(per_s, step, x):
        log = np.zeros((7, LANES))
        arrays = np.array(x), np.array(per_s), np.array([step]), log
        function(*(array.ctypes.data for array in arrays))
        return log

    return run


@pytest.fixture(scope="module", params=[advance_rk4, advance_runge_kutta3], ids=["rk4", "rk3"])
def suspects(request):
    """The function of `logged_tick` for a constant w, where each step is checked."""
    return logged_tick(request.param, grows=False)


@pytest.mark.parametrize("method", [advance_rk4, advance_runge_kutta3], ids=["rk4", "rk3"])
def test_a_mode_that_becomes_fast_late_in_a_long_tick_is_reported(method):
    # The last checked step of 1000 is the one at 0.9 s, where h |λ| is 1.8 in the second lane.
    x = np.array([[0.1, 0.1], [0.05, 0.05]])
    reported, *_ = logged_tick(method, grows=True)([800.0, 1800.0], 1e-3, x)
    assert reported.tolist() == [0.0, 1.0]


def test_a_fast_mode_that_moves_is_reported_in_its_lane(suspects):
    x = np.array([[0.1, 0.1], [0.05, 0.05]])
    reported, ratio, start, end, h, *states = suspects([8.0, 18.0], 0.1, x)
    assert reported.tolist() == [0.0, 1.0]
    assert ratio[1] == pytest.approx((0.1 * 18.0) ** 4, rel=1e-9)  # the square of (h |λ|)²
    assert (start[1], end[1], h[1]) == (0.0, 1.0, pytest.approx(0.1))
    np.testing.assert_array_equal(np.array(states)[:, 1], x[:, 1])
    reported, *_ = suspects([8.0, 13.0], 0.1, x)
    assert not reported.any()
    _, ratio, *_ = suspects([8.0, 25.0], 0.1, x)
    assert ratio[1] == np.inf  # clear
    reported, ratio, *_ = suspects([8.0, 1e200], 0.1, x)  # overflows
    assert (reported[1], ratio[1]) == (1.0, np.inf)
    reported, *_ = suspects([8.0, 8.0], 0.1, x * [1.0, 20.0])  # moves by more than 1
    assert reported.tolist() == [0.0, 1.0]
    reported, *_ = suspects([8.0, 8.0], 1e-3, x * [1.0, 20.0])  # by less than 1 in 100 steps
    assert not reported.any()
    reported, *_ = suspects([18.0, 18.0], 0.1, x * [1.0, 0.0])  # the second mode does not move
    assert reported.tolist() == [1.0, 0.0]
