import math

import numpy as np
import pytest
from hydraulics import LIMIT, PUMP, PUMP_INPUTS, acceleration, output, response

from diagramc.testing import check_leaf
from kneexo.errors import SimulationError
from kneexo.systems import BldcPump

# ----------------------------------------------------------------------------- conversion


@pytest.mark.parametrize("ideal", [False, True], ids=["lag", "ideal"])
def test_conversions_agree_and_keep_arguments_and_changes(ideal):
    state = {} if ideal else {"continuous_state": (-0.6, 0.6)}
    check_leaf(BldcPump(PUMP, ideal), PUMP_INPUTS | state)


# -------------------------------------------------------------------------------- numbers


def test_random_points_meet_the_written_out_equations(leaf):
    p = PUMP
    probe = leaf.Probe(BldcPump(p), PUMP_INPUTS, [(-0.6, 0.6)])
    for z in probe.points(50):
        _, command, pressure, krad_s = z[:4]
        speed = 1e3 * krad_s
        limited = min(max(command, -LIMIT), LIMIT)
        rate = min(max((limited - speed) / p.lag_s, -1e4), 1e4)
        displacement = 0.8e-6 / (2.0 * math.pi)
        flow = displacement * speed / 5.0 - (3e-13 + 4e-13 / 2.0) * pressure
        torque = displacement * pressure / 5.0
        expected = [speed, flow, torque, torque * speed, flow * pressure, 1e-3 * rate]
        # Rounding; the flow is a difference of terms of equal size.
        np.testing.assert_allclose(probe.results(z), expected, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("ideal", [False, True], ids=["lag", "ideal"])
def test_leakage_is_the_only_power_lost(ideal):
    system, pressure = BldcPump(PUMP, ideal), -2.5e6
    values = {"command": 300.0, "speed": 300.0, "pressure": pressure}
    lost = output(system, "shaft_power", **values) - output(system, "hydraulic_power", **values)
    assert lost == pytest.approx(5e-13 * pressure**2, rel=1e-11)  # difference of 20 W and 20 W


def test_step_within_the_limits_is_a_first_order_lag():
    times = np.array([0.002, 0.005, 0.01, 0.03, 0.08])
    speeds = response(BldcPump(), -80.0, times)  # asks for 8000 rad/s², below the limit of 1e4
    # The integrator's accuracy of 1e-9 krad/s, some ten times over.
    np.testing.assert_allclose(speeds, -80.0 * (1.0 - np.exp(-times / 0.010)), atol=1e-5)


def test_step_beyond_the_acceleration_limit_is_a_ramp_and_then_a_lag():
    times = np.array([0.01, 0.03, 0.0399, 0.045, 0.06, 0.1])
    speeds = response(BldcPump(), 500.0, times)
    # At 1e4 rad/s² until 100 rad/s = 1e4 · 10 ms are missing, at 40 ms.
    late = 500.0 - 100.0 * np.exp(-(times - 0.04) / 0.010)
    # The kink at 40 ms costs the integrator some accuracy: error control meets it with 1e-9.
    np.testing.assert_allclose(speeds, np.where(times < 0.04, 1e4 * times, late), atol=1e-4)


# ------------------------------------------------------------------------------ bad input


def test_nan_command_raises_instead_of_hanging():
    with pytest.raises(SimulationError, match="motor"):
        acceleration(BldcPump(), command=math.nan)
