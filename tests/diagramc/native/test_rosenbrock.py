"""Runs by the Rosenbrock method as machine code, against closed forms and in lanes."""

from itertools import pairwise

import numpy as np
import pytest

from diagramc import InputTable, State
from diagramc.diagram_equations import equations_key
from diagramc.equations.equations import Equations, Update
from diagramc.errors import SimulationError
from diagramc.model import CompiledModel
from diagramc.native.machine_code import MachineCode


def model_of(rates_of, states, parameters=(), inputs=0, updates_of=None):
    """A model with derivatives ``rates_of(graph, states, parameters)``; it outputs its states."""
    equations = Equations(
        states=[f"m.x[{i}]" for i in range(states)],
        parameters=list(parameters),
        inputs={"u": inputs} if inputs else {},
    )
    g = equations.graph
    x = [g.source("state", i) for i in range(states)]
    equations.derivatives = rates_of(g, x, [g.source("parameter", i) for i in range(4)])
    equations.outputs = {"y": x}
    if updates_of is not None:
        equations.discrete, equations.initial_discrete = ["m.d"], [g.source("discrete")]
        equations.updates = [Update(0.1, 0.0, ((0, updates_of(g)),))]
    return CompiledModel(MachineCode(equations_key(equations), equations))


def run(model, start, duration_s, tick_s=0.1, parameters=(), discrete=(), **options):
    state = State(np.array(start), np.array(discrete, dtype=float))
    options = {"integrator": "rosenbrock", "record_period_s": tick_s} | options
    return model.simulate(np.array(parameters), state, duration_s, **options)


# -------------------------------------------------------------------------------- accuracy


def pushed_pendulum(g, x, _):
    """Dv/dt = -sin q + cos t + u, with an input u that is a function of time."""
    pushes = g.node("cos", g.source("time")), g.source("input")
    return [x[1], g.add(g.negate(g.node("sin", x[0])), *pushes)]


def test_the_order_is_four_with_time_and_inputs():
    """A tick without errors above the tolerance of 0.01 is one substep."""
    model = model_of(pushed_pendulum, 2, inputs=1)
    table = InputTable(np.array([0.8]), np.array([[[0.0, 0.0, 1.0]], [[0.64, 1.6, 1.0]]]))
    ends = [
        run(model, [1.0, 0.0], 1.6, tick_s, inputs=table, tolerance=1e-2).final.continuous
        for tick_s in (0.2, 0.1, 0.05, 0.0125)
    ]
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert errors[0] < 1e-4
    for coarse, fine in pairwise(errors):
        assert 2**3.5 < coarse / fine < 2**4.7


@pytest.mark.parametrize("source", ["time", "table"])
def test_a_stiff_state_follows_a_function_of_time(source):
    """Dx/dt = -1e6 (x - w) + dw/dt has the solution w = t² - t³ from x = 0 (Prothero, Robinson)."""

    def rates_of(g, x, _):
        t = g.source("time")
        wave = g.subtract(g.multiply(t, t), g.multiply(t, t, t))
        slope = g.subtract(g.add(t, t), g.multiply(g.constant(3.0), t, t))
        if source == "table":
            wave, slope = g.source("input", 0), g.source("input", 1)
        return [g.add(g.multiply(g.constant(-1e6), g.subtract(x[0], wave)), slope)]

    model = model_of(rates_of, 1, inputs=2 if source == "table" else 0)
    polynomials = np.array([[[0.0, 0.0, 1.0, -1.0], [0.0, 2.0, -3.0, 0.0]]])
    table = InputTable(coefficients=polynomials) if source == "table" else None
    result = run(model, [0.0], 2.0, inputs=table)
    t = result.time_s
    np.testing.assert_allclose(result["y"][:, 0], t**2 - t**3, atol=1e-7)


def follower(g, x, _):
    """Dx/dt = -20 (x - u)."""
    return [g.multiply(g.constant(-20.0), g.subtract(x[0], g.source("input")))]


def test_an_input_jumps_within_a_tick():
    table = InputTable(np.array([0.137]), np.array([[[0.0]], [[1.0]]]))
    result = run(model_of(follower, 1, inputs=1), [0.0], 0.5, inputs=table, tolerance=1e-8)
    t = result.time_s
    exact = np.where(t > 0.137, -np.expm1(-20.0 * (t - 0.137)), 0.0)
    np.testing.assert_allclose(result["y"][:, 0], exact, atol=1e-7)


def test_an_input_that_jumps_at_the_end_of_a_tick_has_its_value_before():
    table = InputTable(np.array([0.2]), np.array([[[1.0]], [[3.0]]]))
    result = run(model_of(follower, 1, inputs=1), [1.0], 0.3, inputs=table, tolerance=1e-2)
    np.testing.assert_allclose(result["y"][:3, 0], 1.0, rtol=1e-14)
    assert result["y"][3, 0] > 2.0


def test_a_valve_opens_within_a_tick():
    """A pressure that falls at 1 per second, and a valve of 1e5 1/s that keeps it above zero."""

    def rates_of(g, x, _):
        opening = g.node("max", g.negate(x[0]), g.zero)
        return [g.add(g.constant(-1.0), g.multiply(g.constant(1e5), opening))]

    result = run(model_of(rates_of, 1), [0.25], 0.5, tolerance=1e-8)
    expected = [0.25, 0.15, 0.05, -1e-5, -1e-5, -1e-5]
    np.testing.assert_allclose(result["y"][:, 0], expected, atol=1e-7)


# ----------------------------------------------------------------------------------- lanes


def van_der_pol(g, x, parameters):
    """An oscillator whose damping, a parameter, is stiff; a held value d pushes it."""
    damping = g.subtract(g.one, g.multiply(x[0], x[0]))
    return [
        x[1],
        g.add(g.multiply(parameters[0], damping, x[1]), g.negate(x[0]), g.source("discrete")),
    ]


@pytest.fixture(scope="module")
def oscillators():
    return model_of(van_der_pol, 2, ["mu"], updates_of=lambda g: g.node("sin", g.source("time")))


def test_runs_in_lanes_have_the_bits_of_runs_alone(oscillators):
    """Durations differ too, and some lanes take hundreds of substeps where others take one."""
    stiffness = np.geomspace(1.0, 1e4, 9)[:, None]
    durations = 0.1 * np.arange(3, 12)
    state, options = State(np.array([2.0, 0.0]), np.zeros(1)), {"integrator": "rosenbrock"}
    batch = oscillators.simulate_batch(stiffness, state, durations, threads=1, **options)
    for together, row, duration_s in zip(batch, stiffness, durations, strict=True):
        alone = oscillators.simulate(row, state, duration_s, **options)
        np.testing.assert_array_equal(together["y"], alone["y"])
        np.testing.assert_array_equal(together.final.continuous, alone.final.continuous)


@pytest.mark.parametrize(("integrator", "default"), [("rosenbrock", 1e-7), ("exact_hold", 1e-8)])
def test_each_integrator_has_its_default_tolerance(oscillators, integrator, default):
    """That of rosenbrock is the default of exported C."""
    results = [
        run(oscillators, [2.0, 0.0], 0.5, parameters=[10.0], discrete=[0.0], **options)["y"]
        for options in (
            {"integrator": integrator},
            {"integrator": integrator, "tolerance": default},
            {"integrator": integrator, "tolerance": 0.1 * default},
        )
    ]
    np.testing.assert_array_equal(results[0], results[1])
    assert not np.array_equal(results[0], results[2])


@pytest.mark.parametrize("tolerance", [1e-13, 0.1])
def test_a_tolerance_that_is_out_of_range_is_refused(oscillators, tolerance):
    with pytest.raises(ValueError, match=r"must be in 1e-12 … 0\.01 for rosenbrock"):
        run(oscillators, [2.0, 0.0], 0.5, parameters=[1.0], discrete=[0.0], tolerance=tolerance)


# -------------------------------------------------------------------------------- failures


def explosive(g, x, parameters):
    """Dx/dt = 1 beside dy/dt = p y², which is infinite at t = 1/p from y = 1."""
    return [g.one, g.multiply(parameters[0], x[1], x[1])]


def test_a_run_that_grows_without_bound_names_time_and_state():
    model = model_of(explosive, 2, ["p"])
    state = State(np.array([0.0, 1.0]), np.zeros(0))
    options = {"integrator": "rosenbrock", "record_period_s": 0.1, "failures": "return"}
    batch = model.simulate_batch(np.array([[4.0]] + [[0.1]] * 7), state, 1.0, **options)
    assert str(batch[0]).startswith("t = 0.2 s: m.x[1] changes too fast for the integrator rosen")
    assert batch[0].state["m.x[1]"] > 1e6
    for result in batch[1:]:
        assert result["y"][-1] == pytest.approx([1.0, 1.0 / 0.9], rel=1e-6)
    with pytest.raises(SimulationError, match=r"t = 0 s: m.x\[1\] is not finite"):
        run(model, [0.0, np.nan], 1.0, parameters=[0.1])


def test_a_rate_that_is_not_a_number_names_its_state():
    """The root of x is not a number below zero, which x reaches at 0.25 s."""

    def rates_of(g, x, _):
        return [g.constant(-1.0), g.node("sqrt", x[0]), g.negate(x[2])]

    with pytest.raises(SimulationError, match=r"t = 0.2 s: m.x\[1\] changes too fast"):
        run(model_of(rates_of, 3), [0.25, 0.0, 0.0], 1.0)
