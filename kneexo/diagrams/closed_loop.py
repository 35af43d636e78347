"""Builds the closed loop of plant, encoder, controller, reference and logging (Fig. 8)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

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
from kneexo.common.ports import output_ports, sizes
from kneexo.diagrams.controller import (
    controller_parts,
    controller_signals,
    make_controller,
    users_systems,
)
from kneexo.diagrams.faults import (
    Changes,
    active_faults,
    changed_inside,
    command_faults,
    parameter_changes,
    parameter_faults,
    reading_faults,
    require_triggers,
)
from kneexo.diagrams.part import (
    NO_FAULTS,
    NO_SIGNAL,
    Part,
    built,
    by_name,
    export_inputs,
    leaf_part,
    state_names,
    wire,
    with_faults,
)
from kneexo.diagrams.plant import (
    further_columns,
    make_plant,
    plant_outputs,
    scenario_plant_parts,
    start_arguments,
)
from kneexo.diagrams.signals import NEEDED_SETTINGS, SIGNALS
from kneexo.diagrams.wearer import MOMENT_INPUT, moment_parts, parts_with_states, wearer_parts
from kneexo.errors import ParameterError, close_names, question
from kneexo.law.leaves import LAW_COMMAND
from kneexo.parameters import (
    Cia402Parameters,
    SampledReference,
    Scenario,
)
from kneexo.parameters.device.safety_states import RELEASES
from kneexo.parameters.scenario import require_scenario
from kneexo.parameters.task.fault import OPERATOR_INPUTS
from kneexo.systems import StateVariable, drive, knee_reference, push as push_system
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

    Inputs, which are zero if unconnected:

    - ``disturbance_force``.
    - ``knee_torque``, if the plant has a load and the scenario has neither wearer nor push.
    - ``bypass``, if the plant has a bypass and the scenario has no protection.
    - ``emergency_stop`` and ``reset``, with protection, unless a fault presses them.

    The inputs of ``external_reference``, ``external_moment`` and ``law`` must be connected.

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
    if reference is not None and [*sizes(output_ports(reference)).values()] != [4]:
        raise ParameterError("reference: must have one output port of size 4")
    if reference is not None and external_reference:
        raise ParameterError("reference: external_reference = True replaces it; leave one out")
    names, available = chosen_signals(scenario, signals), signal_columns(scenario)
    require_triggers(scenario, available)
    builder = DiagramBuilder()
    parts = loop_parts(
        scenario,
        law=law,
        reference=reference,
        external_reference=external_reference,
        external_moment=external_moment,
    )
    ports, inputs = wire(builder, parts)
    export_inputs(builder, inputs, _INPUTS)
    for name in available:
        builder.ExportOutput(ports[name], name)
    if names:
        mux_sizes = [len(columns) for columns in names.values()]
        mux = builder.AddNamedSystem("signals", Multiplexer(mux_sizes))
        for index, name in enumerate(names):
            builder.Connect(ports[name], mux.get_input_port(index))
        log = LogVectorOutput(
            mux.get_output_port(), builder, publish_period=scenario.controller.sample_time_s
        )
        log.set_name("log")
    return built(builder, "closed_loop", users_systems(scenario))


_REFERENCE_INPUT = "knee_reference_input"

_INPUTS = {
    _REFERENCE_INPUT: "knee_reference",
    MOMENT_INPUT: "biological_moment",
    LAW_COMMAND: LAW_COMMAND,
    **{name: name for name in OPERATOR_INPUTS},
    "disturbance_force": "disturbance_force",
    "knee_torque": "knee_torque",
    "bypass": "bypass",
}
"""By the signals that no part of the loop offers, the inputs of the loop in their order."""


def make_open_loop(scenario: Scenario) -> Diagram:
    """Build the loop of a scenario without controller, drive, bus and faults.

    The input ``motor_speed_command`` is what arrives at the motor. A wearer moves along the input
    ``knee_reference`` (4,). Outputs: the `SIGNALS` that are left. For errors see
    `make_closed_loop`.
    """
    kept = {"plant", "encoder", "encoder_phase", "phase_sum", "wearer", "cuff", "load_cell"}
    kept |= {"knee_reference"} if scenario.wearer.kind != "none" else set()
    parts = loop_parts(scenario, external_reference=True)
    builder = DiagramBuilder()
    ports, inputs = wire(builder, [part for part in parts if part.name in kept])
    export_inputs(builder, inputs, by_name("motor_speed_command") | _INPUTS)
    for name in SIGNALS | further_columns(parts):
        if name in ports:
            builder.ExportOutput(ports[name], name)
    return builder.Build()


def loop_parts(
    scenario: Scenario,
    *,
    law: System | None = None,
    reference: System | None = None,
    external_reference: bool = False,
    external_moment: bool = False,
) -> list[Part]:
    """Return the systems of the closed loop, in their order; `make_closed_loop` has the arguments.

    A signal goes from the part that offers it to all parts that read it. The command passes through
    drive, bus, faults and watchdog, in this order; the readings pass through their faults.
    """
    bus, push, sample_time_s = scenario.bus, scenario.push, scenario.controller.sample_time_s
    changes = parameter_changes(scenario)
    parts: list[Part | None] = [
        _plant_part(scenario, changes),
        *encoder_parts(scenario),
        _reference_part(scenario, reference, external_reference),
        *wearer_parts(scenario),
        *moment_parts(scenario, external_moment),
        Part(
            "controller",
            lambda: make_controller(scenario, law),
            offers=by_name("motor_speed_command", *controller_signals(scenario)),
        ),
        *reading_faults(scenario),
        leaf_part(
            *("drive", systems.Cia402Drive, drive, bus),
            offers=by_name("motor_speed_command", "target_velocity"),
            through="motor_speed_command",
        )
        if isinstance(bus, Cia402Parameters)
        else None,
        Part(
            "can_bus",
            # Delay and controller update at the same sample, and the delay reads the command from
            # before, which is one sample; so n − 1 delays make n samples.
            lambda: DiscreteTimeDelay(
                update_sec=sample_time_s,
                delay_time_steps=bus.latency_samples - 1,
                vector_size=1,
            ),
            reads={"u": "motor_speed_command"},
            offers={"motor_speed_command": "delayed_u"},
            through="motor_speed_command",
        )
        if bus.latency_samples
        else None,
        # Behind the bus, where the drive's watchdog sees that a frame is lost.
        *command_faults(scenario),
        Part(
            "push",
            lambda: systems.Push(push, sample_time_s),
            lambda: push_system.context_values(push),
        )
        if push is not None
        else None,
        *parameter_faults(scenario, changes),
        *active_faults(scenario),
    ]
    return with_faults([part for part in parts if part is not None], changed_inside(changes, ""))


def _plant_part(scenario: Scenario, changes: dict[int, Changes]) -> Part:
    """Return the plant. Its inputs for a stop are driven if the scenario has protection."""
    fault_names = changed_inside(changes, "plant")
    reads = {f"{name}_fault": f"faults_of_{name}" for name in fault_names}
    if scenario.protection is not None:
        # With another safe state the valve stays closed, and the windings are not shorted.
        safe_state = scenario.protection.safe_state
        reads |= {name: "release" if name == safe_state else NO_SIGNAL for name in RELEASES}
    chosen = scenario.parts.chosen()
    users = further_columns(scenario_plant_parts(scenario)) if chosen else {}
    offers = by_name(*plant_outputs(scenario.plant), *users)
    if scenario.estimator.kind == "exact" and scenario.controller.kind != "pid":
        offers["estimated_state"] = "rod_state"  # the state of the plant is the estimate
    make = partial(plant_of, scenario, fault_names)
    return Part("plant", make, reads=reads, offers=offers, columns=users)


def _reference_part(scenario: Scenario, reference: System | None, external: bool) -> Part:
    """Return the knee reference: that of the scenario, another system, or an input."""
    if external:  # one input of the loop for all parts that read the reference
        offers = {"knee_reference": "y"}
        return Part(
            "knee_reference", lambda: PassThrough(4), reads={"u": _REFERENCE_INPUT}, offers=offers
        )
    if reference is not None:
        (name,) = output_ports(reference)
        return Part("reference", lambda: reference, offers={"knee_reference": name})
    chosen = scenario.reference
    make = partial(systems.make_knee_reference, chosen)
    if isinstance(chosen, SampledReference):
        return Part("reference", make, offers={"knee_reference": "y0"})  # Drake's block
    values = partial(knee_reference.context_values, chosen)
    return Part("reference", make, values, offers=by_name("knee_reference"))


def available_signals(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of the signals that the closed loop of a scenario has."""
    return tuple(signal_columns(scenario))


def signal_columns(scenario: Scenario) -> dict[str, tuple[str, ...]]:
    """Return the columns of each signal that the closed loop of a scenario has.

    The signals are in `SIGNALS`. Those that follow are further outputs of parts of the user, such
    as ``cylinder.friction_force``.
    """
    parts = loop_parts(scenario)
    offered = {signal for part in parts for signal in part.offers or ()}
    known = SIGNALS | further_columns(parts)
    return {name: names for name, names in known.items() if name in offered}


def chosen_signals(scenario: Scenario, signals: Sequence[str] | None) -> dict[str, tuple[str, ...]]:
    """Return the columns of each of ``signals``, or of all `available_signals` for None.

    Raises `ParameterError` for a signal that `available_signals` does not contain.
    """
    if isinstance(signals, str):
        raise ParameterError(f'signals = {signals!r}: must be a list, such as ["{signals}"]')
    available = signal_columns(scenario)
    names = tuple(available if signals is None else signals)
    for name in names:
        if name not in available:
            if name in SIGNALS:
                needed = NEEDED_SETTINGS.get(name, "another controller")
                raise ParameterError(f"signal {name!r} is not in this scenario; needs {needed}")
            advice = question(close_names(name, available)) or f"; known: {', '.join(available)}"
            raise ParameterError(f"signal {name!r} is unknown{advice}")
    return {name: available[name] for name in names}


def loop_values(
    scenario: Scenario, law: System | None = None
) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield path and Context parameters of each system of `make_closed_loop` that has parameters.

    ``law`` replaces the law of the user, and its parameters are left out.
    """
    inner = {"plant": scenario_plant_parts(scenario), "controller": controller_parts(scenario, law)}
    for name, parts in inner.items():
        for part in parts:
            yield f"{name}/{part.name}", part.values()
    for part in loop_parts(scenario, law=law):
        if values := part.values():
            yield part.name, values


def plant_states(scenario: Scenario) -> dict[str, StateVariable]:
    """Return a dictionary from name to continuous state of plant, wearer and load cell.

    The dictionary has the order of the Context. A state has the same name as in the compiled closed
    loop, such as ``plant/motor.x[0]``.
    """
    return {
        name: state
        for path, part in parts_with_states(scenario)
        for name, state in zip(state_names(part, path), part.states, strict=True)
    }


def plant_start(scenario: Scenario) -> dict[str, float]:
    """Return a dictionary from the name of each of the `plant_states` to its initial value.

    The values are in the units of the Context. Raises `ParameterError` and `LinkageError` as
    `make_plant` does.
    """
    return {
        name: value
        for path, part in parts_with_states(scenario)
        for name, value in zip(state_names(part, path), part.start_state(), strict=True)
    }


def plant_of(scenario: Scenario, fault_names: Mapping[str, tuple[str, ...]] = NO_FAULTS) -> Diagram:
    """Build the plant of a scenario, with the initial state that the scenario defines.

    `make_plant` describes ``fault_names``.
    """
    return make_plant(scenario.plant, **start_arguments(scenario), fault_names=fault_names)


def encoder_parts(scenario: Scenario) -> Iterator[Part]:
    """Yield the encoder. It measures θ_4, the signal ``encoder_angle``, minus its phase."""
    encoder = scenario.encoder
    if not encoder.quantized:
        reads, offers = {"u": "encoder_angle"}, {"encoder_reading": "y"}
        yield Part("encoder", lambda: PassThrough(1), reads=reads, offers=offers)
        return
    # "0[0]" is the first element of the first group of numeric parameters of Drake's block. Drake
    # sets its calibration offset in a Context, not in the diagram; so the offset stays zero, and a
    # sum adds the phase.
    yield Part(
        "encoder",
        lambda: _rotary_encoders(encoder.counts_per_revolution),
        lambda: {"0[0]": 0.0},
        reads={"u0": "phase_sum"},
        offers={"encoder_reading": "y0"},
    )
    yield Part(
        "encoder_phase",
        lambda: ConstantVectorSource([-encoder.phase_rad]),
        lambda: {"0[0]": -encoder.phase_rad},
        offers={"encoder_phase": "y0"},
    )
    sum_reads = {"u0": "encoder_angle", "u1": "encoder_phase"}
    yield Part("phase_sum", lambda: Adder(2, 1), reads=sum_reads, offers={"phase_sum": "sum"})


def _rotary_encoders(counts: int) -> System:
    from pydrake.systems.sensors import RotaryEncoders  # this import takes 0.05 s

    return RotaryEncoders([counts])
