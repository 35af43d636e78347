"""Decides whether a control law of the user is compiled, or called as Python once a sample."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, NamedTuple, TypeVar, cast

from pydrake.systems.framework import System

from diagramc import read_diagram, sampled_leaves
from kneexo.common.ports import input_ports, output_ports, sizes
from kneexo.errors import CompilationError, DifferenceError, KneexoError, ParameterError
from kneexo.geometry.rod_polynomial import controller_polynomial
from kneexo.law.trace import HeldCommand, Trace, trace
from kneexo.parameters import LAW_INPUTS, Law, LawParameters, Scenario

T = TypeVar("T")


def why_python(scenario: Scenario) -> str:
    """Return why the law of a scenario is called as Python; an empty text if it is compiled.

    Raises `ParameterError` for a law that cannot be run at all.
    """
    if (traced := function_trace(scenario)) is not None:
        return traced.why_not_compiled
    return _system_law(scenario).why_python if scenario.controller.kind == "law" else ""


def function_trace(scenario: Scenario) -> Trace | None:
    """Return the trace of a law that is a function; None for any other controller."""
    law = scenario.controller
    if not isinstance(law, LawParameters) or law.function.is_system:
        return None
    return trace(law.function, len(law.loaded().initial_state))


def runs_as_python(scenario: Scenario) -> bool:
    """Return True if the law of a scenario is called as Python once a sample."""
    return bool(why_python(scenario))


def users_law(scenario: Scenario) -> Law:
    """Return the law of a scenario whose controller has the kind ``law``."""
    assert isinstance(scenario.controller, LawParameters)
    return scenario.controller.function


def remembered(law: Law, question: Hashable, answer: Callable[[], T]) -> T:
    """Return ``answer()`` about a law of the user, or its earlier result.

    A Drake system and the arguments of a function do not change. A class or function that makes a
    system may make another one whenever a value that it reads has changed. So answers about it are
    kept only while `makers_called_once` lasts.
    """
    makes_systems = law.is_system and not isinstance(law.target, System)
    memo = _answers.get() if makes_systems else law.memo
    if memo is None:
        return answer()
    key = id(law), question
    if key not in memo:
        memo[key] = law, answer()  # with the law, so that no other law gets its id
    return cast(T, memo[key][1])


_answers: ContextVar[dict[Any, Any] | None] = ContextVar("answers", default=None)
"""The answers of `remembered` about laws that make systems, within `makers_called_once`."""


@contextmanager
def makers_called_once() -> Iterator[None]:
    """Context manager, also a decorator: the body asks a law that makes systems each question once.

    Making and reading a system takes some 10 ms. A body inside another shares its answers.
    """
    token = _answers.set({} if (answers := _answers.get()) is None else answers)
    try:
        yield
    finally:
        _answers.reset(token)


def maker_arguments(scenario: Scenario) -> dict[str, Any]:
    """Return the arguments with which the law of a scenario makes its Drake system."""
    law = scenario.controller
    assert isinstance(law, LawParameters)
    if not law.function.takes_scenario:
        return {}
    return {"scenario": known_to_controller(scenario), **law.loaded().values}


def known_to_controller(scenario: Scenario) -> Scenario:
    """Return a scenario that contains only what the controller knows of ``scenario``.

    A controller knows the nominal plant (which becomes the plant), polynomial, encoder, estimator,
    protection and its own parameters. All other values of the result are defaults.
    """
    return Scenario(
        plant=scenario.believed_plant,
        polynomial=controller_polynomial(scenario),
        encoder=scenario.encoder,
        estimator=scenario.estimator,
        controller=scenario.controller,
        protection=scenario.protection,
    )


def known_text(scenario: Scenario) -> str:
    """Return `known_to_controller` as JSON, without the law.

    The text is part of a question to `remembered`: equal texts have equal answers.
    """
    without_law = {"controller": {"function"}}
    return known_to_controller(scenario).model_dump_json(exclude=without_law)


class _SystemLaw(NamedTuple):
    """What the controller has to know of a law that is or makes a Drake system."""

    why_python: str
    """Why the system cannot be compiled, or an empty text for a system that compiles."""
    inputs: tuple[str, ...]
    """Names of the input ports of the system."""


def _system_law(scenario: Scenario) -> _SystemLaw:
    """Return the ports of a law that is a Drake system, and why it cannot be compiled, if so.

    The answer is remembered. Raises `ParameterError` if a port or a sample period is wrong.
    """
    law = users_law(scenario)
    known = known_text(scenario) if law.takes_scenario else ""
    question = "system", known, scenario.controller.sample_time_s
    return remembered(law, question, lambda: _read(scenario))


def _require_periods(system: System, sample_time_s: float, subject: str) -> None:
    """Raise `ParameterError` unless the system of a law keeps to the samples of the controller.

    The command must change at each sample, and any other discrete state at every n-th. ``subject``
    is the name of the law in the message.
    """
    try:
        leaves = sampled_leaves(system, "motor_speed_command")
    except CompilationError as error:
        raise ParameterError(f"{subject}: {error}") from None
    held = (leaf.timing.period_sec() for leaf in leaves if leaf.holds_output)
    fastest_s = min(held, default=sample_time_s)
    if not math.isclose(fastest_s, sample_time_s):
        raise ParameterError(
            f"controller.sample_time_s = {sample_time_s:g} s: must be {fastest_s:g} s, at which "
            f"{subject} updates"
        )
    for name, timing, _ in leaves:
        period_s, offset_s = timing.period_sec(), timing.offset_sec()
        samples = period_s / sample_time_s
        if offset_s or not math.isclose(samples, max(1, round(samples))):
            raise ParameterError(
                f"{subject}: {name} updates every {period_s:g} s from {offset_s:g} s on; must "
                f"update from 0 s on, every controller.sample_time_s = {sample_time_s:g} s or a "
                f"whole multiple of it"
            )


def _read(scenario: Scenario) -> _SystemLaw:
    law, arguments = users_law(scenario), maker_arguments(scenario)
    system = law.any_system(arguments)
    require_ports(system, f"law {law.short_name}")
    _require_periods(system, scenario.controller.sample_time_s, f"law {law.short_name}")
    inputs = tuple(input_ports(system))
    # `any_system` accepts a system that runs as Python only, `make_system` one that can be cloned.
    try:
        read_diagram(law.make_system(arguments), inputs=inputs)
    except DifferenceError as error:
        raise ParameterError(f"law {law.short_name}: {error}") from None
    except KneexoError as error:
        return _SystemLaw(str(error), inputs)
    return _SystemLaw("", inputs)


def law_inputs(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of the inputs, of `LAW_INPUTS`, that the law of the user reads."""
    law = users_law(scenario)
    return _system_law(scenario).inputs if law.is_system else law.arguments.inputs


def held_command(scenario: Scenario) -> HeldCommand | None:
    """Return the system that replaces a law that runs as Python; None if the law is compiled."""
    law = scenario.controller
    if not isinstance(law, LawParameters) or not runs_as_python(scenario):
        return None
    return HeldCommand(law.sample_time_s, law_inputs(scenario))


def require_ports(system: System, subject: str) -> None:
    """Raise `ParameterError` unless a system of the user has the ports of a control law.

    ``subject`` begins the message.
    """
    for name, size in sizes(input_ports(system)).items():
        if LAW_INPUTS.get(name) != size:
            expected = ", ".join(f"{name} ({size})" for name, size in LAW_INPUTS.items())
            raise ParameterError(
                f"{subject}: has an input port {name} of size {size}; must be of {expected}"
            )
    if sizes(output_ports(system)).get("motor_speed_command") != 1:
        raise ParameterError(f"{subject}: must have an output port motor_speed_command of size 1")
