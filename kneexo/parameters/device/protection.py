"""Parameters of the protection: thresholds of the fault detectors, and reaction to a fault."""

from __future__ import annotations

from pydantic import model_validator

from kneexo.parameters.device.safety_states import DETECTORS, SafeState
from kneexo.parameters.fields.fields import limits_of
from kneexo.parameters.fields.quantity import Parameters, choice, quantity


class ProtectionParameters(Parameters):
    """Detectors of faults beside the controller, and the supervisor that stops the motor.

    Each detector compares a residual with a threshold; see `kneexo.systems.FaultDetectors`. The
    default thresholds are above the levels of all runs with position control in
    ``benchmarks/false_alarms.py``, except for strides that are too fast for the pump.
    """

    range_deg: float = quantity(
        1.0,
        "deg",
        "assumption: encoder angle beyond the range of motion; 0 in 10,000 healthy runs, "
        "benchmarks/false_alarms.py",
        ge=0.01,
        le=360,
    )
    rate_deg_s: float = quantity(
        150.0,
        "deg/s",
        "assumption: change of the encoder angle, 3.4 counts a sample; 10,000 healthy runs reach "
        "43.95 deg/s, benchmarks/false_alarms.py",
        ge=1,
        le=1e6,
    )
    flow_mm: float = quantity(
        2.5,
        "mm",
        "assumption: rod travel minus travel by the motor speed; 10,000 healthy runs reach "
        "1.387 mm, benchmarks/false_alarms.py",
        ge=1e-3,
        le=1e4,
    )
    flow_s: float = quantity(
        0.2, "s", "assumption: time constant within which both travels are compared", ge=0.01, le=60
    )
    load_cell_n: float = quantity(
        1500.0, "N", "assumption: above the force of the relief valves", ge=1, le=1e6
    )
    speed_rpm: float = quantity(
        400.0,
        "rpm",
        "assumption: low-passed command minus motor speed; 10,000 healthy runs reach "
        "131.6 rpm, benchmarks/false_alarms.py",
        ge=0.1,
        le=1e6,
    )
    speed_s: float = quantity(0.1, "s", "assumption: time constant of its low-pass", ge=0.01, le=60)
    following_deg: float = quantity(
        6.0,
        "deg",
        "assumption: reference minus measured knee angle; 10,000 healthy runs reach 0.8134 deg, "
        "and 1,000 with the PID of the paper 4.561 deg, benchmarks/false_alarms.py",
        ge=0.01,
        le=360,
    )
    trip_s: float = quantity(
        0.010,
        "s",
        "assumption: five samples, to which the counter of a detector must rise, so that single "
        "outliers stop nothing",
        ge=0,
        le=10,
    )
    healthy_s: float = quantity(
        0.1, "s", "assumption: time without a fault that ends the start", ge=0, le=60
    )
    overdue_s: float = quantity(
        1.0, "s", "assumption: longest start, and longest stop of the motor", ge=0.01, le=60
    )
    stop_rad_s2: float = quantity(
        2e3,
        "rad/s²",
        "assumption: rate at which the speed command falls; the slowest motor of the uncertainty "
        "set follows it",
        ge=1,
        le=1e7,
    )
    standstill_rpm: float = quantity(
        30.0, "rpm", "assumption: motor speed that counts as standstill", ge=0.1, le=1e4
    )
    watchdog_s: float = quantity(
        0.02,
        "s",
        "assumption: ten samples; time without a new speed command after which the drive stops",
        ge=1e-3,
        le=60,
    )
    safe_state: SafeState = choice(
        "zero_speed",
        "zero_speed: the oil holds the knee; dynamic_brake: shorted windings also hold a motor "
        "that does not obey; torque_off: the motor turns freely; bypass: a valve opens "
        "both chambers to the reservoir, and the knee is free",
    )

    @model_validator(mode="after")
    def _start_can_end(self) -> ProtectionParameters:
        if self.healthy_s > self.overdue_s:
            raise ValueError(
                f"healthy_s = {self.healthy_s:g} s: must be at most overdue_s = "
                f"{self.overdue_s:g} s, or each start ends with a stop; reduce healthy_s or extend "
                f"overdue_s"
            )
        return self


LARGEST_THRESHOLDS = {
    name: detector.factor * limits_of(ProtectionParameters.model_fields[detector.field])[1]
    for name, detector in DETECTORS.items()
}
"""Largest threshold that each detector can have, in SI units."""
