"""A step of Dormand and Prince's method against scipy's and against an exact solution."""

import numpy as np
import pytest
import scipy.integrate

from diagramc.native.dormand_prince import DormandPrince
from diagramc.native.integrators import Tick
from diagramc.native.ir import Array, Module
from diagramc.native.llvm import Library, compile_text
from diagramc.native.types import BOOL, DOUBLE, POINTER

SIZES = (3, 11)  # with and without unrolled loops
LANES = 4


def rates(t, x):
    """Coupled states and a forcing: x_i' = −x_{i+1} x_i + t (i + 1)/10."""
    return -np.roll(x, -1, axis=0) * x + t * (np.arange(1, len(x) + 1)[:, None]) / 10


@pytest.fixture(scope="module", params=SIZES)
def stepped(request):
    """``step(x (n, lanes), time, h)`` returns end, slope at the end, and error estimate."""
    size, module, type_ = request.param, Module(), DOUBLE.of(LANES)
    names = ("x", "numbers", "out")
    f = module.function("step", dict.fromkeys(names, POINTER), internal=False)
    x, numbers, out = (Array(f.arguments[name], type_) for name in names)

    def rate(time, state, derivative):
        for i in range(size):
            forcing = f.coerce(time, type_) * ((i + 1) / 10)
            derivative[i] = f.fma(-state[(i + 1) % size], state[i], forcing)

    start = f.constant(0.0)
    tick = Tick(f, size, type_, start, f.constant(9.0), x, f.constant(1, BOOL), rate, start)
    time, h = numbers[0], numbers[1]
    slope = tick.vector()
    tick.rate(time, x, slope)
    results = DormandPrince(f).step(tick, time, h, time + h, slope)
    for n, result in enumerate(results):
        for i in range(size):
            out[n * size + i] = result[i]
    library = Library(compile_text(module.text()))

    def step(state, start, length):
        end = np.empty((3, size, LANES))
        arrays = (state, np.array([start, length]), end)
        library.function("step", 3)(*(array.ctypes.data for array in arrays))
        return end

    step.size = size
    return step


def test_a_step_is_that_of_scipy(stepped):
    rng = np.random.default_rng(0)
    x = rng.uniform(0.5, 1.5, (stepped.size, LANES))
    time, h = rng.uniform(0.0, 1.0, LANES), rng.uniform(0.01, 0.1, LANES)
    end, slope, error = stepped(x, time, h)
    for lane in range(LANES):

        def single(t, state):
            return rates(t, state[:, None])[:, 0]

        solver = scipy.integrate.RK45(
            single, time[lane], x[:, lane], 10.0, first_step=h[lane], rtol=1.0, atol=1e3
        )
        solver.step()
        assert solver.t == pytest.approx(time[lane] + h[lane], rel=1e-15)
        np.testing.assert_allclose(end[:, lane], solver.y, rtol=1e-14)
        np.testing.assert_allclose(slope[:, lane], solver.f, rtol=0, atol=1e-13)
        estimate = h[lane] * np.dot(solver.K.T, solver.E)
        np.testing.assert_allclose(error[:, lane], -estimate, rtol=0, atol=1e-16)
