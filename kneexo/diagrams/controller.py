"""The controller: everything that runs on the embedded target, as one diagram."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder, System

from kneexo import systems
from kneexo.diagrams.part import Part, add_parts, connect
from kneexo.errors import KneexoError, ParameterError
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


def make_controller(scenario: Scenario = Scenario()) -> System:
    """Build the controller of a scenario: what would run on the embedded target.

    ===================  ====  ====================  ==============================================
    input port           size  unit
    ===================  ====  ====================  ==============================================
    encoder_reading      1     rad                   θ_4 as the encoder tells it
    knee_reference       4     rad, rad/s, …         θ_d and its derivatives to the third
    rod_state            3     m, m/s, m/s²          only with the estimator ``exact``
    **output port**
    motor_speed_command  1     rad/s                 motor side, held for a sample
    ===================  ====  ====================  ==============================================

    Subsystems: ``coordinates`` (`KneeCoordinates`), ``rod_reference`` (`RodReference`),
    ``estimator`` (SMC only, unless the states are exact) and ``law``. More outputs, of what is
    inside: ``measured_knee_angle``, ``measured_rod_extension``, ``rod_reference`` and, with the
    SMC, ``sliding_variable`` and ``estimated_state`` (the latter unless the states are exact).

    With ``controller.kind: custom`` this is the user's own: what ``controller.make`` returns, a
    system with at least the port ``motor_speed_command``. It is given a scenario that has what a
    controller may know: believed plant, polynomial, encoder, estimator and controller.

    Raises `ParameterError` when a custom controller cannot be made or lacks a port.
    """
    if isinstance(scenario.controller, CustomControllerParameters):
        return _custom_controller(scenario, scenario.controller)
    builder = DiagramBuilder()
    part = add_parts(builder, controller_parts(scenario))
    coordinates, rod_reference, law = (part[k] for k in ("coordinates", "rod_reference", "law"))
    knee_reference = builder.ExportInput(rod_reference.get_input_port(), "knee_reference")
    builder.ExportInput(coordinates.get_input_port(), "encoder_reading")
    connect(builder, rod_reference, "rod_reference", law, "rod_reference")
    outputs = {
        "motor_speed_command": law.GetOutputPort("motor_speed_command"),
        "measured_knee_angle": coordinates.GetOutputPort("knee_angle"),
        "measured_rod_extension": coordinates.GetOutputPort("rod_extension"),
        "rod_reference": rod_reference.get_output_port(),
    }
    if "estimator" in part:
        estimator = part["estimator"]
        builder.Connect(coordinates.GetOutputPort("rod_extension"), estimator.get_input_port())
        builder.Connect(estimator.get_output_port(), law.GetInputPort("estimated_state"))
        outputs["estimated_state"] = estimator.get_output_port()
    if scenario.controller.kind == "smc":
        outputs["sliding_variable"] = law.GetOutputPort("sliding_variable")
        if "estimator" not in part:
            builder.ExportInput(law.GetInputPort("estimated_state"), "rod_state")
    else:
        connect(builder, coordinates, "knee_angle", law, "knee_angle")
        builder.ConnectInput(knee_reference, law.GetInputPort("knee_reference"))
    for name, port in outputs.items():
        builder.ExportOutput(port, name)
    controller = builder.Build()
    controller.set_name("controller")
    return controller


def controller_parts(scenario: Scenario) -> list[Part]:
    """The leaf systems of `make_controller`, without those of a custom controller."""
    believed, polynomial = scenario.believed_plant, scenario.polynomial
    law, offset = scenario.controller, encoder_offset_rad(scenario)
    if law.command_limit_rad_s != scenario.command_limit_rad_s:
        law = law.model_copy(update={"command_limit_rad_s": scenario.command_limit_rad_s})
    parts = [
        Part(
            "coordinates",
            lambda: systems.KneeCoordinates(believed.linkage, polynomial, offset),
            knee_coordinates.context_values(believed.linkage, polynomial, offset),
        ),
        Part(
            "rod_reference",
            lambda: systems.RodReference(polynomial),
            knee_coordinates.rod_polynomial_values(polynomial),
        ),
    ]
    if isinstance(law, SlidingModeParameters):
        parts.append(
            Part(
                "law",
                lambda: systems.SlidingModeController(law, believed),
                sliding_mode_controller.context_values(law, believed),
            )
        )
        parts += _estimator_parts(scenario)
    elif isinstance(law, PidParameters):
        parts.append(
            Part(
                "law",
                lambda: systems.PidController(law, believed),
                pid_controller.context_values(law, believed),
            )
        )
    return parts


def _estimator_parts(scenario: Scenario) -> Iterable[Part]:
    estimator, sample_time = scenario.estimator, scenario.controller.sample_time_s
    if isinstance(estimator, ObserverParameters):
        yield Part(
            "estimator",
            lambda: systems.TrackingObserver(estimator, sample_time),
            {"time_constant_s": estimator.time_constant_s},
        )
    elif estimator.kind == "difference":
        yield Part("estimator", lambda: systems.BackwardDifference(sample_time), {})


def encoder_offset_rad(scenario: Scenario) -> float:
    """What the controller adds to a reading: phase and half a count, less the mounting error."""
    encoder = scenario.encoder
    phase = encoder.phase_rad if encoder.quantized else 0.0
    return phase + 0.5 * encoder.resolution_rad - encoder.mounting_error_rad


# ------------------------------------------------------------------------ custom controllers


def known_to_controller(scenario: Scenario) -> Scenario:
    """What a controller may know of a scenario; everything else has its default."""
    return Scenario(
        plant=scenario.believed_plant,
        polynomial=scenario.polynomial,
        encoder=scenario.encoder,
        estimator=scenario.estimator,
        controller=scenario.controller,
    )


def _custom_controller(scenario: Scenario, parameters: CustomControllerParameters) -> System:
    told = f"controller.make = {parameters.make!r}"
    module, _, path = parameters.make.partition(":")
    try:
        make: Any = import_module(module)
        for name in path.split("."):
            make = getattr(make, name)
    except (ImportError, AttributeError) as error:
        raise ParameterError(f"{told}: {error}; must be module:function") from None
    try:
        controller = make(known_to_controller(scenario))
    except KneexoError:
        raise
    except Exception as error:
        reason = str(error).partition("\n")[0]
        raise ParameterError(f"{told}: {type(error).__name__}: {reason}") from error
    require_controller(controller, told)
    timing = controller.GetUniquePeriodicDiscreteUpdateAttribute()
    if timing is not None and timing.period_sec() != parameters.sample_time_s:
        raise ParameterError(
            f"controller.sample_time_s = {parameters.sample_time_s:g} s: must be "
            f"{timing.period_sec():g} s, at which the controller updates"
        )
    controller.set_name("controller")
    return controller


def controller_outputs(scenario: Scenario) -> dict[str, int]:
    """Size of each output port of a custom controller."""
    key = known_to_controller(scenario).model_dump_json()
    if key not in _outputs:
        _outputs[key] = port_sizes(make_controller(scenario))
    return _outputs[key]


def port_sizes(controller: System) -> dict[str, int]:
    """Size of each output port."""
    ports = map(controller.get_output_port, range(controller.num_output_ports()))
    return {port.get_name(): port.size() for port in ports}


_outputs: dict[str, dict[str, int]] = {}

_INPUTS = {"encoder_reading": 1, "knee_reference": 4, "rod_state": 3}


def require_controller(controller: Any, told: str = "controller") -> None:
    """Raise `ParameterError` for what is no system with the ports of `make_controller`."""
    if not isinstance(controller, Diagram | System):
        raise ParameterError(f"{told}: {type(controller).__name__} is not a Drake system")
    for index in range(controller.num_input_ports()):
        port = controller.get_input_port(index)
        if _INPUTS.get(port.get_name()) != port.size():
            expected = ", ".join(f"{name} ({size})" for name, size in _INPUTS.items())
            raise ParameterError(
                f"{told}: has an input port {port.get_name()} of size {port.size()}; must be "
                f"of {expected}"
            )
    command = "motor_speed_command"
    if not controller.HasOutputPort(command) or controller.GetOutputPort(command).size() != 1:
        raise ParameterError(f"{told}: must have an output port {command} of size 1")
