"""Decides whether a control law of the user is compiled, or called as Python once a sample."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar, cast

from pydrake.systems.framework import System

from kneexo import systems
from kneexo.compiler import read_diagram
from kneexo.errors import KneexoError, ParameterError
from kneexo.parameters import LAW_INPUTS, Law, LawParameters, Scenario
from kneexo.systems.function_law import trace

T = TypeVar("T")


def why_python(scenario: Scenario) -> str:
    """Return why the law of a scenario is called as Python; an empty text if it is compiled.

    Raises `ParameterError` for a law that cannot be run at all.
    """
    law = scenario.controller
    if not isinstance(law, LawParameters):
        return ""
    if law.function.is_system:
        return _why_system(law.function)
    return trace(law.function, len(law.initial_state)).why_not_compiled


def runs_as_python(scenario: Scenario) -> bool:
    """Return True if the law of a scenario is called as Python once a sample."""
    return bool(why_python(scenario))


def _why_system(law: Law) -> str:
    """Return why the system of a law cannot be compiled; an empty text if it can.

    Raises `ParameterError` if a port is wrong.
    """
    return remembered(law, "why_system", lambda: _why_not_read(law))


def remembered(law: Law, question: Hashable, answer: Callable[[], T]) -> T:
    """Return ``answer()``, or its earlier result if the law of a user has not changed since.

    A Drake system does not change. Any other law has not changed if its fingerprint is the same. An
    answer about a law without fingerprint is not kept.
    """
    now = law.target if isinstance(law.target, System) else law.fingerprint
    before, known = law.memo.get(question, (None, None))
    if now is None or now != before:
        known = answer()
        law.memo[question] = now, known
    return cast(T, known)


def _why_not_read(law: Law) -> str:
    require_ports(law.any_system(), LAW_INPUTS, f"law {law.short_name}")
    inputs = list(port_sizes(law.any_system(), inputs=True))
    try:
        read_diagram(law.make_system(), inputs=inputs)
    except KneexoError as error:
        return str(error)
    return ""


def held_command(scenario: Scenario) -> systems.HeldCommand | None:
    """Return the system that replaces a law that runs as Python; None if the law is compiled."""
    law = scenario.controller
    if not isinstance(law, LawParameters) or not runs_as_python(scenario):
        return None
    return systems.HeldCommand(law.sample_time_s, law_inputs(law.function))


def law_inputs(law: Law) -> tuple[str, ...]:
    """Return the names of the inputs, of `LAW_INPUTS`, that a law of the user reads."""
    if law.is_system:
        return tuple(port_sizes(law.any_system(), inputs=True))
    return law.arguments.inputs


def port_sizes(system: System, *, inputs: bool = False) -> dict[str, int]:
    """Return a dictionary from the name of each output port to its size.

    If ``inputs`` is True, return such a dictionary of the input ports.
    """
    if inputs:
        ports = map(system.get_input_port, range(system.num_input_ports()))
    else:
        ports = map(system.get_output_port, range(system.num_output_ports()))
    return {port.get_name(): port.size() for port in ports}


def require_ports(system: Any, inputs: dict[str, int], subject: str) -> None:
    """Raise `ParameterError` unless ``system`` is a Drake system with fitting ports.

    ``inputs`` maps the name of each allowed input port to its size. ``subject`` begins the message.
    """
    if not isinstance(system, System):
        raise ParameterError(
            f"{subject}: {type(system).__name__} is not a Drake system; to use a function, "
            f"write track(scenario, law=law)"
        )
    for name, size in port_sizes(system, inputs=True).items():
        if inputs.get(name) != size:
            expected = ", ".join(f"{name} ({size})" for name, size in inputs.items())
            raise ParameterError(
                f"{subject}: has an input port {name} of size {size}; must be of {expected}"
            )
    if port_sizes(system).get("motor_speed_command") != 1:
        raise ParameterError(f"{subject}: must have an output port motor_speed_command of size 1")
