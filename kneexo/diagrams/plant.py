"""The plant: motor and pump, cylinder, knee and load, wired as one continuous diagram."""

from __future__ import annotations

import math
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder

from kneexo import linkage
from kneexo.parameters import (
    KneeLoadParameters,
    PlantParameters,
    RodPolynomialParameters,
    SineReference,
)
from kneexo.systems import BldcPump, FourBarKnee, KneeLoad, ReducedCylinder

PLANT_OUTPUTS = {
    "knee": ("knee_angle", "encoder_angle", "moment_arm", "icr"),
    "cylinder": ("rod_extension", "rod_velocity", "rod_state", "load_pressure", "rod_force"),
    "motor": ("motor_speed", "load_flow", "shaft_torque", "shaft_power", "hydraulic_power"),
}
"""Exported output ports, by subsystem; each keeps the name that it has in its leaf system."""

_START_RAD = math.radians(SineReference().mean_deg - SineReference().amplitude_deg)


def make_plant(
    parameters: PlantParameters = PlantParameters(),
    *,
    initial_knee_angle_rad: float = _START_RAD,
    initial_offset_m: float = 0.0,
    table_1: RodPolynomialParameters = RodPolynomialParameters(),
) -> Diagram:
    """Build the plant: motor → cylinder → knee, with load; continuous only, so that it linearizes.

    Subsystems: ``motor`` (`BldcPump`), ``cylinder`` (`ReducedCylinder`), ``knee`` (`FourBarKnee`)
    and, unless the load is none, ``load`` (`KneeLoad`). Inputs: ``motor_speed_command`` (rad/s),
    ``disturbance_force`` (N, on the rod, positive opposes extension) and, with a load,
    ``knee_torque`` (N·m, positive flexes); the last two count as zero when left unconnected.
    Outputs: `PLANT_OUTPUTS`. It starts at rest at the given posture, plus ``initial_offset_m`` of
    rod, the pressure holding load and spring there.

    Raises `LinkageError` when the linkage cannot be assembled. Without load the derivatives do
    not depend on the knee, so its kinematics cost nothing between outputs.
    """
    polynomial = parameters.rod_map == "polynomial"
    knee = FourBarKnee(parameters.linkage, parameters.knee, table_1 if polynomial else None)
    if polynomial:
        extension = linkage.polynomial(table_1.p_si, initial_knee_angle_rad)
    else:
        extension = float(linkage.rod_extension(parameters.linkage, initial_knee_angle_rad))
    extension += initial_offset_m
    load = parameters.load
    force = parameters.cylinder.stiffness_n_per_m * extension
    if isinstance(load, KneeLoadParameters):
        knee_load = KneeLoad(load)
        force += _static_force(knee_load, knee, extension)

    builder = DiagramBuilder()
    motor = builder.AddNamedSystem("motor", BldcPump(parameters.pump, parameters.ideal_motor))
    cylinder = builder.AddNamedSystem(
        "cylinder",
        ReducedCylinder(parameters.cylinder, extension, force / parameters.cylinder.mean_area_m2),
    )
    builder.AddNamedSystem("knee", knee)
    _connect(builder, motor, "load_flow", cylinder, "load_flow")
    _connect(builder, cylinder, "load_pressure", motor, "load_pressure")
    _connect(builder, cylinder, "rod_extension", knee, "rod_extension")
    builder.ExportInput(motor.GetInputPort("motor_speed_command"), "motor_speed_command")
    if isinstance(load, KneeLoadParameters):
        builder.AddNamedSystem("load", knee_load)
        _connect(builder, knee, "knee_angle", knee_load, "knee_angle")
        _connect(builder, knee, "moment_arm", knee_load, "moment_arm")
        _connect(builder, knee_load, "load_force", cylinder, "load_force")
        for name in ("disturbance_force", "knee_torque"):
            builder.ExportInput(knee_load.GetInputPort(name), name)
    else:
        builder.ExportInput(cylinder.GetInputPort("load_force"), "disturbance_force")
    for system in (knee, cylinder, motor):
        for name in PLANT_OUTPUTS[system.get_name()]:
            builder.ExportOutput(system.GetOutputPort(name), name)
    plant = builder.Build()
    plant.set_name("plant")
    return plant


def _static_force(load: Any, knee: Any, extension: float) -> float:
    """Force of the load on the resting rod at t = 0, in N."""
    at, under = knee.CreateDefaultContext(), load.CreateDefaultContext()
    knee.GetInputPort("rod_extension").FixValue(at, [extension])
    for name in ("knee_angle", "moment_arm"):
        load.GetInputPort(name).FixValue(under, knee.GetOutputPort(name).Eval(at))
    return float(load.GetOutputPort("load_force").Eval(under)[0])


def _connect(builder: Any, source: Any, output: str, target: Any, input_: str) -> None:
    builder.Connect(source.GetOutputPort(output), target.GetInputPort(input_))
