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
from kneexo.law.leaves import HeldCommand
from kneexo.law.trace import Trace, trace
from kneexo.parameters import LAW_INPUTS, Law, LawParameters, Scenario
from kneexo.parameters.device.parts import PartsParameters

T = TypeVar("T")


class Decision(NamedTuple):
    """Whether a law is compiled, what it reads, and the equations of a law that is a function."""

    why_python: str = ""
    """Why the law is called as Python, or an empty text for a law that is compiled."""
    inputs: tuple[str, ...] = ()
    """Names of the inputs, of `LAW_INPUTS`, that the law reads."""
    trace: Trace | None = None
    """Equations of a function; None for a Drake system, and for kneexo's own controllers."""


def decide(scenario: Scenario) -> Decision:
    """Decide whether the law of a scenario is compiled, or called as Python once a sample.

    kneexo's own controllers are compiled. Raises `ParameterError` for a law that cannot be run.
    """
    controller = scenario.controller
    if not isinstance(controller, LawParameters):
        return Decision()
    law = controller.function
    if law.is_system:
        known = known_text(scenario) if law.takes_scenario else ""
        key = "system", known, controller.sample_time_s
        return remembered(law, key, lambda: _decide_for_system(scenario, law))
    traced = trace(law, len(controller.loaded().initial_state))
    return Decision(traced.why_not_compiled, law.arguments.inputs, traced)


def why_python(scenario: Scenario) -> str:
    """Return why the law of a scenario is called as Python; an empty text if it is compiled."""
    return decide(scenario).why_python


def held_command(scenario: Scenario) -> HeldCommand | None:
    """Return the system that replaces a law that runs as Python; None if the law is compiled."""
    if not (decision := decide(scenario)).why_python:
        return None
    return HeldCommand(scenario.controller.sample_time_s, decision.inputs)


def law_inputs(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of the inputs, of `LAW_INPUTS`, that the law of the user reads."""
    law = users_law(scenario)
    return decide(scenario).inputs if law.is_system else law.arguments.inputs


def users_law(scenario: Scenario) -> Law:
    """Return the law of a scenario whose controller has the kind ``law``."""
    assert isinstance(scenario.controller, LawParameters)
    return scenario.controller.function


def users_system(scenario: Scenario, *, copied: bool = False) -> System:
    """Return the Drake system of a law that is a system, or a new one of a law that makes systems.

    If ``copied`` is True, a law that is a system gives a clone of this system. Raises
    `ParameterError` as `Law.make_system` does.
    """
    controller = scenario.controller
    assert isinstance(controller, LawParameters)
    law = controller.function
    if isinstance(law.target, System) and not copied:
        return law.target
    if not law.takes_scenario:
        return law.make_system()
    return law.make_system(
        {"scenario": known_to_controller(scenario), **controller.loaded().values}
    )


def remembered(law: Law, key: Hashable, answer: Callable[[], T]) -> T:
    """Return ``answer()`` about a law of the user, or the earlier answer with the same ``key``.

    Answers are kept on the law, because a Drake system and the arguments of a function do not
    change. A law that makes systems is the exception: it may make another system whenever a value
    that it reads has changed. Answers about such a law are kept only inside `makers_called_once`.
    """
    answers, of_makers = law.memo, _answers.get()
    makes_systems = law.is_system and not isinstance(law.target, System)
    if makes_systems:
        answers = {} if of_makers is None else of_makers.setdefault(law, {})
    if key not in answers:
        answers[key] = answer()
    return cast(T, answers[key])


def found_once(scenario: Scenario, find: Callable[[], T]) -> T:
    """Return ``find()``; inside `makers_called_once`, keep the answer to the last call.

    The kept answer counts for the same object ``scenario`` only: a comparison of values would take
    as long as ``find``.
    """
    if (answers := _answers.get()) is None:
        return find()
    if _LAST not in answers or answers[_LAST][0] is not scenario:
        answers[_LAST] = scenario, find()
    return cast(T, answers[_LAST][1])


_LAST = "last scenario"
"""Key of the scenario of `found_once` and of its answer."""


_answers: ContextVar[dict[Any, Any] | None] = ContextVar("answers", default=None)
"""Answers about laws that make systems, by law and key, and that of `found_once`; None outside
`makers_called_once`."""


@contextmanager
def makers_called_once() -> Iterator[None]:
    """Context manager and decorator: inside the body `remembered` keeps all its answers.

    Outside, `remembered` forgets its answers about a law that makes systems at once, and so makes
    and reads a system for each question. This takes some 10 ms. A body inside another body shares
    the answers of the outer body.
    """
    token = _answers.set({} if (answers := _answers.get()) is None else answers)
    try:
        yield
    finally:
        _answers.reset(token)


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
        parts=PartsParameters(estimator=scenario.parts.estimator),
        controller=scenario.controller,
        protection=scenario.protection,
    )


def known_text(scenario: Scenario) -> str:
    """Return `known_to_controller` as JSON, without the law, for a key of `remembered`.

    If two scenarios have equal texts, an answer about the law for one is right for the other too.
    """
    without_law = {"controller": {"function"}}
    return known_to_controller(scenario).model_dump_json(exclude=without_law)


def _require_periods(system: System, sample_time_s: float, subject: str) -> None:
    """Raise `ParameterError` unless the system of a law updates at the samples of the controller.

    The command must change at each sample. Another discrete state may change at every n-th sample.
    ``subject`` is the name of the law in the message.
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


def _decide_for_system(scenario: Scenario, law: Law) -> Decision:
    """Return the `Decision` about a law that is or makes a Drake system.

    The law is compiled if the compiler can read the equations of the system. Raises
    `ParameterError` if a port or a sample period of the system is wrong, or if the equations differ
    from the system itself.
    """
    system, subject = users_system(scenario), f"law {law.short_name}"
    _require_ports(system, subject)
    _require_periods(system, scenario.controller.sample_time_s, subject)
    inputs = tuple(input_ports(system))
    try:
        # A clone is read, because the loop contains a clone too: see `make_controller`.
        read_diagram(users_system(scenario, copied=True), inputs=inputs)
    # With a difference the system contradicts itself: its conversion or its copy forgets something,
    # or it keeps a state in an attribute (``docs/compile_your_diagram.md``). To call such a system
    # as Python would hide this fault. Any other error only says that there are no equations, and
    # the law runs as Python.
    except DifferenceError as error:
        raise ParameterError(f"{subject}: {error}") from None
    except KneexoError as error:
        return Decision(str(error), inputs)
    return Decision("", inputs)


def _require_ports(system: System, subject: str) -> None:
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
