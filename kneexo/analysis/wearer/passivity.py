"""Largest gains of the torque controller with which the knee is passive, as closed forms.

The rod's flow balance has the admittance Y(s) = s/k_q + C_t + k_p + k_i/s, with k_q = 4 β_e/V_t.
The gains k = K D_m Ā/gear are flows per pressure. The leakage C_t is the damping. The output
impedance is Z ≈ r² (Ā² (1 − γ)/Y + m s), with lags in γ, k_p and k_i. This formula leaves out the
damping B of the cylinder, which control reduces. The limits below follow from Re Z ≥ 0 at low and
at high frequency. The limits are necessary for a passive port, but not sufficient (see
`kneexo.analysis.OutputImpedance`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from kneexo.analysis.wearer.impedance import torque_controller
from kneexo.common.result import Result
from kneexo.parameters import Scenario


@dataclass(frozen=True, repr=False)
class PassivityLimits(Result):
    """Largest gains of a torque controller with which the knee can be passive.

    Passive means that the real part of the impedance Z at the cuff is not negative. The gains K_p,
    K_i and the feedforward γ are those of `TorqueController`. With the motor's displacement, k_p
    and k_i are flows per pressure, as is the leakage C_t (see `kneexo.analysis.wearer.passivity`).
    T is the sample time, τ_F the lag of the load cell, and τ_m the lag of motor and bus latency.

    ``integral_rad_s2_per_n`` is the largest K_i for the scenario's K_p and γ. At low frequency Re Z
    ≥ 0 requires (1 − γ)(C_t + k_p) ≥ k_i (τ_m + γ T/2 + (1 − γ) τ_F). The estimator ``difference``
    lags by T/2, so that γ T stands in place of γ T/2. The tracking observer follows a constant
    acceleration without lag. The formula leaves out the leak of the integral. The lag of the hold,
    T/2, does not act on the integral, because its sum includes the present sample.

    ``proportional_rad_s_per_n`` is the largest K_p without integral and feedforward. At high
    frequency Re Z ≥ 0 requires k_p ≤ C_t/max(−Re H_F), where H_F is the lag of hold, motor and load
    cell, H_F = (1 − e^{−jωT})/(jωT (1 + jωτ_m)(1 + jωτ_F)).
    """

    integral_rad_s2_per_n: float
    proportional_rad_s_per_n: float


def passivity_limits(scenario: Scenario) -> PassivityLimits:
    """Return the largest passive gains of the torque controller of a scenario, in reduced order.

    Raises `ParameterError` if the controller is of another kind.
    """
    law, plant = torque_controller(scenario, "passivity_limits"), scenario.plant
    pump, period = plant.pump, law.sample_time_s
    admittance_per_gain = (
        pump.displacement_m3_per_rad / pump.gear_ratio * plant.cylinder.mean_area_m2
    )
    leakage = plant.leakage_m3_per_s_pa / admittance_per_gain  # as a gain, (rad/s)/N
    motor = 0.0 if plant.ideal_motor else pump.lag_s
    delay, cell = scenario.bus.latency_samples * period, scenario.load_cell.filter_s
    share = law.speed_feedforward
    hold_and_estimate = period if scenario.estimator.kind == "difference" else 0.5 * period
    lag = motor + delay + share * hold_and_estimate + (1.0 - share) * cell
    integral = (1.0 - share) * (leakage + law.proportional_rad_s_per_n) / lag

    def real_part(angle: float) -> float:
        """Return the real part of H_F (hold, motor and load cell) at ωT = ``angle``."""
        s = 1j * angle / period
        hold = (1.0 - np.exp(-1j * angle)) / (1j * angle)
        return float((hold * np.exp(-s * delay) / ((1.0 + s * motor) * (1.0 + s * cell))).real)

    # A grid before the search, because hold and lags can give several minima.
    angles = np.linspace(1e-3, np.pi, 2000)
    least = int(np.argmin([real_part(angle) for angle in angles]))
    bounds = angles[max(least - 1, 0)], angles[min(least + 1, angles.size - 1)]
    minimum = scipy.optimize.minimize_scalar(real_part, bounds=bounds, method="bounded")
    return PassivityLimits(integral, leakage / max(-float(minimum.fun), 0.0))
