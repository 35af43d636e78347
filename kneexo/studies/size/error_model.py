"""Closed forms of the tracking error of the sliding-mode controller.

The error has three causes: a wrong piston area, a motor with lag, and leakage.

Below the hydraulic resonance the oil is stiff, and the pump's flow determines the rod speed.
Notation, in which the numbers of equations are those of Lee et al. 2020:

- e = x − x_d: error of the rod extension x, whose reference is x_d. P_L: load pressure.
- s: sliding variable, with slope λ. Φ: width of the boundary layer |s| <= Φ. k: switching gain
  (Eq. 20–27).
- Ā: mean piston area, which the controller assumes. A_i: area of the loaded chamber.
- α: motor speed that a rod speed requires, divided by the value that the controller computes. If
  only the area is wrong, α is A_i/Ā.
- τ: delay from a command to the motor speed, τ = τ_m + T/2 + n T. τ_m is the lag of the motor, T
  the sample time for which a command is held, and n the latency of the bus in samples.
- ω̂: hydraulic natural frequency, ω̂² = 4β_eĀ²/(m̂V_t), with the bulk modulus β_e, the estimated
  mass m̂ and the total volume V_t. κ = k/(Φ ω̂²).
- C_t: leakage coefficient of pump and cylinder.

Inside the boundary layer Eq. 27 gives

    α (ẋ + τ ẍ) + C_t P_L/Ā = ẋ − κ s,  s = (d/dt + λ)² e.

The omitted term ṡ/ω̂² is small beside κ s at frequencies below k/Φ. With p = d/dt,

    [κ (p + λ)² − (1 − α) p + α τ p²] e = [(1 − α) p − α τ p²] x_d − C_t P_L/Ā.

For a slow reference the left side is κ λ² e, so that

    e ≈ ω̂²/(λ² k/Φ) · [(1 − A_i/Ā) ẋ_d − α τ ẍ_d − C_t P_L/Ā].

The left side also decides stability. A loaded area below Ā acts as negative damping. The loop is
stable only if 2λ k/Φ > ω̂² (1 − α). With the default observer and λ = 20 1/s the loop requires
1.4 times this k/Φ (``docs/controllers.md``: 1.37 times with the chamber of P_2 loaded).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from kneexo.analysis.linear.plant_linearization import Complex, frequency_array
from kneexo.common.result import Result
from kneexo.errors import ParameterError
from kneexo.parameters import CylinderParameters, Scenario
from kneexo.studies.hardware import sliding_mode

Chamber = Literal["cap", "rod_side"]
"""Name of the chamber of the cylinder that carries the load."""


@dataclass(frozen=True, repr=False)
class ErrorModel(Result):
    """Closed form of the rod's error e = x − x_d, inside the boundary layer and the speed limit.

    `error_model` makes it. The docstring of `kneexo.studies.size.error_model` defines the symbols.
    """

    lambda_per_s: float
    slope_per_s: float
    """k/Φ: switching gain divided by the width of the boundary layer."""
    stiffness_per_s2: float
    """ω̂²: square of the hydraulic natural frequency, computed from the nominal plant."""
    speed_ratio: float
    """α: motor speed that a rod speed requires, divided by the controller's value of it."""
    delay_s: float
    """τ: delay from a command to the motor speed."""
    leakage_m_per_s_pa: float
    """C_t/Ā: loss of rod speed in m/s by leakage, per Pa of load pressure."""

    @property
    def gain_s(self) -> float:
        """ω̂²/(λ² k/Φ): factor from an error of the rod speed in m/s to the error e in m."""
        return self.stiffness_per_s2 / (self.lambda_per_s**2 * self.slope_per_s)

    @property
    def damping_s(self) -> float:
        """2λκ − (1 − α) with κ = k/(Φ ω̂²): damping, the factor of de/dt in the loop's equation.

        λ is the slope of the sliding variable, k/Φ is ``slope_per_s``, ω̂² is ``stiffness_per_s2``
        and α is ``speed_ratio``. The error e diverges unless the damping is positive.
        """
        kappa = self.slope_per_s / self.stiffness_per_s2
        return 2.0 * self.lambda_per_s * kappa - (1.0 - self.speed_ratio)

    @property
    def stable(self) -> bool:
        """Whether `damping_s` is positive; sampling, observer and oil are neglected."""
        return self.damping_s > 0.0

    def error_m(self, velocity: Any, acceleration: Any, load_pressure_pa: Any = 0.0) -> Any:
        """Return the error e in m for a slow reference x_d.

        ``velocity`` in m/s and ``acceleration`` in m/s² are derivatives of x_d.
        ``load_pressure_pa`` is P_L.
        """
        missing_speed = (1.0 - self.speed_ratio) * velocity
        missing_speed -= self.speed_ratio * self.delay_s * acceleration
        missing_speed -= self.leakage_m_per_s_pa * load_pressure_pa
        return self.gain_s * missing_speed

    def response(self, frequencies_hz: ArrayLike) -> Complex:
        """Return the complex response e/x_d to a sine in x_d, (n,), at frequencies in Hz, (n,)."""
        p = 2j * np.pi * frequency_array(frequencies_hz)
        kappa = self.slope_per_s / self.stiffness_per_s2
        driving = (1.0 - self.speed_ratio) * p - self.speed_ratio * self.delay_s * p**2
        return np.asarray(driving / (kappa * (p + self.lambda_per_s) ** 2 - driving))


def error_model(
    scenario: Scenario = Scenario(),
    *,
    loaded_chamber: Chamber | None = None,
    rod_speed_m_s: float = 0.0,
) -> ErrorModel:
    """Return the closed form of the error for a scenario with the sliding-mode controller.

    Parameters
    ----------
    scenario
        Plant, nominal plant of the controller, controller and bus.
    loaded_chamber
        Chamber that carries the load, for a plant of full order. None for a plant of reduced order.
    rod_speed_m_s
        Rod speed at which k is evaluated. The speed changes k only if the controller's
        uncertainty of area, stiffness or damping is above zero.

    The term |1 − β||x⃛_d − 2λë − λ²ė| of k is neglected, with β of Eq. 23. Raises `ParameterError`
    if the controller is no sliding-mode controller or ``loaded_chamber`` does not match the order
    of the plant.
    """
    law, plant, believed_plant = sliding_mode(scenario), scenario.plant, scenario.believed_plant
    believed = believed_plant.cylinder
    stiffness_per_s2 = 4.0 * believed.bulk_modulus_pa * believed.mean_area_m2**2
    stiffness_per_s2 /= law.mass_estimate_kg * believed.total_volume_m3
    # k = β η + the bounds of what the controller does not know, Eq. 27, with β of Eq. 23.
    k = law.gain_ratio * law.eta_m_s3 + law.area_uncertainty * stiffness_per_s2 * rod_speed_m_s
    force_rate = law.stiffness_uncertainty_n_per_m * rod_speed_m_s
    force_rate += law.load_rate_uncertainty_n_per_s
    k += force_rate / law.mass_estimate_kg
    area_m2 = _area_m2(plant.cylinder, loaded_chamber, plant.full_order is not None)
    pump, believed_pump = plant.pump, believed_plant.pump
    speed_ratio = area_m2 / believed.mean_area_m2
    speed_ratio *= pump.gear_ratio / believed_pump.gear_ratio
    speed_ratio *= believed_pump.displacement_m3_per_rad / pump.displacement_m3_per_rad
    delay_s = 0.0 if plant.ideal_motor else pump.lag_s
    if not law.continuous:
        delay_s = (0.5 + scenario.bus.latency_samples) * law.sample_time_s + delay_s
    return ErrorModel(
        lambda_per_s=law.lambda_per_s,
        slope_per_s=k / law.phi_m_s2,
        stiffness_per_s2=stiffness_per_s2,
        speed_ratio=speed_ratio,
        delay_s=delay_s,
        leakage_m_per_s_pa=plant.leakage_m3_per_s_pa / believed.mean_area_m2,
    )


def _area_m2(cylinder: CylinderParameters, loaded: Chamber | None, full_order: bool) -> float:
    """Return the area in m² of the loaded chamber, or the mean piston area in reduced order.

    Raises `ParameterError` unless ``loaded`` names a chamber in full order and is None in reduced
    order.
    """
    if full_order != (loaded is not None):
        raise ParameterError(
            f"loaded_chamber = {loaded}: must be 'cap' or 'rod_side' in full order, and None in "
            f"reduced order, whose area is the mean one"
        )
    if loaded is None:
        return cylinder.mean_area_m2
    return cylinder.cap_area_m2 if loaded == "cap" else cylinder.rod_side_area_m2
