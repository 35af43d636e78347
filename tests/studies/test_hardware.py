"""Closed forms of what the hardware allows, and scenarios with other hardware."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.optimize import linprog

from kneexo.analysis.frequency.bandwidth import rod_limits
from kneexo.errors import ParameterError
from kneexo.parameters import PlantParameters, RampReference, Scenario
from kneexo.studies.hardware import (
    ACCELERATION_ALONE_RATIO,
    ACCELERATION_LIMIT,
    DISPLACEMENT,
    HARDWARE,
    ONE_PERCENT_RATIO,
    SPEED_LIMIT,
    expected_bandwidth_hz,
    limited_bandwidth_hz,
    limited_gain,
    scaled,
    sliding_mode,
    tuned,
    with_piston,
)
from kneexo.studies.paper import PID_TUNED
from kneexo.studies.size.error_model import error_model

positive = st.floats(1e-4, 1e4)


def test_the_rods_limits_follow_from_tables_2_and_3():
    speed, acceleration = rod_limits(Scenario())
    # 5000 rpm, 6:1, 0.8 cc/rev, mean area 274.8894 mm², 1e4 rad/s².
    assert 1e3 * speed == pytest.approx(5000.0 / 60.0 / 6.0 * 800.0 / 274.8894, rel=1e-6)
    assert acceleration / speed == pytest.approx(1e4 / (5000.0 * 2.0 * math.pi / 60.0), rel=1e-12)


@pytest.mark.parametrize("ramp", [0.05, 0.4, 1.0, 1.5, 2.5])
def test_no_motion_within_both_limits_has_a_larger_fundamental(ramp):
    # A linear program over all periodic speeds, which knows nothing of trapezoids.
    count, speed, frequency = 240, 0.7, 0.9
    omega = 2.0 * math.pi * frequency
    limit = omega * speed / ramp
    time = np.arange(count) / (count * frequency)
    step = time[1]
    change = np.roll(np.eye(count), 1, axis=1) - np.eye(count)
    best = linprog(
        -np.cos(omega * time),
        A_ub=np.vstack([change, -change]),
        b_ub=np.full(2 * count, limit * step),
        A_eq=np.ones((1, count)),
        b_eq=[0.0],
        bounds=(-speed, speed),
    )
    fundamental = -best.fun * 2.0 / count / omega  # of the position
    amplitude = 2.0 * fundamental  # so that the gain is below 1
    gain = limited_gain(frequency, speed_limit=speed, acceleration_limit=limit, amplitude=amplitude)
    # 240 samples a period: corners of the trapezoid within one sample, errors of (π/240)².
    assert gain == pytest.approx(0.5, rel=1e-3)


def test_with_one_limit_the_bandwidth_is_its_own_closed_form():
    fast = limited_bandwidth_hz(speed_limit=0.04, acceleration_limit=1e6, amplitude=0.05)
    assert fast == pytest.approx(2.0 * math.sqrt(2.0) / math.pi**2 * 0.04 / 0.05, rel=1e-6)
    strong = limited_bandwidth_hz(speed_limit=1e3, acceleration_limit=0.7, amplitude=0.05)
    assert strong == pytest.approx(
        math.sqrt(4.0 * math.sqrt(2.0) * 0.7 / (math.pi * 0.05)) / (2.0 * math.pi), rel=1e-9
    )


def test_no_gain_is_above_one():
    limits = {"speed_limit": 1e3, "acceleration_limit": 1e6, "amplitude": 1e-3}
    assert limited_gain(0.1, **limits) == 1.0


def test_where_the_acceleration_limit_takes_over():
    speed, amplitude = 0.04, 0.05

    def bandwidth(ratio, speed=speed):
        limit = ratio * 0.04**2 / amplitude
        return limited_bandwidth_hz(
            speed_limit=speed, acceleration_limit=limit, amplitude=amplitude
        )

    alone = limited_bandwidth_hz(speed_limit=speed, acceleration_limit=1e9, amplitude=amplitude)
    assert bandwidth(ONE_PERCENT_RATIO) / alone == pytest.approx(0.99, abs=1e-7)
    # Below the second mark twice the speed changes nothing; well above it does.
    low = 0.99 * ACCELERATION_ALONE_RATIO
    assert bandwidth(low, 2.0 * speed) == pytest.approx(bandwidth(low), rel=1e-9)
    assert bandwidth(2.0, 2.0 * speed) > 1.03 * bandwidth(2.0)


@given(speed=positive, acceleration=positive, amplitude=positive, share=st.floats(0.1, 10.0))
def test_bandwidth_grows_with_the_limits_and_does_not_know_the_unit(
    speed, acceleration, amplitude, share
):
    limits = {"speed_limit": speed, "acceleration_limit": acceleration, "amplitude": amplitude}
    base = limited_bandwidth_hz(**limits)
    assert 0.0 < base <= 2.0 * math.sqrt(2.0) / math.pi**2 * speed / amplitude * (1.0 + 1e-9)
    assert limited_gain(base, **limits) == pytest.approx(1.0 / math.sqrt(2.0), rel=1e-6)
    scaled_by = {name: share * value for name, value in limits.items()}
    assert limited_bandwidth_hz(**scaled_by) == pytest.approx(base, rel=1e-6)
    for name in ("speed_limit", "acceleration_limit"):
        more = limited_bandwidth_hz(**limits | {name: 1.5 * limits[name]})
        assert more >= base * (1.0 - 1e-9)


@pytest.mark.parametrize("name", ["speed_limit", "acceleration_limit", "amplitude"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
def test_limits_must_be_finite_and_positive(name, value):
    limits = {"speed_limit": 1.0, "acceleration_limit": 1.0, "amplitude": 1.0} | {name: value}
    with pytest.raises(ParameterError, match=f"^{name} = {value:g}: must be finite and > 0$"):
        limited_bandwidth_hz(**limits)


def test_the_expected_bandwidth_needs_a_sine():
    assert expected_bandwidth_hz(Scenario()) == pytest.approx(0.2311, abs=1e-4)
    with pytest.raises(ParameterError, match="ramp"):
        expected_bandwidth_hz(Scenario(reference=RampReference()))


@pytest.mark.parametrize("path", HARDWARE)
def test_one_is_no_change(path):
    assert scaled(Scenario(), {path: 1.0}) == Scenario()


@pytest.mark.parametrize(
    ("factors", "speed"),
    [
        ({SPEED_LIMIT: 2.0}, 2.0),
        ({DISPLACEMENT: 3.0}, 3.0),
        ({"plant.pump.gear_ratio": 0.5}, 2.0),
        ({DISPLACEMENT: 3.0, "plant.pump.gear_ratio": 1.5, ACCELERATION_LIMIT: 4.0}, 2.0),
        ({ACCELERATION_LIMIT: 5.0, "plant.pump.lag_s": 2.0}, 1.0),
    ],
)
def test_the_controller_knows_the_new_actuator(factors, speed):
    base = Scenario()
    other = scaled(base, factors)
    assert rod_limits(other)[0] / rod_limits(base)[0] == pytest.approx(speed, rel=1e-12)
    law, old = sliding_mode(other), sliding_mode(base)
    assert law.eta_m_s3 / old.eta_m_s3 == pytest.approx(speed, rel=1e-12)
    assert law.eta_m_s3 / law.phi_m_s2 == pytest.approx(old.eta_m_s3 / old.phi_m_s2, rel=1e-12)
    assert other.command_limit_rad_s == pytest.approx(
        base.command_limit_rad_s * factors.get(SPEED_LIMIT, 1.0)
    )


def test_the_nominal_plant_changes_too():
    base = Scenario(nominal=PlantParameters())
    other = scaled(base, {DISPLACEMENT: 2.0})
    assert other.nominal.pump == other.plant.pump


def test_a_larger_piston_has_a_larger_pump_and_the_same_speed():
    nominal = PlantParameters()
    scenario = with_piston(Scenario(nominal=nominal), 1.44)
    assert rod_limits(scenario) == pytest.approx(rod_limits(Scenario()), rel=1e-12)
    for plant in (scenario.plant, scenario.nominal):
        assert plant.cylinder.bore_m == pytest.approx(0.024, rel=1e-12)
        assert plant.cylinder.rod_diameter_m == pytest.approx(0.012, rel=1e-12)
        assert plant.cylinder.total_volume_m3 == pytest.approx(1.44 * 41_233e-9, rel=1e-12)
        displacement = 1.44 * 0.8e-6 / (2.0 * math.pi)
        assert plant.pump.displacement_m3_per_rad == pytest.approx(displacement, rel=1e-12)
    assert scenario.controller.eta_m_s3 == pytest.approx(1.44 * 2.8e5, rel=1e-12)
    assert scenario.controller.phi_m_s2 == pytest.approx(3.2, rel=1e-12)
    # The command answers to s with (k/Φ)/b̂, and b̂ is as R ω̂².
    before, after = error_model(Scenario()), error_model(scenario)
    gains = [model.slope_per_s / model.stiffness_per_s2 for model in (before, after)]
    assert gains[0] == pytest.approx(gains[1], rel=1e-9)
    pid = with_piston(Scenario(controller=PID_TUNED), 1.44)
    assert pid.controller == PID_TUNED


def test_counts_are_whole_and_a_pid_keeps_its_gains():
    base = Scenario(controller=PID_TUNED)
    other = scaled(base, {"encoder.counts_per_revolution": 0.3337, DISPLACEMENT: 2.0})
    assert other.encoder.counts_per_revolution == round(0.3337 * 4096)
    assert other.controller == base.controller
    with pytest.raises(ParameterError, match=r"controller.kind = pid: must be smc"):
        tuned(base, {"lambda_per_s": 1.0, "slope_per_s": 1e4, "observer_s": 0.01})


def test_tuned_sets_the_slope_by_phi():
    other = tuned(Scenario(), {"lambda_per_s": 50.0, "slope_per_s": 4e4, "observer_s": 0.01})
    law = sliding_mode(other)
    assert law.gain_ratio * law.eta_m_s3 / law.phi_m_s2 == pytest.approx(4e4, rel=1e-12)
    assert law.lambda_per_s == 50.0
    assert law.eta_m_s3 == sliding_mode(Scenario()).eta_m_s3
    assert other.estimator.time_constant_s == 0.01
