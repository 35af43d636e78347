"""Fault buttons and protection of the page to play with.

The WebAssembly module of a loop contains every fault that the page can throw. The page switches one
fault on by its start time, and leaves the others after the end of the run. So no choice of a fault
needs another module. The module contains the protection too. The page switches it off by thresholds
of the detectors, and a time of the watchdog, that no run reaches.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

from kneexo.analysis.tracking.clauses import CAUSES
from kneexo.errors import ParameterError
from kneexo.page.maps import Map
from kneexo.page.sliders import Slider
from kneexo.page.thrown_faults import throw_of, thrown_faults
from kneexo.parameters import ProtectionParameters, Scenario
from kneexo.parameters.device.plant import RPM
from kneexo.parameters.device.safety_states import (
    DETECTORS,
    EVENTS,
    REASONS,
    SAFE_STATES,
    STATES,
    transitions,
)
from kneexo.parameters.task.fault import FaultParameters

# After the end of each run, and finite, as parameters of a module must be.
IDLE_S = 1e5
"""Start in s of a fault that is not chosen, and duration of a fault that does not end."""

UNREACHABLE = 1e9
"""Thresholds of the detectors of a loop without protection, in their units."""

_PREFIX = "fault."


def is_protected(scenario: Scenario) -> bool:
    """Return whether a page shows a scenario with faults and protection.

    Raises `ParameterError` for a scenario with faults that a page cannot throw, and for faults or
    protection with a wearer.
    """
    throw_of(scenario)
    protected = bool(scenario.faults) or scenario.protection is not None
    if protected and scenario.wearer.kind != "none":
        raise ParameterError(
            "protection: a page with a wearer cannot show faults and protection; leave them out "
            "(--set protection=null --set faults=[])"
        )
    return protected


def with_thrown_faults(scenario: Scenario, values: Mapping[str, float]) -> Scenario:
    """Return a scenario with other ``values``, protection, and all faults that can be thrown.

    ``values`` has dotted paths, and the sizes of faults as ``fault.NAME.size``. The faults begin at
    the start of the run.
    """
    others = {path: value for path, value in values.items() if not path.startswith(_PREFIX)}
    faults = tuple(
        FaultParameters(
            place=fault.place,
            kind=fault.kind,
            size=values.get(f"{_PREFIX}{name}.size", fault.size),
            start_s=0.0,
            duration_s=IDLE_S,
        )
        for name, fault in thrown_faults(scenario).items()
    )
    protection = scenario.protection or ProtectionParameters()
    return scenario.changed({"protection": protection, "faults": ()} | others | {"faults": faults})


def sizes_of(faults: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the quantities of all sizes in the result of `fault_data`."""
    return [choice["quantity"] for choice in faults["choices"].values() if "quantity" in choice]


# Not fitted, because each of these parameters is a number times a factor: a page with protection is
# made in half the time.
def direct_maps(scenario: Scenario, columns: Iterable[str]) -> Iterator[tuple[int, Map]]:
    """Yield index and formula of each start, duration and threshold among a module's parameters.

    A page sets these parameters to any number, also beyond the ranges of the sliders.
    """
    names = list(thrown_faults(scenario))
    for index, column in enumerate(columns):
        name, factor = "", 1.0
        if found := re.fullmatch(r"fault_(\d+)(?:_\w+)?\.(start_s|duration_s)", column):
            name = f"{_PREFIX}{names[int(found[1])]}.{found[2]}"
        elif found := re.fullmatch(r"controller/detectors\.(\w+)_threshold", column):
            detector = DETECTORS[found[1]]
            name, factor = f"protection.{detector.field}", detector.factor
        elif column == "watchdog.watchdog_samples":
            name, factor = "protection.watchdog_s", 1.0 / scenario.controller.sample_time_s
        if name:
            yield index, {"kind": "affine", "of": [name], "offset": 0.0, "factors": [factor]}


def fault_data(scenario: Scenario) -> dict[str, Any]:
    """Return what a page knows about faults, protection and the safety state machine, as data.

    ``choices``
        Label, place, kind and size of each fault by name. A fault whose size the user can change
        has the ``quantity`` of the size.
    ``quantities``
        Start and duration of the chosen fault, and the time of the reset.
    ``idle``, ``off``
        Values of the module without fault and with the scenario's thresholds, and thresholds of a
        loop without protection.
    ``fault``, ``protection``
        The choices that the page shows first.
    ``safe``
        What is true of the knee in the safe state, in words.
    ``standstill_rad_s``, ``overdue_s``
        Motor speed that counts as standstill, and longest start and stop.
    ``names``, ``states``
        Names of all states by their number, and the states that are reached with their meanings.
    ``events``, ``reasons``, ``stopped_by``, ``causes``
        Events with their meanings; names of the reasons by their number, what stopped the motor in
        words, and their events.
    ``transitions``
        Rows of state, event and next state, in order of the priority of the events.
    """
    throw = throw_of(scenario)
    choices: dict[str, dict[str, Any]] = {}
    for name, fault in thrown_faults(scenario).items():
        choices[name] = {"label": fault.label, "place": fault.place, "kind": fault.kind}
        choices[name]["size"] = throw.size if name == throw.name else fault.size
        if fault.slider is not None:
            size = choices[name]["size"]
            choices[name]["quantity"] = _quantity(f"{name}.size", fault.slider, size, fault.unit)
    start_s = throw.start_s
    if start_s is None:  # the fastest motion of the default sine is at a quarter of its run
        start_s = round(min(FaultParameters().start_s, scenario.duration_s / 4.0), 3)
    protection = scenario.protection or ProtectionParameters()
    reached, rows = ["starting"], transitions(protection.safe_state)
    for state in reached:
        ends = (row.next_state for row in rows if row.state == state)
        reached += (end for end in dict.fromkeys(ends) if end not in reached)
    safe = SAFE_STATES[protection.safe_state]
    meanings = {**STATES, "released": f"the speed command is zero; {safe}"}
    causes = ("", *(detector.event for detector in DETECTORS.values()), "emergency", "overdue")
    clocks = {f"{_PREFIX}{n}.{f}": IDLE_S for n in choices for f in ("start_s", "duration_s")}
    sizes = {f"{_PREFIX}{n}.size": c["size"] for n, c in choices.items() if "quantity" in c}
    fields = [*(detector.field for detector in DETECTORS.values()), "watchdog_s"]
    thresholds = {f"protection.{field}": getattr(protection, field) for field in fields}
    return {
        "choices": choices,
        "quantities": [
            _quantity("start_s", Slider("start of the fault", 0.0, 60.0, "within a run"), start_s),
            _quantity("duration_s", _DURATION, throw.duration_s),
            _quantity("reset_s", _RESET_TIME, throw.reset_s),
        ],
        "idle": clocks | sizes | thresholds,
        "off": dict.fromkeys(thresholds, UNREACHABLE),
        "fault": throw.name,
        "protection": "off" if scenario.protection is None else "on",
        "safe": safe,
        "standstill_rad_s": protection.standstill_rpm * RPM,
        "overdue_s": protection.overdue_s,
        "names": list(STATES),
        "states": {state: meanings[state] for state in STATES if state in reached},
        "events": EVENTS,
        "reasons": REASONS,
        "stopped_by": list(CAUSES.values()),
        "causes": causes,
        "transitions": [(r.state, r.event, r.next_state) for r in rows if r.state in reached],
    }


_DURATION = Slider("duration, 0 for ever", 0.0, 10.0, "0: the fault does not end")
_RESET_TIME = Slider("reset pressed at, 0 for never", 0.0, 60.0, "within a run")


def _quantity(name: str, slider: Slider, value: float, unit: str = "s") -> dict[str, Any]:
    """Return a number of a fault as a quantity of the page, which shows it at once."""
    shown_at_once = replace(slider, main=True)
    return shown_at_once.quantity(f"{_PREFIX}{name}", value, unit, "assumption")
