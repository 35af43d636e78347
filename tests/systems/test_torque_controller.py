import math

import numpy as np
import pytest
from table_1 import P_MM_DEG

from diagramc import read_diagram
from diagramc.c.plan import compensated_sums
from diagramc.c.printer import FLOAT
from diagramc.testing import check_leaf
from kneexo.parameters import TorqueParameters
from kneexo.systems import TorqueController

# Lee et al. 2020, Tables 1, 2 and 3.
GAIN = 6.0 * 274.8894e-6 / (0.8e-6 / (2.0 * math.pi))
LIMIT = 5000.0 * 2.0 * math.pi / 60.0
T = 0.002
NUMBERS = {
    "proportional_rad_s_per_n": 1.5,
    "integral_rad_s2_per_n": 20.0,
    "leak_per_s": 0.3,
    "speed_feedforward": 0.8,
    "anti_windup_s": 0.05,
    "timeout_s": 0.006,
    "torque_limit_n_m": 25.0,
    "assistance": 0.3,
    "stiffness_n_m_per_rad": 80.0,
    "damping_n_m_s_per_rad": 2.0,
    "band_rad": 0.05,
}
MODES = ["zero_torque", "assist", "impedance", "assist_as_needed"]
INPUTS = {
    "measured_force": [(-50.0, 50.0), (0.0, 0.002)],
    "estimated_state": [(0.05, 0.1), (-0.01, 0.01), (-1.0, 1.0)],
    "knee_angle": [(0.5, 0.9)],
    "knee_reference": [(0.5, 0.9), (-0.2, 0.2), (-1.0, 1.0), (-1.0, 1.0)],
}
STATE = [(-100.0, 100.0), (-50.0, 50.0)]


def ranges_of(mode, **changes):
    moment = {"biological_moment": [(-60.0, 60.0)]} if mode == "assist" else {}
    return INPUTS | moment | changes


def arm(angle):
    slope = np.polyval(np.polyder(P_MM_DEG), math.degrees(angle))
    return -1e-3 * slope * 180.0 / math.pi


def desired(mode, angle, velocity, reference, moment=0.0):
    deviation = angle - reference[0]
    torque = {
        "zero_torque": 0.0,
        "assist": 0.3 * moment,
        "impedance": -80.0 * deviation - 2.0 * (-velocity / arm(angle) - reference[1]),
        "assist_as_needed": -80.0 * math.copysign(max(abs(deviation) - 0.05, 0.0), deviation),
    }[mode]
    return min(max(torque, -25.0), 25.0)


def written_out(mode, force, velocity, angle, reference, state, moment=0.0):
    """Command and integral after an update, with `NUMBERS`."""
    _, integral = state
    error = -desired(mode, angle, velocity, reference, moment) / arm(angle) - force
    integral += T * (20.0 * error - 0.3 * integral)
    unlimited = 1.5 * error + integral + 0.8 * GAIN * velocity
    command = min(max(unlimited, -LIMIT), LIMIT)
    return [command, integral + T * (command - unlimited) / 0.05]


def update(system, state=(0.0, 0.0), **values):
    inputs = {
        "measured_force": [0.0, 0.0],
        "estimated_state": [0.07, 0.0, 0.0],
        "knee_angle": 0.8,
        "knee_reference": [0.8, 0.0, 0.0, 0.0],
        **values,
    }
    context = system.CreateDefaultContext()
    for name, value in inputs.items():
        system.GetInputPort(name).FixValue(context, value)
    context.SetDiscreteState(0, list(state))
    return system.EvalUniquePeriodicDiscreteUpdate(context).get_vector(0).CopyToVector()


# ----------------------------------------------------------------------------- conversion


@pytest.mark.parametrize("mode", MODES)
def test_conversions_agree_and_keep_arguments_and_changes(mode):
    system = TorqueController(TorqueParameters(mode=mode, **NUMBERS))
    check_leaf(system, ranges_of(mode) | {"discrete_state": STATE})


# -------------------------------------------------------------------------------- numbers


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("force", [50.0, 900.0], ids=["near", "limited"])
def test_random_points_meet_the_written_out_law(leaf, mode, force):
    ranges = ranges_of(mode, measured_force=[(force - 50.0, force), (0.0, 0.002)])
    system = TorqueController(TorqueParameters(mode=mode, **NUMBERS))
    probe = leaf.Probe(system, ranges, STATE)
    for z in probe.points(50):
        moment = z[11] if mode == "assist" else 0.0
        state = z[12:14] if mode == "assist" else z[11:13]
        arguments = (mode, z[1], z[4], z[6], z[7:11], state, moment)
        torque = desired(mode, z[6], z[4], z[7:11], moment)
        expected = [state[0], torque, *written_out(*arguments)]
        # Seven printed digits of the area; sums of terms of up to 1e3 rad/s.
        np.testing.assert_allclose(probe.results(z), expected, rtol=1e-6, atol=1e-3)


def test_a_flexing_torque_is_a_pulling_rod():
    system = TorqueController(TorqueParameters(mode="assist", assistance=1.0))
    # 5 N·m at 45 deg: r = 101.9 mm/rad after Table 1.
    pull = -5.0 / 0.1019
    angle = math.radians(45.0)
    command = update(system, measured_force=[pull, 0.0], knee_angle=angle, biological_moment=5.0)
    assert command[0] == pytest.approx(0.0, abs=4.0 * 0.05)  # K_p, last digit of r


def test_without_integral_action_there_is_no_memory():
    system = TorqueController(TorqueParameters(integral_rad_s2_per_n=0.0))
    assert update(system, (0.0, 12.0), measured_force=[900.0, 0.0])[1] == 0.0


def test_an_old_reading_holds_the_motor_and_clears_the_integral():
    system = TorqueController(TorqueParameters(**NUMBERS))
    assert update(system, (9.0, 9.0), measured_force=[40.0, 0.0059])[0] != 0.0
    assert list(update(system, (9.0, 9.0), measured_force=[40.0, 0.0061])) == [0.0, 0.0]


def test_the_integral_is_a_sum_that_exported_c_compensates():
    equations = read_diagram(TorqueController(), inputs=tuple(INPUTS))
    assert 1 in compensated_sums(equations.equations, FLOAT)
