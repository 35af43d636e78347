"""Why the sliding-mode loop errs: closed forms for a wrong piston area, a lagging motor, leakage.

Below its resonance the oil is stiff, so the rod moves as the pump does. Let α be the motor speed
that a rod speed takes, over what the controller believes (A_i/Ā when only the area is wrong), τ the
delay from a command to the speed, and κ = k/(Φ ω̂²) with ω̂² = 4β_eĀ²/(m̂V_t). Inside the boundary
layer Eq. 27 then reads

    α (ẋ + τ ẍ) + C_t P_L/Ā = ẋ − κ s,  s = (d/dt + λ)² e,  e = x − x_d;

what it leaves out, ṡ/ω̂², is small beside κ s below the frequency k/Φ. So, with p = d/dt,

    [κ (p + λ)² − (1 − α) p + α τ p²] e = [(1 − α) p − α τ p²] x_d − C_t P_L/Ā,

and for a reference that is slow beside the left side

    e ≈ ω̂²/(λ² k/Φ) · [(1 − A_i/Ā) ẋ_d − α τ ẍ_d − C_t P_L/Ā].

The delay is that of the motor, of the held command and of the bus: τ = τ_m + T/2 + n T. The left
side also says when there is such an error at all: a loaded area below Ā is negative damping, and
the loop is stable only with 2λ k/Φ > ω̂² (1 − α). With the default observer it takes 1.4 times as
much at λ = 20 1/s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from kneexo.analysis.hardware import sliding_mode
from kneexo.analysis.plant_linearization import Complex, frequency_array
from kneexo.analysis.signals import rms
from kneexo.errors import ParameterError
from kneexo.parameters import CylinderParameters, Scenario
from kneexo.result import Array, Result, axes_or_new
from kneexo.simulation import simulate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Chamber = Literal["cap", "rod_side"]
"""Which chamber carries the load."""


@dataclass(frozen=True, repr=False)
class ErrorModel(Result):
    """The error e of the rod in closed form, inside the boundary layer and the speed limit."""

    lambda_per_s: float
    slope_per_s: float
    """k/Φ."""
    stiffness_per_s2: float
    """ω̂², the square of the hydraulic frequency that the controller believes in."""
    speed_ratio: float
    """α: motor speed that a rod speed takes, over what the controller believes."""
    delay_s: float
    """τ: from a command to the motor's speed."""
    leakage_m_per_s_pa: float
    """C_t/Ā: rod speed lost per load pressure."""

    @property
    def gain_s(self) -> float:
        """ω̂²/(λ² k/Φ): error in m per m/s of rod speed that the command lacks."""
        return self.stiffness_per_s2 / (self.lambda_per_s**2 * self.slope_per_s)

    @property
    def damping_s(self) -> float:
        """2λκ − (1 − α): without this the loop itself diverges, however slow the reference."""
        kappa = self.slope_per_s / self.stiffness_per_s2
        return 2.0 * self.lambda_per_s * kappa - (1.0 - self.speed_ratio)

    @property
    def stable(self) -> bool:
        """Whether the stiff-oil loop is stable; sampling, observer and oil may still undo it."""
        return self.damping_s > 0.0

    def error_m(self, velocity: Any, acceleration: Any, load_pressure_pa: Any = 0.0) -> Any:
        """Error e for slow references, from velocity and acceleration of x_d, and P_L."""
        lacking = (1.0 - self.speed_ratio) * velocity
        lacking -= self.speed_ratio * self.delay_s * acceleration
        return self.gain_s * (lacking - self.leakage_m_per_s_pa * load_pressure_pa)

    def response(self, frequencies_hz: ArrayLike) -> Complex:
        """e/x_d at frequencies in Hz, (n,), without the approximation of a slow reference."""
        p = 2j * np.pi * frequency_array(frequencies_hz)
        kappa = self.slope_per_s / self.stiffness_per_s2
        driving = (1.0 - self.speed_ratio) * p - self.speed_ratio * self.delay_s * p**2
        return np.asarray(driving / (kappa * (p + self.lambda_per_s) ** 2 - driving))

    def slowness(self, frequency_hz: float) -> float:
        """How far the slow form overstates |e| at a frequency: its |e| over that of `response`."""
        p = 2j * np.pi * frequency_hz
        slow = self.error_m(p, p * p)
        return float(abs(slow / self.response(frequency_hz)[0]))


def error_model(
    scenario: Scenario = Scenario(),
    *,
    loaded_chamber: Chamber | None = None,
    rod_speed_m_s: float = 0.0,
) -> ErrorModel:
    """The closed form of a scenario with the sliding-mode controller.

    The full order needs the chamber that carries the load. ``rod_speed_m_s`` counts where k grows
    with the speed. The share |1 − β||x⃛_d − 2λë − λ²ė| of k is left out.

    Raises `ParameterError` for another controller, and for the full order without its chamber.
    """
    law, believed, plant = sliding_mode(scenario), scenario.believed_plant, scenario.plant
    oil = believed.cylinder
    stiffness = 4.0 * oil.bulk_modulus_pa * oil.mean_area_m2**2
    stiffness /= law.mass_estimate_kg * oil.total_volume_m3
    k = law.gain_ratio * law.eta_m_s3 + law.area_uncertainty * stiffness * rod_speed_m_s
    bounds = law.stiffness_uncertainty_n_per_m * rod_speed_m_s + law.load_rate_uncertainty_n_per_s
    k += bounds / law.mass_estimate_kg
    area = _area_m2(plant.cylinder, loaded_chamber, plant.full_order is not None)
    pump, believed_pump = plant.pump, believed.pump
    speed_ratio = area / oil.mean_area_m2
    speed_ratio *= pump.gear_ratio / believed_pump.gear_ratio
    speed_ratio *= believed_pump.displacement_m3_per_rad / pump.displacement_m3_per_rad
    held = 0.0 if law.continuous else (0.5 + scenario.bus.latency_samples) * law.sample_time_s
    return ErrorModel(
        lambda_per_s=law.lambda_per_s,
        slope_per_s=k / law.phi_m_s2,
        stiffness_per_s2=stiffness,
        speed_ratio=speed_ratio,
        delay_s=held + (0.0 if plant.ideal_motor else pump.lag_s),
        leakage_m_per_s_pa=(pump.leakage_m3_per_s_pa + plant.cylinder.leakage_m3_per_s_pa)
        / oil.mean_area_m2,
    )


def _area_m2(cylinder: CylinderParameters, loaded: Chamber | None, full_order: bool) -> float:
    """The area that moves the oil."""
    if full_order != (loaded is not None):
        raise ParameterError(
            f"loaded_chamber = {loaded}: must be 'cap' or 'rod_side' in full order, and None in "
            f"reduced order, whose area is the mean one"
        )
    if loaded is None:
        return cylinder.mean_area_m2
    return cylinder.cap_area_m2 if loaded == "cap" else cylinder.rod_side_area_m2


@dataclass(frozen=True, repr=False)
class ErrorComparison(Result):
    """Simulated and predicted error of the rod over the last part of a run, each (n,)."""

    model: ErrorModel
    time_s: Array
    simulated_m: Array
    predicted_m: Array

    @property
    def ratio(self) -> float:
        """Simulated over predicted error, root mean square."""
        return rms(self.simulated_m) / rms(self.predicted_m)

    @property
    def correlation(self) -> float:
        """Cosine of the angle between the two: 1 when they have one shape, −1 with wrong sign."""
        product = float(np.mean(self.simulated_m * self.predicted_m))
        return product / (rms(self.simulated_m) * rms(self.predicted_m))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Plot both errors over time."""
        ax = axes_or_new(ax)
        ax.plot(self.time_s, 1e3 * self.simulated_m, "C0", lw=2.5, alpha=0.6, label="simulated")
        ax.plot(self.time_s, 1e3 * self.predicted_m, "k--", lw=1, label="closed form")
        ax.set(xlabel="time (s)", ylabel="error of the rod (mm)")
        ax.legend()
        return ax


def compare_error(
    scenario: Scenario = Scenario(),
    *,
    loaded_chamber: Chamber | None = None,
    settled_s: float = 0.0,
) -> ErrorComparison:
    """Simulate a scenario, without its quantizers, and hold its error against the closed form.

    Compared from ``settled_s`` on, as the controller sees the rod (Eq. 10). Raises what
    `error_model` and the simulation raise.
    """
    model = error_model(scenario, loaded_chamber=loaded_chamber)
    run = simulate(
        scenario.without_quantizers(),
        signals=("measured_rod_extension", "rod_reference", "load_pressure"),
    )
    late = run.time_s >= settled_s - 1e-9
    predicted = model.error_m(
        run["rod_reference_velocity_m_s"],
        run["rod_reference_acceleration_m_s2"],
        run["load_pressure_pa"],
    )
    error = run["measured_rod_extension_m"] - run["rod_reference_m"]
    return ErrorComparison(model, run.time_s[late], error[late], predicted[late])
