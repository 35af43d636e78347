"""Fits to real records of hydraulic machines. The records state no units and no geometry.

What they cannot show: values in SI units, and whether a structure is right. The residuals of each
model fail the test for whiteness, that of the motor with hysteresis too. The command of the load
comes from a controller, so its fit in open loop is biased by noise that returns through the
controller.
"""

from pathlib import Path

import numpy as np
import pytest
from pydrake.symbolic import Variable, max as larger, min as smaller, tanh
from pydrake.systems.primitives import SymbolicVectorSystem

from diagramc import Log, State, Unknown, compile_diagram, identify

RECORDS = Path(__file__).parent / "records"


def columns(name):
    return np.loadtxt(RECORDS / f"{name}.csv.xz", delimiter=",").T


def compiled(states, inputs, parameters, rates, measured):
    return compile_diagram(
        SymbolicVectorSystem(
            state=states, input=inputs, parameter=parameters, dynamics=rates, output=measured
        ),
        inputs=["u0"],
    )


def variables(names):
    return [Variable(name) for name in names.split()]


def unknowns(*ranges):
    return [Unknown(f".0[{i}]", *ends) for i, ends in enumerate(ranges)]


@pytest.mark.slow(gate=0)
def test_a_hanging_load_on_a_valve_with_dead_band():
    time_s, _, position, command = columns("hanging_load")
    x, v, u, *p = variables("x v u up down above below lag")
    flow = p[0] * larger(u - p[2], 0.0) + p[1] * smaller(u - p[3], 0.0)
    model = compiled([x, v], [u], p, [v, (flow - v) / p[4]], [x])
    asked = unknowns((0.5, 20.0), (0.2, 20.0), (-0.3, 0.5), (-1.0, -0.1), (0.01, 1.0))
    log = Log(time_s, {"y0": position}, 0.02, {"u0": command})
    fit = identify(model, log, [*asked, Unknown(".x[0]", 0.0, 1.0)])
    assert fit.values[".0[0]"] > 1.5 * fit.values[".0[1]"]  # the load hinders up, helps down
    assert fit.train["y0"] == pytest.approx(97.84, abs=0.2)
    assert fit.validation["y0"] == pytest.approx(84.87, abs=1.0)
    assert fit.whiteness["y0"] < 0.05


@pytest.mark.slow
def test_a_motor_without_its_hysteresis_is_not_white():
    time_s, current, rotation = columns("MotorRotation")
    y, z, u, *p = variables("y z u gain slope dead offset lag play")

    def rate(driven):
        return (p[0] * tanh(p[1] * larger(driven - p[2], 0.0)) + p[3] - y) / p[4]

    follower = 50.0 * (larger(u - p[5] - z, 0.0) + smaller(u + p[5] - z, 0.0))
    asked = unknowns((1, 10), (0.05, 2), (0.01, 1), (-0.2, 0.2), (0.01, 2), (0.01, 0.5))
    log = Log(time_s, {"y0": rotation}, 0.02, {"u0": current})
    without, with_play = (
        identify(compiled(*model), log, known, validation=0.0)
        for model, known in (
            (([y], [u], p[:5], [rate(u)], [y]), asked[:5]),
            (([y, z], [u], p, [rate(z), follower], [y]), asked),
        )
    )
    assert without.whiteness["y0"] < 0.05
    assert any("the residuals are not white (p = 0" in note for note in without.notes)
    assert with_play.noise["y0"] < 0.5 * without.noise["y0"]
    assert with_play.correlation_time_s["y0"] < 0.25 * without.correlation_time_s["y0"]
    assert with_play.interval[".0[5]"][0] > 0.05


@pytest.mark.slow
def test_one_of_two_cylinders_on_a_common_supply_moves_the_other():
    time_s, *references, first, second = columns("MultivariableCylinders")
    a, b, ra, rb, *p = variables("a b ra rb k0 k1 most0 most1 c01 c10 bias0 bias1")
    toward = [
        larger(smaller(p[i] * (r + p[6 + i] - x), p[2 + i]), -p[2 + i])
        for i, (x, r) in enumerate(((a, ra), (b, rb)))
    ]
    rates = [toward[0] + p[4] * toward[1], toward[1] + p[5] * toward[0]]
    model = compiled([a, b], [ra, rb], p, rates, [a, b])
    # The rows show the position of a sample later than the reference.
    late = [Unknown(f"y0[{i}].delay_s", -0.2, 0.2) for i in range(2)]
    asked = unknowns(*[(0.3, 30)] * 2, *[(2, 100)] * 2, *[(-1, 1)] * 4)
    measured = {"y0[0]": first, "y0[1]": second}
    log = Log(time_s, measured, 0.1, {"u0": np.transpose(references)})
    start = State(np.array([first[0], second[0]]), np.zeros(0))
    fit = identify(model, log, [*asked, *late], state=start)
    assert fit.interval[".0[5]"][1] < -0.05  # of the first cylinder on the second
    assert fit.interval[".0[4]"][0] < 0.0 < fit.interval[".0[4]"][1]
    assert max(fit.interval[late[0].name][1], fit.interval[late[1].name][1]) < 0.0
    assert min(fit.validation.values()) == pytest.approx(90.0, abs=1.0)
