"""The simple loop (no load, PID, no quantizer) as plain functions that every peer calls.

``p`` are the parameters of `hand_written`, ``xp`` the module of elementary functions. Continuous
states as in kneexo, of order one: motor speed in krad/s, rod extension in m, its velocity in m/s,
load pressure in MPa.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

FLOATS = SimpleNamespace(
    **{name: getattr(math, name) for name in ("cos", "sin", "acos", "atan2", "sqrt")},
    minimum=min,
    maximum=max,
)
"""``xp`` for plain floats."""

EXTENSION, PRESSURE = 1, 3
PA_PER_MPA = 1e6


def clip(value: Any, limit: float, xp: Any) -> Any:
    """Value within ±limit."""
    return xp.minimum(xp.maximum(value, -limit), limit)


def polynomial(coefficients: Any, t: Any) -> Any:
    """Horner's rule, highest power first."""
    value = coefficients[0]
    for coefficient in coefficients[1:]:
        value = value * t + coefficient
    return value


def derivatives(p: Any, x: Any, command: Any, xp: Any = FLOATS) -> list[Any]:
    """Rates of motor, rod and oil at a held motor speed command in rad/s."""
    speed, _, velocity, pressure = 1e3 * x[0], x[1], x[2], PA_PER_MPA * x[3]
    limited = clip(command, p.motor_speed_limit_rad_s, xp)
    leakage = p.motor_leakage_m3_per_s_pa + p.cylinder_leakage_m3_per_s_pa
    flow = p.motor_displacement_m3_per_rad * speed / p.motor_gear_ratio - leakage * pressure
    stiffness = 4.0 * p.cylinder_bulk_modulus_pa / p.cylinder_total_volume_m3
    acceleration = (limited - speed) / p.motor_lag_s
    force = (
        p.cylinder_mean_area_m2 * pressure
        - p.cylinder_damping_n_s_per_m * velocity
        - p.cylinder_stiffness_n_per_m * x[1]
    )
    return [
        1e-3 * clip(acceleration, p.motor_acceleration_limit_rad_s2, xp),
        velocity,
        force / p.cylinder_mass_kg,
        stiffness * (flow - p.cylinder_mean_area_m2 * velocity) / PA_PER_MPA,
    ]


def measured_angle(p: Any, extension: Any, xp: Any = FLOATS) -> Any:
    """Knee angle that the controller computes from the encoder (Eq. 3–7), from the rod."""
    fit = (xp.sqrt(p.knee_dead_centre_m - extension) - p.knee_centre) / p.knee_half_width
    theta_4 = polynomial(p.knee_encoder.tolist(), fit) + p.coordinates_offset_rad
    a_2, a_3, a_4 = p.coordinates_a_2_m, p.coordinates_a_3_m, p.coordinates_a_4_m
    c_1 = p.coordinates_o_b_x_m - p.coordinates_o_a_x_m + a_4 * xp.cos(theta_4)
    c_2 = p.coordinates_o_b_y_m - p.coordinates_o_a_y_m + a_4 * xp.sin(theta_4)
    squares = c_1 * c_1 + c_2 * c_2
    cosine = (a_2 * a_2 - a_3 * a_3 - squares) / (2.0 * a_3 * xp.sqrt(squares))
    angle = xp.atan2(-c_2, -c_1) + p.coordinates_eq6_sign * xp.acos(cosine)
    angle = angle + p.coordinates_phi_rad
    return xp.atan2(xp.sin(angle), xp.cos(angle))


def reference_angle(p: Any, t: Any, xp: Any = FLOATS) -> Any:
    """Knee angle wanted at t."""
    phase = 2.0 * math.pi * p.reference_frequency_hz * t
    return p.reference_mean_rad - p.reference_amplitude_rad * xp.cos(phase)


def pid(p: Any, z: Any, error: Any, xp: Any = FLOATS) -> tuple[Any, list[Any]]:
    """Command in rad/s, and the next state (integral, filtered error) from the present one."""
    share = 1.0 - math.exp(-p.sample_time_s / p.controller_filter_s)
    filtered = z[1] + share * (error - z[1])
    slope = (error - filtered) / p.controller_filter_s
    rate = p.controller_proportional_per_s * filtered + z[0] + p.controller_derivative * slope
    per_rate = -p.controller_speed_gain_rad_per_m * p.controller_moment_arm_m
    command = clip(per_rate * rate, p.controller_command_limit_rad_s, xp)
    excess = (command / per_rate - rate) / p.controller_anti_windup_s
    integral = z[0] + p.sample_time_s * (p.controller_integral_per_s2 * error + excess)
    return command, [integral, filtered]


def update(p: Any, t: Any, x: Any, z: Any, xp: Any = FLOATS) -> tuple[Any, list[Any]]:
    """Command and next state of the controller at a sample."""
    error = reference_angle(p, t, xp) - measured_angle(p, x[EXTENSION], xp)
    return pid(p, z, error, xp)


def start(p: Any) -> tuple[list[float], list[float]]:
    """States of plant and controller at t = 0, before the first sample."""
    error = reference_angle(p, 0.0) - measured_angle(p, p.cylinder_start_m)
    return [0.0, p.cylinder_start_m, 0.0, p.cylinder_start_pa / PA_PER_MPA], [0.0, error]
