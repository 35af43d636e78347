"""The bus from controller to motor: how it codes a speed command, and how late the motor acts."""

from __future__ import annotations

import math
from typing import Any, Literal

from kneexo.parameters.plant import RPM
from kneexo.parameters.quantity import Parameters, quantity

INT32_MIN, INT32_MAX = -(2**31), 2**31 - 1
"""The range of a drive's 32-bit target velocity."""


def _latency(default: int, source: str) -> Any:
    return quantity(default, "samples", source, ge=0, le=10)


class NoBus(Parameters):
    """No coding: the motor gets the command as a real number."""

    kind: Literal["none"] = "none"
    latency_samples: int = _latency(0, "assumption: latency from controller to motor; not printed")

    @property
    def velocity_unit_rad_s(self) -> float:
        """Zero: no command is rounded."""
        return 0.0


class Cia402Parameters(Parameters):
    """CANopen to a CiA 402 drive in cyclic synchronous velocity mode (0x6060 = 9).

    Each sample the controller sends its command as target velocity (0x60FF): an int32 in units of
    0x60A9. Source: CiA 301, CiA 402 (IEC 61800-7-201), maxon EPOS4 Firmware Specification.
    """

    kind: Literal["cia402"] = "cia402"
    # mypy knows no Literal of floats; pydantic does.
    velocity_unit_rpm: Literal[1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5, 1e-6] = quantity(  # type: ignore[valid-type]
        1.0,
        "rpm",
        "assumption: SI unit velocity (0x60A9), as maxon's EPOS4 offers it: 1 rpm, its default, or "
        "0.1, 0.01, … 1e-6 rpm; the paper says CAN and Maxon, no more",
    )
    latency_samples: int = _latency(
        1,
        "assumption: SYNC once a sample and a synchronous PDO (CiA 301), which acts at the SYNC "
        "after the one it was computed at; 0 is an event-driven PDO",
    )

    @property
    def velocity_unit_rad_s(self) -> float:
        """Speed of one unit of 0x60FF in rad/s."""
        return self.velocity_unit_rpm * RPM

    @property
    def si_unit_velocity(self) -> int:
        """Object 0x60A9: power of ten (int8), revolution (0xB4) per minute (0x47), reserved byte.

        Source: CiA 303-2; EPOS4 Firmware Specification, "SI unit velocity".
        """
        return (round(math.log10(self.velocity_unit_rpm)) & 0xFF) << 24 | 0x00B44700
