"""Puts a Drake system of the user in the place of a leaf system of kneexo."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from diagramc import read_diagram
from kneexo.common.ports import input_ports, output_ports, sizes
from kneexo.common.user_code import user_code
from kneexo.diagrams.part import Part, by_name
from kneexo.errors import CompilationError, DifferenceError, ParameterError
from kneexo.law.decision import remembered
from kneexo.parameters import Scenario
from kneexo.parameters.device.parts import PartParameters
from kneexo.parameters.fields.replaced import believed
from kneexo.systems import StateVariable

_EXTENSION_TOLERANCE_M = 1e-6  # of the start of an object, which cannot be told where to start


def users_part(
    chosen: PartParameters,
    replaced: Part,
    template: Callable[[], Any],
    start: dict[str, Any],
    scenario: Scenario | None,
    *,
    needed: tuple[str, ...] = (),
    period_s: float | None = None,
) -> Part:
    """Return the part of the user that takes a place.

    What is known of a Drake object is remembered as long as the object lives. A class or a function
    is asked anew, as `remembered` says.

    Parameters
    ----------
    chosen
        The part of the user.
    replaced
        kneexo's own part, whose name and wires the user's part gets.
    template
        Function that returns a leaf system with the ports of kneexo's own part.
    start
        What a function of the user gets as ``start``.
    scenario
        What a function of the user gets as ``scenario``.
    needed
        Input ports that the part must have, because the scenario acts on the leaf through them.
    period_s
        Sample time in s that a sampled part must have; None: the part must be continuous.

    Raises
    ------
    ParameterError
        The system has other ports, other kinds of states, or another start.
    """
    # A function may read the numbers that its part replaces.
    known = scenario and scenario.model_copy(update={"plant": believed(scenario.plant)})
    place, make = replaced.name, partial(chosen.system, known, start)
    subject = f"parts.{place}: {chosen.make.short_name}"
    numbers = repr((start, sorted(chosen.values.items())))
    text = scenario.model_dump_json() if scenario and chosen.make.takes_scenario else ""
    # `start` and `needed` together determine the template, so the question leaves it out.
    question = place, needed, period_s, numbers, text

    def what_is_known() -> dict[str, Any]:
        system, own = make(), template()
        _require_ports(subject, system, own, needed)
        context = system.CreateDefaultContext()
        _require_states(subject, system, context, period_s)
        if place == "cylinder":
            with user_code(f"{subject}: has no rod_extension at the start"):
                extension = system.GetOutputPort("rod_extension").Eval(context)[0]
            wanted = start["initial_extension_m"]
            if not abs(extension - wanted) <= _EXTENSION_TOLERANCE_M:
                raise ParameterError(
                    f"{subject}: its rod starts at {extension:.7g} m, and the knee at "
                    f"{wanted:.7g} m; must start there: give a function with the argument start, "
                    f"and begin at start['initial_extension_m']"
                )
        # A further output takes the signal of no other part, even one of the same name.
        offers, columns = by_name(*output_ports(own)), dict[str, tuple[str, ...]]()
        for name, size in sizes(output_ports(system)).items():
            if name not in offers and size:
                signal, indices = f"{place}.{name}", [f"[{index}]" for index in range(size)]
                offers[signal] = name
                columns[signal] = tuple(signal + index for index in indices if size > 1) or (
                    signal,
                )
        numbers = read_numbers(place, subject, system)
        if chosen.make.is_object:
            # A conversion that forgets an attribute gives a copy that agrees with itself. So the
            # object is compared too, which needs equations.
            read_numbers(place, subject, chosen.make.target)
            if why := numbers["key"]()[1]:
                raise ParameterError(f"{why}; give its class, or a function that makes it")
        return numbers | {"offers": offers, "columns": columns}

    return replaced._replace(make=make, **remembered(chosen.make, question, what_is_known))


def read_numbers(place: str, subject: str, system: Any) -> dict[str, Any]:
    """Return the fields of a `Part` for a system: parameters, states, start and equations key.

    Raises `ParameterError`, which begins with the ``subject``, if the equations give other values
    than the called system.
    """
    inputs, key = input_ports(system), ("", "")
    try:
        read = read_diagram(system, inputs=inputs)
        key = read.key, ""
    except DifferenceError as error:
        raise ParameterError(f"{subject}: {error}") from None
    except CompilationError as error:
        from diagramc import read_for_linearization  # it imports Drake's geometry

        key = "", f"{subject}: {error}"
        try:
            read = read_for_linearization(system, inputs=inputs)
        except CompilationError:  # a system with events has no linear model, so no numbers
            return {"values": dict, "states": (), "start": None, "key": lambda: key}
    state = read.state()

    def named(names: Sequence[str], values: Any) -> dict[str, float]:
        return dict(zip(names, values.tolist(), strict=True))

    values = named(read.parameter_names, read.parameters())
    continuous = named(read.state_names, state.continuous)
    return {
        "values": lambda: values,
        "states": tuple(StateVariable(f"{place}_state_{n}") for n in range(len(continuous))),
        "start": lambda: [*continuous.values()],
        "state_names": tuple(continuous),
        "discrete_start": named(read.discrete_names, state.discrete),
        "key": lambda: key,
    }


def _require_ports(subject: str, system: Any, template: Any, needed: Sequence[str]) -> None:
    """Raise `ParameterError` unless a system can replace ``template``.

    The system must have all outputs of the template and the inputs ``needed``. Its other inputs are
    among those of the template.
    """
    for kind, ports in (("input", input_ports), ("output", output_ports)):
        found, wanted = sizes(ports(system)), sizes(ports(template))
        table = ", ".join(f"{name} ({size})" for name, size in wanted.items())
        rule = f"must be {table}" if kind == "output" else f"may be {table}"
        rule += f"; must have {', '.join(needed)}" if kind == "input" and needed else ""
        for name in wanted if kind == "output" else {**found, **dict.fromkeys(needed, 0)}:
            if name not in wanted or found.get(name) != wanted[name]:
                size = f"{name} of size {found[name]}" if name in found else f"no {name}"
                raise ParameterError(f"{subject}: has {size} as {kind} port; {kind} ports {rule}")


def _require_states(subject: str, system: Any, context: Any, period_s: float | None) -> None:
    """Raise `ParameterError` for a sampled part where a continuous one is meant, or otherwise."""
    continuous, groups = context.num_continuous_states(), context.num_discrete_state_groups()
    if period_s is None and groups:
        raise ParameterError(f"{subject}: has discrete states; this place must be continuous")
    if period_s is not None:
        timing = system.GetUniquePeriodicDiscreteUpdateAttribute() if groups else None
        if continuous or (groups and (timing is None or timing.period_sec() != period_s)):
            raise ParameterError(
                f"{subject}: must be sampled, with one update every controller.sample_time_s = "
                f"{period_s:g} s"
            )
