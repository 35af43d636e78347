"""Builds the diagram to export (controller, plant or loop), and names and types its ports for C."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import Gain

from diagramc import (
    DiagramEquations,
    Interface,
    __version__ as compiler_version,
    read_diagram,
    rk4_step_s,
)
from kneexo.common.ports import input_ports
from kneexo.diagrams.closed_loop import (
    available_signals,
    encoder_parts,
    make_closed_loop,
    plant_of,
)
from kneexo.diagrams.controller import make_controller
from kneexo.diagrams.part import Part, export_inputs, wire
from kneexo.diagrams.protection import reading_range_rad, reference_range_rad
from kneexo.diagrams.signals import SIGNALS
from kneexo.errors import ParameterError
from kneexo.parameters import SampledReference, Scenario, SimulationParameters
from kneexo.parameters.device.safety_states import RELEASES, STATES
from kneexo.parameters.fields.fields import limits_of
from kneexo.parameters.task.fault import OPERATOR_INPUTS
from kneexo.simulation.compiled import why_python_in_run
from kneexo.systems import EncoderCount
from kneexo.version import __version__

TOOL = f"kneexo {__version__}, diagramc {compiler_version}"
"""The programs that make firmware and FMUs, with their versions."""

What = Literal["controller", "plant", "loop"]
"""Name of a part of a scenario that can be exported."""
WHAT: tuple[What, ...] = ("controller", "plant", "loop")
"""Names of all parts of a scenario that can be exported."""

ENCODER_COUNT = "encoder_count"
"""Name of the port that has the count of the encoder."""

_FIELDS = {
    **SIGNALS,
    "encoder_angle": ("encoder_angle_rad",),
    "rod_state": ("rod_extension_m", "rod_velocity_m_s", "rod_acceleration_m_s2"),
    "disturbance_force": ("disturbance_force_n",),
    "knee_torque": ("knee_torque_n_m",),
    "bypass": ("bypass_command",),
    **{name: (name,) for name in ("torque_off", "dynamic_brake", "release", *OPERATOR_INPUTS)},
}


@dataclass(frozen=True)
class Target:
    """A diagram to export, with its ports and their names in C."""

    what: What
    diagram: System
    inputs: tuple[str, ...]
    """Names of the input ports that become inputs of the exported code."""
    outputs: tuple[str, ...]
    interface: Interface
    tick_s: float | None
    """Time in s that a step covers, or None if the diagram has a sample time."""


def make_target(scenario: Scenario, what: str, *, counts: bool = False) -> Target:
    """Return controller, plant or loop of a scenario as a diagram, with its ports in C.

    ``controller``
        `make_controller`. Inputs: encoder reading and knee reference, and with torque control the
        reading of the load cell. Output: motor speed command. Protection adds the inputs motor
        speed, emergency stop and reset, and the outputs residuals, state, reason and release.
        With ``counts``, the reading of a quantized encoder is replaced by its count, a whole
        number.
    ``plant``
        The plant with its encoder. Inputs: motor speed command and external forces. Outputs:
        encoder reading, the count of a quantized encoder, and the signals of the plant.
    ``loop``
        `make_closed_loop`. Inputs: external forces. The knee reference is an input too if it is
        sampled, and so is the biological moment of a wearer. Outputs: all available signals.

    Raises `ParameterError` for another ``what`` and for a law that is called as Python, and the
    errors of `make_closed_loop`.
    """
    if what not in WHAT:
        raise ParameterError(f"what = {what!r}: must be one of {', '.join(WHAT)}")
    if what != "plant" and (reason := why_python_in_run(scenario)):
        raise ParameterError(
            f"controller: the law cannot be exported, because it is called as Python: {reason}; "
            f"docs/your_controller.md says how to get it compiled"
        )
    if what == "controller":
        return _controller(scenario, counts)
    if what == "plant" and scenario.faults:
        raise ParameterError(
            "faults: the plant alone contains no faults; leave them out, or export the loop"
        )
    return _plant(scenario) if what == "plant" else _loop(scenario)


def largest_step_s(scenario: Scenario, what: str) -> float:
    """Return the step of RK4 in s with which a part of a scenario is exported by default.

    The step follows the fastest mode at the start, and the fastest mode in each state into which
    a release can bring the plant. A release of the protection shorts the windings, takes the torque
    from the motor, or opens the bypass. The result is the shortest of these `rk4_step_s`.
    ``what`` is ``controller``, ``plant`` or ``loop``. Raises the errors of `make_target`.
    """
    target = make_target(scenario, what)
    return released_step_s(scenario, read_diagram(target.diagram, inputs=target.inputs))


def released_step_s(scenario: Scenario, diagram: DiagramEquations) -> float:
    """Return `largest_step_s` in s for a target whose equations are read already.

    ``diagram`` has the equations of the target, with which `rk4_step_s` is evaluated.
    """
    equations, parameters, protection = diagram.equations, diagram.parameters(), scenario.protection
    port_of_element = [name for name, size in equations.inputs.items() for _ in range(size)]
    acting = {*port_of_element, *([] if protection is None else [protection.safe_state])}
    steps = [rk4_step_s(equations, parameters, diagram.state())]
    # A release acts if it is an input of the target (the plant), or if the protection inside the
    # target uses it (the loop). A release makes faster modes: shorted windings stop the motor with
    # k_t²/(R J), and an open bypass empties the chambers.
    for release in acting & {*RELEASES}:
        state, inputs = diagram.state(), np.array([float(p == release) for p in port_of_element])
        is_valve = [name == "plant/bypass.x[0]" for name in equations.states]
        state.continuous[is_valve] = release == "bypass"
        is_number = [name == "controller/supervisor.0[0]" for name in equations.discrete]
        state.discrete[is_number] = list(STATES).index("released")
        steps.append(rk4_step_s(equations, parameters, state, inputs))
    return min(steps)


def require_step(step_s: float | None) -> None:
    """Raise `ParameterError` for a step outside the range of ``simulation.step_s``."""
    low, high = limits_of(SimulationParameters.model_fields["step_s"])
    if step_s is not None and not low <= step_s <= high:
        raise ParameterError(f"step_s = {step_s:g} s: must be {low:g} … {high:g} s")


def _controller(scenario: Scenario, counts: bool) -> Target:
    """Return the controller as a target. `make_target` describes ``counts``."""
    law = scenario.controller
    if law.kind == "smc" and law.continuous:
        raise ParameterError(
            "controller.continuous = true: has no sample time; must be false to be exported"
        )
    controller = make_controller(scenario)
    inputs = [*input_ports(controller)]
    outputs = ["motor_speed_command"]
    failed, protection = {_FIELDS["motor_speed_command"][0]: 0.0}, scenario.protection
    if protection is not None:
        outputs += ["residuals", "safety_state", "safety_reason", "release"]
        has_release = protection.safe_state in RELEASES
        failed_state = list(STATES).index("released" if has_release else "stopped")
        # After a failed call the outputs are those at the end of a stop.
        failed |= {"safety_state": failed_state, "release": float(has_release)}
    ranges = {}
    if "knee_reference" in inputs:
        ranges[_FIELDS["knee_reference"][0]] = reference_range_rad(scenario)
    diagram = controller
    if counts and scenario.encoder.quantized and "encoder_reading" in inputs:
        builder = DiagramBuilder()
        reading = builder.AddNamedSystem(ENCODER_COUNT, Gain(scenario.encoder.resolution_rad, 1))
        builder.AddNamedSystem("controller", controller)
        builder.Connect(reading.get_output_port(), controller.GetInputPort("encoder_reading"))
        builder.ExportInput(reading.get_input_port(), ENCODER_COUNT)
        other_inputs = [name for name in inputs if name != "encoder_reading"]
        for name in other_inputs:
            builder.ExportInput(controller.GetInputPort(name), name)
        inputs = [ENCODER_COUNT, *other_inputs]
        for name in outputs:
            builder.ExportOutput(controller.GetOutputPort(name), name)
        diagram = builder.Build()
        ranges[ENCODER_COUNT] = count_range(scenario)
    integers = frozenset(name for name in inputs if name == ENCODER_COUNT)
    interface = Interface(_fields_of(diagram), integers, ranges, failed, protection is not None)
    return Target("controller", diagram, tuple(inputs), tuple(outputs), interface, None)


def _fields_of(diagram: System) -> dict[str, tuple[str, ...]]:
    """Return the names in C of the elements of each port that a diagram has, by port."""
    return {
        port: names
        for port, names in _FIELDS.items()
        if diagram.HasInputPort(port) or diagram.HasOutputPort(port)
    }


def count_range(scenario: Scenario) -> tuple[float, float]:
    """Return the lowest and highest encoder count that the exported controller accepts.

    Without protection they are the counts within the range of motion. With protection the range is
    one turn wider at each end, because the fault detectors judge a count outside the range of
    motion.
    """
    resolution = scenario.encoder.resolution_rad
    low, high = (reading / resolution for reading in reading_range_rad(scenario))
    # `FaultDetectors` too take a reading up to one turn beyond each end as it is. A reading further
    # away counts as a reading without meaning.
    one_turn = 0 if scenario.protection is None else scenario.encoder.counts_per_revolution
    return low - one_turn, high + one_turn


def _plant(scenario: Scenario) -> Target:
    builder = DiagramBuilder()
    parts = [Part("plant", lambda: plant_of(scenario)), *encoder_parts(scenario)]
    ports, inputs = wire(builder, parts)
    export_inputs(builder, inputs, {name: name for name in inputs})
    encoder = ports["encoder_reading"]
    builder.ExportOutput(encoder, "encoder_reading")
    outputs = ["encoder_reading"]
    if scenario.encoder.quantized:
        count = builder.AddNamedSystem(ENCODER_COUNT, EncoderCount(scenario.encoder.resolution_rad))
        builder.Connect(encoder, count.get_input_port())
        builder.ExportOutput(count.get_output_port(), ENCODER_COUNT)
        outputs.append(ENCODER_COUNT)
    for name in SIGNALS:
        if name in ports and name not in outputs:
            builder.ExportOutput(ports[name], name)
            outputs.append(name)
    diagram = builder.Build()
    diagram.set_name("plant")  # messages name the diagram
    tick = scenario.controller.sample_time_s
    return Target(
        "plant", diagram, tuple(inputs), tuple(outputs), Interface(_fields_of(diagram)), tick
    )


def _loop(scenario: Scenario) -> Target:
    sampled = isinstance(scenario.reference, SampledReference)
    diagram = make_closed_loop(
        scenario, signals=(), external_reference=sampled, external_moment=True
    )
    inputs = tuple(input_ports(diagram))
    outputs = available_signals(scenario)
    tick = scenario.controller.sample_time_s
    return Target("loop", diagram, inputs, outputs, Interface(_fields_of(diagram)), tick)
