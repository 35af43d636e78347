"""Sliding-mode controller of the rod (Lee et al. 2020, Eq. 20–27)."""

from __future__ import annotations

from typing import Any

import pydrake.math as drake_math

from kneexo.parameters import PlantParameters, SlidingModeParameters
from kneexo.systems._leaf import (
    NamedLeaf,
    clip,
    discrete_state,
    leaf_template,
    values_of,
    where_positive,
)


def sliding_variable(state: Any, reference: Any, lambda_: Any) -> Any:
    """Return s = ë + 2λė + λ²e in m/s², with e = x − x_d (Eq. 20).

    ``state`` has x, v and a of the rod. ``reference`` has x_d and at least its first two time
    derivatives.
    """
    e, e_1, e_2 = (x - x_d for x, x_d in zip(state, reference[:3], strict=True))
    return e_2 + 2.0 * lambda_ * e_1 + lambda_ * lambda_ * e


def sliding_mode_command(state: Any, reference: Any, p: Any, signum: bool = False) -> Any:
    """Return the motor speed command of Eq. 27 in rad/s, without the limit of the motor.

    u = b̂⁻¹(û − k sat(s/Φ)),  û = −f̂ + x⃛_d − 2λë − λ²ė,
    f̂ = −(4β_eĀ²/(m̂V_t) + K/m̂) v − (B/m̂) a,  b̂ = 4β_eĀD_m/(gear·m̂V_t),
    k = (ΔK|v| + ΔB|a| + ΔḞ_L)/m̂ + ω̂²|ΔA/Ā||v| + |1 − β||x⃛_d − 2λë − λ²ė| + βη,
    with ω̂² = 4β_eĀ²/(m̂V_t).

    The term with ΔA, which is zero by default and not in Eq. 27, covers chambers whose area is
    not Ā. Eq. 27 lacks the absolute values of v and a, and Eq. 23 prints the inverse of
    β = √(b_max/b_min). ``p`` has the Context parameters of `SlidingModeController` as attributes.
    With ``signum``, sgn(s) replaces sat(s/Φ).
    """
    _, v, a = state
    _, v_d, a_d, j_d = reference
    lambda_ = p.lambda_per_s
    s = sliding_variable(state, reference, lambda_)
    demand = j_d - 2.0 * lambda_ * (a - a_d) - lambda_ * lambda_ * (v - v_d)
    hydraulic = 4.0 * p.bulk_modulus_pa * p.mean_area_m2 / (p.mass_estimate_kg * p.total_volume_m3)
    f = (
        -(hydraulic * p.mean_area_m2 + p.stiffness_n_per_m / p.mass_estimate_kg) * v
        - p.damping_n_s_per_m / p.mass_estimate_kg * a
    )
    b = hydraulic * p.displacement_m3_per_rad / p.gear_ratio
    k = (
        (
            p.stiffness_uncertainty_n_per_m * drake_math.abs(v)
            + p.damping_uncertainty_n_s_per_m * drake_math.abs(a)
            + p.load_rate_uncertainty_n_per_s
        )
        / p.mass_estimate_kg
        + p.area_uncertainty * hydraulic * p.mean_area_m2 * drake_math.abs(v)
        + drake_math.abs(1.0 - p.gain_ratio) * drake_math.abs(demand)
        + p.gain_ratio * p.eta_m_s3
    )
    if signum:
        switch = where_positive(s, 1.0, where_positive(-s, -1.0, 0.0))
    else:
        switch = clip(s / p.phi_m_s2, -1.0, 1.0)
    return (demand - f - k * switch) / b


def context_values(parameters: SlidingModeParameters, plant: PlantParameters) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `SlidingModeController`."""
    return {
        **values_of(
            parameters,
            "lambda_per_s",
            "phi_m_s2",
            "eta_m_s3",
            "stiffness_uncertainty_n_per_m",
            "damping_uncertainty_n_s_per_m",
            "load_rate_uncertainty_n_per_s",
            "area_uncertainty",
            "mass_estimate_kg",
            "gain_ratio",
            "command_limit_rad_s",
        ),
        **values_of(
            plant.cylinder,
            "mean_area_m2",
            "total_volume_m3",
            "bulk_modulus_pa",
            "damping_n_s_per_m",
            "stiffness_n_per_m",
        ),
        **values_of(plant.pump, "gear_ratio", "displacement_m3_per_rad"),
    }


class SlidingModeController(NamedLeaf):
    """Sliding-mode control of the rod (Eq. 27; see `sliding_mode_command`).

    ===================  ====  ===================  =======================================
    input port           size  unit
    ===================  ====  ===================  =======================================
    estimated_state      3     m, m/s, m/s²         x, v, a
    rod_reference        4     m, m/s, m/s², m/s³   x_d and derivatives to the third
    **output port**
    motor_speed_command  1     rad/s                within ±``command_limit_rad_s``
    sliding_variable     1     m/s²                 s of the present inputs
    ===================  ====  ===================  =======================================

    The discrete state, updated every ``sample_time_s``, is the command, which the output port
    shows. With ``continuous=True`` there is no state and the command follows the inputs at once
    (Fig. 9). Context parameters by name: λ, Φ, η, the bounds of Eq. 27, m̂ (``mass_estimate_kg``),
    β (``gain_ratio``) and the numbers of the plant that the controller believes in. Source: Lee et
    al. 2020, Eq. 20–27, with the errata listed in `sliding_mode_command`.
    """

    def __init__(
        self,
        parameters: SlidingModeParameters = SlidingModeParameters(),
        plant: PlantParameters = PlantParameters(),
    ) -> None:
        self._declare_parameters(context_values(parameters, plant))
        self._signum = parameters.switching == "signum"
        self._state = self.DeclareVectorInputPort("estimated_state", 3)
        self._reference = self.DeclareVectorInputPort("rod_reference", 4)
        inputs, declare = (self._state, self._reference), self._declare_output
        if parameters.continuous:
            declare("motor_speed_command", 1, self._command, *inputs)
        else:
            self._declare_update(parameters.sample_time_s, 1, self._command)
            declare("motor_speed_command", 1, discrete_state, self.xd_ticket())
        declare("sliding_variable", 1, self._calc_sliding_variable, *inputs)

    def _command(self, context: Any) -> list[Any]:
        p = self.parameters(context)
        command = sliding_mode_command(
            self._state.Eval(context), self._reference.Eval(context), p, self._signum
        )
        return [clip(command, -p.command_limit_rad_s, p.command_limit_rad_s)]

    def _calc_sliding_variable(self, context: Any) -> list[Any]:
        return [
            sliding_variable(
                self._state.Eval(context),
                self._reference.Eval(context),
                self.parameters(context).lambda_per_s,
            )
        ]


SlidingModeController_ = leaf_template(SlidingModeController)
"""Template of `SlidingModeController` classes by scalar type of Drake."""
