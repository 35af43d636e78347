"""Builds the closed loop of plant, encoder, controller, reference and logging (Fig. 8)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder, System
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    DiscreteTimeDelay,
    LogVectorOutput,
    Multiplexer,
    PassThrough,
)

from kneexo import systems
from kneexo.diagrams.controller import (
    controller_outputs,
    controller_parts,
    make_controller,
)
from kneexo.diagrams.faults import LoopFaults, fault_values, pressed_buttons
from kneexo.diagrams.part import NO_FAULTS, Part, connect, state_names
from kneexo.diagrams.plant import make_plant, scenario_plant_parts, start_arguments
from kneexo.diagrams.signals import (
    CONTROLLER_SIGNALS,
    LAW_OUTPUTS,
    NEEDED_SETTINGS,
    OPTIONAL_OUTPUTS,
    PROTECTION_OUTPUTS,
    SIGNALS,
    WEARER_OUTPUTS,
)
from kneexo.diagrams.wearer import add_wearer, moment_of, wearer_parts
from kneexo.errors import ParameterError, close_names, question
from kneexo.parameters import (
    Cia402Parameters,
    SampledReference,
    Scenario,
)
from kneexo.parameters.scenario import require_scenario
from kneexo.parameters.task.fault import OPERATOR_INPUTS
from kneexo.systems import StateVariable, drive, knee_reference, push as push_system
from kneexo.systems.function_law import LAW_COMMAND
from kneexo.systems.knee_reference import require_reference_in_range


def make_closed_loop(
    scenario: Scenario = Scenario(),
    *,
    reference: System | None = None,
    signals: Sequence[str] | None = None,
    external_reference: bool = False,
    external_moment: bool = False,
    law: System | None = None,
) -> Diagram:
    """Build the closed loop of a scenario, by default with the paper's sliding-mode controller.

    Subsystems:

    - ``plant``: see `make_plant`.
    - ``encoder``: Drake's `RotaryEncoders` behind ``phase_sum``, which adds the constant
      ``encoder_phase``; a `PassThrough` for an encoder that is not quantized.
    - ``reference``: the knee reference.
    - ``controller``: see `make_controller`.
    - ``wearer`` and ``cuff``, only with a wearer: `WearerKnee` moves along the reference, and
      `Cuff` acts on the plant. ``moment`` is the biological moment, if the wearer has one.
    - ``load_cell``: `LoadCell`, only with a wearer or a torque controller.
    - ``drive``: `Cia402Drive`, only with a bus of this kind.
    - ``can_bus``: `DiscreteTimeDelay`, only for a bus with latency.
    - ``push``: `Push`, which acts on the plant, only with a push.
    - ``fault_0``, …, ``watchdog``: see `kneexo.diagrams.faults`, only with faults.
    - ``signals`` and ``log``: a `Multiplexer` and a `VectorLogSink`, which logs the columns
      ``columns(signals)`` at the control period. Both are absent for ``signals=()``.

    Inputs: ``disturbance_force``, ``knee_torque`` if the plant has a load and the scenario has
    neither wearer nor push, and ``bypass`` if the plant has a bypass and the scenario no
    protection. With protection, also ``emergency_stop`` and ``reset``, unless a fault presses
    them. An unconnected input is zero.
    Outputs: each of `available_signals`. Drake logs the state before an update, so that the logged
    command at t was held until t. The paper's ideal case (Fig. 9) is
    `kneexo.studies.paper.IDEAL_SMC`.

    Parameters
    ----------
    scenario
        The closed loop.
    reference
        A system that replaces the scenario's reference. Its only output port (4,) contains θ_d and
        three derivatives. The scenario's reference then only decides where the plant starts.
    signals
        Names in `SIGNALS` of the signals to log. None: all available signals.
    external_reference
        True: an input port ``knee_reference`` replaces the subsystem ``reference``.
    external_moment
        True: an input port ``biological_moment`` replaces the subsystem ``moment`` if it exists.
    law
        A system that replaces the law of the user: see `make_controller`. With a `HeldCommand` the
        command comes from outside, by the input ``law_command`` of the loop.

    Raises
    ------
    ParameterError
        The reference leaves the range of motion, a signal is unknown, or a port is missing.
    LinkageError
        The linkage cannot be assembled.
    """
    require_scenario(scenario)
    require_reference_in_range(scenario.reference, scenario.plant.knee)
    names = chosen_signals(scenario, signals)
    builder = DiagramBuilder()
    faults = LoopFaults(builder, scenario)
    plant = builder.AddNamedSystem("plant", plant_of(scenario, faults.names_inside("plant")))
    encoder = add_encoder(builder, scenario, plant.GetOutputPort("encoder_angle"))
    if external_reference:
        # One exported input for all parts that read the reference.
        source = builder.AddNamedSystem("knee_reference", PassThrough(4))
        builder.ExportInput(source.get_input_port(), "knee_reference")
    else:
        if reference is None:
            reference = systems.make_knee_reference(scenario.reference)
        elif reference.num_output_ports() != 1 or reference.get_output_port().size() != 4:
            raise ParameterError("reference: must have one output port of size 4")
        source = builder.AddNamedSystem("reference", reference)
    wearer = add_wearer(
        builder,
        scenario,
        plant,
        source.get_output_port(),
        external_moment=external_moment,
        fault_names=faults.names_inside(""),
    )
    controller = builder.AddNamedSystem("controller", make_controller(scenario, law))
    ports = {name: plant.GetOutputPort(name) for name in SIGNALS if plant.HasOutputPort(name)} | {
        "knee_reference": source.get_output_port(),
        "encoder_reading": faults.on_signal("encoder", encoder.get_output_port()),
        **wearer,
    }
    if "measured_force" in ports:
        ports["measured_force"] = faults.on_signal("load_cell", ports["measured_force"])
    for index in range(controller.num_input_ports()):
        port = controller.get_input_port(index)
        name = port.get_name()
        if name in pressed_buttons(scenario):
            builder.Connect(faults.button(name), port)
        elif name in (LAW_COMMAND, *OPERATOR_INPUTS):
            builder.ExportInput(port, name)
        else:
            builder.Connect(ports.get(name) or plant.GetOutputPort(name), port)
    available = available_signals(scenario)
    # An exact estimate; the port of a controller with an estimator replaces it below.
    ports["estimated_state"] = plant.GetOutputPort("rod_state")
    ports |= {
        name: controller.GetOutputPort(name)
        for name in CONTROLLER_SIGNALS
        if controller.HasOutputPort(name)
    }
    command = controller.GetOutputPort("motor_speed_command")
    if isinstance(scenario.bus, Cia402Parameters):
        coding = builder.AddNamedSystem("drive", systems.Cia402Drive(scenario.bus))
        builder.Connect(command, coding.get_input_port())
        ports["target_velocity"] = coding.GetOutputPort("target_velocity")
        command = coding.GetOutputPort("motor_speed_command")
    if scenario.bus.latency_samples:
        # The controller holds its output for a sample, so n − 1 delays make n samples of latency.
        bus = builder.AddNamedSystem(
            "can_bus",
            DiscreteTimeDelay(
                update_sec=scenario.controller.sample_time_s,
                delay_time_steps=scenario.bus.latency_samples - 1,
                vector_size=1,
            ),
        )
        builder.Connect(command, bus.get_input_port())
        command = bus.get_output_port()
    # Behind the bus, where the drive's watchdog sees that a frame is lost.
    command = faults.on_command(command)
    ports["motor_speed_command"] = command
    builder.Connect(command, plant.GetInputPort("motor_speed_command"))

    if scenario.push is not None:
        push = systems.Push(scenario.push, scenario.controller.sample_time_s)
        connect(builder, builder.AddNamedSystem("push", push), "knee_torque", plant, "knee_torque")
    faults.on_parameters(plant)
    ports["active_faults"] = faults.finish(ports, available)
    connected = set()
    if scenario.push is not None or "wearer_motion" in wearer:
        connected.add("knee_torque")
    if scenario.protection is not None:
        release = scenario.protection.safe_state
        if plant.HasInputPort(release):
            connect(builder, controller, "release", plant, release)
        connected.add("bypass")  # with another safe state the valve stays closed
    for name in ("disturbance_force", "knee_torque", "bypass"):
        if plant.HasInputPort(name) and name not in connected:
            builder.ExportInput(plant.GetInputPort(name), name)
    for name in available:
        builder.ExportOutput(ports[name], name)
    if names:
        mux = builder.AddNamedSystem("signals", Multiplexer([len(SIGNALS[name]) for name in names]))
        for index, name in enumerate(names):
            builder.Connect(ports[name], mux.get_input_port(index))
        log = LogVectorOutput(
            mux.get_output_port(), builder, publish_period=scenario.controller.sample_time_s
        )
        log.set_name("log")
    diagram = builder.Build()
    diagram.set_name("closed_loop")
    return diagram


def available_signals(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of the `SIGNALS` that the closed loop of a scenario has."""
    missing = set()
    if scenario.controller.kind == "law":
        outputs = controller_outputs(scenario)
        missing |= {name for name in CONTROLLER_SIGNALS if outputs.get(name) != len(SIGNALS[name])}
        if scenario.estimator.kind == "exact":
            missing.discard("estimated_state")  # the law reads the state of the plant
    elif scenario.controller.kind == "pid":
        missing |= {"estimated_state", *LAW_OUTPUTS}
    else:
        missing.add("desired_torque" if scenario.controller.kind == "smc" else "sliding_variable")
    if scenario.bus.kind != "cia402":
        missing.add("target_velocity")
    for option, (_, outputs_of_option) in OPTIONAL_OUTPUTS.items():
        if getattr(scenario.plant, option) is None:
            missing |= set(outputs_of_option)
    if scenario.wearer.kind == "none":
        missing |= set(WEARER_OUTPUTS)
    if scenario.has_load_cell:
        missing.discard("measured_force")
    if moment_of(scenario) is None:
        missing.add("biological_moment")
    if not scenario.faults:
        missing.add("active_faults")
    if scenario.protection is None:
        missing |= set(PROTECTION_OUTPUTS)
    return tuple(name for name in SIGNALS if name not in missing)


def chosen_signals(scenario: Scenario, signals: Sequence[str] | None) -> tuple[str, ...]:
    """Return ``signals`` as a tuple, or all `available_signals` if ``signals`` is None.

    Raises `ParameterError` for a signal that `available_signals` does not contain.
    """
    if isinstance(signals, str):
        raise ParameterError(f'signals = {signals!r}: must be a list, such as ["{signals}"]')
    available = available_signals(scenario)
    names = available if signals is None else tuple(signals)
    for name in names:
        if name not in available:
            if name in SIGNALS:
                needed = NEEDED_SETTINGS.get(name, "another controller")
                raise ParameterError(f"signal {name!r} is not in this scenario; needs {needed}")
            advice = question(close_names(name, available)) or f"; known: {', '.join(available)}"
            raise ParameterError(f"signal {name!r} is unknown{advice}")
    return names


def loop_values(
    scenario: Scenario, law: System | None = None
) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield path and Context parameters of each leaf system of `make_closed_loop`.

    Drake's systems without parameters are left out, and so is a controller that
    `has_unknown_parts`. ``law`` replaces the law of the user, and its parameters are left out too.
    """
    for part in scenario_plant_parts(scenario):
        yield f"plant/{part.name}", part.values()
    if scenario.encoder.quantized:
        # "0[0]" is the first element of the first group of numeric parameters of Drake's block.
        # Drake's calibration offset of the encoder stays zero; the phase is added before it.
        yield "encoder_phase", {"0[0]": -scenario.encoder.phase_rad}
        yield "encoder", {"0[0]": 0.0}
    if not isinstance(scenario.reference, SampledReference):
        yield "reference", knee_reference.context_values(scenario.reference)
    for part in wearer_parts(scenario):
        yield part.name, part.values()
    for part in controller_parts(scenario, law):
        yield f"controller/{part.name}", part.values()
    if isinstance(scenario.bus, Cia402Parameters):
        yield "drive", drive.context_values(scenario.bus)
    if scenario.push is not None:
        yield "push", push_system.context_values(scenario.push)
    yield from fault_values(scenario)


def plant_states(scenario: Scenario) -> dict[str, StateVariable]:
    """Return a dictionary from name to continuous state of plant, wearer and load cell.

    The dictionary has the order of the Context. A state has the same name as in the compiled closed
    loop, such as ``plant/motor.x[0]``.
    """
    return {
        name: state
        for path, part in _continuous_parts(scenario)
        for name, state in zip(state_names(part, path), part.states, strict=True)
    }


def plant_start(scenario: Scenario) -> dict[str, float]:
    """Return a dictionary from the name of each of the `plant_states` to its initial value.

    The values are in the units of the Context. Raises `ParameterError` and `LinkageError` as
    `make_plant` does.
    """
    return {
        name: value
        for path, part in _continuous_parts(scenario)
        for name, value in zip(state_names(part, path), part.start_state(), strict=True)
    }


def _continuous_parts(scenario: Scenario) -> Iterator[tuple[str, Part]]:
    """Yield each part of plant, wearer and load cell, with the path of its subsystem."""
    yield from (("plant", part) for part in scenario_plant_parts(scenario))
    yield from (("", part) for part in wearer_parts(scenario))


def plant_of(scenario: Scenario, fault_names: Mapping[str, tuple[str, ...]] = NO_FAULTS) -> Diagram:
    """Build the plant of a scenario, with the initial state that the scenario defines.

    `make_plant` describes ``fault_names``.
    """
    return make_plant(scenario.plant, **start_arguments(scenario), fault_names=fault_names)


def add_encoder(builder: Any, scenario: Scenario, angle: Any) -> Any:
    """Add the encoder to a DiagramBuilder and return the system that outputs its reading.

    The encoder measures θ_4, the value of the port ``angle``, minus the phase of the encoder.
    """
    from pydrake.systems.sensors import RotaryEncoders  # this import takes 0.05 s

    if not scenario.encoder.quantized:
        encoder = builder.AddNamedSystem("encoder", PassThrough(1))
        builder.Connect(angle, encoder.get_input_port())
        return encoder
    encoder = builder.AddNamedSystem(
        "encoder", RotaryEncoders([scenario.encoder.counts_per_revolution])
    )
    # Drake sets its calibration offset in a Context, not in the diagram; so a sum adds the phase.
    phase = builder.AddNamedSystem(
        "encoder_phase", ConstantVectorSource([-scenario.encoder.phase_rad])
    )
    phase_sum = builder.AddNamedSystem("phase_sum", Adder(2, 1))
    builder.Connect(angle, phase_sum.get_input_port(0))
    builder.Connect(phase.get_output_port(), phase_sum.get_input_port(1))
    builder.Connect(phase_sum.get_output_port(), encoder.get_input_port())
    return encoder
