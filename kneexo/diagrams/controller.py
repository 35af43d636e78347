"""Builds the controller, all that runs on the embedded target, as one diagram."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import Saturation, ZeroOrderHold

from kneexo import systems
from kneexo.diagrams.law import (
    connect_inputs,
    held_command,
    known_text,
    law_inputs,
    maker_arguments,
    port_sizes,
    remembered,
    users_law,
)
from kneexo.diagrams.part import Part, add_parts, leaf_part
from kneexo.diagrams.protection import connect_protection, guarded_ports, protection_parts
from kneexo.diagrams.signals import CONTROLLER_SIGNALS, PROTECTION_OUTPUTS, SIGNALS
from kneexo.errors import ParameterError
from kneexo.geometry.rod_polynomial import controller_polynomial
from kneexo.parameters import (
    LawParameters,
    ObserverParameters,
    PidParameters,
    Scenario,
    SlidingModeParameters,
    TorqueParameters,
)
from kneexo.systems import (
    function_law,
    knee_coordinates,
    pid_controller,
    sliding_mode_controller,
    torque_controller,
)


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
    motor_speed          1     rad/s                 as the drive reports it; only with protection
    emergency_stop       1     1                     0, or the motor stops; only with protection
    reset                1     1                     its rise resets a stop; only with protection
    **output port**
    motor_speed_command  1     rad/s                 motor side, held for a sample
    ===================  ====  ====================  ==============================================

    Subsystems: ``coordinates`` (`KneeCoordinates`), ``rod_reference`` (`RodReference`) and ``law``.
    There is also an ``estimator`` if the law has the input ``estimated_state`` and the estimator is
    not ``exact``. More outputs: ``measured_knee_angle``, ``measured_rod_extension`` and
    ``rod_reference``. An estimator adds ``estimated_state``, the sliding-mode law adds
    ``sliding_variable``, and the torque controller adds ``desired_torque``. Protection adds the
    subsystems ``guard`` (`InputGuard`) and ``detectors`` (`FaultDetectors`), which replace bad
    inputs and implausible readings, and ``supervisor`` (`SafetySupervisor`), through which the
    command passes. Its outputs are ``residuals``, ``safety_state``, ``safety_reason`` and
    ``release``.

    The ports of a law of the user decide what the law is connected to: see `LawParameters`. A law
    that reads ``encoder_reading``, and nothing that kneexo computes from this reading, is the only
    subsystem but for ``limit`` and ``hold``. ``limit`` limits the command of a Drake system of the
    user, and ``hold`` holds the command of a system without discrete state for a sample.

    Parameters
    ----------
    scenario
        Nominal plant, polynomial, encoder, estimator and controller.
    law
        A system that replaces the law of the scenario and has the same input ports, such as
        `HeldCommand`. Its command is neither limited nor held.

    Raises
    ------
    ParameterError
        A law of the user cannot be made, or one of its ports is wrong. There is a ``law`` for a
        scenario whose controller is not the user's.
    """
    builder = DiagramBuilder()
    is_users_system = law is None and has_unknown_parts(scenario)
    subsystems = add_parts(builder, _parts(scenario, law))
    law = subsystems["law"]
    command = law.GetOutputPort("motor_speed_command")
    if is_users_system:
        command = _limited_and_held(builder, scenario, law, command)
    # Ports by the name that the controller, or the law, gives them.
    outputs = {"motor_speed_command": command}
    sources: dict[str, Any] = {}  # ports inside the controller that the law can read
    inputs: dict[str, Any] = {}
    if "coordinates" in subsystems:  # absent for a law that reads nothing computed from a reading
        coordinates, rod_reference = subsystems["coordinates"], subsystems["rod_reference"]
        sources = {
            "rod_extension": coordinates.GetOutputPort("rod_extension"),
            "knee_angle": coordinates.GetOutputPort("knee_angle"),
            "rod_reference": rod_reference.get_output_port(),
        }
        reference = subsystems.get("guard", rod_reference).GetInputPort("knee_reference")
        reading = coordinates.get_input_port()
        inputs["knee_reference"] = builder.ExportInput(reference, "knee_reference")
        inputs["encoder_reading"] = builder.ExportInput(reading, "encoder_reading")
        if "guard" in subsystems:
            sources |= guarded_ports(builder, subsystems, sources, inputs)
        outputs |= {
            "measured_knee_angle": sources["knee_angle"],
            "measured_rod_extension": sources["rod_extension"],
            "rod_reference": sources["rod_reference"],
        }
    if "estimator" in subsystems:
        builder.Connect(sources["rod_extension"], subsystems["estimator"].get_input_port())
        sources["estimated_state"] = subsystems["estimator"].get_output_port()
        outputs["estimated_state"] = sources["estimated_state"]
    connect_inputs(builder, law, sources, inputs)
    if "supervisor" in subsystems:
        outputs |= connect_protection(builder, subsystems, sources, inputs, command)
    for name in SIGNALS:
        if name in CONTROLLER_SIGNALS and name not in outputs and law.HasOutputPort(name):
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


def controller_parts(scenario: Scenario, law: System | None = None) -> list[Part]:
    """Return the leaf systems of `make_controller`, as parts of the diagram.

    The list is empty for a controller that `has_unknown_parts`.
    """
    return [] if law is None and has_unknown_parts(scenario) else _parts(scenario, law)


def has_unknown_parts(scenario: Scenario) -> bool:
    """Return True if the controller of a scenario contains a Drake system of the user.

    The values of the Context parameters of such a system are read from the system.
    """
    law = scenario.controller
    return isinstance(law, LawParameters) and law.function.is_system


def _parts(scenario: Scenario, replacement: System | None = None) -> list[Part]:
    """Return the leaf systems of a controller; ``replacement`` replaces the scenario's law."""
    believed, polynomial = scenario.believed_plant, controller_polynomial(scenario)
    law = scenario.with_loaded_law().controller
    measurement = believed.linkage, polynomial, encoder_offset_rad(scenario)
    # The scenario's limit is a whole number of the drive's units, so that a rounded command at the
    # limit still counts as saturated.
    if law.command_limit_rad_s != scenario.command_limit_rad_s:
        law = law.model_copy(update={"command_limit_rad_s": scenario.command_limit_rad_s})
    if replacement is not None and not isinstance(law, LawParameters):
        raise ParameterError(
            f"law: replaces a law of the user, but controller.kind is {law.kind}; to use a law of "
            f"yours, write make_controller(scenario.with_law(law))"
        )
    if isinstance(law, LawParameters):
        inputs = {*law_inputs(scenario)}
        raw = "encoder_reading" in inputs and inputs <= _RAW_INPUTS
        # With protection the coordinates stay, because the detectors read them.
        if raw and scenario.protection is None:
            return [_law_part(scenario, law, replacement)]
    parts = [
        leaf_part("coordinates", systems.KneeCoordinates, knee_coordinates, *measurement),
        Part(
            "rod_reference",
            lambda: systems.RodReference(polynomial),
            lambda: knee_coordinates.rod_polynomial_values(polynomial),
        ),
    ]
    estimates = True
    if isinstance(law, LawParameters):
        parts.append(_law_part(scenario, law, replacement))
        estimates = "estimated_state" in inputs
    elif isinstance(law, SlidingModeParameters):
        parts.append(
            leaf_part("law", systems.SlidingModeController, sliding_mode_controller, law, believed)
        )
    elif isinstance(law, PidParameters):
        parts.append(leaf_part("law", systems.PidController, pid_controller, law, believed))
        estimates = False
    elif isinstance(law, TorqueParameters):
        arguments = law, believed, polynomial
        parts.append(leaf_part("law", systems.TorqueController, torque_controller, *arguments))
    if estimates:
        parts += _estimator_parts(scenario)
    if scenario.protection is not None:
        parts += protection_parts(scenario, scenario.protection)
    return parts


_RAW_INPUTS = {"encoder_reading", "knee_reference", "rod_state"}
"""Inputs of a law that kneexo does not compute from the reading of the encoder."""


def _law_part(scenario: Scenario, law: LawParameters, replacement: System | None) -> Part:
    """Return the control law of the user, or ``replacement`` if it is not None."""
    if "rod_state" in law_inputs(scenario) and scenario.estimator.kind != "exact":
        raise ParameterError(
            f"law {law.function.short_name}: reads rod_state, the true state of the rod: needs "
            f"estimator.kind = exact, not {scenario.estimator.kind}"
        )
    if replacement is not None:
        return Part("law", lambda: replacement, dict)
    if not law.function.is_system:
        return leaf_part("law", systems.FunctionLaw, function_law, law)
    system = law.function.make_system(maker_arguments(scenario))
    return Part("law", lambda: system, dict)


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

    The offset is the encoder's phase, plus half a count, minus the mounting error. Half a count,
    because an encoder rounds down: the error of a reading is then zero on average.
    """
    encoder = scenario.encoder
    phase = encoder.phase_rad if encoder.quantized else 0.0
    return phase + 0.5 * encoder.resolution_rad - encoder.mounting_error_rad


def controller_signals(scenario: Scenario) -> list[str]:
    """Return the names of the further output ports of a controller: `SIGNALS`, and ``release``."""
    if scenario.controller.kind == "law":
        outputs = remembered(
            users_law(scenario),
            ("outputs", known_text(scenario)),
            lambda: port_sizes(make_controller(scenario, held_command(scenario))),
        )
        names = [name for name in SIGNALS if name in CONTROLLER_SIGNALS]
        names = [name for name in names if outputs.get(name) == len(SIGNALS[name])]
    else:
        names = ["measured_knee_angle", "measured_rod_extension", "rod_reference"]
        names += _LAW_SIGNALS[scenario.controller.kind]
        if scenario.controller.kind != "pid" and scenario.estimator.kind != "exact":
            names.append("estimated_state")
        names += PROTECTION_OUTPUTS if scenario.protection is not None else ()
    return [*names, "release"] if scenario.protection is not None else names


_LAW_SIGNALS = {"smc": ("sliding_variable",), "pid": (), "torque": ("desired_torque",)}
"""Names of the further output ports of each control law of kneexo."""
