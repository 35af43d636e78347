"""The safety state machine as a table: detectors, states, events and transitions.

`kneexo.systems.SafetySupervisor` makes the equations from this table, so the simulation, exported C
and FMUs have the same machine. A test compares the table with ``docs/scenario_files.md``.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from kneexo.parameters.device.plant import RPM

SafeState = Literal["zero_speed", "dynamic_brake", "torque_off", "bypass"]
"""How a stop ends: zero_speed by the command alone, the others also by a release.

A release acts without the control of the drive, on the input of the plant that has the name of the
safe state.
"""

SAFE_STATES: dict[SafeState, str] = {
    "zero_speed": "the motor stands",
    "dynamic_brake": "the windings are shorted",
    "torque_off": "the motor has no torque",
    "bypass": "the bypass is open",
}
"""What a page and a verdict tell of a safe state."""

RELEASES = tuple(name for name in SAFE_STATES if name != "zero_speed")
"""The safe states with a release, and the inputs of the plant that a release acts on."""


class Detector(NamedTuple):
    """A detector: the event that it causes, and the field and unit of its threshold."""

    event: str
    field: str
    """Name of the threshold in `ProtectionParameters`."""
    unit: str
    factor: float
    """Number of SI units in a unit of the threshold."""


_DEG, _MM = math.pi / 180.0, 1e-3

# The first detector that has detected a fault is the reason of a stop. So the reading comes first,
# because flow and following are computed from it.
DETECTORS = {
    "range": Detector("implausible", "range_deg", "deg", _DEG),
    "rate": Detector("implausible", "rate_deg_s", "deg/s", _DEG),
    "flow": Detector("implausible", "flow_mm", "mm", _MM),
    "load_cell": Detector("implausible", "load_cell_n", "N", 1.0),
    "speed": Detector("disobeyed", "speed_rpm", "rpm", RPM),
    "following": Detector("away", "following_deg", "deg", _DEG),
}
"""The detectors of `FaultDetectors`, in order."""

EMERGENCY_STOP = len(DETECTORS) + 1
"""Number of the emergency stop among the reasons. The reasons 1, 2, … are the `DETECTORS`."""
NOT_HEALTHY = EMERGENCY_STOP + 1
"""Number of the reason that the loop did not become healthy in time after its start."""
REASONS = ("none", *DETECTORS, "emergency stop", "start")
"""Names of the reasons by their number."""

# In order: `SafetySupervisor` tells the `LAW_ACTS` by their numbers, which are the lowest.
STATES = {
    "starting": "the law acts; following and speed cannot stop the motor yet",
    "operating": "the law acts",
    "stopping": "the speed command falls to zero with a rate limit",
    "stopped": "the speed command is zero, and the oil holds the knee if the motor stands",
    "released": "the speed command is zero; the windings are shorted, the motor has no torque, or "
    "the bypass is open",
}
"""The states by their number, with what the supervisor does in them."""

LAW_ACTS = ("starting", "operating")
"""The states in which the command of the law passes. A stop from one of these sets the reason."""

EVENTS = {
    "emergency": "the input `emergency_stop` is not within ±0.5",
    "implausible": "range, rate, flow or load_cell has detected a fault",
    "disobeyed": "speed has detected a fault: the motor does not obey",
    "away": "following has detected a fault",
    "standstill": "the speed command is zero and the motor speed is small",
    "healthy": "no detector has detected a fault for `healthy_s`",
    "overdue": "the state has lasted `overdue_s`",
    "reset": "the input `reset` rises from 0 to 1",
}
"""The events in order of priority: the first event with a transition decides."""


class Transition(NamedTuple):
    """A transition between two `STATES`, for safe states with (True) or without release, or all."""

    state: str
    event: str
    next_state: str
    release: bool | None = None


TRANSITIONS = (
    Transition("starting", "emergency", "stopping"),
    Transition("starting", "implausible", "stopping"),
    Transition("starting", "healthy", "operating"),
    Transition("starting", "overdue", "stopping"),
    Transition("operating", "emergency", "stopping"),
    Transition("operating", "implausible", "stopping"),
    Transition("operating", "disobeyed", "stopping", False),
    Transition("operating", "disobeyed", "released", True),
    Transition("operating", "away", "stopping"),
    Transition("stopping", "disobeyed", "released", True),
    Transition("stopping", "standstill", "stopped", False),
    Transition("stopping", "standstill", "released", True),
    Transition("stopping", "overdue", "stopped", False),
    Transition("stopping", "overdue", "released", True),
    Transition("stopped", "emergency", "stopped"),
    Transition("stopped", "implausible", "stopped"),
    Transition("stopped", "reset", "starting"),
    Transition("released", "emergency", "released"),
    Transition("released", "implausible", "released"),
    Transition("released", "reset", "starting"),
)
"""All transitions. A transition to the same state keeps events of lower priority from acting."""


def transitions(safe_state: SafeState) -> tuple[Transition, ...]:
    """Return the transitions with a safe state, in order of the priority of their events."""
    present = (row for row in TRANSITIONS if row.release in (None, safe_state != "zero_speed"))
    return tuple(sorted(present, key=lambda row: list(EVENTS).index(row.event)))
