"""Leaf systems of the hydraulics at chosen points: pumps with their motor, and cylinders."""

import math

import numpy as np
from pydrake.systems.analysis import Simulator

from kneexo.parameters import BldcPumpParameters

RPM = 2.0 * math.pi / 60.0
LIMIT = 5000.0 * RPM
PUMP = BldcPumpParameters(
    gear_ratio=5.0, internal_leakage_m3_per_s_pa=3e-13, external_leakage_m3_per_s_pa=4e-13
)
PUMP_INPUTS = {"motor_speed_command": [(-600.0, 600.0)], "load_pressure": [(-3e6, 3e6)]}


def pump_at(system, *, command=0.0, pressure=0.0, speed=0.0, **releases):
    context = system.CreateDefaultContext()
    for name, value in releases.items():
        system.GetInputPort(name).FixValue(context, value)
    system.GetInputPort("motor_speed_command").FixValue(context, command)
    system.GetInputPort("load_pressure").FixValue(context, pressure)
    if context.num_continuous_states():
        context.SetContinuousState([1e-3 * speed])
    return context


def output(pump, name, **values):
    return pump.GetOutputPort(name).Eval(pump_at(pump, **values))[0]


def acceleration(pump, **values):
    return 1e3 * pump.EvalTimeDerivatives(pump_at(pump, **values)).CopyToVector()[0]


def response(pump, command, times, **values):
    """Speeds of the motor at the times."""
    simulator = Simulator(pump, pump_at(pump, command=command, **values))
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    simulator.get_mutable_integrator().set_maximum_step_size(1e-3)
    speeds = []
    for time in times:
        simulator.AdvanceTo(time)
        speeds.append(pump.GetOutputPort("motor_speed").Eval(simulator.get_context())[0])
    return np.array(speeds)


def cylinder_at(system, *, flow=0.0, force=None, state=None):
    context = system.CreateDefaultContext()
    system.GetInputPort("load_flow").FixValue(context, flow)
    if force is not None:
        system.GetInputPort("load_force").FixValue(context, force)
    if state is not None:
        context.SetContinuousState(state)
    return context
