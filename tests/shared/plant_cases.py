"""Parameters of plants, their states and outputs, for several tests of the plant."""

import math

from kneexo.parameters import BldcPumpParameters, CylinderParameters, PlantParameters

# Lee et al. 2020, Tables 2 and 3; lag and leakage are this project's assumptions.
PAPER = {
    "lag": 0.010,
    "gear": 6.0,
    "displacement": 0.8e-6 / (2.0 * math.pi),
    "c_im": 2e-13,
    "c_em": 0.0,
    "c_l": 0.0,
    "area": math.pi / 4.0 * (0.020**2 - 0.5 * 0.010**2),
    "volume": 41_233e-9,
    "bulk": 1.72e9,
    "mass": 1.6,
    "damping": 0.05,
    "stiffness": 0.0,
}


# Soft oil, a spring and every leakage, so that no term of Eq. 13, 15, 16 can hide.
SOFT = PAPER | {
    "lag": 0.020,
    "gear": 4.0,
    "c_im": 3e-12,
    "c_em": 8e-12,
    "c_l": 5e-12,
    "bulk": 5e7,
    "mass": 1.4,
    "damping": 40.0,
    "stiffness": 3000.0,
}


def plant_parameters(n):
    return PlantParameters(
        pump=BldcPumpParameters(
            lag_s=n["lag"],
            gear_ratio=n["gear"],
            displacement_m3_per_rad=n["displacement"],
            internal_leakage_m3_per_s_pa=n["c_im"],
            external_leakage_m3_per_s_pa=n["c_em"],
        ),
        cylinder=CylinderParameters(
            total_volume_m3=n["volume"],
            bulk_modulus_pa=n["bulk"],
            mass_kg=n["mass"],
            damping_n_s_per_m=n["damping"],
            stiffness_n_per_m=n["stiffness"],
            leakage_m3_per_s_pa=n["c_l"],
        ),
    )


def by_name(system, name, context):
    """Value of an output port, a scalar where it has one element."""
    value = system.GetOutputPort(name).Eval(context)
    return value[0] if value.size == 1 else value


def with_command(plant, command=0.0):
    context = plant.CreateDefaultContext()
    plant.GetInputPort("motor_speed_command").FixValue(context, [command])
    return context


def set_state(plant, context, *, speed=0.0, extension=0.1, velocity=0.0, pressure=0.0):
    """Set the continuous state from SI values; ``context`` is the root's."""
    motor = plant.GetSubsystemByName("motor").GetMyMutableContextFromRoot(context)
    cylinder = plant.GetSubsystemByName("cylinder").GetMyMutableContextFromRoot(context)
    motor.SetContinuousState([1e-3 * speed])
    cylinder.SetContinuousState([extension, velocity, 1e-6 * pressure])
