"""Describes the faults of a scenario as parts of the closed loop, on signals and parameters."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from functools import partial
from typing import Any

from pydrake.systems.primitives import Adder, ConstantVectorSource

from kneexo import systems
from kneexo.diagrams.part import Part, by_name, leaf_part
from kneexo.diagrams.signals import NEEDED_SETTINGS, SIGNALS
from kneexo.diagrams.wearer import parts_with_states
from kneexo.errors import ParameterError, close_names, question, shown
from kneexo.parameters import FaultParameters, Scenario
from kneexo.parameters.paths import changed, has_path, value_at
from kneexo.parameters.task.fault import FAULTY_SIGNALS, LOSING, OPERATOR_INPUTS
from kneexo.systems import drive_watchdog, fault as fault_system

_CHANGING = ("plant", "wearer", "load_cell")  # parts of a scenario whose numbers can change

Changes = dict[str, dict[str, float]]
"""For each system, by its path, the Context parameters that a fault changes and their changes."""


def fault_structure(scenario: Scenario) -> tuple[Any, ...]:
    """Return data to compare the faults of two scenarios: equal data, equations of one form.

    The sizes and times of the faults do not belong to the data, because they are parameters.
    Raises `ParameterError` for a fault that cannot be in this scenario, or changes nothing.
    """
    # With the signal of the trigger: two signals of one column look alike to all other data, and a
    # run once watched the signal of an earlier run.
    kinds = (
        (fault.place, fault.kind, fault.signal and _signal_of(fault)) for fault in scenario.faults
    )
    return (*kinds, *_names(parameter_changes(scenario)).items())


def pressed_buttons(scenario: Scenario) -> set[str]:
    """Return the names of the buttons of the protection that faults of a scenario press."""
    return {fault.place for fault in scenario.faults} & set(OPERATOR_INPUTS)


def _losing(scenario: Scenario) -> list[int]:
    """Return the numbers of the faults that lose commands."""
    faults = enumerate(scenario.faults)
    return [number for number, f in faults if f.place == "command" and f.kind in LOSING]


_SIGNAL_AT = {"encoder": "encoder_reading", "load_cell": "measured_force"} | {
    name: name for name in OPERATOR_INPUTS
}
"""For each place of a fault before the controller, the signal that passes through the fault."""


def reading_faults(scenario: Scenario) -> Iterator[Part]:
    """Yield the faults of what the controller reads, and each button that only faults press."""
    for place, signal in _SIGNAL_AT.items():
        if place in pressed_buttons(scenario):
            nobody = partial(ConstantVectorSource, [0.0])
            yield Part(place, nobody, lambda: {"0[0]": 0.0}, offers={place: "y0"})
        yield from _signal_faults(scenario, place, signal)


def command_faults(scenario: Scenario) -> Iterator[Part]:
    """Yield the faults of the command, and the drive's watchdog if a command can be lost."""
    yield from _signal_faults(scenario, "command", "motor_speed_command")
    protection, losing = scenario.protection, _losing(scenario)
    if protection is None or not losing:
        return
    arguments = protection, scenario.controller.sample_time_s
    yield leaf_part("watchdog", systems.DriveWatchdog, drive_watchdog, *arguments)._replace(
        reads={"lost": "lost_commands"},
        offers=by_name("motor_speed_command"),
        through="motor_speed_command",
    )
    yield _sum("lost_commands", [f"lost_{number}" for number in losing], 1)


def parameter_faults(scenario: Scenario, all_changes: dict[int, Changes]) -> Iterator[Part]:
    """Yield the faults of parameters, and for each changed system the sum of its changes.

    ``all_changes`` are the `parameter_changes` of the scenario.
    """
    sources: dict[str, list[str]] = {}
    for number, changes in all_changes.items():
        fault = scenario.faults[number]
        for path, offsets in changes.items():
            name = _name(number, path)
            sources.setdefault(path, []).append(name)
            yield Part(
                name,
                partial(
                    systems.ParameterFault,
                    fault,
                    offsets,
                    scenario.controller.sample_time_s,
                    _trigger(fault),
                ),
                partial(fault_system.offset_values, fault, offsets),
                reads=_trigger_signal(fault),
                offers={name: "offsets", f"active_{number}": "active"},
            )
    for path, names in _names(all_changes).items():
        yield _sum(f"faults_of_{path.rpartition('/')[2]}", sources[path], len(names))


def active_faults(scenario: Scenario) -> Iterator[Part]:
    """Yield the number of active faults, if the scenario has faults."""
    if scenario.faults:
        active = [f"active_{number}" for number in range(len(scenario.faults))]
        yield _sum("active_faults", active, 1)


def changed_inside(changes: dict[int, Changes], folder: str) -> dict[str, tuple[str, ...]]:
    """Return the Context parameters that faults change, by the name of their system.

    ``changes`` are `parameter_changes`. The systems are those inside the subsystem ``folder``, or
    those of the loop itself for "".
    """
    paths = ((path.rpartition("/"), names) for path, names in _names(changes).items())
    return {name: names for (parent, _, name), names in paths if parent == folder}


def _signal_faults(scenario: Scenario, place: str, signal: str) -> Iterator[Part]:
    """Yield the faults of the place ``place``, through which ``signal`` passes."""
    for number, fault in enumerate(scenario.faults):
        if fault.place != place:
            continue
        make = partial(
            systems.FaultySignal,
            fault,
            scenario.controller.sample_time_s,
            size=len(SIGNALS.get(signal, (signal,))),
            trigger=_trigger(fault),
            **_reading(scenario, fault),
        )
        yield Part(
            f"fault_{number}",
            make,
            partial(fault_system.context_values, fault, **_reading(scenario, fault)),
            reads={"signal": signal} | _trigger_signal(fault),
            offers={signal: "signal", f"active_{number}": "active"}
            | ({f"lost_{number}": "lost"} if fault.kind in LOSING else {}),
            through=signal,
        )


def _trigger_signal(fault: FaultParameters) -> dict[str, str]:
    """Return the signal that the port ``trigger`` of a fault reads, if it has this port."""
    return {} if fault.signal is None else {"trigger": _signal_of(fault)[0]}


def require_triggers(scenario: Scenario, available: Collection[str]) -> None:
    """Raise `ParameterError` if a fault starts by a signal that is not among ``available``."""
    for number, fault in enumerate(scenario.faults):
        for signal in _trigger_signal(fault).values():
            if signal not in available:
                needed = NEEDED_SETTINGS.get(signal, "another controller")
                raise ParameterError(
                    f"faults.{number}: signal {fault.signal!r} is not in this scenario; needs "
                    f"{needed}"
                )


def _sum(name: str, signals: list[str], size: int) -> Part:
    """Return a sum of signals of equal size, which offers the signal ``name``."""
    reads = {f"u{index}": signal for index, signal in enumerate(signals)}
    return Part(name, partial(Adder, len(signals), size), reads=reads, offers={name: "sum"})


def _name(number: int, path: str) -> str:
    """Return the name of the `ParameterFault` by which a fault changes the system at ``path``.

    A fault of a number that several systems have, such as a piston area, has several of them.
    """
    return f"fault_{number}_{path.rpartition('/')[2]}"


def _reading(scenario: Scenario, fault: FaultParameters) -> dict[str, float]:
    """Return ``lead_s`` and ``resolution`` of the `FaultySignal` of a fault.

    A reading has a lead of one sample, because who reads it sees the fault before its update. The
    command has no lead.
    """
    sampled = fault.place != "command"
    lead_s = scenario.controller.sample_time_s if sampled else 0.0
    return {"lead_s": lead_s, "resolution": scenario.encoder.resolution_rad}


def _signal_of(fault: FaultParameters) -> tuple[str, int]:
    """Return the signal that triggers a fault, and the index of its column."""
    signals = {signal: names for signal, names in SIGNALS.items() if signal != "active_faults"}
    for signal, names in signals.items():
        if fault.signal in names:
            return signal, names.index(fault.signal)
    known = [column for names in signals.values() for column in names]
    advice = question(close_names(str(fault.signal), known)) or "; take another of signals.csv"
    raise ParameterError(f"faults: signal {fault.signal!r} cannot start a fault{advice}")


def _trigger(fault: FaultParameters) -> tuple[int, int] | None:
    if fault.signal is None:
        return None
    signal, index = _signal_of(fault)
    return len(SIGNALS[signal]), index


def parameter_changes(scenario: Scenario) -> dict[int, Changes]:
    """Return the changes that each fault of a parameter makes, by its index in the list.

    All faults of one system have the same names, so that their changes can be added. A name that
    only other faults change has the change 0.
    """
    found = {
        number: _changes_of(scenario, number)
        for number, fault in enumerate(scenario.faults)
        if fault.place not in FAULTY_SIGNALS
    }
    names: dict[str, dict[str, float]] = {}
    for changes in found.values():
        for path, offsets in changes.items():
            names.setdefault(path, {}).update(dict.fromkeys(offsets, 0.0))
    return {
        number: {path: names[path] | offsets for path, offsets in changes.items()}
        for number, changes in found.items()
    }


def _names(changes: dict[int, Changes]) -> dict[str, tuple[str, ...]]:
    """Return the names of the changed Context parameters, by the path of their system."""
    return {path: tuple(offsets) for of in changes.values() for path, offsets in of.items()}


def _changes_of(scenario: Scenario, number: int) -> Changes:
    """Return the Context parameters that the fault ``number`` changes, with their changes."""
    fault = scenario.faults[number]
    subject = f"faults.{number}: place = {shown(fault.place)}"
    value = value_at(scenario, fault.place)
    if fault.place.partition(".")[0] not in _CHANGING:
        raise ParameterError(
            f"{subject}: is unknown; must be {', '.join(FAULTY_SIGNALS)}, or the path of a number "
            f"of {', '.join(_CHANGING)} that the scenario has"
        )
    if fault.place.startswith("load_cell.") and not scenario.has_load_cell:
        raise ParameterError(f"{subject}: needs wearer.kind = leg or controller.kind = torque")
    if fault.place.startswith("plant.linkage."):
        raise ParameterError(f"{subject}: is of the linkage, which cannot change during a run")
    if value is not None and not has_path(scenario, fault.place):
        raise ParameterError(
            f"{subject}: a part of yours replaces what has this number, and has no fault of its "
            f"parameters; let a signal fail"
        )
    if has_path(scenario, fault.place) and not isinstance(value, float):
        raise ParameterError(f"{subject}: is no number that can change during a run")
    try:
        other = changed(scenario, {"faults": (), fault.place: fault.size})
    except ParameterError as error:
        message = str(error).removeprefix("Scenario: ")
        raise ParameterError(f"faults.{number}: {message}") from None
    healthy = {path: part.values() for path, part in parts_with_states(scenario)}
    found: Changes = {}
    for path, part in parts_with_states(other):
        for name, faulty in part.values().items():
            if (change := faulty - healthy[path][name]) != 0.0:
                found.setdefault(path, {})[name] = change
    if not found:
        raise ParameterError(
            f"{subject}: has no effect with size = {fault.size:g}; the value is {value:g} without "
            f"the fault"
        )
    return found
