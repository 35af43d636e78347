"""Builds the controller, all that runs on the embedded target, as one diagram."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import Saturation, ZeroOrderHold

from kneexo import systems
from kneexo.common.ports import output_ports, sizes
from kneexo.diagrams.part import Part, built, by_name, export_inputs, leaf_part, wire
from kneexo.diagrams.protection import protection_parts, raw
from kneexo.diagrams.signals import CONTROLLER_SIGNALS, PROTECTION_OUTPUTS, SIGNALS
from kneexo.diagrams.users_part import read_numbers, users_part
from kneexo.errors import ParameterError
from kneexo.geometry.rod_polynomial import controller_polynomial
from kneexo.law import FunctionLaw, leaves
from kneexo.law.decision import (
    held_command,
    known_text,
    known_to_controller,
    law_inputs,
    remembered,
    users_law,
    users_system,
)
from kneexo.law.leaves import LAW_COMMAND
from kneexo.parameters import (
    LawParameters,
    ObserverParameters,
    PidParameters,
    Scenario,
    SlidingModeParameters,
    TorqueParameters,
)
from kneexo.parameters.task.fault import OPERATOR_INPUTS
from kneexo.systems import (
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
    knee_reference       4     rad, rad/s, …         θ_d and its derivatives to the third
    encoder_reading      1     rad                   θ_4 as read by the encoder
    measured_force       2     N, s                  reading of the load cell, age; torque only
    biological_moment    1     N·m                   only with torque in the mode ``assist``
    motor_speed          1     rad/s                 as the drive reports it; only with protection
    rod_state            3     m, m/s, m/s²          only with the estimator ``exact``
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
    signals, inputs = wire(builder, controller_parts(scenario, law))
    export_inputs(builder, inputs, _INPUTS)
    for name, signal in _OUTPUTS.items():
        # A signal comes from kneexo if kneexo computes it, and else from the law.
        port = signals.get(signal, signals.get(_of_law(name)))
        if port is not None:
            builder.ExportOutput(port, name)
    return built(builder, "controller", users_systems(scenario))


_INPUTS = {
    signal: name
    for name in (
        *("knee_reference", "encoder_reading", "measured_force", "biological_moment"),
        *("motor_speed", "rod_state", LAW_COMMAND, *OPERATOR_INPUTS),
    )
    for signal in (name, *raw(name).values())
}
"""By the signals that no part of the controller offers, its inputs in their order."""

_OUTPUTS = {
    "motor_speed_command": "motor_speed_command",
    "measured_knee_angle": "knee_angle",
    "measured_rod_extension": "rod_extension",
    **{name: name for name in ("rod_reference", "estimated_state", *PROTECTION_OUTPUTS)},
    "release": "release",
    **by_name("sliding_variable", "desired_torque"),
}
"""The outputs of the controller in their order, and the signals that they show."""


def _of_law(name: str) -> str:
    """Return the signal that the control law itself offers for an output of the controller."""
    return f"{name} of the law"


_OFFERS_OF_LAW = {_of_law(name): name for name in CONTROLLER_SIGNALS}


def controller_parts(scenario: Scenario, replacement: System | None = None) -> list[Part]:
    """Return the systems of `make_controller`; ``replacement`` replaces the scenario's law."""
    believed, polynomial = scenario.believed_plant, controller_polynomial(scenario)
    law = scenario.with_loaded_law().controller
    # The scenario's limit is a whole number of the drive's units, so that a rounded command at the
    # limit still counts as saturated.
    if law.command_limit_rad_s != scenario.command_limit_rad_s:
        law = law.model_copy(update={"command_limit_rad_s": scenario.command_limit_rad_s})
    if replacement is not None and not isinstance(law, LawParameters):
        raise ParameterError(
            f"law: replaces a law of the user, but controller.kind is {law.kind}; to use a law of "
            f"yours, write make_controller(scenario.with_law(law))"
        )
    behind_law: list[Part] = []
    measures, estimates = True, law.kind != "pid"
    if isinstance(law, LawParameters):
        inputs = {*law_inputs(scenario)}
        # With protection the coordinates stay, because the detectors read them.
        is_raw = "encoder_reading" in inputs and inputs <= _RAW_INPUTS
        measures = not is_raw or scenario.protection is not None
        estimates = "estimated_state" in inputs
        law_part, *behind_law = _users_law(scenario, law, inputs, replacement)
    elif isinstance(law, SlidingModeParameters):
        component = systems.SlidingModeController
        law_part = leaf_part("law", component, sliding_mode_controller, law, believed)
    elif isinstance(law, PidParameters):
        law_part = leaf_part("law", systems.PidController, pid_controller, law, believed)
    elif isinstance(law, TorqueParameters):
        arguments = law, believed, polynomial
        law_part = leaf_part("law", systems.TorqueController, torque_controller, *arguments)
    # Without an estimator the true state of the rod takes the place of the estimated state.
    reads = {"estimated_state": "rod_state"} if scenario.estimator.kind == "exact" else {}
    parts = [*_coordinates(scenario)] if measures else []
    command = by_name("motor_speed_command")
    parts.append(law_part._replace(reads=reads, offers=command, may_offer=_OFFERS_OF_LAW))
    if estimates:
        parts += _estimator_parts(scenario)
    parts += behind_law
    if scenario.protection is not None:
        parts += protection_parts(scenario, scenario.protection)
    return parts


def users_systems(scenario: Scenario) -> list[str]:
    """Return the places of the Drake systems of the user: ``law`` and those of the parts."""
    law = scenario.controller
    is_system = isinstance(law, LawParameters) and law.function.is_system
    return ["law"] * is_system + [*scenario.parts.chosen()]


_RAW_INPUTS = {"encoder_reading", "knee_reference", "rod_state"}
"""Inputs of a law that kneexo does not compute from the reading of the encoder."""


def _coordinates(scenario: Scenario) -> Iterator[Part]:
    """Yield the parts that turn the reading of the encoder and the reference into coordinates."""
    polynomial = controller_polynomial(scenario)
    measurement = scenario.believed_plant.linkage, polynomial, scenario.encoder.offset_rad
    coordinates = leaf_part("coordinates", systems.KneeCoordinates, knee_coordinates, *measurement)
    if scenario.protection is not None:
        measured = raw("knee_angle", "rod_extension")
        coordinates = coordinates._replace(
            reads=raw("encoder_reading"), offers={signal: name for name, signal in measured.items()}
        )
    yield coordinates
    yield Part(
        "rod_reference",
        lambda: systems.RodReference(polynomial),
        lambda: knee_coordinates.rod_polynomial_values(polynomial),
    )


def _users_law(
    scenario: Scenario, law: LawParameters, inputs: set[str], replacement: System | None
) -> Iterator[Part]:
    """Yield the control law of the user, or ``replacement`` if it is not None.

    The command of a Drake system of the user is limited. The command of a system without discrete
    state is held for a sample too.
    """
    if "rod_state" in inputs and scenario.estimator.kind != "exact":
        raise ParameterError(
            f"law {law.function.short_name}: reads rod_state, the true state of the rod: needs "
            f"estimator.kind = exact, not {scenario.estimator.kind}"
        )
    if replacement is not None:
        yield Part("law", lambda: replacement)
    elif not law.function.is_system:
        yield leaf_part("law", FunctionLaw, leaves, law)
    else:
        subject = f"law {law.function.short_name}"

        def make() -> System:
            return users_system(scenario, copied=True)

        def what_is_known() -> tuple[dict[str, Any], bool]:
            system = make()
            groups = system.CreateDefaultContext().num_discrete_state_groups()
            return read_numbers("law", subject, system), groups > 0

        question = "numbers", known_text(scenario) if law.function.takes_scenario else ""
        numbers, holds = remembered(law.function, question, what_is_known)
        yield Part("law", make, **numbers)
        limit, sample_time_s = scenario.command_limit_rad_s, scenario.controller.sample_time_s
        yield Part(
            "limit",
            lambda: Saturation([-limit], [limit]),
            reads={"u0": "motor_speed_command"},
            offers={"motor_speed_command": "y0"},
            through="motor_speed_command",
        )
        # A system with discrete states holds its command by them.
        if not holds:
            yield Part(
                "hold",
                lambda: ZeroOrderHold(sample_time_s, 1),
                reads={"u": "motor_speed_command"},
                offers={"motor_speed_command": "y"},
                through="motor_speed_command",
            )


def _estimator_parts(scenario: Scenario) -> Iterator[Part]:
    """Yield the estimator of a scenario; yield nothing if the estimator is ``exact``."""
    estimator, sample_time = scenario.estimator, scenario.controller.sample_time_s
    position = {"measured_position": "rod_extension"}
    if (chosen := scenario.parts.estimator) is not None:
        template, known = systems.TrackingObserver, known_to_controller(scenario)
        own, needed = Part("estimator", template, reads=position), ("measured_position",)
        yield users_part(chosen, own, template, {}, known, needed=needed, period_s=sample_time)
    elif isinstance(estimator, ObserverParameters):
        yield Part(
            "estimator",
            lambda: systems.TrackingObserver(estimator, sample_time),
            lambda: {"time_constant_s": estimator.time_constant_s},
            reads=position,
        )
    elif estimator.kind == "difference":
        yield Part("estimator", lambda: systems.BackwardDifference(sample_time), reads=position)


def controller_signals(scenario: Scenario) -> list[str]:
    """Return the names of a controller's output ports besides ``motor_speed_command``.

    They are names in `SIGNALS`, and ``release`` if the scenario has protection.
    """
    if scenario.controller.kind == "law":
        outputs = remembered(
            users_law(scenario),
            ("outputs", known_text(scenario)),
            lambda: sizes(output_ports(make_controller(scenario, held_command(scenario)))),
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
