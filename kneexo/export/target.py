"""What is exported of a scenario: its controller, its plant or its closed loop."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import Gain

from kneexo import linkage
from kneexo.compiler.c.interface import Interface
from kneexo.compiler.c.step_size import rk4_step_s
from kneexo.compiler.model import compile_diagram
from kneexo.diagrams.closed_loop import add_encoder, available_signals, make_closed_loop, plant_of
from kneexo.diagrams.controller import make_controller
from kneexo.diagrams.signals import SIGNALS
from kneexo.errors import ParameterError
from kneexo.parameters import SampledReference, Scenario, SimulationParameters
from kneexo.parameters.quantity import limits_of

What = Literal["controller", "plant", "loop"]
"""What can be exported."""
WHAT: tuple[What, ...] = ("controller", "plant", "loop")
"""All that can be exported."""

ENCODER_COUNT = "encoder_count"
"""Name of the port that carries the encoder's count."""

_FIELDS = {
    **SIGNALS,
    "encoder_angle": ("encoder_angle_rad",),
    "rod_state": ("rod_extension_m", "rod_velocity_m_s", "rod_acceleration_m_s2"),
    "disturbance_force": ("disturbance_force_n",),
    "knee_torque": ("knee_torque_n_m",),
}


@dataclass(frozen=True)
class Target:
    """A diagram to export."""

    what: What
    diagram: System
    inputs: tuple[str, ...]
    """Input ports that stay open."""
    outputs: tuple[str, ...]
    interface: Interface
    tick_s: float | None
    """Time of a step, where the diagram has no sample time."""


def target(scenario: Scenario, what: str, *, counts: bool = False) -> Target:
    """The diagram of a scenario that is exported.

    ``controller``
        `make_controller`: encoder reading and knee reference in, motor speed command out. With
        ``counts`` the reading is the encoder's count, a whole number.
    ``plant``
        The plant with its encoder: motor speed command in, and forces from outside; encoder reading
        and the plant's signals out.
    ``loop``
        `make_closed_loop`: all available signals out; in what comes from outside, and the reference
        when it is sampled.

    Raises `ParameterError` for another ``what``, and as `make_closed_loop` does.
    """
    if what not in WHAT:
        raise ParameterError(f"what = {what!r}: must be one of {', '.join(WHAT)}")
    if what == "controller":
        return _controller(scenario, counts)
    return _plant(scenario) if what == "plant" else _loop(scenario)


def largest_step_s(scenario: Scenario, what: str) -> float:
    """Largest step of RK4 of an exported target in s, where none is given: see `rk4_step_s`.

    Raises as `target`.
    """
    to_print = target(scenario, what)
    model = compile_diagram(to_print.diagram, inputs=to_print.inputs)
    return rk4_step_s(model.code.program.equations, model.parameters(), model.state())


def require_step(step_s: float | None) -> None:
    """Raise `ParameterError` for a step outside the range of ``simulation.step_s``."""
    low, high = limits_of(SimulationParameters.model_fields["step_s"])
    if step_s is not None and not low <= step_s <= high:
        raise ParameterError(f"step_s = {step_s:g} s: must be {low:g} … {high:g} s")


def _controller(scenario: Scenario, counts: bool) -> Target:
    law = scenario.controller
    if law.kind == "smc" and law.continuous:
        raise ParameterError(
            "controller.continuous = true: has no sample time; must be false to be exported"
        )
    controller = make_controller(scenario)
    inputs = [controller.get_input_port(i).get_name() for i in range(controller.num_input_ports())]
    ranges = {}
    if "knee_reference" in inputs:
        ranges[_FIELDS["knee_reference"][0]] = reference_range_rad(scenario)
    diagram = controller
    if counts and scenario.encoder.quantized and "encoder_reading" in inputs:
        builder = DiagramBuilder()
        count = builder.AddNamedSystem(ENCODER_COUNT, Gain(scenario.encoder.resolution_rad, 1))
        part = builder.AddNamedSystem("controller", controller)
        builder.Connect(count.get_output_port(), part.GetInputPort("encoder_reading"))
        builder.ExportInput(count.get_input_port(), ENCODER_COUNT)
        inputs = [ENCODER_COUNT, *(name for name in inputs if name != "encoder_reading")]
        for name in inputs[1:]:
            builder.ExportInput(part.GetInputPort(name), name)
        builder.ExportOutput(part.GetOutputPort("motor_speed_command"), "motor_speed_command")
        diagram = builder.Build()
        ranges[ENCODER_COUNT] = count_range(scenario)
    integers = frozenset(name for name in inputs if name == ENCODER_COUNT)
    interface = Interface(_FIELDS, integers, ranges)
    return Target("controller", diagram, tuple(inputs), ("motor_speed_command",), interface, None)


def count_range(scenario: Scenario) -> tuple[float, float]:
    """Lowest and highest count that the controller takes: a knee between its stops, or just beyond.

    θ_4 by Eq. 3–7 of the stops and the overshoot that the plant allows, with the mounting error on
    either side, less the phase.
    """
    encoder, plant = scenario.encoder, scenario.believed_plant
    knee = plant.knee
    low, high = knee.flexion_min_deg - knee.overshoot_deg, knee.flexion_max_deg + knee.overshoot_deg
    angles = linkage.encoder_angle(plant.linkage, np.radians(np.linspace(low, high, 181)))
    counts = (angles - encoder.phase_rad) / encoder.resolution_rad
    slack = 1.0 + abs(encoder.mounting_error_rad) / encoder.resolution_rad
    return float(counts.min() - slack), float(counts.max() + slack)


def reference_range_rad(scenario: Scenario) -> tuple[float, float]:
    """Lowest and highest knee angle that the controller takes as reference.

    As `require_reference_in_range`: the range of motion and the overshoot beyond. An angle far
    outside would fill the integral of a PID for longer than it lasts.
    """
    knee = scenario.plant.knee
    return (
        math.radians(knee.flexion_min_deg - knee.overshoot_deg),
        math.radians(knee.flexion_max_deg + knee.overshoot_deg),
    )


def _plant(scenario: Scenario) -> Target:
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem("plant", plant_of(scenario))
    encoder = add_encoder(builder, scenario, plant.GetOutputPort("encoder_angle"))
    inputs = [plant.get_input_port(i).get_name() for i in range(plant.num_input_ports())]
    for name in inputs:
        builder.ExportInput(plant.GetInputPort(name), name)
    builder.ExportOutput(encoder.get_output_port(), "encoder_reading")
    outputs = ["encoder_reading"]
    for name in SIGNALS:
        if plant.HasOutputPort(name):
            builder.ExportOutput(plant.GetOutputPort(name), name)
            outputs.append(name)
    diagram = builder.Build()
    diagram.set_name("plant")
    tick = scenario.controller.sample_time_s
    return Target("plant", diagram, tuple(inputs), tuple(outputs), Interface(_FIELDS), tick)


def _loop(scenario: Scenario) -> Target:
    sampled = isinstance(scenario.reference, SampledReference)
    diagram = make_closed_loop(scenario, signals=(), external_reference=sampled)
    inputs = tuple(diagram.get_input_port(i).get_name() for i in range(diagram.num_input_ports()))
    outputs = available_signals(scenario)
    tick = scenario.controller.sample_time_s
    return Target("loop", diagram, inputs, outputs, Interface(_FIELDS), tick)
