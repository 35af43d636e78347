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
from kneexo.systems.knee_load import weight_torque

PLANT_OUTPUTS = {
    "knee": ("knee_angle", "encoder_angle", "moment_arm", "icr"),
    "cylinder": ("rod_extension", "rod_velocity", "rod_state", "load_pressure", "rod_force"),
    "motor": ("motor_speed", "load_flow", "shaft_torque", "shaft_power", "hydraulic_power"),
}
"""Exported output ports, by subsystem; each keeps the name that it has in its leaf system."""

_START_RAD = math.radians(SineReference().mean_deg - SineReference().amplitude_deg)


def rod_at(
    plant: PlantParameters, table_1: RodPolynomialParameters, knee_angle: float
) -> tuple[float, float]:
    """Rod extension and moment arm of the plant in m at a knee angle in rad."""
    if plant.rod_map == "polynomial":
        p = table_1.p_si
        slope = linkage.polynomial(linkage.polynomial_derivative(p), knee_angle)
        return float(linkage.polynomial(p, knee_angle)), -float(slope)
    at = linkage.pose(plant.linkage, knee_angle)
    return float(at.rod_extension), float(at.moment_arm)


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
    rod, the pressure holding the load.

    Raises `LinkageError` when the linkage cannot be assembled. Without load the derivatives do
    not depend on the knee, so its kinematics cost nothing between outputs.
    """
    extension, arm = rod_at(parameters, table_1, initial_knee_angle_rad)
    load = parameters.load
    force = (
        _static_force(load, initial_knee_angle_rad, arm)
        if isinstance(load, KneeLoadParameters)
        else 0.0
    )

    builder = DiagramBuilder()
    motor = builder.AddNamedSystem("motor", BldcPump(parameters.pump, parameters.ideal_motor))
    cylinder = builder.AddNamedSystem(
        "cylinder",
        ReducedCylinder(
            parameters.cylinder,
            extension + initial_offset_m,
            force / parameters.cylinder.mean_area_m2,
        ),
    )
    knee = builder.AddNamedSystem(
        "knee",
        FourBarKnee(
            parameters.linkage,
            parameters.knee,
            table_1 if parameters.rod_map == "polynomial" else None,
        ),
    )
    _connect(builder, motor, "load_flow", cylinder, "load_flow")
    _connect(builder, cylinder, "load_pressure", motor, "load_pressure")
    _connect(builder, cylinder, "rod_extension", knee, "rod_extension")
    builder.ExportInput(motor.GetInputPort("motor_speed_command"), "motor_speed_command")
    if isinstance(load, KneeLoadParameters):
        knee_load = builder.AddNamedSystem("load", KneeLoad(load))
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


def _static_force(load: KneeLoadParameters, angle: float, arm: float) -> float:
    torque = weight_torque(
        angle,
        mass=load.segment_mass_kg,
        centre_of_mass=load.centre_of_mass_m,
        thigh_inclination=load.thigh_inclination_rad,
        gravity=load.gravity_m_s2,
    )
    return float((torque + load.knee_torque_n_m) / arm + load.disturbance_n)


def _connect(builder: Any, source: Any, output: str, target: Any, input_: str) -> None:
    builder.Connect(source.GetOutputPort(output), target.GetInputPort(input_))
