"""The drive's rounding against `decimal` arithmetic."""

import math
from decimal import ROUND_HALF_UP, Decimal
from functools import cache

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression

from diagramc.testing import check_leaf
from kneexo.parameters import Cia402Parameters, PlantParameters, Scenario
from kneexo.systems import Cia402Drive
from kneexo.systems.drive import nearest_integer

units = pytest.mark.parametrize("unit_rpm", [1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5, 1e-6])
BELOW_HALF = math.nextafter(0.5, 0.0)


def sent(system, command):
    """Integer and speed of a command in rad/s."""
    context = system.CreateDefaultContext()
    system.get_input_port().FixValue(context, [command])
    names = ("target_velocity", "motor_speed_command")
    return [system.GetOutputPort(name).Eval(context)[0] for name in names]


@cache
def drive(unit_rpm):
    return Cia402Drive(Cia402Parameters(velocity_unit_rpm=unit_rpm))


# ----------------------------------------------------------------------------- conversion


def test_conversions_agree_and_have_no_derivative_but_that_of_the_unit():
    check_leaf(drive(0.1), {"motor_speed_command": (-5.0, 5.0)})
    system = drive(1.0).ToAutoDiffXd()
    context = system.CreateDefaultContext()
    system.get_input_port().FixValue(context, [AutoDiffXd(1.3, [1.0])])
    (speed,) = system.GetOutputPort("motor_speed_command").Eval(context)
    assert speed.value() == pytest.approx(12 * math.pi / 30.0, rel=1e-15)
    assert not np.any(speed.derivatives())


# --------------------------------------------------------------------------------- rounding


@pytest.mark.parametrize(
    ("value", "integer"),
    [
        *((0.0, 0), (0.5, 1), (1.5, 2), (2.5, 3), (-0.5, -1), (-1.5, -2), (-2.5, -3)),
        *((BELOW_HALF, 0), (-BELOW_HALF, 0), (math.nextafter(0.5, 1.0), 1)),
        *((2147483646.5, 2147483647), (-4999.4999999, -4999), (14.51, 15)),
    ],
)
def test_halves_are_rounded_away_from_zero_in_every_scalar(value, integer):
    assert nearest_integer(value) == integer
    assert nearest_integer(AutoDiffXd(value, [1.0])) == integer
    assert nearest_integer(Expression(value)).Evaluate() == integer


@units
@given(rpm=st.floats(-6000.0, 6000.0))
@example(rpm=5000.0)  # beyond an int32 in millionths
@example(rpm=-5000.0)
@example(rpm=-0.5)
def test_the_integer_is_the_nearest_and_the_speed_half_a_unit_off_at_most(unit_rpm, rpm):
    integer, speed = sent(drive(unit_rpm), rpm * math.pi / 30.0)
    exact = Decimal(rpm) / Decimal(f"{unit_rpm:g}")
    nearest = int(exact.to_integral_value(ROUND_HALF_UP))  # halves away from zero
    expected = max(-(2**31), min(nearest, 2**31 - 1))
    rest = abs(exact - nearest)
    # The command in units has the relative rounding of two operations.
    if abs(rest - Decimal("0.5")) > abs(exact) * Decimal("1e-15"):
        assert integer == expected
    else:
        assert abs(integer - expected) <= 1
    assert speed == pytest.approx(integer * unit_rpm * math.pi / 30.0, rel=1e-14, abs=0.0)
    if expected == nearest:
        error_rpm = abs(speed * 30.0 / math.pi - rpm)
        assert error_rpm <= 0.5 * unit_rpm + 1e-14 * abs(rpm)


def test_a_command_that_is_no_number_stays_none():
    assert all(math.isnan(value) for value in sent(Cia402Drive(), math.nan))


# ------------------------------------------------------------------------------- parameters


@pytest.mark.parametrize(
    ("counts", "bus", "quantized"),
    [
        (True, {"latency_samples": 3}, True),
        (False, {"kind": "cia402", "latency_samples": 3}, True),
        (False, {"latency_samples": 3}, False),
    ],
)
def test_linear_analysis_keeps_the_latency_and_no_quantizer(counts, bus, quantized):
    scenario = Scenario(encoder={"quantized": counts, "mounting_error_rad": 0.01}, bus=bus)
    assert scenario.quantized == quantized
    free = Scenario(
        encoder={"quantized": False, "mounting_error_rad": 0.01},
        bus={"latency_samples": 3},
        load_cell={"quantized": False},
    )
    assert scenario.without_quantizers() == free
    assert not free.quantized


@pytest.mark.parametrize(
    ("limit_rpm", "bus", "expected_rpm"),
    [
        (4774.648, {}, 4774.648),
        (4774.648, {"kind": "cia402"}, 4774.0),
        (4774.648, {"kind": "cia402", "velocity_unit_rpm": 0.1}, 4774.6),
        (4774.648, {"kind": "cia402", "velocity_unit_rpm": 0.001}, 4774.648),
        (5000.0, {"kind": "cia402", "velocity_unit_rpm": 0.1}, 5000.0),
        (5000.0, {"kind": "cia402", "velocity_unit_rpm": 1e-6}, 2147.483647),
    ],
)
def test_the_limit_of_the_command_is_a_whole_number_of_units(limit_rpm, bus, expected_rpm):
    pump = {"speed_limit_rad_s": limit_rpm * math.pi / 30.0}
    scenario = Scenario(plant=PlantParameters(pump=pump), bus=bus)
    limit = scenario.command_limit_rad_s
    assert limit * 30.0 / math.pi == pytest.approx(expected_rpm, rel=1e-12)
    if scenario.bus.kind == "cia402":
        assert sent(Cia402Drive(scenario.bus), limit)[1] == pytest.approx(limit, rel=1e-15)
