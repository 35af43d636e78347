import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from kneexo.errors import SimulationError
from kneexo.parameters import BldcPumpParameters, MotorParameters
from kneexo.systems import BldcPump
from kneexo.systems.bldc_pump import shaft_loss

RPM = 2.0 * math.pi / 60.0
LIMIT = 5000.0 * RPM
MEAN_AREA = 274.8894e-6  # Lee et al. 2020, Table 2
PARAMETERS = BldcPumpParameters(
    gear_ratio=5.0, internal_leakage_m3_per_s_pa=3e-13, external_leakage_m3_per_s_pa=4e-13
)
INPUTS = {"motor_speed_command": [(-600.0, 600.0)], "load_pressure": [(-3e6, 3e6)]}
LIMITED_INPUTS = INPUTS | {"torque_off": [(0.0, 1.0)], "dynamic_brake": [(0.0, 1.0)]}


def at(system, *, command=0.0, pressure=0.0, speed=0.0, **releases):
    context = system.CreateDefaultContext()
    for name, value in releases.items():
        system.GetInputPort(name).FixValue(context, value)
    system.GetInputPort("motor_speed_command").FixValue(context, command)
    system.GetInputPort("load_pressure").FixValue(context, pressure)
    if context.num_continuous_states():
        context.SetContinuousState([1e-3 * speed])
    return context


def output(system, name, **values):
    return system.GetOutputPort(name).Eval(at(system, **values))[0]


def acceleration(system, **values):
    return 1e3 * system.EvalTimeDerivatives(at(system, **values)).CopyToVector()[0]


def response(command, times, pressure=0.0, speed=0.0, motor=None):
    system = BldcPump(motor=motor)
    simulator = Simulator(system, at(system, command=command, pressure=pressure, speed=speed))
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    simulator.get_mutable_integrator().set_maximum_step_size(1e-3)
    speeds = []
    for time in times:
        simulator.AdvanceTo(time)
        speeds.append(system.GetOutputPort("motor_speed").Eval(simulator.get_context())[0])
    return np.array(speeds)


# ----------------------------------------------------------------------------- conversion


@pytest.mark.parametrize("ideal", [False, True], ids=["lag", "ideal"])
def test_conversions_agree_and_keep_arguments_and_changes(leaf, ideal):
    probe = leaf.Probe(BldcPump(PARAMETERS, ideal), INPUTS, [] if ideal else [(-0.6, 0.6)])
    probe.check_contract(8, gear_ratio=3.0)


# -------------------------------------------------------------------------------- numbers


def test_random_points_meet_the_written_out_equations(leaf):
    p = PARAMETERS
    probe = leaf.Probe(BldcPump(p), INPUTS, [(-0.6, 0.6)], spread=0.0)
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


def test_5000_rpm_pump_11_1_cm3_per_s_and_move_the_rod_40_4_mm_per_s():
    flow = output(BldcPump(), "load_flow", speed=LIMIT)
    assert flow == pytest.approx(0.8e-6 * 5000.0 / 60.0 / 6.0, rel=1e-14)
    assert flow == pytest.approx(11.1e-6, abs=0.05e-6)  # last printed digit
    assert flow / MEAN_AREA == pytest.approx(40.4e-3, abs=0.05e-3)


def test_full_flow_at_the_rated_pressure_takes_39_w_of_200_w():
    power = output(BldcPump(), "shaft_power", speed=LIMIT, pressure=3.5e6)
    assert power == pytest.approx(39.0, abs=0.5)  # last printed digit


@pytest.mark.parametrize("ideal", [False, True], ids=["lag", "ideal"])
def test_leakage_is_the_only_power_lost(ideal):
    system, pressure = BldcPump(PARAMETERS, ideal), -2.5e6
    values = {"command": 300.0, "speed": 300.0, "pressure": pressure}
    lost = output(system, "shaft_power", **values) - output(system, "hydraulic_power", **values)
    assert lost == pytest.approx(5e-13 * pressure**2, rel=1e-11)  # difference of 20 W and 20 W


def test_step_within_the_limits_is_a_first_order_lag():
    times = np.array([0.002, 0.005, 0.01, 0.03, 0.08])
    speeds = response(-80.0, times)  # asks for 8000 rad/s², below the limit of 1e4
    # The integrator's accuracy of 1e-9 krad/s, some ten times over.
    np.testing.assert_allclose(speeds, -80.0 * (1.0 - np.exp(-times / 0.010)), atol=1e-5)


def test_step_beyond_the_acceleration_limit_is_a_ramp_and_then_a_lag():
    times = np.array([0.01, 0.03, 0.0399, 0.045, 0.06, 0.1])
    speeds = response(500.0, times)
    # At 1e4 rad/s² until 100 rad/s = 1e4 · 10 ms are missing, at 40 ms.
    late = 500.0 - 100.0 * np.exp(-(times - 0.04) / 0.010)
    # The kink at 40 ms costs the integrator some accuracy: error control meets it with 1e-9.
    np.testing.assert_allclose(speeds, np.where(times < 0.04, 1e4 * times, late), atol=1e-4)


def test_speed_settles_at_the_limit_when_more_is_commanded():
    # After 0.25 s the lag has left exp(-20) of 100 rad/s.
    assert response(2000.0, [0.25]) == pytest.approx([LIMIT], abs=1e-5)
    assert response(-2000.0, [0.25]) == pytest.approx([-LIMIT], abs=1e-5)


def test_pressure_does_not_slow_the_speed_controlled_motor():
    assert response(80.0, [0.02], pressure=3e6) == pytest.approx(response(80.0, [0.02]), rel=1e-15)


# --------------------------------------------------------------- torque, current and supply

DRY = {"viscous_torque_n_m_s_per_rad": 0.0}
GEARED = 0.8e-6 / (2.0 * math.pi) / 6.0  # torque at the motor per pressure of the oil, in m³/rad


def limited(**values):
    return BldcPump(motor=MotorParameters(**values))


@pytest.mark.parametrize("supply", [4.0, 24.0])
def test_conversions_with_torque_agree_and_keep_arguments_and_changes(leaf, supply):
    system = BldcPump(PARAMETERS, False, MotorParameters(supply_voltage_v=supply))
    inputs = LIMITED_INPUTS | {"dynamic_brake": [(0.0, 0.4)]}  # braked, the voltage is zero
    leaf.Probe(system, inputs, [(-0.3, 0.3)]).check_contract(11, inertia_kg_m2=3e-5)


def test_random_points_meet_the_written_out_torque_current_and_voltage(leaf):
    n = MotorParameters(
        inertia_kg_m2=3e-5, torque_constant_n_m_per_a=0.05, resistance_ohm=0.4,
        coulomb_torque_n_m=0.03, viscous_torque_n_m_s_per_rad=4e-5, friction_band_rad_s=40.0,
        supply_voltage_v=15.0, current_limit_a=6.0,
    )  # fmt: skip
    probe = leaf.Probe(BldcPump(PARAMETERS, False, n), LIMITED_INPUTS, [(-0.5, 0.5)], spread=0.0)
    limits = set()
    for z in probe.points(100):
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


def test_within_its_limits_the_motor_follows_the_speed_loop():
    for values in ({"command": 90.0, "speed": 30.0}, {"command": -200.0, "speed": -120.0}):
        loaded = values | {"pressure": 2.5e6}
        assert acceleration(limited(), **loaded) == pytest.approx(
            acceleration(BldcPump(), **loaded), rel=1e-9
        )


def test_holding_a_pressure_takes_its_torque_over_the_torque_constant():
    current = output(limited(), "motor_current", pressure=2.8e6)
    assert current == pytest.approx(GEARED * 2.8e6 / 0.04, rel=1e-12)
    assert current == pytest.approx(1.485, abs=1e-3)
    assert output(limited(), "motor_voltage", pressure=2.8e6) == pytest.approx(0.15 * current)


def test_a_part_of_the_current_makes_a_part_of_the_acceleration():
    """One phase of three lost: 5 A. From rest, without oil: α = k_t i/J."""
    rate = acceleration(limited(current_limit_a=5.0, inertia_kg_m2=4e-5), command=500.0)
    assert rate == pytest.approx(0.04 * 5.0 / 4e-5, rel=1e-12)


@pytest.mark.parametrize("supply", [12.0, 18.0])
def test_a_sagging_supply_sets_the_speed_without_load(supply):
    """U = k_t ω + R (T_c + b ω)/k_t."""
    (speed,) = response(LIMIT, [0.5], motor=MotorParameters(supply_voltage_v=supply))
    per_ohm = 0.04 / 0.15
    expected = (supply * per_ohm - 0.01) / (0.04 * per_ohm + 1e-5)
    assert speed == pytest.approx(expected, rel=1e-6)
    assert speed < 0.9 * LIMIT


def test_a_dead_motor_coasts_down_by_its_friction():
    """J dω/dt = −T_c tanh(ω/ω_0) makes sinh(ω/ω_0) decay with the rate T_c/(J ω_0)."""
    dead = MotorParameters(current_limit_a=0.0, **DRY)
    times = np.array([0.01, 0.05, 0.1, 0.13])
    speeds = response(0.0, times, speed=60.0, motor=dead)
    expected = 10.0 * np.arcsinh(np.sinh(6.0) * np.exp(-0.01 / (2e-5 * 10.0) * times))
    np.testing.assert_allclose(speeds, expected, rtol=1e-4)
    viscous = MotorParameters(current_limit_a=0.0, coulomb_torque_n_m=0.0)
    (slow,) = response(0.0, [0.5], speed=60.0, motor=viscous)
    assert slow == pytest.approx(60.0 * math.exp(-1e-5 / 2e-5 * 0.5), rel=1e-5)


def test_a_dead_motor_is_driven_by_the_oil():
    rate = acceleration(limited(current_limit_a=0.0), command=0.0, pressure=2.0e6)
    assert rate == pytest.approx(-GEARED * 2.0e6 / 2e-5, rel=1e-12)


def test_without_torque_the_motor_is_a_dead_motor():
    dead = limited(current_limit_a=0.0)
    for speed in (-300.0, 100.0):
        values = {"command": LIMIT, "pressure": 1e6, "speed": speed}
        off = values | {"torque_off": 1.0}
        assert acceleration(limited(), **off) == acceleration(dead, **values)
        assert output(limited(), "motor_current", **off) == 0.0
        assert output(limited(), "motor_voltage", **off) == pytest.approx(0.04 * speed)


def test_the_dynamic_brake_is_a_viscous_damper_that_no_limit_or_command_weakens():
    """J dω/dt = −(k_t²/R + b) ω: the current may exceed the limit of the drive."""
    motor = MotorParameters(coulomb_torque_n_m=0.0, current_limit_a=0.0, supply_voltage_v=0.0)
    values = {"command": LIMIT, "dynamic_brake": 1.0, "torque_off": 1.0, "speed": 300.0}
    current = -0.04 * 300.0 / 0.15
    found = output(BldcPump(motor=motor), "motor_current", **values)
    assert found == pytest.approx(current, rel=1e-12)
    assert output(BldcPump(motor=motor), "motor_voltage", **values) == pytest.approx(0.0, abs=1e-12)
    rate = -(0.04**2 / 0.15 + 1e-5) / 2e-5
    assert acceleration(BldcPump(motor=motor), **values) == pytest.approx(300.0 * rate, rel=1e-12)
    released = values | {"dynamic_brake": 0.0}
    assert acceleration(BldcPump(motor=motor), **released) == pytest.approx(-300.0 * 1e-5 / 2e-5)


def test_at_5000_rpm_the_brake_takes_140_a():
    current = output(limited(), "motor_current", speed=LIMIT, dynamic_brake=1.0)
    assert current == pytest.approx(-140.0, rel=0.01)


def test_the_oil_turns_a_braked_motor_at_the_speed_of_its_damping():
    """Without friction ω = −D_m P_L R/(gear k_t²), 67 rpm at the relief pressure."""
    torque = GEARED * 3.5e6
    values = {"pressure": 3.5e6, "dynamic_brake": 1.0, "speed": -torque * 0.15 / 0.04**2}
    assert values["speed"] == pytest.approx(-67.0 * RPM, rel=0.01)
    rate = acceleration(BldcPump(motor=MotorParameters(coulomb_torque_n_m=0.0, **DRY)), **values)
    assert rate == pytest.approx(0.0, abs=1e-12 * torque / 2e-5)


def test_a_locked_shaft_takes_the_current_limit_and_hardly_turns():
    """The friction of 10 N·m balances 0.6 N·m at ω_0 artanh(0.06), which is 6 rpm."""
    (speed,) = response(LIMIT, [0.02], motor=MotorParameters(coulomb_torque_n_m=10.0, **DRY))
    assert speed == pytest.approx(10.0 * math.atanh(0.06), rel=1e-4)
    assert speed < 0.002 * LIMIT


def test_friction_opposes_the_speed():
    p = MotorParameters()
    assert shaft_loss(500.0, p) == pytest.approx(0.01 + 0.005, rel=1e-9)
    assert shaft_loss(-500.0, p) == -shaft_loss(500.0, p)


# ------------------------------------------------------------------------------ bad input


def test_nan_command_raises_instead_of_hanging():
    with pytest.raises(SimulationError, match="motor"):
        acceleration(BldcPump(), command=math.nan)
