"""Describes a diagram as a list of parts, and wires the parts by the names of their signals.

The list is used by the builder of the diagram, compiled runs, linear analysis and export as FMU.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

from kneexo.common.ports import input_ports, output_ports
from kneexo.errors import ParameterError, shortened
from kneexo.systems import StateVariable

NO_FAULTS: Mapping[str, tuple[str, ...]] = MappingProxyType({})
"""No Context parameters that faults change, of no systems."""


NO_SIGNAL = ""
"""What an input port reads that stays unconnected, although a signal has the port's name."""


class Part(NamedTuple):
    """Description of a system in a diagram: how it is made, its numbers, what it reads and offers.

    An input port reads the signal of its own name, and an output port offers the signal of its own
    name, unless ``reads`` and ``offers`` say otherwise. See `wire`.
    """

    name: str
    """Name of the system in the diagram."""
    make: Callable[..., Any]
    """Function that returns the system; compiled runs do not call it.

    The makers of plant, wearer and load cell take ``fault_names``: the Context parameters that
    faults change.
    """
    values: Callable[[], dict[str, float]] = dict
    """Function that returns a dictionary from the name of a Context parameter to its value.

    A parameter without a name, in a further vector, is called ``vector[index]``. A name can begin
    with the path of a leaf inside a Diagram of the user: see `full_name`.
    """
    states: tuple[StateVariable, ...] = ()
    """Continuous states of the system, in the order of the Context."""
    start: Callable[[], Sequence[float]] | None = None
    """Function that returns the initial ``states`` in the units of their columns; None: zeros."""
    reads: Mapping[str, str] = MappingProxyType({})
    """Signal of each input port that reads a signal of another name than its own."""
    offers: Mapping[str, str] | None = None
    """Output port of each signal that the part offers. None: all ports, by their names."""
    may_offer: Mapping[str, str] = MappingProxyType({})
    """Output port of each signal that the part offers if its system has the port."""
    columns: Mapping[str, tuple[str, ...]] = MappingProxyType({})
    """Columns of each signal that only this part of the user offers; the signals of kneexo are in
    `kneexo.diagrams.SIGNALS`."""
    state_names: tuple[str, ...] = ()
    """Names of the continuous states of a part of the user; kneexo's own are ``x[0]``, ``x[1]`` …
    """
    discrete_start: Mapping[str, float] = MappingProxyType({})
    """Initial discrete states of a part of the user, by their names."""
    key: Callable[[], tuple[str, str]] | None = None
    """Function that returns two texts about a system of the user; None for kneexo's own.

    They are a hash of its equations, and why it has none; one of the two is empty.
    """
    through: str = ""
    """Signal that passes through the part, which reads it from the parts before, as ``reads``
    says, and offers it to all others."""

    def start_state(self) -> list[float]:
        """Return the initial values of ``states`` in the units of the Context."""
        start = [0.0] * len(self.states) if self.start is None else self.start()
        return [value / state.factor for value, state in zip(start, self.states, strict=True)]


def leaf_part(name: str, component: Any, module: Any, *arguments: Any, **fields: Any) -> Part:
    """Return the part of a leaf system without continuous states.

    Parameters
    ----------
    name
        Name of the leaf system in the diagram.
    component
        Class of the leaf system.
    module
        Module of the class. Its function ``context_values`` takes the same arguments as the class.
    arguments
        Positional arguments of both.
    fields
        Other fields of the part, by name.
    """
    values = partial(module.context_values, *arguments)
    return Part(name, partial(component, *arguments), values, **fields)


def by_name(*signals: str) -> dict[str, str]:
    """Return the ``offers`` of a part whose output ports have the names of ``signals``."""
    return dict(zip(signals, signals, strict=True))


def with_faults(parts: Iterable[Part], fault_names: Mapping[str, tuple[str, ...]]) -> list[Part]:
    """Return ``parts``, of which those in ``fault_names`` are made with inputs of faults.

    ``fault_names`` has the Context parameters that faults change, by the name of the part.
    """
    return [
        part._replace(make=partial(part.make, fault_names=fault_names[part.name]))
        if part.name in fault_names
        else part
        for part in parts
    ]


def state_names(part: Part, path: str) -> list[str]:
    """Return the names that a compiled model gives the continuous states of a part.

    ``path`` is the path of the part's system in the loop, such as ``plant/motor``.
    """
    names = part.state_names or [f"x[{index}]" for index in range(len(part.states))]
    return [full_name(path, name) for name in names]


def full_name(path: str, name: str) -> str:
    """Return the name in the compiled loop of a number of a part's system at a path.

    The number ``gain`` or ``.gain`` of a leaf system is ``path.gain``, and the number
    ``filter.gain`` of a Diagram is ``path/filter.gain``.
    """
    if name.startswith("."):
        return path + name
    return f"{path}/{name}" if "." in name else f"{path}.{name}"


def wire(builder: Any, parts: Iterable[Part]) -> tuple[dict[str, Any], dict[str, list[Any]]]:
    """Add the systems of ``parts`` to a DiagramBuilder and connect them by names of signals.

    Of parts that offer one signal, the last one has it. A part with ``through`` reads its signal
    as the parts before it in the list offer it; every other port reads what the last part offers.

    Parameters
    ----------
    builder
        The DiagramBuilder.
    parts
        The systems, in their order in the diagram.

    Returns
    -------
    signals, inputs
        The output port of each signal, and the input ports of each signal that no part offers.

    Raises
    ------
    ParameterError
        A part offers an output port that its system does not have.
    """
    systems, ports = [], dict[str, Any]()
    for part in parts:
        system = builder.AddNamedSystem(part.name, part.make())
        systems.append((part, system))
        for name, port in input_ports(system).items() if part.through else ():
            if part.reads.get(name, name) == part.through:
                builder.Connect(ports[part.through], port)
        own = output_ports(system)
        offered = by_name(*own) if part.offers is None else part.offers
        for signal, name in offered.items():
            if name not in own:
                raise ParameterError(
                    f"part {part.name}: offers {signal!r} by the output port {name!r}, which is "
                    f"none of its ports {', '.join(own)}"
                )
        offers = {**offered, **part.may_offer}
        ports |= {signal: own[name] for signal, name in offers.items() if name in own}
    inputs: dict[str, list[Any]] = {}
    for part, system in systems:
        for name, port in input_ports(system).items():
            signal = part.reads.get(name, name)
            if signal in (NO_SIGNAL, part.through):
                continue
            if signal in ports:
                builder.Connect(ports[signal], port)
            else:
                inputs.setdefault(signal, []).append(port)
    return ports, inputs


def built(builder: Any, name: str, users: Collection[str]) -> Any:
    """Return the Diagram of a DiagramBuilder with a name.

    Raises `ParameterError` if Drake cannot order the ports, as in an algebraic loop, and there are
    systems ``users`` of the user.
    """
    try:
        diagram = builder.Build()
    except RuntimeError as error:  # of several lines
        if not users:
            raise
        reason = shortened(str(error).splitlines()[0].rstrip(":"), 100)
        raise ParameterError(
            f"{name} with your {', '.join(users)}: {reason}; an "
            f"output port follows all inputs at once, unless DeclareVectorOutputPort gets "
            f"prerequisites_of_calc, such as {{self.all_state_ticket()}}"
        ) from error
    diagram.set_name(name)
    return diagram


def export_inputs(
    builder: Any, inputs: Mapping[str, Sequence[Any]], names: Mapping[str, str]
) -> None:
    """Export the input ports of the signals in ``names``, in this order.

    ``names`` maps a signal to the name of the diagram's input. Other signals of ``inputs`` stay
    unconnected.
    """
    for signal, name in names.items():
        for port in inputs.get(signal, ())[:1]:
            index = builder.ExportInput(port, name)
            for other in inputs[signal][1:]:
                builder.ConnectInput(index, other)
