"""Tables of the signals of the closed loop, with their output ports and columns in a run.

A new signal needs an output port of a leaf system and an entry in `SIGNALS`. A signal of the plant
needs an entry in `PLANT_OUTPUTS` or `OPTIONAL_OUTPUTS` too, and a signal of the controller an entry
in `CONTROLLER_SIGNALS`. A signal that not every scenario has needs an entry in `NEEDED_SETTINGS`.
"""

from __future__ import annotations

from collections.abc import Sequence

# In the order of the columns of signals.csv.
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
    "desired_torque": ("desired_torque_n_m",),
    "target_velocity": ("target_velocity_units",),
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
    "bypass_opening": ("bypass_opening",),
    "motor_current": ("motor_current_a",),
    "motor_voltage": ("motor_voltage_v",),
    "motor_temperatures": ("winding_temperature_degc", "case_temperature_degc"),
    "measured_force": ("measured_force_n", "measured_force_age_s"),
    "wearer_motion": ("wearer_angle_rad", "wearer_rate_rad_s"),
    "interaction_torque": ("interaction_torque_n_m",),
    "interaction_power": ("power_of_wearer_w", "power_into_exoskeleton_w"),
    "cuff_slip": ("cuff_slip_rad",),
    "biological_moment": ("biological_moment_n_m",),
    "active_faults": ("active_faults",),
    "residuals": (
        "range_residual_rad",
        "rate_residual_rad_s",
        "flow_residual_m",
        "load_cell_residual_n",
        "speed_residual_rad_s",
        "following_residual_rad",
    ),
    "safety_state": ("safety_state",),
    "safety_reason": ("safety_reason",),
}
"""Dictionary from each signal of the closed loop to the names of its columns in a run.

The name of a column ends with the unit, except for a quantity without unit: ``bypass_opening``,
``active_faults``, ``safety_state`` and ``safety_reason``. ``target_velocity_units`` is in velocity
units of the bus.
"""

PLANT_OUTPUTS = {
    "knee": ("knee_angle", "encoder_angle", "moment_arm", "icr"),
    "cylinder": ("rod_extension", "rod_velocity", "rod_state", "load_pressure", "rod_force"),
    "motor": ("motor_speed", "load_flow", "shaft_torque", "shaft_power", "hydraulic_power"),
}
"""For each subsystem of every plant, the names of its output ports that the plant exports.

The output ports of the plant have the same names. `OPTIONAL_OUTPUTS` has the output ports that only
some plants have.
"""

OPTIONAL_OUTPUTS = {
    "full_order": ("cylinder", ("chamber_pressures", "makeup_flow", "relief_flow")),
    "bypass": ("bypass", ("bypass_opening",)),
    "motor": ("motor", ("motor_current", "motor_voltage")),
    "thermal": ("temperature", ("motor_temperatures",)),
}
"""For each part of `PlantParameters` that can be left out: a subsystem and names of output ports.

If the plant has the part, it also exports these output ports of the subsystem.
"""

PROTECTION_OUTPUTS = ("residuals", "safety_state", "safety_reason")
"""Names of the output ports that a controller with protection has."""

NEEDED_SETTINGS = {
    **dict.fromkeys(
        ("wearer_motion", "interaction_torque", "interaction_power", "cuff_slip"),
        "wearer.kind = leg",
    ),
    "measured_force": "wearer.kind = leg or controller.kind = torque",
    "biological_moment": "wearer.moment",
    "desired_torque": "controller.kind = torque",
    **{
        name: f"plant.{option} = true"
        for option, (_, names) in OPTIONAL_OUTPUTS.items()
        for name in names
    },
    "target_velocity": "bus.kind = cia402",
    "active_faults": "faults",
    **dict.fromkeys(PROTECTION_OUTPUTS, "protection"),
}
"""Dictionary from a signal that not every scenario has to the setting that the signal needs.

Error messages show the text of the setting to a user who asks for a signal that is missing. A
signal that is not listed here exists in every scenario, or depends on the kind of controller.
"""

CONTROLLER_SIGNALS = frozenset(
    ("measured_knee_angle", "measured_rod_extension", "rod_reference", "estimated_state")
).union(("sliding_variable", "desired_torque"), PROTECTION_OUTPUTS)
"""Names of the `SIGNALS` that are output ports of the controller."""


def columns(signals: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the columns that a run logs for ``signals``, in order."""
    return tuple(column for signal in signals for column in SIGNALS[signal])
