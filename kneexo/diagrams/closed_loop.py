"""The closed loop: plant, encoder, estimator, controller, reference and logging (Fig. 8)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    DiscreteTimeDelay,
    LogVectorOutput,
    Multiplexer,
    PassThrough,
)

from kneexo import systems
from kneexo.diagrams.plant import FULL_ORDER_OUTPUTS, make_plant
from kneexo.errors import ParameterError
from kneexo.parameters import Scenario
from kneexo.systems.knee_reference import require_reference_in_range, start_angle_rad

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


def available_signals(scenario: Scenario) -> tuple[str, ...]:
    """The names of `SIGNALS` that the scenario's closed loop has."""
    missing = set()
    if scenario.controller.kind != "smc":
        missing |= {"estimated_state", "sliding_variable"}
    if scenario.plant.full_order is None:
        missing |= set(FULL_ORDER_OUTPUTS)
    return tuple(name for name in SIGNALS if name not in missing)


def chosen_signals(scenario: Scenario, signals: Sequence[str] | None) -> tuple[str, ...]:
    """``signals``, all available ones when None; `ParameterError` for an unknown one."""
    available = available_signals(scenario)
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
    signals: Sequence[str] | None = None,
    external_reference: bool = False,
) -> Diagram:
    """Build the closed loop of a scenario; without arguments the paper's sliding-mode setup.

    Subsystems: ``plant``, ``encoder`` (Drake's `RotaryEncoders`, behind ``encoder_phase`` and
    ``encoder_mounting``, or a `PassThrough` when it is not quantized), ``coordinates``,
    ``reference``, ``rod_reference``, ``estimator`` (SMC only, unless the states are exact),
    ``controller``, ``can_bus`` (only with latency), ``signals`` and ``log`` (a `VectorLogSink` at
    the control period with the columns ``columns(signals)``; all available signals by default,
    none with ``signals=()``). Inputs: ``disturbance_force`` and, with a load, ``knee_torque``; both
    may stay unconnected. Outputs: each of `available_signals`.

    With ``external_reference`` there is no ``reference`` subsystem but an input ``knee_reference``
    (θ_d and its derivatives to the third); the scenario's reference then only says where the
    plant starts.

    A logged command at t is the one held up to t: Drake's updates and publishes at t both see the
    state before the update. The paper's ideal case (Fig. 9) is `kneexo.studies.paper.IDEAL_SMC`.

    Raises `ParameterError` when the reference leaves the range of motion or a signal is unknown,
    `LinkageError` when the linkage cannot be assembled.
    """
    require_reference_in_range(scenario.reference, scenario.plant.knee)
    names = chosen_signals(scenario, signals)
    builder = DiagramBuilder()

    def add(name: str, system: Any) -> Any:
        return builder.AddNamedSystem(name, system)

    plant = add(
        "plant",
        make_plant(
            scenario.plant,
            initial_knee_angle_rad=start_angle_rad(scenario.reference),
            initial_offset_m=scenario.initial_offset_m,
            table_1=scenario.polynomial,
        ),
    )
    rod_reference = add("rod_reference", systems.RodReference(scenario.polynomial))
    encoder = _encoder(builder, scenario, plant.GetOutputPort("encoder_angle"))
    coordinates = add(
        "coordinates",
        systems.KneeCoordinates(
            scenario.believed_plant.linkage,
            scenario.polynomial,
            encoder_offset_rad(scenario),
        ),
    )
    if external_reference:
        knee_reference = add("knee_reference", PassThrough(4))
        builder.ExportInput(knee_reference.get_input_port(), "knee_reference")
    else:
        knee_reference = add("reference", systems.make_knee_reference(scenario.reference))
    builder.Connect(knee_reference.get_output_port(), rod_reference.get_input_port())
    builder.Connect(encoder.get_output_port(), coordinates.get_input_port())

    ports = {name: plant.GetOutputPort(name) for name in SIGNALS if plant.HasOutputPort(name)} | {
        "knee_reference": knee_reference.get_output_port(),
        "rod_reference": rod_reference.get_output_port(),
        "encoder_reading": encoder.get_output_port(),
        "measured_knee_angle": coordinates.GetOutputPort("knee_angle"),
        "measured_rod_extension": coordinates.GetOutputPort("rod_extension"),
    }
    law = scenario.controller.model_copy(
        update={"command_limit_rad_s": scenario.command_limit_rad_s}
    )
    if law.kind == "smc":
        controller = add("controller", systems.SlidingModeController(law, scenario.believed_plant))
        ports["estimated_state"] = _estimate(builder, scenario, plant, coordinates)
        ports["sliding_variable"] = controller.GetOutputPort("sliding_variable")
        inputs = {"estimated_state": "estimated_state"}
    else:
        controller = add("controller", systems.PidController(law, scenario.believed_plant))
        inputs = {"knee_angle": "measured_knee_angle", "knee_reference": "knee_reference"}
    for port, signal in (inputs | {"rod_reference": "rod_reference"}).items():
        builder.Connect(ports[signal], controller.GetInputPort(port))

    command = controller.GetOutputPort("motor_speed_command")
    if scenario.can_delay_samples:
        # The controller's output is held already, so n − 1 steps here make n samples of latency.
        bus = add(
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
    for name in available_signals(scenario):
        builder.ExportOutput(ports[name], name)
    if names:
        mux = add("signals", Multiplexer([len(SIGNALS[name]) for name in names]))
        for index, name in enumerate(names):
            builder.Connect(ports[name], mux.get_input_port(index))
        log = LogVectorOutput(
            mux.get_output_port(), builder, publish_period=scenario.controller.sample_time_s
        )
        log.set_name("log")
    diagram = builder.Build()
    diagram.set_name("closed_loop")
    return diagram


def _estimate(builder: Any, scenario: Scenario, plant: Any, coordinates: Any) -> Any:
    """Add the estimator that the scenario asks for; returns the port with x, v and a."""
    if scenario.estimator.kind == "exact":
        return plant.GetOutputPort("rod_state")
    sample_time = scenario.controller.sample_time_s
    if scenario.estimator.kind == "observer":
        system = systems.TrackingObserver(scenario.estimator, sample_time)
    else:
        system = systems.BackwardDifference(sample_time)
    estimator = builder.AddNamedSystem("estimator", system)
    builder.Connect(coordinates.GetOutputPort("rod_extension"), estimator.get_input_port())
    return estimator.get_output_port()


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


def encoder_offset_rad(scenario: Scenario) -> float:
    """What the controller adds to a reading: phase and half a count, less the mounting error."""
    encoder = scenario.encoder
    phase = encoder.phase_rad if encoder.quantized else 0.0
    return phase + 0.5 * encoder.resolution_rad - encoder.mounting_error_rad
