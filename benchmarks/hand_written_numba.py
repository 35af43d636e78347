"""The closed loop of `complete_model.c` once more, written by hand for numba."""

# Everything inline in two functions, states in scalars: what numba makes the fastest code from.

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

_options = {"error_model": "numpy", "fastmath": {"contract"}, "forceinline": True}


@njit(**_options)
def clip(value: float, limit: float) -> float:
    """Value within ±limit."""
    return -limit if value < -limit else limit if value > limit else value


@njit(**_options)
def polynomial(coefficients: Any, t: float) -> float:
    """Horner's rule, highest power first."""
    value = coefficients[0]
    for i in range(1, coefficients.size):
        value = value * t + coefficients[i]
    return value


@njit(**_options)
def differentiated(coefficients: Any) -> Any:
    """Coefficients of the derivative."""
    result = coefficients[:-1].copy()
    for i in range(result.size):
        result[i] *= result.size - i
    return result


@njit(**_options)
def fit_argument(p: Any, extension: float) -> float:
    """Argument of the polynomials of the knee."""
    root = math.sqrt(p.knee_dead_centre_m - extension)
    return (root - p.knee_centre) / p.knee_half_width


@njit(**_options)
def measured_angle(p: Any, fit: float) -> float:
    """Knee angle from the encoder by Eq. 3–7."""
    reading = polynomial(p.knee_encoder, fit)
    count = p.encoder_resolution_rad
    if count != 0.0:
        reading = math.floor(reading / count) * count
    theta_4 = reading + p.coordinates_offset_rad
    a_2, a_3, a_4 = p.coordinates_a_2_m, p.coordinates_a_3_m, p.coordinates_a_4_m
    c_1 = p.coordinates_o_b_x_m - p.coordinates_o_a_x_m + a_4 * math.cos(theta_4)
    c_2 = p.coordinates_o_b_y_m - p.coordinates_o_a_y_m + a_4 * math.sin(theta_4)
    squares = c_1 * c_1 + c_2 * c_2
    cosine = (a_2 * a_2 - a_3 * a_3 - squares) / (2.0 * a_3 * math.sqrt(squares))
    angle = math.atan2(-c_2, -c_1) + p.coordinates_eq6_sign * math.acos(cosine)
    angle += p.coordinates_phi_rad
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@njit(**_options)
def reference(p: Any, t: float) -> tuple[float, float, float, float]:
    """Knee angle wanted at t, and three derivatives."""
    w = 2.0 * math.pi * p.reference_frequency_hz
    cosine = p.reference_amplitude_rad * math.cos(w * t)
    sine = p.reference_amplitude_rad * math.sin(w * t)
    return p.reference_mean_rad - cosine, w * sine, w * w * cosine, -w * w * w * sine


@njit(**_options)
def load_acceleration(p: Any, t: float, extension: float) -> float:
    """F_L/m of weight, constant torque and disturbance."""
    fit = fit_argument(p, extension)
    weight = p.load_segment_mass_kg * p.load_gravity_m_s2 * p.load_centre_of_mass_m
    tilt = p.load_thigh_inclination_rad - polynomial(p.knee_angle, fit)
    torque = weight * math.sin(tilt) + p.load_knee_torque_n_m
    force = torque / polynomial(p.knee_arm, fit) + p.load_disturbance_n
    if p.load_disturbance_amplitude_n != 0.0:
        wave = math.sin(2.0 * math.pi * p.load_disturbance_frequency_hz * t)
        force += p.load_disturbance_amplitude_n * wave
    return force / p.cylinder_mass_kg


@njit(**_options)
def sliding_mode_gains(p: Any) -> tuple[float, ...]:
    """Gains of observer and law that need computing only once."""
    dt = p.sample_time_s
    z = math.exp(-dt / p.estimator_time_constant_s)
    mass = p.controller_mass_estimate_kg
    hydraulic = 4.0 * p.controller_bulk_modulus_pa * p.controller_mean_area_m2
    hydraulic /= mass * p.controller_total_volume_m3
    stiff = hydraulic * p.controller_mean_area_m2
    return (
        1.0 - z * z * z,
        1.5 * (1.0 - z * z) * (1.0 - z) / dt,
        (1.0 - z) ** 3 / (dt * dt),
        p.controller_gear_ratio / (hydraulic * p.controller_displacement_m3_per_rad),
        stiff + p.controller_stiffness_n_per_m / mass,
        p.controller_damping_n_s_per_m / mass,
        p.controller_stiffness_uncertainty_n_per_m / mass + p.controller_area_uncertainty * stiff,
        p.controller_damping_uncertainty_n_s_per_m / mass,
        abs(1.0 - p.controller_gain_ratio),
        p.controller_load_rate_uncertainty_n_per_s / mass
        + p.controller_gain_ratio * p.controller_eta_m_s3,
    )


@njit(**_options)
def rates(p: Any, q: Any, loaded: bool, t: float, command: float, x: Any) -> Any:
    """Derivatives of motor speed, rod extension, velocity and load pressure."""
    speed, extension, velocity, pressure = x
    per_lag, per_speed, per_velocity, decay, push, damping, stiffness = q
    acceleration = push * pressure - damping * velocity - stiffness * extension
    if loaded:
        acceleration -= load_acceleration(p, t, extension)
    return (
        clip((command - speed) * per_lag, p.motor_acceleration_limit_rad_s2),
        velocity,
        acceleration,
        per_speed * speed - per_velocity * velocity - decay * pressure,
    )


@njit(**_options)
def along(x: Any, h: float, f: Any) -> Any:
    """X + h f."""
    return x[0] + h * f[0], x[1] + h * f[1], x[2] + h * f[2], x[3] + h * f[3]


@njit(**_options)
def closed_loop(p: Any, pid: bool, loaded: bool, steps: int, samples: int, record: Any) -> int:
    """Fill ``record`` (samples + 1, 2) with extension and pressure; see `complete_model.c`."""
    dt = p.sample_time_s
    h = dt / steps
    hydraulic = 4.0 * p.cylinder_bulk_modulus_pa / p.cylinder_total_volume_m3
    q = (
        1.0 / p.motor_lag_s,
        hydraulic * p.motor_displacement_m3_per_rad / p.motor_gear_ratio,
        hydraulic * p.cylinder_mean_area_m2,
        hydraulic * (p.motor_leakage_m3_per_s_pa + p.cylinder_leakage_m3_per_s_pa),
        p.cylinder_mean_area_m2 / p.cylinder_mass_kg,
        p.cylinder_damping_n_s_per_m / p.cylinder_mass_kg,
        p.cylinder_stiffness_n_per_m / p.cylinder_mass_kg,
    )
    x = (0.0, p.cylinder_start_m, 0.0, p.cylinder_start_pa)
    start = measured_angle(p, fit_argument(p, x[1]))

    first = differentiated(p.table_1)
    second = differentiated(first)
    third = differentiated(second)
    gain_x, gain_v, gain_a, per_b, f_v, f_a, k_v, k_a, k_demand, k_0 = sliding_mode_gains(p)
    lambda_ = p.controller_lambda_per_s
    predicted_x, predicted_v, predicted_a = polynomial(p.table_1, start), 0.0, 0.0

    share = 1.0 - math.exp(-dt / p.controller_filter_s)
    per_rate = -p.controller_speed_gain_rad_per_m * p.controller_moment_arm_m
    integral, filtered = 0.0, reference(p, 0.0)[0] - start

    for sample in range(samples + 1):
        t = sample * dt
        record[sample, 0], record[sample, 1] = x[1], x[3]
        fit = fit_argument(p, x[1])
        flexion = polynomial(p.knee_angle, fit)
        if not (
            0.0 <= x[1] <= p.cylinder_stroke_m
            and p.knee_flexion_min_rad - p.knee_overshoot_rad <= flexion
            and flexion <= p.knee_flexion_max_rad + p.knee_overshoot_rad
            and math.isfinite(x[3])
        ):
            return sample
        if sample == samples:
            break
        angle = measured_angle(p, fit)
        angle_d, rate_d, acceleration_d, jerk_d = reference(p, t)
        if pid:
            error = angle_d - angle
            filtered += share * (error - filtered)
            rate = p.controller_proportional_per_s * filtered + integral
            rate += p.controller_derivative * (error - filtered) / p.controller_filter_s
            command = clip(per_rate * rate, p.controller_command_limit_rad_s)
            if p.controller_integral_per_s2 > 0.0:
                excess = (command / per_rate - rate) / p.controller_anti_windup_s
                integral += dt * (p.controller_integral_per_s2 * error + excess)
        else:
            innovation = polynomial(p.table_1, angle) - predicted_x
            rod = predicted_x + gain_x * innovation
            v = predicted_v + gain_v * innovation
            a = predicted_a + gain_a * innovation
            predicted_x = rod + dt * (v + 0.5 * dt * a)
            predicted_v, predicted_a = v + dt * a, a
            x_1, x_2, x_3 = (
                polynomial(first, angle_d),
                polynomial(second, angle_d),
                polynomial(third, angle_d),
            )
            e = rod - polynomial(p.table_1, angle_d)
            e_1 = v - x_1 * rate_d
            e_2 = a - (x_2 * rate_d * rate_d + x_1 * acceleration_d)
            jerk = x_3 * rate_d**3 + 3.0 * x_2 * rate_d * acceleration_d + x_1 * jerk_d
            s = e_2 + 2.0 * lambda_ * e_1 + lambda_ * lambda_ * e
            demand = jerk - 2.0 * lambda_ * e_2 - lambda_ * lambda_ * e_1
            k = k_v * abs(v) + k_a * abs(a) + k_demand * abs(demand) + k_0
            unlimited = demand + f_v * v + f_a * a - k * clip(s / p.controller_phi_m_s2, 1.0)
            command = clip(unlimited * per_b, p.controller_command_limit_rad_s)
        command = clip(command, p.motor_speed_limit_rad_s)
        for i in range(steps):
            now = t + i * h
            k_1 = rates(p, q, loaded, now, command, x)
            k_2 = rates(p, q, loaded, now + 0.5 * h, command, along(x, 0.5 * h, k_1))
            k_3 = rates(p, q, loaded, now + 0.5 * h, command, along(x, 0.5 * h, k_2))
            k_4 = rates(p, q, loaded, now + h, command, along(x, h, k_3))
            x = (
                x[0] + h / 6.0 * (k_1[0] + 2.0 * (k_2[0] + k_3[0]) + k_4[0]),
                x[1] + h / 6.0 * (k_1[1] + 2.0 * (k_2[1] + k_3[1]) + k_4[1]),
                x[2] + h / 6.0 * (k_1[2] + 2.0 * (k_2[2] + k_3[2]) + k_4[2]),
                x[3] + h / 6.0 * (k_1[3] + 2.0 * (k_2[3] + k_3[3]) + k_4[3]),
            )
    return -1


def run_numba(p: Any, *, pid: bool, loaded: bool, steps: int, samples: int) -> Any:
    """Rod extension and load pressure (samples + 1, 2), by RK4."""
    record = np.empty((samples + 1, 2))
    failed = closed_loop(p, pid, loaded, steps, samples, record)
    if failed >= 0:
        raise RuntimeError(f"the numba program left its range at sample {failed}")
    return record
