"""Builds the controller, all that runs on the embedded target, as one diagram."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextvars import ContextVar
from functools import lru_cache
from typing import Any

from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import Saturation, ZeroOrderHold

from kneexo import systems
from kneexo.diagrams.law import (
    held_command,
    port_sizes as port_sizes,
    remembered,
    require_ports,
)
from kneexo.diagrams.part import Part, add_parts
from kneexo.diagrams.signals import LAW_OUTPUTS
from kneexo.errors import ParameterError, shortened
from kneexo.parameters import (
    LAW_INPUTS,
    CustomControllerParameters,
    Law,
    LawParameters,
    ObserverParameters,
    PidParameters,
    Scenario,
    SlidingModeParameters,
    TorqueParameters,
)
from kneexo.rod_polynomial import controller_polynomial
from kneexo.systems import (
    function_law,
    knee_coordinates,
    pid_controller,
    sliding_mode_controller,
    torque_controller,
)
from kneexo.systems.function_law import LAW_COMMAND
from kneexo.user_code import function_at, user_code


def make_controller(scenario: Scenario = Scenario(), law: System | None = None) -> System:
    """Build the controller of a scenario, the part of the loop that runs on the embedded target.

    ===================  ====  ====================  ==============================================
    input port           size  unit
    ===================  ====  ====================  ==============================================
    encoder_reading      1     rad                   θ_4 as read by the encoder
    knee_reference       4     rad, rad/s, …         θ_d and its derivatives to the third
    rod_state            3     m, m/s, m/s²          only with the estimator ``exact``
    measured_force       2     N, s                  reading of the load cell, age; torque only
    biological_moment    1     N·m                   only with torque in the mode ``assist``
    **output port**
    motor_speed_command  1     rad/s                 motor side, held for a sample
    ===================  ====  ====================  ==============================================

    Subsystems: ``coordinates`` (`KneeCoordinates`), ``rod_reference`` (`RodReference`) and ``law``.
    There is also an ``estimator`` if the law has the input ``estimated_state`` and the estimator is
    not ``exact``. More outputs: ``measured_knee_angle``, ``measured_rod_extension`` and
    ``rod_reference``. An estimator adds ``estimated_state``, the sliding-mode law adds
    ``sliding_variable``, and the torque controller adds ``desired_torque``.

    Parameters
    ----------
    scenario
        Nominal plant, polynomial, encoder, estimator and controller. If ``controller.kind`` is
        ``custom``, the function ``controller.make`` returns the whole controller, a system with at
        least the output port ``motor_speed_command``. The argument of this function is the result
        of `known_to_controller`.
    law
        A system that replaces the scenario's control law. It has the output ``motor_speed_command``
        and any of the inputs ``rod_extension`` (m), ``rod_reference`` (4), ``estimated_state`` (3),
        ``knee_angle`` (rad) and ``knee_reference`` (4).

    Raises
    ------
    ParameterError
        A custom controller cannot be made, or a port is wrong.
    """
    if law is None and isinstance(scenario.controller, CustomControllerParameters):
        return _custom_controller(scenario, scenario.controller)
    unknown_law = law is None and has_unknown_parts(scenario)
    builder = DiagramBuilder()
    part = add_parts(builder, _parts(scenario, law))
    coordinates, rod_reference = part["coordinates"], part["rod_reference"]
    law = part["law"]
    knee_reference = builder.ExportInput(rod_reference.get_input_port(), "knee_reference")
    builder.ExportInput(coordinates.get_input_port(), "encoder_reading")
    sources = {
        "rod_extension": coordinates.GetOutputPort("rod_extension"),
        "knee_angle": coordinates.GetOutputPort("knee_angle"),
        "rod_reference": rod_reference.get_output_port(),
    }
    command = law.GetOutputPort("motor_speed_command")
    if unknown_law:
        command = _limited_and_held(builder, scenario, law, command)
    outputs = {
        "motor_speed_command": command,
        "measured_knee_angle": sources["knee_angle"],
        "measured_rod_extension": sources["rod_extension"],
        "rod_reference": sources["rod_reference"],
    }
    if "estimator" in part:
        builder.Connect(sources["rod_extension"], part["estimator"].get_input_port())
        sources["estimated_state"] = part["estimator"].get_output_port()
        outputs["estimated_state"] = sources["estimated_state"]
    for name in port_sizes(law, inputs=True):
        port = law.GetInputPort(name)
        if name in sources:
            builder.Connect(sources[name], port)
        elif name == "knee_reference":
            builder.ConnectInput(knee_reference, port)
        else:
            builder.ExportInput(port, "rod_state" if name == "estimated_state" else name)
    for name in LAW_OUTPUTS:
        if law.HasOutputPort(name):
            outputs[name] = law.GetOutputPort(name)
    for name, output in outputs.items():
        builder.ExportOutput(output, name)
    controller = builder.Build()
    controller.set_name("controller")
    return controller


def _limited_and_held(builder: Any, scenario: Scenario, law: System, command: Any) -> Any:
    """Limit the output port ``command`` of a user's system; return the port of the result.

    The command of a system without discrete state is held for a sample too.
    """
    limit = scenario.command_limit_rad_s
    saturation = builder.AddNamedSystem("limit", Saturation([-limit], [limit]))
    builder.Connect(command, saturation.get_input_port())
    if holds_its_command(law):
        return saturation.get_output_port()
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(scenario.controller.sample_time_s, 1))
    builder.Connect(saturation.get_output_port(), hold.get_input_port())
    return hold.get_output_port()


def holds_its_command(law: System) -> bool:
    """Return True if a system has discrete states, which then hold its command."""
    return law.CreateDefaultContext().num_discrete_state_groups() > 0


def controller_parts(scenario: Scenario) -> list[Part]:
    """Return the leaf systems of `make_controller`; an empty list if it `has_unknown_parts`."""
    return [] if has_unknown_parts(scenario) else _parts(scenario)


def has_unknown_parts(scenario: Scenario) -> bool:
    """Return True if the controller of a scenario is or contains a Drake system of the user.

    The values of the Context parameters of such a system are read from the system.
    """
    law = scenario.controller
    if isinstance(law, LawParameters):
        return law.function.is_system
    return isinstance(law, CustomControllerParameters)


def users_law(scenario: Scenario) -> Law:
    """Return the code of the user in a controller that `has_unknown_parts`, as a law."""
    law = scenario.controller
    if isinstance(law, LawParameters):
        return law.function
    assert isinstance(law, CustomControllerParameters)
    return _maker(function_at(law.make, f"controller.make = {shortened(law.make)!r}"))


_maker = lru_cache(maxsize=64)(Law)


def _parts(scenario: Scenario, custom_law: System | None = None) -> list[Part]:
    """Return the leaf systems of a controller; ``custom_law`` replaces the scenario's law."""
    believed, polynomial = scenario.believed_plant, controller_polynomial(scenario)
    law, offset = scenario.controller, encoder_offset_rad(scenario)
    if law.command_limit_rad_s != scenario.command_limit_rad_s:
        law = law.model_copy(update={"command_limit_rad_s": scenario.command_limit_rad_s})
    parts = [
        Part(
            "coordinates",
            lambda: systems.KneeCoordinates(believed.linkage, polynomial, offset),
            lambda: knee_coordinates.context_values(believed.linkage, polynomial, offset),
        ),
        Part(
            "rod_reference",
            lambda: systems.RodReference(polynomial),
            lambda: knee_coordinates.rod_polynomial_values(polynomial),
        ),
    ]
    if custom_law is not None:
        if not isinstance(custom_law, System) and callable(custom_law):
            raise ParameterError(
                "law: a function must be given as track(scenario, law=law), or here as "
                "make_controller(scenario.with_law(law))"
            )
        require_ports(custom_law, {**LAW_INPUTS, LAW_COMMAND: 1}, "law")
        parts.append(Part("law", lambda: custom_law, dict))
        if custom_law.HasInputPort("estimated_state"):
            parts += _estimator_parts(scenario)
    elif isinstance(law, LawParameters):
        parts += _law_parts(scenario, law)
    elif isinstance(law, SlidingModeParameters):
        parts.append(
            Part(
                "law",
                lambda: systems.SlidingModeController(law, believed),
                lambda: sliding_mode_controller.context_values(law, believed),
            )
        )
        parts += _estimator_parts(scenario)
    elif isinstance(law, PidParameters):
        parts.append(
            Part(
                "law",
                lambda: systems.PidController(law, believed),
                lambda: pid_controller.context_values(law, believed),
            )
        )
    elif isinstance(law, TorqueParameters):
        parts.append(
            Part(
                "law",
                lambda: systems.TorqueController(law, believed, polynomial),
                lambda: torque_controller.context_values(law, believed, polynomial),
            )
        )
        parts += _estimator_parts(scenario)
    return parts


def _law_parts(scenario: Scenario, law: LawParameters) -> Iterator[Part]:
    """Yield a control law of the user, and the estimator if the law reads its output."""
    if law.function.is_system:
        system = law.function.make_system()
        subject = f"law {law.function.short_name}"
        require_ports(system, LAW_INPUTS, subject)
        _require_period(system, law.sample_time_s, subject)
        yield Part("law", lambda: system, dict)
        inputs: Iterable[str] = port_sizes(system, inputs=True)
    else:
        yield Part(
            "law",
            lambda: systems.FunctionLaw(law),
            lambda: function_law.context_values(law),
        )
        inputs = law.function.arguments.inputs
    if "estimated_state" in inputs:
        yield from _estimator_parts(scenario)


def _estimator_parts(scenario: Scenario) -> Iterable[Part]:
    """Yield the estimator of a scenario; yield nothing if the estimator is ``exact``."""
    estimator, sample_time = scenario.estimator, scenario.controller.sample_time_s
    if isinstance(estimator, ObserverParameters):
        yield Part(
            "estimator",
            lambda: systems.TrackingObserver(estimator, sample_time),
            lambda: {"time_constant_s": estimator.time_constant_s},
        )
    elif estimator.kind == "difference":
        yield Part("estimator", lambda: systems.BackwardDifference(sample_time), dict)


def encoder_offset_rad(scenario: Scenario) -> float:
    """Return the offset in rad that the controller adds to an encoder reading.

    The offset is the encoder's phase, plus half a count, minus the mounting error.
    """
    encoder = scenario.encoder
    phase = encoder.phase_rad if encoder.quantized else 0.0
    return phase + 0.5 * encoder.resolution_rad - encoder.mounting_error_rad


# ------------------------------------------------------------------------ custom controllers


def known_to_controller(scenario: Scenario) -> Scenario:
    """Return a scenario that contains only what the controller knows of ``scenario``.

    A controller knows the nominal plant (which becomes the plant), polynomial, encoder, estimator
    and its own parameters. All other values of the result are defaults.
    """
    return Scenario(
        plant=scenario.believed_plant,
        polynomial=controller_polynomial(scenario),
        encoder=scenario.encoder,
        estimator=scenario.estimator,
        controller=scenario.controller,
    )


def _custom_controller(scenario: Scenario, parameters: CustomControllerParameters) -> System:
    subject = f"controller.make = {shortened(parameters.make)!r}"
    make = function_at(parameters.make, subject)
    if parameters.make in _running.get():
        raise ParameterError(
            f"{subject}: the function asks for its own controller; must build it, or ask for "
            f"one of another kind"
        )
    token = _running.set(_running.get() | {parameters.make})
    try:
        with user_code(f"{subject}: the function fails"):
            controller = make(known_to_controller(scenario))
    finally:
        _running.reset(token)
    require_controller(controller, subject)
    _require_period(controller, parameters.sample_time_s, "the controller")
    controller.set_name("controller")
    return controller


def _require_period(system: System, sample_time_s: float, subject: str) -> None:
    """Raise `ParameterError` if a system updates its discrete state at another period."""
    timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
    if timing is not None and timing.period_sec() != sample_time_s:
        raise ParameterError(
            f"controller.sample_time_s = {sample_time_s:g} s: must be {timing.period_sec():g} s, "
            f"at which {subject} updates"
        )


def controller_outputs(scenario: Scenario) -> dict[str, int]:
    """Return a dictionary from the name of each output port of a user's controller to its size."""
    return remembered(
        users_law(scenario),
        ("outputs", known_to_controller(scenario).model_dump_json()),
        lambda: port_sizes(make_controller(scenario, held_command(scenario))),
    )


_running: ContextVar[frozenset[str]] = ContextVar("running", default=frozenset())
"""Names of the users' functions that are running, by which recursion is detected."""

_INPUTS = {"encoder_reading": 1, "knee_reference": 4, "rod_state": 3, LAW_COMMAND: 1}


def require_controller(controller: Any, subject: str = "controller") -> None:
    """Raise `ParameterError` unless ``controller`` is a system with the ports of `make_controller`.

    ``subject`` begins the message.
    """
    require_ports(controller, _INPUTS, subject)
