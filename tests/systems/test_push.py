"""The pulse of a push, and loops with a push in both engines."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from kneexo.parameters import PushParameters, Scenario
from kneexo.simulation import simulate
from kneexo.systems import Push

T = 0.002


@pytest.mark.parametrize(
    ("start_s", "duration_s", "first", "end"),
    [(0.0, T, 0, 1), (2 * T, 2 * T, 2, 4), (0.0051, 0.0011, 3, 4), (3 * 0.002, 0.3, 3, 10)],
)
def test_the_pulse_begins_and_ends_at_samples(start_s, duration_s, first, end):
    push = Push(PushParameters(torque_n_m=-7.0, start_s=start_s, duration_s=duration_s), T)
    simulator = Simulator(push)
    simulator.Initialize()
    torques = []
    for tick in range(10):
        simulator.AdvanceTo((tick + 0.5) * T)
        torques.append(push.GetOutputPort("knee_torque").Eval(simulator.get_context())[0])
    assert torques == [-7.0 if first <= tick < end else 0.0 for tick in range(10)]


def pushed(torque_n_m, **push):
    load = {"kind": "knee", "inertia_kg_m2": 0.1}
    return Scenario(
        plant={"load": load},
        reference={"kind": "step", "start_deg": 40.0, "end_deg": 40.0},
        push={"torque_n_m": torque_n_m} | push,
        simulation={"duration_s": 0.06},
    )


@pytest.mark.slow
def test_drake_and_the_compiled_engine_push_alike():
    scenario = pushed(30.0, start_s=0.02, duration_s=0.02)
    angles = [
        simulate(scenario.with_engine(engine).with_steps(step_s))["knee_angle_rad"]
        for engine, step_s in (("compiled", 1e-4), ("drake", 5e-5))
    ]
    free = simulate(scenario.changed({"push": None}).with_steps(1e-4))["knee_angle_rad"]
    np.testing.assert_array_equal(angles[0][:11], free[:11])
    moved = np.max(np.abs(angles[0] - free))
    assert math.degrees(moved) > 0.02
    np.testing.assert_allclose(angles[0], angles[1], rtol=0.0, atol=0.02 * moved)


@pytest.mark.slow
def test_a_push_for_the_whole_run_is_a_constant_torque():
    scenario = pushed(12.0, start_s=0.0, duration_s=0.06)
    constant = scenario.changed({"push": None, "plant.load.knee_torque_n_m": 12.0})
    # At the start the cylinder holds the constant torque, but not yet that of a push.
    runs = [simulate(s)["knee_angle_rad"] for s in (scenario, constant)]
    free = simulate(scenario.changed({"push": None}))["knee_angle_rad"]
    assert runs[0][-1] > free[-1]  # a positive torque flexes
    assert abs(runs[0][-1] - runs[1][-1]) < 0.5 * abs(runs[0][-1] - free[-1])
