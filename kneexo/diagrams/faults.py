"""Adds the faults of a scenario to the closed loop, on its signals and its parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydrake.systems.primitives import Adder, ConstantVectorSource

from kneexo import systems
from kneexo.diagrams.part import Part
from kneexo.diagrams.plant import scenario_plant_parts
from kneexo.diagrams.signals import NEEDED_SETTINGS, SIGNALS
from kneexo.diagrams.wearer import wearer_parts
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
    return (*kinds, *_names(_changes(scenario)).items())


def fault_values(scenario: Scenario) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield the name and the Context parameters of each system that `LoopFaults` adds.

    The pairs are those of `loop_values`, so that a compiled run needs no diagram.

    Raises `ParameterError` as `fault_structure` does.
    """
    changes = _changes(scenario)
    if scenario.protection is not None and _losing(scenario):
        sample_time_s = scenario.controller.sample_time_s
        yield "watchdog", drive_watchdog.context_values(scenario.protection, sample_time_s)
    for name in sorted(pressed_buttons(scenario)):
        yield name, {"0[0]": 0.0}  # the only element of Drake's block
    for number, fault in enumerate(scenario.faults):
        if fault.place in FAULTY_SIGNALS:
            values = fault_system.context_values(fault, **_reading(scenario, fault))
            yield f"fault_{number}", values
        for path, offsets in changes.get(number, {}).items():
            yield _name(number, path), fault_system.offset_values(fault, offsets)


def pressed_buttons(scenario: Scenario) -> set[str]:
    """Return the names of the buttons of the protection that faults of a scenario press."""
    return {fault.place for fault in scenario.faults} & set(OPERATOR_INPUTS)


def _losing(scenario: Scenario) -> list[int]:
    """Return the numbers of the faults that lose commands."""
    faults = enumerate(scenario.faults)
    return [number for number, f in faults if f.place == "command" and f.kind in LOSING]


class LoopFaults:
    """Adds the faults of a scenario to the DiagramBuilder of its closed loop."""

    def __init__(self, builder: Any, scenario: Scenario) -> None:
        self._builder, self._scenario = builder, scenario
        self._systems: dict[int, Any] = {}  # a system of each fault, for its output ``active``
        self._triggered: list[tuple[int, FaultParameters, Any]] = []
        self._changes = _changes(scenario)

    def on_signal(self, place: str, port: Any) -> Any:
        """Add the faults of the signal ``place``, an output port; return the port behind them."""
        for number, fault in enumerate(self._scenario.faults):
            if fault.place != place:
                continue
            system = systems.FaultySignal(
                fault,
                self._scenario.controller.sample_time_s,
                size=port.size(),
                trigger=_trigger(fault),
                **_reading(self._scenario, fault),
            )
            self._add(number, fault, f"fault_{number}", system)
            self._builder.Connect(port, system.GetInputPort("signal"))
            port = system.GetOutputPort("signal")
        return port

    def on_command(self, port: Any) -> Any:
        """Add the faults of the command, and the drive's watchdog if a command can be lost."""
        port = self.on_signal("command", port)
        protection, losing = self._scenario.protection, _losing(self._scenario)
        if protection is None or not losing:
            return port
        watchdog = systems.DriveWatchdog(protection, self._scenario.controller.sample_time_s)
        self._builder.AddNamedSystem("watchdog", watchdog)
        lost = [self._systems[number].GetOutputPort("lost") for number in losing]
        self._builder.Connect(self._sum("lost_commands", lost), watchdog.GetInputPort("lost"))
        self._builder.Connect(port, watchdog.GetInputPort("motor_speed_command"))
        return watchdog.GetOutputPort("motor_speed_command")

    def button(self, name: str) -> Any:
        """Add a button that only faults press; return its output port."""
        nobody = self._builder.AddNamedSystem(name, ConstantVectorSource([0.0]))
        return self.on_signal(name, nobody.get_output_port())

    def names_inside(self, folder: str) -> dict[str, tuple[str, ...]]:
        """Return the Context parameters that faults change, by the name of their system.

        The systems are those inside the subsystem ``folder``, or those of the loop itself for "".
        """
        inside = {}
        for path, names in _names(self._changes).items():
            parent, _, name = path.rpartition("/")
            if parent == folder:
                inside[name] = names
        return inside

    def on_parameters(self, plant: Any) -> None:
        """Add the faults of parameters, and connect them to their systems."""
        sources: dict[str, list[Any]] = {}
        for number, changes in self._changes.items():
            fault = self._scenario.faults[number]
            for path, offsets in changes.items():
                system = systems.ParameterFault(
                    fault, offsets, self._scenario.controller.sample_time_s, _trigger(fault)
                )
                self._add(number, fault, _name(number, path), system)
                sources.setdefault(path, []).append(system.GetOutputPort("offsets"))
        for path, ports in sources.items():
            parent, _, name = path.rpartition("/")
            if parent:
                target = plant.GetInputPort(f"{name}_fault")
            else:
                target = self._builder.GetSubsystemByName(name).GetInputPort("fault")
            self._builder.Connect(self._sum(f"faults_of_{name}", ports), target)

    def finish(self, ports: Mapping[str, Any], available: Sequence[str]) -> Any:
        """Connect each trigger to its signal, and return the output port of ``active_faults``.

        ``ports`` has the output ports of all signals. The port has the number of active faults.
        Without faults the result is None. Raises `ParameterError` if the loop lacks the signal of a
        trigger.
        """
        for number, fault, system in self._triggered:
            signal, _ = _signal_of(fault)
            if signal not in available:
                needed = NEEDED_SETTINGS.get(signal, "another controller")
                raise ParameterError(
                    f"faults.{number}: signal {fault.signal!r} is not in this scenario; needs "
                    f"{needed}"
                )
            self._builder.Connect(ports[signal], system.GetInputPort("trigger"))
        active = [system.GetOutputPort("active") for system in self._systems.values()]
        return self._sum("active_faults", active) if active else None

    def _add(self, number: int, fault: FaultParameters, name: str, system: Any) -> None:
        self._builder.AddNamedSystem(name, system)
        self._systems.setdefault(number, system)
        if fault.signal is not None:
            self._triggered.append((number, fault, system))

    def _sum(self, name: str, ports: list[Any]) -> Any:
        """Add a sum of output ports of equal size; return its output port."""
        adder = self._builder.AddNamedSystem(name, Adder(len(ports), ports[0].size()))
        for index, port in enumerate(ports):
            self._builder.Connect(port, adder.get_input_port(index))
        return adder.get_output_port()


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


def _parts(scenario: Scenario) -> Iterator[tuple[str, Part]]:
    """Yield the systems whose parameters a fault can change, by path."""
    for part in scenario_plant_parts(scenario):
        yield f"plant/{part.name}", part
    for part in wearer_parts(scenario):
        yield part.name, part


def _changes(scenario: Scenario) -> dict[int, Changes]:
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
    if has_path(scenario, fault.place) and not isinstance(value, float):
        raise ParameterError(f"{subject}: is no number that can change during a run")
    try:
        other = changed(scenario, {"faults": (), fault.place: fault.size})
    except ParameterError as error:
        message = str(error).removeprefix("Scenario: ")
        raise ParameterError(f"faults.{number}: {message}") from None
    healthy = {path: part.values() for path, part in _parts(scenario)}
    found: Changes = {}
    for path, part in _parts(other):
        for name, faulty in part.values().items():
            if (change := faulty - healthy[path][name]) != 0.0:
                found.setdefault(path, {})[name] = change
    if not found:
        raise ParameterError(
            f"{subject}: has no effect with size = {fault.size:g}; the value is {value:g} without "
            f"the fault"
        )
    return found
