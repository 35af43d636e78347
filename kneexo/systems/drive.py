"""CiA 402 drive in cyclic synchronous velocity mode: the speed command as an integer."""

from __future__ import annotations

from typing import Any

import pydrake.math as drake_math

from kneexo.parameters import Cia402Parameters
from kneexo.parameters.device.bus import INT32_MAX, INT32_MIN
from kneexo.systems._leaf import NamedLeaf, clip, leaf_template, values_of, where_positive


def nearest_integer(value: Any) -> Any:
    """Return the nearest integer; round halves away from zero, as C's ``lround`` does.

    ``floor(|value| + 0.5)`` would round 0.49999999999999994 to 1.
    """
    magnitude = drake_math.abs(value)
    whole = drake_math.floor(magnitude)
    whole = where_positive(0.5 - (magnitude - whole), whole, whole + 1.0)
    return where_positive(-value, -whole, whole)


def context_values(parameters: Cia402Parameters) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `Cia402Drive`."""
    return values_of(parameters, "velocity_unit_rad_s")


class Cia402Drive(NamedLeaf):
    """Rounds the speed command to the integer target velocity of a CiA 402 drive.

    n = clip(round(u/q_d), −2³¹ … 2³¹ − 1), u_d = q_d n, with the velocity unit q_d. Halves
    round away from zero (`nearest_integer`).

    ===================  ====  =====  =====================================================
    input port           size  unit
    ===================  ====  =====  =====================================================
    motor_speed_command  1     rad/s  u, computed by the controller
    **output port**
    target_velocity      1     1      n, object 0x60FF in units of 0x60A9
    motor_speed_command  1     rad/s  u_d, received by the drive
    ===================  ====  =====  =====================================================

    Stateless. The latency of the bus is not part of this system: `make_closed_loop` adds Drake's
    `DiscreteTimeDelay`. Context parameter by name: ``velocity_unit_rad_s`` (q_d). The derivative is
    zero, as with Drake's `RotaryEncoders`, so that linear analysis bypasses the system. Source:
    CiA 402 (IEC 61800-7-201), cyclic synchronous velocity mode; rounding to the nearest integer is
    an assumption.
    """

    def __init__(self, parameters: Cia402Parameters = Cia402Parameters()) -> None:
        self._declare_parameters(context_values(parameters))
        self._command = self.DeclareVectorInputPort("motor_speed_command", 1)
        self._declare_output("target_velocity", 1, lambda c: [self._integer(c)], self._command)
        self._declare_output("motor_speed_command", 1, self._calc_command, self._command)

    def _integer(self, context: Any) -> Any:
        unit = self.parameters(context).velocity_unit_rad_s
        integer = nearest_integer(self._command.Eval(context)[0] / unit)
        return clip(integer, float(INT32_MIN), float(INT32_MAX))

    def _calc_command(self, context: Any) -> list[Any]:
        return [self.parameters(context).velocity_unit_rad_s * self._integer(context)]


Cia402Drive_ = leaf_template(Cia402Drive)
"""Template of `Cia402Drive` classes by scalar type of Drake."""
