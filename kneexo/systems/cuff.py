"""Cuff between the wearer's leg and the shank of the exoskeleton."""

from __future__ import annotations

from typing import Any

from pydrake.systems.framework import BasicVector_

from kneexo.parameters.wearer.wearer import CuffParameters
from kneexo.systems._leaf import NamedLeaf, clip, fill, leaf_template, require_finite, values_of
from kneexo.systems.state_variable import StateVariable


def context_values(parameters: CuffParameters) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `Cuff`."""
    slip = ("slip_torque_n_m", "slip_damping_n_m_s_per_rad") * _slips(parameters)
    return values_of(parameters, "stiffness_n_m_per_rad", "damping_n_m_s_per_rad", *slip)


def _slips(parameters: CuffParameters) -> bool:
    return parameters.slip_torque_n_m is not None


def state_variables(parameters: CuffParameters) -> tuple[StateVariable, ...]:
    """Return the continuous states of `Cuff`. A cuff without slip torque has none."""
    return (StateVariable("cuff_slip_rad"),) * _slips(parameters)


class Cuff(NamedLeaf):
    """Spring and damper between the leg of the wearer and the shank of the exoskeleton.

    τ_i = τ_s + b_c (dθ_h/dt − dθ/dt),  τ_s = k_c (θ_h − θ − δ),  dθ/dt = −(dx/dt)/r,
    dδ/dt = (τ_s − clip(τ_s, ±τ_0))/c.
    When the torque of the spring exceeds the slip torque τ_0, the cuff slides along the leg.
    Without a slip torque, δ is zero.

    ==================  ====  ==========  =====================================================
    input port          size  unit
    ==================  ====  ==========  =====================================================
    wearer_motion       2     rad, rad/s  θ_h and dθ_h/dt
    knee_angle          1     rad         θ of the exoskeleton
    rod_velocity        1     m/s         dx/dt
    moment_arm          1     m           r = −dx/dθ
    **output port**
    interaction_torque  1     N·m         τ_i on the exoskeleton, positive flexes
    cuff_slip           1     rad         δ
    interaction_power   2     W           τ_i dθ_h/dt given by the leg, τ_i dθ/dt taken by the exo
    ==================  ====  ==========  =====================================================

    State: δ in rad, if there is a slip torque. Context parameters by name: all numbers of
    `CuffParameters`, without the numbers of the slip if there is no slip torque. The torque on the
    leg is −τ_i. The difference of the two powers is the power that the cuff dissipates or stores in
    its spring. Raises `SimulationError` when the rate of δ is not finite. Source: a spring and
    damper in series with a rigid-viscoplastic element (Bingham), which regularizes dry friction.
    """

    def __init__(self, parameters: CuffParameters = CuffParameters()) -> None:
        self._declare_parameters(context_values(parameters))
        self._leg = self.DeclareVectorInputPort("wearer_motion", 2)
        self._angle = self.DeclareVectorInputPort("knee_angle", 1)
        self._velocity = self.DeclareVectorInputPort("rod_velocity", 1)
        self._arm = self.DeclareVectorInputPort("moment_arm", 1)
        self._slides = _slips(parameters)
        if self._slides:
            self.DeclareContinuousState(BasicVector_[self._scalar]([0.0]))
        declare = self._declare_output
        state = (self.xc_ticket(),) if self._slides else ()
        sources = (self._leg, self._angle, self._velocity, self._arm, *state)
        self._torque = declare("interaction_torque", 1, lambda c: [self._calc_torque(c)], *sources)
        declare("cuff_slip", 1, lambda c: [self._slip(c)], *(state or [self.nothing_ticket()]))
        declare("interaction_power", 2, self._calc_power, *sources)

    def _slip(self, context: Any) -> Any:
        return context.get_continuous_state_vector().GetAtIndex(0) if self._slides else 0.0

    def _spring_torque(self, context: Any) -> Any:
        deflection = self._leg.Eval(context)[0] - self._angle.Eval(context)[0] - self._slip(context)
        return self.parameters(context).stiffness_n_m_per_rad * deflection

    def _knee_rate(self, context: Any) -> Any:
        return -self._velocity.Eval(context)[0] / self._arm.Eval(context)[0]

    def _calc_torque(self, context: Any) -> Any:
        rate = self._leg.Eval(context)[1] - self._knee_rate(context)
        return self._spring_torque(context) + self.parameters(context).damping_n_m_s_per_rad * rate

    def _calc_power(self, context: Any) -> list[Any]:
        torque = self._torque.Eval(context)[0]
        return [torque * self._leg.Eval(context)[1], torque * self._knee_rate(context)]

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
        """Set the rate of the slip of the cuff. Raises `SimulationError` if it is not finite."""
        if not self._slides:
            return
        p = self.parameters(context)
        torque = self._spring_torque(context)
        excess = torque - clip(torque, -p.slip_torque_n_m, p.slip_torque_n_m)
        rate = excess / p.slip_damping_n_m_s_per_rad
        require_finite(self, context, slip_rate=rate)
        fill(derivatives.get_mutable_vector(), [rate])


Cuff_ = leaf_template(Cuff)
"""Template of `Cuff` classes by scalar type of Drake."""
