"""Periodic orbits: known periods and multipliers, an independent integrator, Drake's Simulator."""

import math

import numpy as np
import pytest
from pydrake.examples import PendulumPlant, VanDerPolOscillator
from pydrake.symbolic import Expression, Variable, atan, cos, sin
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    Gain,
    MatrixGain,
    Sine,
    SymbolicVectorSystem,
    ZeroOrderHold,
)
from scipy.integrate import solve_ivp

from kneexo.compiler import LinearizationError, ParameterError, periodic_orbit


def test_van_der_pols_limit_cycle():
    plant = VanDerPolOscillator()
    context = plant.CreateDefaultContext()
    context.SetContinuousState([2.0, 0.1])
    orbit = periodic_orbit(plant, context, period_s=6.5, step_s=1e-3)
    assert orbit.period_s == pytest.approx(6.66328685932313, rel=1e-10)  # for mu = 1
    # The product of the multipliers is exp ∫ trace = exp ∫ (1 − x²) dt over the period.
    start = orbit.model.operating_point.state
    path = solve_ivp(
        lambda t, z: [z[1], (1.0 - z[0] ** 2) * z[1] - z[0], 1.0 - z[0] ** 2],
        (0.0, orbit.period_s),
        [*start, 0.0],
        method="DOP853",
        rtol=1e-12,
        atol=1e-12,
    )
    assert path.y[:2, -1] == pytest.approx(start, abs=1e-9)
    assert orbit.multipliers == pytest.approx([1.0, math.exp(path.y[2, -1])], abs=1e-8)
    assert orbit.autonomous
    assert orbit.stable
    assert repr(orbit) == "PeriodicOrbit(autonomous, period_s=6.66329, stable=True)"
    state = orbit.context.get_continuous_state_vector().CopyToVector()
    assert (state == start).all()


@pytest.mark.slow
def test_mathieus_equation_has_the_monodromy_of_an_independent_integrator():
    x, v, t, u = (Variable(name) for name in "xvtu")
    plant = SymbolicVectorSystem(
        time=t,
        state=[x, v],
        input=[u],
        dynamics=[v, -(1.1 + 0.4 * cos(t)) * x - 0.1 * v + u],
        output=[3.0 * x + u],
    )
    orbit = periodic_orbit(
        plant, period_s=2.0 * math.pi, inputs=["u0"], outputs=["y0"], step_s=1e-3
    )

    def rates(t, z, drive):
        return [z[1], -(1.1 + 0.4 * math.cos(t)) * z[0] - 0.1 * z[1] + drive]

    starts = ((1.0, 0.0), 0.0), ((0.0, 1.0), 0.0), ((0.0, 0.0), 1.0)
    for column, (start, drive) in enumerate(starts):
        path = solve_ivp(
            rates,
            (0.0, 2.0 * math.pi),
            start,
            args=(drive,),
            rtol=1e-12,
            atol=1e-13,
            method="DOP853",
        )
        ours = np.hstack([orbit.model.a, orbit.model.b])[:, column]
        assert ours == pytest.approx(path.y[:, -1], abs=1e-9)
    assert orbit.model.c.tolist() == [[3.0, 0.0]]
    assert orbit.model.d.tolist() == [[1.0]]
    assert not orbit.autonomous


@pytest.fixture
def driven_pendulum():
    """A pendulum under a sine with the period 1 s and a feedback, both sampled every 1/16 s."""
    builder = DiagramBuilder()
    sine = builder.AddNamedSystem("sine", Sine(2.0, 2.0 * math.pi, 0.4, 1))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(1 / 16, 1))
    total = builder.AddNamedSystem("total", Adder(3, 1))
    pendulum = builder.AddNamedSystem("pendulum", PendulumPlant())
    law = builder.AddNamedSystem("law", MatrixGain([[0.0, -0.2]]))
    back = builder.AddNamedSystem("back", ZeroOrderHold(1 / 16, 1, offset_sec=1 / 32))
    gain = builder.AddNamedSystem("gain", Gain(1.0, 1))
    builder.Connect(sine.get_output_port(0), hold.get_input_port())
    builder.Connect(hold.get_output_port(), total.get_input_port(0))
    builder.Connect(pendulum.get_output_port(), law.get_input_port())
    builder.Connect(law.get_output_port(), back.get_input_port())
    builder.Connect(back.get_output_port(), total.get_input_port(1))
    builder.ExportInput(gain.get_input_port(), "u")
    builder.Connect(gain.get_output_port(), total.get_input_port(2))
    builder.Connect(total.get_output_port(), pendulum.get_input_port())
    builder.ExportOutput(pendulum.get_output_port(), "state")
    return builder.Build()


def test_a_sampled_orbit_moves_as_in_drakes_simulator(driven_pendulum, drake_runs):
    context = driven_pendulum.CreateDefaultContext()
    driven_pendulum.GetInputPort("u").FixValue(context, [0.1])
    orbit = periodic_orbit(
        driven_pendulum, context, period_s=1.0, inputs=["u"], outputs=["state"], step_s=1e-3
    )
    assert orbit.stable
    assert len(orbit.model.state_names) == 4
    runs = drake_runs(driven_pendulum, orbit.context, ["u"])
    end = runs.end(runs.state, runs.values, 1.0)[:4]
    assert end == pytest.approx(orbit.model.operating_point.state, abs=1e-8)
    moved = runs.jacobian(1.0)[:4]
    ours = np.hstack([orbit.model.a, orbit.model.b])
    np.testing.assert_allclose(ours, moved, rtol=0.0, atol=1e-7)
    with pytest.raises(LinearizationError, match="periodic orbit"):
        orbit.model.sine_response([1.0])


@pytest.mark.slow
def test_a_start_that_newton_leaves_is_followed_by_a_transient():
    # x' = −arctan(5 x) + 0.2 sin t: Newton's steps from x = 40 grow, the motion itself decays.
    x, t = Variable("x"), Variable("t")
    plant = SymbolicVectorSystem(
        time=t, state=[x], dynamics=[-10.0 * atan(5.0 * x) + 0.2 * sin(t)], output=[x]
    )
    context = plant.CreateDefaultContext()
    context.SetContinuousState([40.0])
    orbit = periodic_orbit(plant, context, period_s=2.0 * math.pi, step_s=1e-3)
    (start,) = orbit.model.operating_point.state
    path = solve_ivp(
        lambda t, z: -10.0 * np.arctan(5.0 * z) + 0.2 * math.sin(t),
        (0.0, 2.0 * math.pi),
        [start],
        rtol=1e-11,
        atol=1e-13,
    )
    assert path.y[0, -1] == pytest.approx(start, abs=1e-9)
    assert abs(start) < 0.1


def drift(rate):
    (t,) = rate.GetVariables() if isinstance(rate, Expression) else (Variable("t"),)
    return SymbolicVectorSystem(time=t, state=[Variable("x")], dynamics=[rate])


@pytest.mark.parametrize(
    ("error", "match", "plant", "arguments"),
    [
        (ParameterError, "period_s: is missing", VanDerPolOscillator, {}),
        (ParameterError, "period_s = -1 s: must be", VanDerPolOscillator, {"period_s": -1}),
        (LinearizationError, "ends at an equilibrium", VanDerPolOscillator, {"period_s": 6.0}),
        (
            LinearizationError,
            "has no states",
            lambda: ConstantVectorSource([1.0]),
            {"period_s": 1.0},
        ),
        (
            LinearizationError,
            "the period of the search ends at 0 s",
            lambda: drift(1.0),
            {"period_s": 1.0},
        ),
        (
            LinearizationError,
            r"in 6\.28319 s x\[0\] changes by 6\.28319; start nearer",
            lambda: drift(1.0 + sin(Variable("t"))),
            {"period_s": 2.0 * math.pi},
        ),
    ],
)
def test_no_orbit_is_one_line(error, match, plant, arguments):
    with pytest.raises(error, match=rf"\A(?=.*{match})[^\n]*\Z"):
        periodic_orbit(plant(), **arguments)


@pytest.mark.parametrize("step_s", [0.0, -1.0, math.nan, "x", True])
def test_a_step_that_is_not_positive_is_refused(step_s):
    with pytest.raises(ParameterError, match=r"\Astep_s = .*must be .*finite and > 0\Z"):
        periodic_orbit(VanDerPolOscillator(), period_s=6.6, step_s=step_s)
