"""Builds the controller, all that runs on the embedded target, as one diagram."""

from __future__ import annotations

from collections.abc import Iterable
from contextvars import ContextVar
from importlib import import_module
from typing import Any

from pydrake.systems.framework import DiagramBuilder, System

from kneexo import systems
from kneexo.diagrams.part import Part, add_parts
from kneexo.diagrams.signals import LAW_OUTPUTS
from kneexo.errors import ParameterError, shortened
from kneexo.parameters import (
    CustomControllerParameters,
    ObserverParameters,
    PidParameters,
    Scenario,
    SlidingModeParameters,
)
from kneexo.systems import (
    knee_coordinates,
    pid_controller,
    sliding_mode_controller,
)
from kneexo.user_code import user_code


def make_controller(scenario: Scenario = Scenario(), law: System | None = None) -> System:
    """Build the controller of a scenario, the part of the loop that runs on the embedded target.

    ===================  ====  ====================  ==============================================
    input port           size  unit
    ===================  ====  ====================  ==============================================
    encoder_reading      1     rad                   θ_4 as read by the encoder
    knee_reference       4     rad, rad/s, …         θ_d and its derivatives to the third
    rod_state            3     m, m/s, m/s²          only with the estimator ``exact``
    **output port**
    motor_speed_command  1     rad/s                 motor side, held for a sample
    ===================  ====  ====================  ==============================================

    Subsystems: ``coordinates`` (`KneeCoordinates`), ``rod_reference`` (`RodReference`) and ``law``.
    There is also an ``estimator`` if the law has the input ``estimated_state`` and the estimator is
    not ``exact``. More outputs: ``measured_knee_angle``, ``measured_rod_extension`` and
    ``rod_reference``. An estimator adds ``estimated_state``, and the sliding-mode law adds
    ``sliding_variable``.

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
    outputs = {
        "motor_speed_command": law.GetOutputPort("motor_speed_command"),
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
            builder.ExportInput(port, "rod_state")
    for name in LAW_OUTPUTS:
        if law.HasOutputPort(name):
            outputs[name] = law.GetOutputPort(name)
    for name, output in outputs.items():
        builder.ExportOutput(output, name)
    controller = builder.Build()
    controller.set_name("controller")
    return controller


def controller_parts(scenario: Scenario) -> list[Part]:
    """Return the leaf systems of `make_controller`; an empty list for a custom controller."""
    return _parts(scenario) if scenario.controller.kind != "custom" else []


def _parts(scenario: Scenario, custom_law: System | None = None) -> list[Part]:
    """Return the leaf systems of a controller; ``custom_law`` replaces the scenario's law."""
    believed, polynomial = scenario.believed_plant, scenario.polynomial
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
        _require_ports(custom_law, _LAW_INPUTS, "law")
        parts.append(Part("law", lambda: custom_law, dict))
        if custom_law.HasInputPort("estimated_state"):
            parts += _estimator_parts(scenario)
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
    return parts


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
        polynomial=scenario.polynomial,
        encoder=scenario.encoder,
        estimator=scenario.estimator,
        controller=scenario.controller,
    )


def _custom_controller(scenario: Scenario, parameters: CustomControllerParameters) -> System:
    subject = f"controller.make = {shortened(parameters.make)!r}"
    make = _function(parameters.make, subject)
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
    timing = controller.GetUniquePeriodicDiscreteUpdateAttribute()
    if timing is not None and timing.period_sec() != parameters.sample_time_s:
        raise ParameterError(
            f"controller.sample_time_s = {parameters.sample_time_s:g} s: must be "
            f"{timing.period_sec():g} s, at which the controller updates"
        )
    controller.set_name("controller")
    return controller


def _function(name: str, subject: str) -> Any:
    """Import and return a function by its name ``module:function``.

    ``subject`` begins the message of every `ParameterError`.
    """
    module, _, path = name.partition(":")
    try:
        with user_code(f"{subject}: the module cannot be imported"):
            make: Any = import_module(module)
    except ParameterError as error:
        cause = error.__cause__
        missing = cause.name if isinstance(cause, ModuleNotFoundError) else None
        if missing is None or not f"{module}.".startswith(f"{missing}."):
            raise
        raise ParameterError(
            f"{subject}: no module named {shortened(missing)!r}; must be module:function on the "
            f"Python path"
        ) from None
    with user_code(f"{subject}: the module fails"):
        for attribute in path.split("."):
            try:
                make = getattr(make, attribute)
            except AttributeError as error:
                raise ParameterError(
                    f"{subject}: {shortened(str(error), 300)}; must be module:function on the "
                    f"Python path"
                ) from None
    return make


def controller_outputs(scenario: Scenario) -> dict[str, int]:
    """Return a dictionary from the name of each output port of a custom controller to its size."""
    key = known_to_controller(scenario).model_dump_json()
    if key not in _outputs:
        _outputs[key] = port_sizes(make_controller(scenario))
    return _outputs[key]


def port_sizes(system: System, *, inputs: bool = False) -> dict[str, int]:
    """Return a dictionary from the name of each output port to its size.

    If ``inputs`` is True, return such a dictionary of the input ports.
    """
    if inputs:
        ports = map(system.get_input_port, range(system.num_input_ports()))
    else:
        ports = map(system.get_output_port, range(system.num_output_ports()))
    return {port.get_name(): port.size() for port in ports}


_outputs: dict[str, dict[str, int]] = {}

_running: ContextVar[frozenset[str]] = ContextVar("running", default=frozenset())
"""Names of the users' functions that are running, by which recursion is detected."""

_INPUTS = {"encoder_reading": 1, "knee_reference": 4, "rod_state": 3}
_LAW_INPUTS = {
    "rod_extension": 1,
    "rod_reference": 4,
    "estimated_state": 3,
    "knee_angle": 1,
    "knee_reference": 4,
}


def require_controller(controller: Any, subject: str = "controller") -> None:
    """Raise `ParameterError` unless ``controller`` is a system with the ports of `make_controller`.

    ``subject`` begins the message.
    """
    _require_ports(controller, _INPUTS, subject)


def _require_ports(system: Any, inputs: dict[str, int], subject: str) -> None:
    if not isinstance(system, System):
        raise ParameterError(f"{subject}: {type(system).__name__} is not a Drake system")
    for name, size in port_sizes(system, inputs=True).items():
        if inputs.get(name) != size:
            expected = ", ".join(f"{name} ({size})" for name, size in inputs.items())
            raise ParameterError(
                f"{subject}: has an input port {name} of size {size}; must be of {expected}"
            )
    if port_sizes(system).get("motor_speed_command") != 1:
        raise ParameterError(f"{subject}: must have an output port motor_speed_command of size 1")
