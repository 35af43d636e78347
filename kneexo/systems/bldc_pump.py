"""BLDC motor with gear and axial-piston pump (Lee et al. 2020, Eq. 12, 13)."""

from __future__ import annotations

from typing import Any

from pydrake.systems.framework import BasicVector_

from kneexo.parameters import BldcPumpParameters
from kneexo.systems._leaf import NamedLeaf, clip, leaf_template, require_finite, values_of
from kneexo.systems.state_variable import StateVariable

# Of order one as all states, see `PA_PER_MPA`. Here the unit alone changes little: Drake's default
# integrator takes 216 steps for 0.1 s of the closed loop with krad/s, and 196 with rad/s.
RAD_S_PER_KRAD_S = 1e3
"""Number of rad/s in a krad/s. The motor speed is a state in krad/s and an output in rad/s."""


def context_values(parameters: BldcPumpParameters) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `BldcPump`."""
    return values_of(
        parameters,
        "speed_limit_rad_s",
        "lag_s",
        "acceleration_limit_rad_s2",
        "gear_ratio",
        "displacement_m3_per_rad",
        "leakage_m3_per_s_pa",
    )


def state_variables(ideal: bool = False) -> tuple[StateVariable, ...]:
    """Return the continuous states of `BldcPump` in their order; an ideal motor has none."""
    return () if ideal else (StateVariable("motor_speed_rad_s", RAD_S_PER_KRAD_S),)


class BldcPump(NamedLeaf):
    """Speed-controlled BLDC motor with gear and axial-piston pump.

    dω_m/dt = α_d = clip((clip(ω_cmd, ±ω_max) − ω_m)/τ_m, ±α_max),
    Q_L = D_m ω_m/gear − (C_im + C_em/2) P_L.

    ===================  ====  =======  ==============================================
    input port           size  unit
    ===================  ====  =======  ==============================================
    motor_speed_command  1     rad/s    motor side of the gear
    load_pressure        1     Pa       P_L = P_1 − P_2
    **output port**
    motor_speed          1     rad/s    motor side; positive drives the rod out
    load_flow            1     m³/s     Q_L
    shaft_torque         1     N·m      motor side, D_m P_L/gear (lossless pump)
    shaft_power          1     W        torque times motor speed
    hydraulic_power      1     W        Q_L P_L, after leakage
    ===================  ====  =======  ==============================================

    The state is the motor speed in krad/s, a number of order one. If ``ideal`` is True, there is no
    state, and the speed equals the unlimited command, as in Eq. 17. Context parameters by name:
    ``speed_limit_rad_s, lag_s, acceleration_limit_rad_s2, gear_ratio, displacement_m3_per_rad,
    leakage_m3_per_s_pa`` (C_im + C_em/2). Raises `SimulationError` when the acceleration is not
    finite. Source: Lee et al. 2020, Eq. 12, 13; lag and acceleration limit are assumptions.

    Parameters
    ----------
    parameters
        Numbers of the drive, the gear and the pump.
    ideal
        True: the speed equals the command, and there is no state.
    """

    def __init__(
        self, parameters: BldcPumpParameters = BldcPumpParameters(), ideal: bool = False
    ) -> None:
        self._declare_parameters(context_values(parameters))
        self._declare_pump(ideal)

    def _declare_pump(self, ideal: bool) -> None:
        """Declare the ports and the state."""
        self._ideal = ideal
        self._command = self.DeclareVectorInputPort("motor_speed_command", 1)
        self._pressure = self.DeclareVectorInputPort("load_pressure", 1)
        if not ideal:
            self.DeclareContinuousState(BasicVector_[self._scalar]([0.0]))
        speed = self._command if ideal else self.xc_ticket()
        both = (speed, self._pressure)
        declare = self._declare_output
        declare("motor_speed", 1, lambda c: [self._speed(c)], speed)
        declare("load_flow", 1, lambda c: [self._flow(c)], *both)
        declare("shaft_torque", 1, lambda c: [self._torque(c)], self._pressure)
        declare("shaft_power", 1, lambda c: [self._torque(c) * self._speed(c)], *both)
        declare("hydraulic_power", 1, self._hydraulic_power, *both)

    def _speed(self, context: Any) -> Any:
        if self._ideal:
            return self._command.Eval(context)[0]
        return RAD_S_PER_KRAD_S * context.get_continuous_state_vector().GetAtIndex(0)

    def _flow(self, context: Any) -> Any:
        """Return the load flow Q_L in m³/s (Eq. 13)."""
        p, pressure = self.parameters(context), self._pressure.Eval(context)[0]
        pumped = p.displacement_m3_per_rad * self._speed(context) / p.gear_ratio
        return pumped - p.leakage_m3_per_s_pa * pressure

    def _torque(self, context: Any) -> Any:
        p = self.parameters(context)
        return p.displacement_m3_per_rad * self._pressure.Eval(context)[0] / p.gear_ratio

    def _acceleration(self, context: Any) -> Any:
        """Return the acceleration in rad/s² that the speed loop of the drive asks for."""
        p = self.parameters(context)
        command = clip(self._command.Eval(context)[0], -p.speed_limit_rad_s, p.speed_limit_rad_s)
        wanted, limit = (command - self._speed(context)) / p.lag_s, p.acceleration_limit_rad_s2
        return clip(wanted, -limit, limit)

    def _hydraulic_power(self, context: Any) -> list[Any]:
        return [self._flow(context) * self._pressure.Eval(context)[0]]

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
        """Set the acceleration of the motor. Raises `SimulationError` if it is not finite."""
        if self._ideal:
            return
        acceleration = self._acceleration(context)
        require_finite(self, context, motor_acceleration=acceleration)
        derivatives.get_mutable_vector().SetAtIndex(0, 1.0 / RAD_S_PER_KRAD_S * acceleration)


BldcPump_ = leaf_template(BldcPump)
"""Template of `BldcPump` classes by scalar type of Drake."""
