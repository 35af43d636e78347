import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from diagramc import read_diagram
from diagramc.c.plan import compensated_sums
from diagramc.c.printer import FLOAT
from diagramc.testing import check_leaf
from kneexo.parameters import BldcPumpParameters, CylinderParameters, PidParameters, PlantParameters
from kneexo.systems import PidController

# Lee et al. 2020, Tables 2 and 3.
AREA, DISPLACEMENT, GEAR = 274.8894e-6, 0.8e-6 / (2.0 * math.pi), 6.0
SPEED_GAIN = GEAR * AREA / DISPLACEMENT
LIMIT = 5000.0 * 2.0 * math.pi / 60.0
T = 0.002
GAINS = {
    "proportional_per_s": 8.0,
    "integral_per_s2": 30.0,
    "derivative": 0.4,
    "filter_s": 0.015,
    "anti_windup_s": 0.05,
    "velocity_feedforward": 0.7,
    "moment_arm_m": 0.09,
}
INPUTS = {
    "knee_angle": [(0.5, 0.52)],
    "knee_reference": [(0.5, 0.52), (-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0)],
    "rod_reference": [(0.05, 0.1), (-0.01, 0.01), (-1.0, 1.0), (-1.0, 1.0)],
}
FAR = INPUTS | {"knee_angle": [(1.0, 1.4)]}
STATE = [(-500.0, 500.0), (-0.02, 0.02), (-0.02, 0.02)]


def at(system, knee_angle=0.5, knee_reference=0.5, rod_velocity=0.0, state=(0.0, 0.0, 0.0)):
    context = system.CreateDefaultContext()
    system.GetInputPort("knee_angle").FixValue(context, knee_angle)
    system.GetInputPort("knee_reference").FixValue(context, [knee_reference, 0.0, 0.0, 0.0])
    system.GetInputPort("rod_reference").FixValue(context, [0.07, rod_velocity, 0.0, 0.0])
    context.SetDiscreteState(0, list(state))
    return context


def update(system, *arguments, **values):
    context = at(system, *arguments, **values)
    return system.EvalUniquePeriodicDiscreteUpdate(context).get_vector(0).CopyToVector()


def settled(system, error):
    """The command once the filter has reached a constant error."""
    return update(system, 0.0, error, state=(0.0, 0.0, error))[0]


def written_out(error, rod_velocity, state, limit=LIMIT, gain=SPEED_GAIN, dt=T):
    """The law with `GAINS`, as difference equations."""
    _, integral, filtered = state
    decay = math.exp(-dt / 0.015)
    filtered = decay * filtered + (1.0 - decay) * error
    rate = 8.0 * filtered + integral + 0.4 * (error - filtered) / 0.015
    unlimited = gain * (0.7 * rod_velocity - 0.09 * rate)
    limited = min(max(unlimited, -limit), limit)
    surplus = (unlimited - limited) / (gain * 0.09)  # knee rate that the limit takes away, negative
    return [limited, integral + dt * (30.0 * error + surplus / 0.05), filtered]


# ----------------------------------------------------------------------------- conversion


@pytest.mark.parametrize("ranges", [INPUTS, FAR], ids=["near", "limited"])
def test_conversions_agree_and_keep_arguments_and_changes(ranges):
    system = PidController(
        PidParameters(**GAINS, sample_time_s=0.004),
        PlantParameters(pump=BldcPumpParameters(gear_ratio=5.0)),
    )
    check_leaf(system, ranges | {"discrete_state": STATE})


# -------------------------------------------------------------------------------- numbers


@pytest.mark.parametrize("ranges", [INPUTS, FAR], ids=["near", "limited"])
def test_random_points_meet_the_written_out_law(leaf, ranges):
    probe = leaf.Probe(PidController(PidParameters(**GAINS)), ranges, STATE)
    for z in probe.points(50):
        error, state = z[2] - z[1], z[10:13]
        expected = written_out(error, z[7], state)
        # Seven printed digits of the area; sums of terms of up to 1e3 rad/s.
        np.testing.assert_allclose(probe.results(z), [state[0], *expected], rtol=1e-6, atol=1e-3)


def test_command_gain_follows_gear_area_and_displacement():
    plant = PlantParameters(
        pump=BldcPumpParameters(gear_ratio=3.0, displacement_m3_per_rad=2e-7),
        cylinder=CylinderParameters(bore_m=0.03, rod_diameter_m=0.01),
    )
    area = math.pi / 4.0 * (0.03**2 - 0.5 * 0.01**2)
    command = settled(PidController(PidParameters(), plant), 0.01)
    assert command == pytest.approx(-5.0 * 0.1 * 0.01 * 3.0 * area / 2e-7, rel=1e-12)


def test_a_saturated_controller_without_integral_action_keeps_no_memory_of_its_limit():
    system = PidController()  # K_p alone
    state = np.zeros(3)
    for _ in range(1000):
        state = update(system, 0.5, 1.5, state=state)
    assert state[0] == pytest.approx(-LIMIT)
    assert state[1] == 0.0
    for _ in range(1000):  # 100 time constants of the filter
        state = update(system, 0.5, 0.5, state=state)
    assert state[0] == pytest.approx(0.0, abs=1e-9)


def test_the_integral_is_a_sum_that_exported_c_compensates():
    inputs = ("knee_angle", "knee_reference", "rod_reference")
    equations = read_diagram(PidController(), inputs=inputs)
    assert 1 in compensated_sums(equations.equations, FLOAT)


def test_initial_error_gives_no_derivative_kick():
    system = PidController(PidParameters(proportional_per_s=0.0, derivative=0.3))
    simulator = Simulator(system, at(system, 0.3, 0.5))
    context = simulator.get_context()
    simulator.Initialize()
    assert context.get_discrete_state(0).CopyToVector() == pytest.approx([0.0, 0.0, 0.2])
    simulator.AdvanceTo(0.1)
    assert system.GetOutputPort("motor_speed_command").Eval(context)[0] == 0.0
    kick = update(system, 0.3, 0.5)[0]  # from z = 0 there would be one
    assert abs(kick) == LIMIT


# ------------------------------------------------------------------------------ bad input


def test_nan_angle_is_not_hidden_by_the_limit():
    system = PidController()
    simulator = Simulator(system, at(system, math.nan))
    simulator.AdvanceTo(0.01)
    assert np.isnan(system.GetOutputPort("motor_speed_command").Eval(simulator.get_context()))
