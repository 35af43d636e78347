"""Parameters of the bus: units of the target velocity, latency, refusals."""

import math

import pytest

from kneexo.errors import ParameterError
from kneexo.parameters import Cia402Parameters, NoBus, Scenario


@pytest.mark.parametrize(
    ("unit_rpm", "code"),
    [
        (1.0, 0x00B44700),
        (0.1, 0xFFB44700),
        (0.01, 0xFEB44700),
        (1e-3, 0xFDB44700),
        (1e-4, 0xFCB44700),
        (1e-5, 0xFBB44700),
        (1e-6, 0xFAB44700),
    ],
)
def test_the_code_of_the_velocity_unit_is_that_of_0x60a9(unit_rpm, code):
    assert Cia402Parameters(velocity_unit_rpm=unit_rpm).si_unit_velocity == code


def test_units_are_rpm_outside_and_rad_s_inside():
    assert Cia402Parameters(velocity_unit_rpm=0.1).velocity_unit_rad_s == pytest.approx(
        0.1 * 2.0 * math.pi / 60.0, rel=1e-15
    )
    assert NoBus().velocity_unit_rad_s == 0.0


def test_another_unit_is_refused():
    line = r"bus.velocity_unit_rpm = 0.5 rpm: must be 1.0, 0.1, 0.01, 0.001, 0.0001, 1e-05 or 1e-06"
    with pytest.raises(ParameterError, match=rf"^Scenario: {line}$"):
        Scenario(bus={"kind": "cia402", "velocity_unit_rpm": 0.5})
