"""Parameters of the bus from controller to motor: coding of the speed command, and latency."""

from __future__ import annotations

import math
from typing import Any, Literal

from kneexo.parameters.device.plant import RPM
from kneexo.parameters.fields.quantity import Parameters, quantity

INT32_MIN, INT32_MAX = -(2**31), 2**31 - 1
"""Smallest and largest 32-bit integer, the range of a drive's target velocity."""


def _latency(default: int, source: str) -> Any:
    return quantity(default, "samples", source, ge=0, le=10)


class NoBus(Parameters):
    """A bus that does not round: the motor receives the speed command as a real number."""

    kind: Literal["none"] = "none"
    latency_samples: int = _latency(
        0, "assumption: latency from controller to motor; not in the paper"
    )

    @property
    def velocity_unit_rad_s(self) -> float:
        """Zero instead of a velocity unit, because this bus does not round the command."""
        return 0.0


class Cia402Parameters(Parameters):
    """CANopen to a CiA 402 drive in cyclic synchronous velocity mode (0x6060 = 9).

    In each sample the controller sends its command as target velocity (object 0x60FF), a 32-bit
    integer in units of object 0x60A9. Source: CiA 301, CiA 402 (IEC 61800-7-201), maxon EPOS4
    Firmware Specification.
    """

    kind: Literal["cia402"] = "cia402"
    # mypy rejects a Literal of floats, pydantic accepts it.
    velocity_unit_rpm: Literal[1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5, 1e-6] = quantity(  # type: ignore[valid-type]
        1.0,
        "rpm",
        "assumption: SI unit velocity (0x60A9), as maxon's EPOS4 offers it: 1 rpm, its default, or "
        "0.1, 0.01, … 1e-6 rpm; the paper says CAN and Maxon, no more",
    )
    latency_samples: int = _latency(
        1,
        "assumption: one SYNC per sample and a synchronous PDO (CiA 301), whose command acts one "
        "SYNC later than it is computed; 0 is an event-driven PDO",
    )

    @property
    def velocity_unit_rad_s(self) -> float:
        """Motor speed of one unit of object 0x60FF, in rad/s."""
        return self.velocity_unit_rpm * RPM

    @property
    def si_unit_velocity(self) -> int:
        """Value of object 0x60A9, the code of the velocity unit.

        The bytes are the power of ten (int8), revolution (0xB4), minute (0x47) and a reserved byte.
        Source: CiA 303-2; EPOS4 Firmware Specification, "SI unit velocity".
        """
        return (round(math.log10(self.velocity_unit_rpm)) & 0xFF) << 24 | 0x00B44700
