"""The signals of the closed loop: names of ports, columns of the log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from kneexo.diagrams.controller import controller_outputs
from kneexo.diagrams.plant import FULL_ORDER_OUTPUTS
from kneexo.errors import ParameterError
from kneexo.parameters import Scenario

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
    if scenario.bus.kind != "cia402":
        missing.add("target_velocity")
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
