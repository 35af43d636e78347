"""Torque controller of the knee on the measured rod force."""

from __future__ import annotations

from typing import Any

from kneexo.geometry.linkage import polynomial, polynomial_derivative
from kneexo.parameters import PlantParameters, RodPolynomialParameters, TorqueParameters
from kneexo.systems._leaf import (
    NamedLeaf,
    clip,
    discrete_state,
    leaf_template,
    values_of,
    where_positive,
)
from kneexo.systems.knee_coordinates import rod_polynomial_values


def context_values(
    parameters: TorqueParameters, plant: PlantParameters, rod_polynomial: RodPolynomialParameters
) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `TorqueController`."""
    return {
        **values_of(
            parameters,
            "proportional_rad_s_per_n",
            "integral_rad_s2_per_n",
            "leak_per_s",
            "speed_feedforward",
            "anti_windup_s",
            "timeout_s",
            "torque_limit_n_m",
            "assistance",
            "stiffness_n_m_per_rad",
            "damping_n_m_s_per_rad",
            "band_rad",
            "command_limit_rad_s",
        ),
        "speed_gain_rad_per_m": plant.speed_gain_rad_per_m,
        **rod_polynomial_values(rod_polynomial),
    }


class TorqueController(NamedLeaf):
    """PI control of the rod force, with feedforward of the measured rod speed.

    e = F_d − F,  F_d = −τ_d/r̂,  I ← I + T(K_i e − λ I + (u_lim − u)/T_t),
    u = K_p e + I + T(K_i e − λ I) + γ G v̂,  u_lim = clip(u, ±u_max),  G = gear·Ā/D_m.
    τ_d is the desired torque of the actuator on the knee, positive in flexion, limited to ±τ_max.
    r̂ = −dx/dθ follows from Eq. 10, and the knee rate is −v̂/r̂. By ``mode``,
    ``zero_torque``: τ_d = 0;  ``assist``: τ_d = a M;
    ``impedance``: τ_d = −K_v(θ − θ_ref) − B_v(dθ/dt − dθ_ref/dt);
    ``assist_as_needed``: τ_d = −K_v(θ − θ_ref − clip(θ − θ_ref, ±band)).
    If the age of the reading exceeds ``timeout_s``, the command and I are zero, and the oil holds
    the knee. Without integral action (K_i = 0) I stays zero.

    ===================  ====  =============  ===============================================
    input port           size  unit
    ===================  ====  =============  ===============================================
    measured_force       2     N, s           F, positive when the rod pushes, and its age
    estimated_state      3     m, m/s, m/s²   x̂, v̂, â of the rod; v̂ is used
    knee_angle           1     rad            measured θ
    knee_reference       4     rad, rad/s, …  θ_ref and derivatives
    biological_moment    1     N·m            M, only in the mode ``assist``
    **output port**
    motor_speed_command  1     rad/s          within ±``command_limit_rad_s``
    desired_torque       1     N·m            τ_d of the present inputs
    ===================  ====  =============  ===============================================

    The discrete state, updated every ``sample_time_s``, has the command and I. Context parameters
    by name: the numbers of `TorqueParameters`, ``speed_gain_rad_per_m`` (G), and ``p_1`` … ``p_6``
    of Eq. 10 in SI units. The pump is a velocity source, so an error of the force commands a speed.

    Parameters
    ----------
    parameters
        Gains, limits, mode and sample time.
    plant
        The plant that the controller assumes: gear, area and displacement give G.
    rod_polynomial
        Coefficients of Eq. 10.
    """

    def __init__(
        self,
        parameters: TorqueParameters = TorqueParameters(),
        plant: PlantParameters = PlantParameters(),
        rod_polynomial: RodPolynomialParameters = RodPolynomialParameters(),
    ) -> None:
        self._declare_parameters(context_values(parameters, plant, rod_polynomial))
        self._mode, self._sample_time = parameters.mode, parameters.sample_time_s
        self._force = self.DeclareVectorInputPort("measured_force", 2)
        self._estimate = self.DeclareVectorInputPort("estimated_state", 3)
        self._angle = self.DeclareVectorInputPort("knee_angle", 1)
        self._reference = self.DeclareVectorInputPort("knee_reference", 4)
        sources = [self._estimate, self._angle, self._reference]
        if self._mode == "assist":
            self._moment = self.DeclareVectorInputPort("biological_moment", 1)
            sources = [self._moment]
        self._declare_update(parameters.sample_time_s, 2, self._update)
        self._declare_command()
        self._desired = self._declare_output("desired_torque", 1, self._calc_desired, *sources)

    def _arm(self, context: Any) -> Any:
        coefficients = self.parameters(context)[-6:]
        slope = polynomial_derivative(coefficients, 1)
        return -polynomial(slope, self._angle.Eval(context)[0])

    def _calc_desired(self, context: Any) -> list[Any]:
        p = self.parameters(context)
        if self._mode == "zero_torque":
            return [0.0]
        if self._mode == "assist":
            torque = p.assistance * self._moment.Eval(context)[0]
        else:
            reference = self._reference.Eval(context)
            deviation = self._angle.Eval(context)[0] - reference[0]
            if self._mode == "assist_as_needed":
                outside = deviation - clip(deviation, -p.band_rad, p.band_rad)
                torque = -p.stiffness_n_m_per_rad * outside
            else:
                rate = -self._estimate.Eval(context)[1] / self._arm(context) - reference[1]
                torque = -p.stiffness_n_m_per_rad * deviation - p.damping_n_m_s_per_rad * rate
        return [clip(torque, -p.torque_limit_n_m, p.torque_limit_n_m)]

    def _update(self, context: Any) -> list[Any]:
        p, dt = self.parameters(context), self._sample_time
        _, integral = discrete_state(context)
        force, age = self._force.Eval(context)
        error = -self._desired.Eval(context)[0] / self._arm(context) - force
        # The leak gives phase: without it the least phase margin with a wearer is 3.4°, that of a
        # relaxed leg.
        growth = dt * (p.integral_rad_s2_per_n * error - p.leak_per_s * integral)
        # A positive feedback of the rod speed, which limits the gain margin to about 1/γ.
        speed = p.speed_feedforward * p.speed_gain_rad_per_m * self._estimate.Eval(context)[1]
        command = p.proportional_rad_s_per_n * error + integral + growth + speed
        limited = clip(command, -p.command_limit_rad_s, p.command_limit_rad_s)
        growth = growth + dt * (limited - command) / p.anti_windup_s
        growth = where_positive(p.integral_rad_s2_per_n, growth, -integral)
        stale = age - p.timeout_s
        # Exported C of single precision compensates rounding errors of a state that is such a sum.
        return [
            where_positive(stale, 0.0, limited),
            integral + where_positive(stale, -integral, growth),
        ]


TorqueController_ = leaf_template(TorqueController)
"""Template of `TorqueController` classes by scalar type of Drake."""
