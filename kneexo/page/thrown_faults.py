"""Faults that a user of a page throws at the running knee."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from kneexo.errors import ParameterError
from kneexo.page.sliders import LEAKAGE, Slider
from kneexo.parameters.paths import value_at
from kneexo.parameters.scenario import Scenario
from kneexo.parameters.task.fault import FAULTY_SIGNALS, FaultParameters, Kind


@dataclass(frozen=True)
class ThrownFault:
    """A fault that a page throws: place, kind and default size as in `FaultParameters`."""

    label: str
    place: str
    kind: Kind
    size: float = 0.0
    slider: Slider | None = None
    """Label, range and unit of the size; None for a fault without size."""
    unit: str = ""
    """Unit of the size, as in `FaultParameters`."""


RESET = "reset"
"""Name of the fault that presses the reset. It accompanies the fault that the user chooses."""

THROWN_FAULTS: Mapping[str, ThrownFault] = {
    "encoder_frozen": ThrownFault("encoder frozen", "encoder", "frozen"),
    "encoder_jump": ThrownFault(
        "encoder jumps",
        "encoder",
        "offset",
        5.0,
        Slider("jump of the encoder", 0.2, 20.0, "below to far above the thresholds", "log"),
        "deg",
    ),
    "command_weak": ThrownFault(
        "command lost",
        "command",
        "scale",
        0.0,
        Slider("share of the command that arrives", 0.0, 0.9, "none to almost all"),
        "1",
    ),
    "command_frozen": ThrownFault("command frozen", "command", "frozen"),
    "motor_weak": ThrownFault(
        "motor dead or weak",
        "plant.motor.current_limit_a",
        "value",
        0.0,
        Slider("current limit with the fault", 0.0, 10.0, "a dead to a weak motor"),
        "A",
    ),
    "supply_sag": ThrownFault(
        "supply sags",
        "plant.motor.supply_voltage_v",
        "value",
        8.0,
        Slider("supply with the fault", 0.0, 20.0, "no supply to a weak battery"),
        "V",
    ),
    "piston_leak": ThrownFault(
        "piston leaks",
        "plant.cylinder.leakage_m3_per_s_pa",
        "value",
        1e-10,
        Slider(
            "leakage of the piston with the fault",
            3e-12,
            1e-9,
            "worn to torn seal",
            "log",
            LEAKAGE,
        ),
        "m³/(s·Pa)",
    ),
    "emergency_stop": ThrownFault("emergency stop", "emergency_stop", "value", 1.0),
    RESET: ThrownFault("reset", RESET, "value", 1.0),
}
"""The faults that a page throws, by name. Sizes and ranges are assumptions."""


def thrown_faults(scenario: Scenario) -> dict[str, ThrownFault]:
    """Return the `THROWN_FAULTS` that a scenario can have."""
    return {
        name: thrown
        for name, thrown in THROWN_FAULTS.items()
        if thrown.place in FAULTY_SIGNALS or value_at(scenario, thrown.place) is not None
    }


@dataclass(frozen=True)
class Throw:
    """The fault that a user throws, a name in `THROWN_FAULTS` or ``none``, and its numbers."""

    name: str = "none"
    size: float = 0.0
    start_s: float | None = None
    """Start; None: the page chooses it."""
    duration_s: float = 0.0
    """Duration; 0 for a fault that does not end."""
    reset_s: float = 0.0
    """Time at which the reset is pressed; 0 for never."""


def throw_of(scenario: Scenario) -> Throw:
    """Return the fault and the reset that a scenario has.

    Raises `ParameterError` for faults that a page cannot throw.
    """
    faults = [fault for fault in scenario.faults if fault.place != RESET]
    resets = [fault.start_s for fault in scenario.faults if fault.place == RESET]
    fault = faults[0] if faults else FaultParameters()
    known = {(thrown.place, thrown.kind): name for name, thrown in thrown_faults(scenario).items()}
    name = known.get((fault.place, fault.kind)) if faults else "none"
    triggered = any((f.signal, f.mttf_s) != (None, None) for f in scenario.faults)
    if name is None or len(faults) > 1 or len(resets) > 1 or triggered:
        names = [f"{place} {kind}" for place, kind in known if place != RESET]
        raise ParameterError(
            f"faults: a page throws one fault at a given time, of {', '.join(names)}, and perhaps "
            f"one reset; leave the faults out (--set faults=[])"
        )
    return Throw(
        name,
        fault.size,
        fault.start_s if faults else None,
        fault.duration_s or 0.0,
        *resets,
    )
