"""The closed loop: plant, encoder, estimator, controller, reference and logging (Fig. 8)."""

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
    port_sizes,
    require_controller,
)
from kneexo.diagrams.plant import FULL_ORDER_OUTPUTS, make_plant, plant_parts
from kneexo.errors import ParameterError
from kneexo.parameters import CustomControllerParameters, SampledReference, Scenario
from kneexo.systems import knee_reference
from kneexo.systems.knee_reference import require_reference_in_range

SIGNALS = {
    "knee_reference": (
        "knee_reference_rad",
        "knee_reference_rate_rad_s",
        "knee_reference_acceleration_rad_s2",
        "knee_reference_jerk_rad_s3",
    ),
    "knee_angle": ("knee_angle_rad",),
    "measured_knee_angle": ("measured_knee_angle_rad",),
    "encoder_reading": ("encoder_reading_rad",),
    "rod_reference": (
        "rod_reference_m",
        "rod_reference_velocity_m_s",
        "rod_reference_acceleration_m_s2",
        "rod_reference_jerk_m_s3",
    ),
    "rod_extension": ("rod_extension_m",),
    "rod_velocity": ("rod_velocity_m_s",),
    "measured_rod_extension": ("measured_rod_extension_m",),
    "estimated_state": (
        "estimated_rod_extension_m",
        "estimated_rod_velocity_m_s",
        "estimated_rod_acceleration_m_s2",
    ),
    "sliding_variable": ("sliding_variable_m_s2",),
    "motor_speed_command": ("motor_speed_command_rad_s",),
    "motor_speed": ("motor_speed_rad_s",),
    "load_flow": ("load_flow_m3_s",),
    "load_pressure": ("load_pressure_pa",),
    "rod_force": ("rod_force_n",),
    "moment_arm": ("moment_arm_m",),
    "icr": ("icr_x_m", "icr_y_m"),
    "shaft_torque": ("shaft_torque_n_m",),
    "shaft_power": ("shaft_power_w",),
    "hydraulic_power": ("hydraulic_power_w",),
    "chamber_pressures": ("cap_pressure_pa", "rod_side_pressure_pa"),
    "makeup_flow": ("cap_makeup_flow_m3_s", "rod_side_makeup_flow_m3_s"),
    "relief_flow": ("cap_relief_flow_m3_s", "rod_side_relief_flow_m3_s"),
}
"""Every signal of the closed loop and the names of its columns, which end in the unit."""


OF_CONTROLLER = {
    *("measured_knee_angle", "measured_rod_extension", "rod_reference"),
    *("estimated_state", "sliding_variable"),
}
"""Those of `SIGNALS` that are outputs of the controller."""


def available_signals(
    scenario: Scenario, outputs: Mapping[str, int] | None = None
) -> tuple[str, ...]:
    """The names of `SIGNALS` that the scenario's closed loop has.

    ``outputs``: size of each output port of the controller, where it is not the scenario's.
    """
    missing = set()
    if outputs is None and scenario.controller.kind == "custom":
        outputs = controller_outputs(scenario)
    if outputs is not None:
        missing |= {name for name in OF_CONTROLLER if outputs.get(name) != len(SIGNALS[name])}
    elif scenario.controller.kind != "smc":
        missing |= {"estimated_state", "sliding_variable"}
    if scenario.plant.full_order is None:
        missing |= set(FULL_ORDER_OUTPUTS)
    return tuple(name for name in SIGNALS if name not in missing)


def chosen_signals(
    scenario: Scenario,
    signals: Sequence[str] | None,
    outputs: Mapping[str, int] | None = None,
) -> tuple[str, ...]:
    """``signals``, all available ones when None; `ParameterError` for an unknown one."""
    available = available_signals(scenario, outputs)
    names = available if signals is None else tuple(signals)
    for name in names:
        if name not in available:
            raise ParameterError(f"signal {name!r} is unknown; known: {', '.join(available)}")
    return names


def columns(signals: Sequence[str]) -> tuple[str, ...]:
    """Names of the logged columns of ``signals``, in order."""
    return tuple(column for signal in signals for column in SIGNALS[signal])


def make_closed_loop(
    scenario: Scenario = Scenario(),
    *,
    controller: System | None = None,
    reference: System | None = None,
    signals: Sequence[str] | None = None,
    external_reference: bool = False,
) -> Diagram:
    """Build the closed loop of a scenario; without arguments the paper's sliding-mode setup.

    Subsystems: ``plant``, ``encoder`` (Drake's `RotaryEncoders`, behind ``encoder_phase`` and
    ``encoder_mounting``, or a `PassThrough` when it is not quantized), ``reference``,
    ``controller`` (see `make_controller`), ``can_bus`` (only with latency), ``signals`` and ``log``
    (a `VectorLogSink` at the control period with the columns ``columns(signals)``; all available
    signals by default, none with ``signals=()``). Inputs: ``disturbance_force`` and, with a load,
    ``knee_torque``; both may stay unconnected. Outputs: each of `available_signals`.

    Parameters
    ----------
    scenario
        The loop. Where ``controller`` is given, its controller only tells sample time of the log
        and command limit.
    controller
        A system in place of the scenario's controller, with ports as `make_controller` says: of
        the inputs those that it needs, of the outputs at least ``motor_speed_command``. It has its
        own sample time.
    reference
        A system in place of the scenario's reference: one output (4,), θ_d and its derivatives to
        the third. The scenario's reference then only says where the plant starts.
    signals
        What is logged: names of `SIGNALS`.
    external_reference
        An input ``knee_reference`` in place of the subsystem ``reference``.

    A logged command at t is the one held up to t: Drake's updates and publishes at t both see the
    state before the update. The paper's ideal case (Fig. 9) is `kneexo.studies.paper.IDEAL_SMC`.

    Raises `ParameterError` when the reference leaves the range of motion, a signal is unknown or a
    port is missing, `LinkageError` when the linkage cannot be assembled.
    """
    require_reference_in_range(scenario.reference, scenario.plant.knee)
    outputs = None
    if controller is not None:
        require_controller(controller)
        outputs = port_sizes(controller)
    names = chosen_signals(scenario, signals, outputs)
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem("plant", make_plant(scenario.plant, **_plant_start(scenario)))
    encoder = _encoder(builder, scenario, plant.GetOutputPort("encoder_angle"))
    if external_reference:
        source = builder.AddNamedSystem("knee_reference", PassThrough(4))
        builder.ExportInput(source.get_input_port(), "knee_reference")
    else:
        if reference is None:
            reference = systems.make_knee_reference(scenario.reference)
        elif reference.num_output_ports() != 1 or reference.get_output_port().size() != 4:
            raise ParameterError("reference: must have one output port of size 4")
        source = builder.AddNamedSystem("reference", reference)
    controller = controller or make_controller(scenario)
    builder.AddNamedSystem("controller", controller)
    ports = {name: plant.GetOutputPort(name) for name in SIGNALS if plant.HasOutputPort(name)} | {
        "knee_reference": source.get_output_port(),
        "encoder_reading": encoder.get_output_port(),
    }
    for index in range(controller.num_input_ports()):
        port = controller.get_input_port(index)
        signal = ports.get(port.get_name()) or plant.GetOutputPort(port.get_name())
        builder.Connect(signal, port)
    available = available_signals(scenario, outputs)
    ports["estimated_state"] = plant.GetOutputPort("rod_state")  # unless the controller has one
    ports |= {
        name: controller.GetOutputPort(name)
        for name in OF_CONTROLLER
        if controller.HasOutputPort(name)
    }
    command = controller.GetOutputPort("motor_speed_command")
    if scenario.can_delay_samples:
        # The controller's output is held already, so n − 1 steps here make n samples of latency.
        bus = builder.AddNamedSystem(
            "can_bus",
            DiscreteTimeDelay(
                update_sec=scenario.controller.sample_time_s,
                delay_time_steps=scenario.can_delay_samples - 1,
                vector_size=1,
            ),
        )
        builder.Connect(command, bus.get_input_port())
        command = bus.get_output_port()
    ports["motor_speed_command"] = command
    builder.Connect(command, plant.GetInputPort("motor_speed_command"))

    for name in ("disturbance_force", "knee_torque"):
        if plant.HasInputPort(name):
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


def loop_values(scenario: Scenario) -> Iterator[tuple[str, dict[str, float]]]:
    """Path and Context parameters of each leaf system of `make_closed_loop`.

    Those of a custom controller are not among them.
    """
    for part in plant_parts(scenario.plant, **_plant_start(scenario)):
        yield f"plant/{part.name}", part.values
    if scenario.encoder.quantized:
        # The second is Drake's calibration offset, which can only be set in a Context.
        yield "encoder_phase", {"0[0]": -scenario.encoder.phase_rad}
        yield "encoder", {"0[0]": 0.0}
    if not isinstance(scenario.reference, SampledReference):
        yield "reference", knee_reference.context_values(scenario.reference)
    if not isinstance(scenario.controller, CustomControllerParameters):
        for part in controller_parts(scenario):
            yield f"controller/{part.name}", part.values


def _plant_start(scenario: Scenario) -> dict[str, Any]:
    """Where `make_plant` and `plant_start` put the rod of a scenario."""
    return {
        "initial_knee_angle_rad": knee_reference.start_angle_rad(scenario.reference),
        "initial_offset_m": scenario.initial_offset_m,
        "table_1": scenario.polynomial,
    }


def _encoder(builder: Any, scenario: Scenario, angle: Any) -> Any:
    """Add the encoder that reads the port ``angle`` (θ_4), less its phase; returns the system."""
    from pydrake.systems.sensors import RotaryEncoders  # with cameras and geometry: 0.05 s

    if not scenario.encoder.quantized:
        encoder = builder.AddNamedSystem("encoder", PassThrough(1))
        builder.Connect(angle, encoder.get_input_port())
        return encoder
    encoder = builder.AddNamedSystem(
        "encoder", RotaryEncoders([scenario.encoder.counts_per_revolution])
    )
    # The encoder's own calibration offset can only be set in a Context, not in the diagram.
    phase = builder.AddNamedSystem(
        "encoder_phase", ConstantVectorSource([-scenario.encoder.phase_rad])
    )
    mounting = builder.AddNamedSystem("encoder_mounting", Adder(2, 1))
    builder.Connect(angle, mounting.get_input_port(0))
    builder.Connect(phase.get_output_port(), mounting.get_input_port(1))
    builder.Connect(mounting.get_output_port(), encoder.get_input_port())
    return encoder
