import math

import numpy as np
import pytest
from hydraulics import LIMIT, PUMP, PUMP_INPUTS, RPM, acceleration, output, response

from diagramc.testing import check_leaf
from kneexo.parameters import MotorParameters
from kneexo.systems import TorqueLimitedPump

LIMITED_INPUTS = PUMP_INPUTS | {"torque_off": [(0.0, 1.0)], "dynamic_brake": [(0.0, 1.0)]}


DRY = {"viscous_torque_n_m_s_per_rad": 0.0}


GEARED = 0.8e-6 / (2.0 * math.pi) / 6.0  # torque at the motor per pressure of the oil, in m³/rad


def limited(**values):
    return TorqueLimitedPump(motor=MotorParameters(**values))


@pytest.mark.parametrize("supply", [4.0, 24.0])
def test_conversions_with_torque_agree_and_keep_arguments_and_changes(supply):
    system = TorqueLimitedPump(PUMP, MotorParameters(supply_voltage_v=supply))
    inputs = LIMITED_INPUTS | {"dynamic_brake": [(0.0, 0.4)]}  # braked, the voltage is zero
    check_leaf(system, inputs | {"continuous_state": (-0.3, 0.3)})


def test_random_points_meet_the_written_out_torque_current_and_voltage(leaf):
    n = MotorParameters(
        inertia_kg_m2=3e-5, torque_constant_n_m_per_a=0.05, resistance_ohm=0.4,
        coulomb_torque_n_m=0.03, viscous_torque_n_m_s_per_rad=4e-5, friction_band_rad_s=40.0,
        supply_voltage_v=15.0, current_limit_a=6.0,
    )  # fmt: skip
    probe = leaf.Probe(TorqueLimitedPump(PUMP, n), LIMITED_INPUTS, [(-0.5, 0.5)])
    limits = set()
    for z in probe.points(200):
        _, command, pressure, torque_off, brake, krad_s = z[:6]
        speed = 1e3 * krad_s
        wanted = min(max((min(max(command, -LIMIT), LIMIT) - speed) / 0.010, -1e4), 1e4)
        load = 0.8e-6 / (2.0 * math.pi) * pressure / 5.0
        load += 0.03 * math.tanh(speed / 40.0) + 4e-5 * speed
        current = (3e-5 * wanted + load) / 0.05
        limit = "none"
        if abs(0.05 * speed + 0.4 * current) > 15.0:
            limit = "supply"
            current = (math.copysign(15.0, 0.05 * speed + 0.4 * current) - 0.05 * speed) / 0.4
        if abs(current) > 6.0:
            limit, current = "current", math.copysign(6.0, current)
        if torque_off > 0.5:
            limit, current = "torque off", 0.0
        if brake > 0.5:
            limit, current = "brake", -0.05 * speed / 0.4
        limits.add(limit)
        expected = [current, 0.05 * speed + 0.4 * current, 1e-3 * (0.05 * current - load) / 3e-5]
        # The torque of the oil, up to 0.08 N·m, cancels in the acceleration.
        np.testing.assert_allclose(probe.results(z)[-3:], expected, rtol=1e-9, atol=1e-12)
    assert limits == {"none", "supply", "current", "torque off", "brake"}


@pytest.mark.parametrize("supply", [12.0, 18.0])
def test_a_sagging_supply_sets_the_speed_without_load(supply):
    """U = k_t ω + R (T_c + b ω)/k_t."""
    (speed,) = response(limited(supply_voltage_v=supply), LIMIT, [0.5])
    per_ohm = 0.04 / 0.15
    expected = (supply * per_ohm - 0.01) / (0.04 * per_ohm + 1e-5)
    assert speed == pytest.approx(expected, rel=1e-6)
    assert speed < 0.9 * LIMIT


def test_a_dead_motor_coasts_down_by_its_friction():
    """J dω/dt = −T_c tanh(ω/ω_0) makes sinh(ω/ω_0) decay with the rate T_c/(J ω_0)."""
    dead = MotorParameters(current_limit_a=0.0, **DRY)
    times = np.array([0.01, 0.05, 0.1, 0.13])
    speeds = response(TorqueLimitedPump(motor=dead), 0.0, times, speed=60.0)
    expected = 10.0 * np.arcsinh(np.sinh(6.0) * np.exp(-0.01 / (2e-5 * 10.0) * times))
    np.testing.assert_allclose(speeds, expected, rtol=1e-4)
    viscous = MotorParameters(current_limit_a=0.0, coulomb_torque_n_m=0.0)
    (slow,) = response(TorqueLimitedPump(motor=viscous), 0.0, [0.5], speed=60.0)
    assert slow == pytest.approx(60.0 * math.exp(-1e-5 / 2e-5 * 0.5), rel=1e-5)


def test_the_dynamic_brake_is_a_viscous_damper_that_no_limit_or_command_weakens():
    """J dω/dt = −(k_t²/R + b) ω: the current may exceed the limit of the drive."""
    motor = MotorParameters(coulomb_torque_n_m=0.0, current_limit_a=0.0, supply_voltage_v=0.0)
    values = {"command": LIMIT, "dynamic_brake": 1.0, "torque_off": 1.0, "speed": 300.0}
    current = -0.04 * 300.0 / 0.15
    pump = TorqueLimitedPump(motor=motor)
    assert output(pump, "motor_current", **values) == pytest.approx(current, rel=1e-12)
    assert output(pump, "motor_voltage", **values) == pytest.approx(0.0, abs=1e-12)
    rate = -(0.04**2 / 0.15 + 1e-5) / 2e-5
    assert acceleration(pump, **values) == pytest.approx(300.0 * rate, rel=1e-12)
    released = values | {"dynamic_brake": 0.0}
    assert acceleration(pump, **released) == pytest.approx(-300.0 * 1e-5 / 2e-5)


def test_the_oil_turns_a_braked_motor_at_the_speed_of_its_damping():
    """Without friction ω = −D_m P_L R/(gear k_t²), 67 rpm at the relief pressure."""
    torque = GEARED * 3.5e6
    values = {"pressure": 3.5e6, "dynamic_brake": 1.0, "speed": -torque * 0.15 / 0.04**2}
    assert values["speed"] == pytest.approx(-67.0 * RPM, rel=0.01)
    rate = acceleration(limited(coulomb_torque_n_m=0.0, **DRY), **values)
    assert rate == pytest.approx(0.0, abs=1e-12 * torque / 2e-5)


def test_a_locked_shaft_takes_the_current_limit_and_hardly_turns():
    """The friction of 10 N·m balances 0.6 N·m at ω_0 artanh(0.06), which is 6 rpm."""
    (speed,) = response(limited(coulomb_torque_n_m=10.0, **DRY), LIMIT, [0.02])
    assert speed == pytest.approx(10.0 * math.atanh(0.06), rel=1e-4)
    assert speed < 0.002 * LIMIT


def test_at_5000_rpm_the_brake_takes_140_a():
    current = output(limited(), "motor_current", speed=LIMIT, dynamic_brake=1.0)
    assert current == pytest.approx(-140.0, rel=0.01)
