"""PID controller of the knee angle; Lee et al. 2020, Section 5, compare their law with a PID."""

from __future__ import annotations

from typing import Any

import pydrake.math as drake_math

from kneexo.parameters import PidParameters, PlantParameters
from kneexo.systems._leaf import (
    NamedLeaf,
    clip,
    discrete_state,
    leaf_template,
    values_of,
    where_positive,
)


def context_values(parameters: PidParameters, plant: PlantParameters) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `PidController`."""
    return {
        **values_of(
            parameters,
            "proportional_per_s",
            "integral_per_s2",
            "derivative",
            "filter_s",
            "anti_windup_s",
            "velocity_feedforward",
            "moment_arm_m",
            "command_limit_rad_s",
        ),
        "speed_gain_rad_per_m": plant.speed_gain_rad_per_m,
    }


class PidController(NamedLeaf):
    """PID controller of the knee angle with filtered error and back-calculated anti-windup.

    With the error e = θ_d − θ_p, its first-order filter z and G = gear·Ā/D_m (motor per rod speed):
    z⁺ = z + (1 − e^(−T/T_d))(e − z),  I⁺ = I + T(K_i e + (w_u − w)/T_t),
    w = K_p z⁺ + I + K_d (e − z⁺)/T_d,  u = clip(G(−r_0 w + K_v dx_d/dt), ±u_max).
    T is the sample time, T_d ``filter_s``, T_t ``anti_windup_s`` and r_0 ``moment_arm_m``. w is the
    commanded knee rate, and w_u the knee rate that the limited command u gives. The rod retracts as
    the knee flexes, hence the minus sign. The filter smooths the counts of the encoder in P and D,
    as the observer does for the sliding-mode controller. Without integral action (K_i = 0) I stays
    zero, because nothing would lead it back to zero after a limited command.

    ===================  ====  =====================  ===================================
    input port           size  unit
    ===================  ====  =====================  ===================================
    knee_angle           1     rad                    measured θ_p
    knee_reference       4     rad, rad/s, …          θ_d and derivatives (θ_d is used)
    rod_reference        4     m, m/s, …              x_d and derivatives (dx_d/dt is used)
    **output port**
    motor_speed_command  1     rad/s                  within ±``command_limit_rad_s``
    ===================  ====  =====================  ===================================

    The discrete state, updated every ``sample_time_s``, has the command, which the output port
    shows, I and z. ``Simulator.Initialize()`` sets z to e, so that an initial error gives no
    derivative kick. Context parameters by name: the gains of `PidParameters` and
    ``speed_gain_rad_per_m`` (G).
    """

    def __init__(
        self,
        parameters: PidParameters = PidParameters(),
        plant: PlantParameters = PlantParameters(),
    ) -> None:
        self._declare_parameters(context_values(parameters, plant))
        self._sample_time = parameters.sample_time_s
        self._knee_angle = self.DeclareVectorInputPort("knee_angle", 1)
        self._knee_reference = self.DeclareVectorInputPort("knee_reference", 4)
        self._rod_reference = self.DeclareVectorInputPort("rod_reference", 4)
        self._declare_update(parameters.sample_time_s, 3, self._update)
        self._declare_initialization(lambda c: [0.0, 0.0, self._error(c)])
        self._declare_command()

    def _error(self, context: Any) -> Any:
        return self._knee_reference.Eval(context)[0] - self._knee_angle.Eval(context)[0]

    def _update(self, context: Any) -> list[Any]:
        p = self.parameters(context)
        _, integral, filtered = discrete_state(context)
        error = self._error(context)
        dt = self._sample_time
        share = 1.0 - drake_math.exp(-dt / p.filter_s)
        filtered = filtered + share * (error - filtered)
        slope = (error - filtered) / p.filter_s
        rate = p.proportional_per_s * filtered + integral + p.derivative * slope
        per_rate = -p.speed_gain_rad_per_m * p.moment_arm_m
        feedforward = (
            p.speed_gain_rad_per_m * p.velocity_feedforward * self._rod_reference.Eval(context)[1]
        )
        command = clip(per_rate * rate + feedforward, -p.command_limit_rad_s, p.command_limit_rad_s)
        excess = (command - feedforward) / per_rate - rate
        growth = dt * (p.integral_per_s2 * error + excess / p.anti_windup_s)
        # As a sum, the integral is compensated for rounding in exported C of single precision.
        integral = integral + where_positive(p.integral_per_s2, growth, -integral)
        return [command, integral, filtered]


PidController_ = leaf_template(PidController)
"""Template of `PidController` classes by scalar type of Drake."""
