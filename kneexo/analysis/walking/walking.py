"""Walking with a measured gait: requirements on the actuator and tracking of the closed loop.

`walking_demand` computes the required speed and power of the motor from the motion of the knee, by
inverse dynamics without a controller. `walking_metrics` simulates the closed loop. The scenario
defines the load: the shank's weight and a constant torque of the wearer. There are no ground
reaction forces.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import scipy

from kneexo.analysis.frequency.bandwidth import rod_of
from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.analysis.signals import to_rpm
from kneexo.analysis.tracking.tracking import TRACKING_SIGNALS, run_metrics
from kneexo.common.result import Array, Result, data_frame
from kneexo.errors import ParameterError, failure_noted
from kneexo.parameters import KneeLoadParameters, Scenario, gait_reference
from kneexo.parameters.paths import changed
from kneexo.parameters.task.gait import gait_start_percent
from kneexo.simulation import needs_runs, simulate
from kneexo.systems.knee_load import load_force

WALKING_METRICS = (
    "max_error_deg",
    "rms_error_deg",
    "mean_command_change_rpm",
    "saturated_share",
    "peak_motor_speed_rpm",
    "peak_motor_acceleration_rad_s2",
    "peak_pressure_mpa",
    "peak_shaft_power_w",
    "delivered_energy_j",
    "net_energy_j",
)
"""Names of the numbers that `walking_metrics` returns. Energies are per stride."""

_SAMPLES = 1000  # samples of a stride
_HARMONICS = 40  # harmonics of a stride; higher ones are rounding errors of the gait data
_ANGLE_STEP = 1e-5  # rad, step of a central difference; relative error 1e-10 of the moment arm


@dataclass(frozen=True, repr=False)
class WalkingDemand(Result):
    """Signals that the actuator must provide from one heel contact to the next, each (n,).

    Limits and lag of pump and motor are neglected.
    """

    frequency_hz: float
    cycle_percent: Array
    knee_angle_deg: Array
    knee_rate_deg_s: Array
    rod_speed_m_s: Array
    rod_acceleration_m_s2: Array
    rod_force_n: Array
    load_pressure_pa: Array
    load_flow_m3_s: Array
    motor_speed_rad_s: Array
    motor_acceleration_rad_s2: Array
    shaft_power_w: Array

    def to_dataframe(self) -> Any:
        """Return the signals as a `pandas.DataFrame` with the index ``cycle_percent``.

        Raises `PackageError` without pandas.
        """
        columns = {field.name: getattr(self, field.name) for field in fields(self)[1:]}
        return data_frame(columns, "cycle_percent")

    def peaks(self) -> dict[str, float]:
        """Return the largest |value| of each signal, the mean |motor acceleration| and energies.

        The energies are work of the motor on the pump in one stride. ``net_energy_j`` includes
        negative power, from pump to motor. ``delivered_energy_j`` leaves it out.
        """
        time = self.cycle_percent / (100.0 * self.frequency_hz)
        peaks = {
            f"peak_{field.name}": float(np.max(np.abs(getattr(self, field.name))))
            for field in fields(self)
            if field.name not in ("frequency_hz", "cycle_percent")
        }
        return peaks | {
            "mean_motor_acceleration_rad_s2": float(
                np.mean(np.abs(self.motor_acceleration_rad_s2))
            ),
            **_energies(time, self.shaft_power_w, 1),
        }


def _energies(time_s: Array, power_w: Array, cycles: int) -> dict[str, float]:
    """Return the work of the motor on the pump per cycle.

    ``net_energy_j`` includes negative power, and ``delivered_energy_j`` leaves it out.
    """
    return {
        "delivered_energy_j": float(np.trapezoid(np.maximum(power_w, 0.0), time_s)) / cycles,
        "net_energy_j": float(np.trapezoid(power_w, time_s)) / cycles,
    }


def walking_demand(scenario: Scenario, frequency_hz: float = 1.0) -> WalkingDemand:
    """Compute motor speed, pressure and power for the measured gait by inverse dynamics.

    The function solves Eq. 16, 15 and 13 of Lee et al. 2020, with their symbols, in this order:

    P_L = (m a + B v + K x + F_L)/Ā, Q_L = Ā v + C_L P_L + V_t/(4β_e) dP_L/dt,
    ω_m = gear (Q_L + (C_im + C_em/2) P_L)/D_m. A scenario of full order is treated as reduced
    order. If the load has an inertia I about the knee, −I d²θ_p/dt²/r replaces the inertial force
    m a, where r is the moment arm.

    Raises `ParameterError` when the frequency is out of range or the gait leaves the range of
    motion.
    """
    plant = scenario.plant
    cylinder, pump = plant.cylinder, plant.pump
    reference = gait_reference(frequency_hz, 1)
    plant.knee.require_in_range(*reference.range_deg)
    knee = scipy.interpolate.CubicSpline(
        reference.times_s, np.radians(reference.angles_deg), bc_type="periodic"
    )
    period = 1.0 / frequency_hz
    # The stride starts at heel contact, the reference later, at the smallest flexion.
    time = np.linspace(0.0, period, _SAMPLES + 1)
    reference_time = time - 0.01 * gait_start_percent() * period
    angle, rate, acceleration = (knee(reference_time, order) for order in range(3))
    arm = moment_arm_m(scenario, angle)
    rod_speed = -arm * rate
    rod_acceleration = _rate(time, rod_speed)
    inertia = plant.knee_inertia_kg_m2
    inertial_force = cylinder.mass_kg * rod_acceleration
    if inertia is not None:
        inertial_force = -inertia * acceleration / arm
    force = inertial_force + _load_force(scenario, time, angle, arm)
    pressure = (
        force
        + cylinder.damping_n_s_per_m * rod_speed
        + cylinder.stiffness_n_per_m * rod_of(scenario, angle)
    ) / cylinder.mean_area_m2
    flow = (
        cylinder.mean_area_m2 * rod_speed
        + cylinder.leakage_m3_per_s_pa * pressure
        + cylinder.total_volume_m3 / (4.0 * cylinder.bulk_modulus_pa) * _rate(time, pressure)
    )
    per_revolution = pump.displacement_m3_per_rad / pump.gear_ratio
    motor_speed = (flow + pump.leakage_m3_per_s_pa * pressure) / per_revolution
    return WalkingDemand(
        frequency_hz=frequency_hz,
        cycle_percent=100.0 * time / period,
        knee_angle_deg=np.degrees(angle),
        knee_rate_deg_s=np.degrees(rate),
        rod_speed_m_s=rod_speed,
        rod_acceleration_m_s2=rod_acceleration,
        rod_force_n=force,
        load_pressure_pa=pressure,
        load_flow_m3_s=flow,
        motor_speed_rad_s=motor_speed,
        motor_acceleration_rad_s2=_rate(time, motor_speed),
        shaft_power_w=per_revolution * pressure * motor_speed,
    )


def linear_error_deg(scenario: Scenario, demand: WalkingDemand) -> Array:
    """Return the knee error in deg, (n,), that the linear loop predicts over a stride.

    The loop is linearized in the middle of the stride's range of angles. Limits of the motor are
    neglected. The response of the linear loop is applied to each harmonic of the rod's motion,
    because only the load makes the rod's response depend on the posture. Raises
    `LinearizationError` when the loop cannot be linearized.
    """
    angle = np.radians(demand.knee_angle_deg)
    middle = 0.5 * float(demand.knee_angle_deg.min() + demand.knee_angle_deg.max())
    loop = linearize_loop(scenario, knee_angle_deg=middle)
    harmonics = np.fft.rfft(rod_of(scenario, angle)[:-1])
    harmonics[_HARMONICS + 1 :] = 0.0
    orders = np.arange(1, _HARMONICS + 1)
    harmonics[1 : _HARMONICS + 1] *= loop.output_response(orders * demand.frequency_hz) - 1.0
    harmonics[0] = 0.0
    error = np.fft.irfft(harmonics, angle.size - 1)
    return np.degrees(np.append(error, error[0]) / moment_arm_m(scenario, angle))


def moment_arm_m(scenario: Scenario, knee_angle_rad: Array) -> Array:
    """Return the moment arm −dx/dθ_p in m at knee angles in rad, by central differences."""
    before = rod_of(scenario, knee_angle_rad - _ANGLE_STEP)
    after = rod_of(scenario, knee_angle_rad + _ANGLE_STEP)
    return (before - after) / (2.0 * _ANGLE_STEP)


def _rate(time: Array, periodic: Array) -> Array:
    """Return the time derivative (n,) of a signal (n,) sampled over exactly one period."""
    closed = np.append(periodic[:-1], periodic[0])  # a periodic spline needs equal ends
    return np.asarray(scipy.interpolate.CubicSpline(time, closed, bc_type="periodic")(time, 1))


def _load_force(scenario: Scenario, time: Array, angle: Array, arm: Array) -> Array:
    """Return the load force F_L in N, (n,), that `KneeLoad` computes; zero without a load."""
    if not isinstance(scenario.plant.load, KneeLoadParameters):
        return np.zeros_like(time)
    samples = zip(angle, arm, time, strict=True)
    return np.array([load_force(scenario.plant.load, *values) for values in samples])


# ------------------------------------------------------------------------------ closed loop


@needs_runs
def walk(scenario: Scenario, frequency_hz: float = 1.0, cycles: int = 3) -> dict[str, Array]:
    """Simulate ``cycles`` strides; return ``time_s`` and signal columns after the first stride.

    The closed loop follows the measured gait with ``frequency_hz`` strides a second. Raises
    `ParameterError` for fewer than two ``cycles``. Also raises the errors of
    `kneexo.simulation.simulate`.
    """
    if cycles < 2:
        raise ParameterError(f"cycles = {cycles}: must be >= 2, the first of which is discarded")
    walking = scenario.model_copy(update={"reference": gait_reference(frequency_hz, cycles)})
    walking = changed(walking, {"simulation.duration_s": cycles / frequency_hz})
    run = simulate(walking, signals=(*TRACKING_SIGNALS, "motor_speed"))
    after_first = run.time_s >= 1.0 / frequency_hz - 1e-9
    signals = {name: values[after_first] for name, values in run.data.items()}
    return {"time_s": run.time_s[after_first]} | signals


@needs_runs
def walking_metrics(
    scenario: Scenario, frequency_hz: float = 1.0, cycles: int = 3
) -> dict[str, Any]:
    """Simulate walking by `walk` and return a dictionary of `WALKING_METRICS` and ``failure``.

    If the run fails, ``failure`` is the error message, and the metrics are nan. Otherwise
    ``failure`` is an empty text.
    """
    row: dict[str, Any] = dict.fromkeys(WALKING_METRICS, math.nan)
    with failure_noted(row):
        signals = walk(scenario, frequency_hz, cycles)
        row |= _metrics(scenario, signals, cycles - 1)
    return row


def _metrics(scenario: Scenario, signals: Mapping[str, Array], cycles: int) -> dict[str, float]:
    """Return the `WALKING_METRICS` of the signals of `walk`, which last ``cycles`` strides."""
    time, power, speed = signals["time_s"], signals["shaft_power_w"], signals["motor_speed_rad_s"]
    metrics = run_metrics(scenario, time, signals, settled_s=0.0)
    walking = {
        "peak_motor_speed_rpm": to_rpm(float(np.max(np.abs(speed)))),
        "peak_motor_acceleration_rad_s2": float(np.max(np.abs(np.diff(speed) / np.diff(time)))),
        **_energies(time, power, cycles),
    }
    values = asdict(metrics) | walking
    return {name: values[name] for name in WALKING_METRICS}
