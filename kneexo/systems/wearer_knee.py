"""Knee of the wearer, with inertia, weight, stiffness, viscous and hysteretic damping."""

from __future__ import annotations

import math
from typing import Any

from pydrake.systems.framework import BasicVector_

from kneexo.parameters import KneeLoadParameters, LegParameters
from kneexo.parameters.wearer.wearer import MAXWELL_BANK
from kneexo.systems._leaf import (
    NamedLeaf,
    fill,
    leaf_template,
    require_finite,
    value_or_zero,
    values_of,
)
from kneexo.systems.knee_load import weight_torque
from kneexo.systems.state_variable import StateVariable

_CORNERS_RAD_S = tuple(2.0 * math.pi * corner for corner, _ in MAXWELL_BANK)
_WEIGHTS = tuple(weight for _, weight in MAXWELL_BANK)


def context_values(parameters: LegParameters, load: KneeLoadParameters) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `WearerKnee`."""
    return {
        **values_of(
            parameters,
            "inertia_kg_m2",
            "leg_mass_kg",
            "centre_of_mass_m",
            "bare_stiffness_n_m_per_rad",
            "loss_modulus_n_m_per_rad",
            "damping_n_m_s_per_rad",
            "neutral_angle_rad",
            "effort",
        ),
        **values_of(load, "thigh_inclination_rad", "gravity_m_s2"),
    }


def state_variables(motion: str) -> tuple[StateVariable, ...]:
    """Return the continuous states of `WearerKnee` in order. A prescribed motion has none."""
    if motion == "prescribed":
        return ()
    memories = (f"leg_memory_{index + 1}_rad" for index in range(len(MAXWELL_BANK)))
    return tuple(map(StateVariable, ("wearer_angle_rad", "wearer_rate_rad_s", *memories)))


def start_state(
    parameters: LegParameters, angle_rad: float, rate_rad_s: float
) -> tuple[float, ...]:
    """Return the initial state of `WearerKnee`. The Maxwell elements are relaxed.

    ``angle_rad`` and ``rate_rad_s`` are the reference and its rate at t = 0. A passive leg starts
    at rest.
    """
    if parameters.motion == "prescribed":
        return ()
    if parameters.motion == "passive":
        deflection = angle_rad - parameters.neutral_angle_rad
        return (angle_rad, 0.0, *([deflection] * len(MAXWELL_BANK)))
    return (angle_rad, rate_rad_s, *([0.0] * len(MAXWELL_BANK)))


class WearerKnee(NamedLeaf):
    """Knee of the wearer, whose leg moves with the cuff.

    With ``prescribed`` motion θ_h = θ_ref and dθ_h/dt = dθ_ref/dt, without state. Otherwise
    I_h d²θ_h/dt² = A + W(θ_h) − k_0 s − b ds/dt − h Σ κ_i (s − ξ_i) − τ_int,
    dξ_i/dt = 2π f_i (s − ξ_i),  W(θ) = m_h g l_h sin(α_thigh − θ).
    With ``passive`` motion the deflection is s = θ_h − θ_n about the neutral angle, and A = 0.
    With ``active`` motion the deflection is s = θ_h − θ_ref about the reference, and
    A = (ε − 1) M + I_h d²θ_ref/dt² − W(θ_ref). A is the sum of two torques. The muscles of the leg
    give ε M, a share of the biological moment M(t). The rest, −M + I_h d²θ_ref/dt² − W(θ_ref),
    stands for the ground reaction. So a leg with ε = 1 that feels no torque follows the reference.

    ==================  ====  =============  ==================================================
    input port          size  unit
    ==================  ====  =============  ==================================================
    knee_reference      4     rad, rad/s, …  θ_ref and derivatives to the third
    biological_moment   1     N·m            M, positive flexes; 0 if unconnected
    interaction_torque  1     N·m            τ_int on the exoskeleton; 0 if unconnected
    **output port**
    wearer_motion       2     rad, rad/s     θ_h and dθ_h/dt
    ==================  ====  =============  ==================================================

    State: θ_h in rad, dθ_h/dt in rad/s and ξ_i in rad. Context parameters by name: numbers of
    `LegParameters`, with ``bare_stiffness_n_m_per_rad`` (k_0) in place of k, and
    ``thigh_inclination_rad`` (α_thigh) and ``gravity_m_s2`` of the load. Source: the Maxwell
    elements approximate hysteretic damping (see `kneexo.parameters.wearer.wearer.MAXWELL_BANK`).
    The Maxwell element i has the weight κ_i and the corner frequency f_i, and h is the loss
    modulus.

    Parameters
    ----------
    parameters
        Numbers of the leg.
    load
        Gravity and the inclination of the thigh.
    initial_angle_rad, initial_rate_rad_s
        θ_h in rad and dθ_h/dt in rad/s at the start, with relaxed Maxwell elements. A passive leg
        starts at rest, and a prescribed motion ignores both.

    Raises
    ------
    SimulationError
        The acceleration is not finite.
    """

    def __init__(
        self,
        parameters: LegParameters = LegParameters(),
        load: KneeLoadParameters = KneeLoadParameters(),
        initial_angle_rad: float = 0.0,
        initial_rate_rad_s: float = 0.0,
    ) -> None:
        self._declare_parameters(context_values(parameters, load))
        self._motion = parameters.motion
        self._reference = self.DeclareVectorInputPort("knee_reference", 4)
        self._moment = self.DeclareVectorInputPort("biological_moment", 1)
        self._torque = self.DeclareVectorInputPort("interaction_torque", 1)
        start = start_state(parameters, initial_angle_rad, initial_rate_rad_s)
        if start:
            self.DeclareContinuousState(BasicVector_[self._scalar](list(start)))
        source = self.xc_ticket() if start else self._reference
        self._declare_output("wearer_motion", 2, self._calc_motion, source)

    def _calc_motion(self, context: Any) -> list[Any]:
        if self._motion == "prescribed":
            return list(self._reference.Eval(context)[:2])
        vector = context.get_continuous_state_vector()
        return [vector.GetAtIndex(0), vector.GetAtIndex(1)]

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
        """Set the rates of the leg. Raises `SimulationError` when one of them is not finite."""
        if self._motion == "prescribed":
            return
        p = self.parameters(context)
        angle, rate, *memories = context.get_continuous_state_vector().CopyToVector().tolist()

        def weight(knee_angle: Any) -> Any:
            return weight_torque(
                knee_angle,
                mass=p.leg_mass_kg,
                centre_of_mass=p.centre_of_mass_m,
                thigh_inclination=p.thigh_inclination_rad,
                gravity=p.gravity_m_s2,
            )

        torque = weight(angle) - value_or_zero(self._torque, context)
        deflection, deflection_rate = angle - p.neutral_angle_rad, rate
        if self._motion == "active":
            reference = self._reference.Eval(context)
            deflection, deflection_rate = angle - reference[0], rate - reference[1]
            muscles = (p.effort - 1.0) * value_or_zero(self._moment, context)
            torque += muscles + p.inertia_kg_m2 * reference[2] - weight(reference[0])
        torque -= (
            p.bare_stiffness_n_m_per_rad * deflection + p.damping_n_m_s_per_rad * deflection_rate
        )
        lags = [deflection - memory for memory in memories]
        weighted_lag = sum(share * lag for share, lag in zip(_WEIGHTS, lags, strict=True))
        acceleration = (torque - p.loss_modulus_n_m_per_rad * weighted_lag) / p.inertia_kg_m2
        require_finite(self, context, leg_acceleration=acceleration)
        rates = (corner * lag for corner, lag in zip(_CORNERS_RAD_S, lags, strict=True))
        fill(derivatives.get_mutable_vector(), (rate, acceleration, *rates))


WearerKnee_ = leaf_template(WearerKnee)
"""Template of `WearerKnee` classes by scalar type of Drake."""
