"""BLDC motor with gear and axial-piston pump (Lee et al. 2020, Eq. 12, 13)."""

from __future__ import annotations

from typing import Any

import pydrake.math as drake_math
from pydrake.systems.framework import BasicVector_

from kneexo.parameters import BldcPumpParameters, MotorParameters, ThermalParameters
from kneexo.parameters.device.plant import WINDING_REFERENCE_DEGC
from kneexo.systems._leaf import (
    NamedLeaf,
    clip,
    leaf_template,
    require_finite,
    smooth_step,
    value_or_zero,
    values_of,
    where_positive,
)
from kneexo.systems.state_variable import StateVariable

# Of order one as all states, see `PA_PER_MPA`. Here the unit alone changes little: Drake's default
# integrator takes 216 steps for 0.1 s of the closed loop with krad/s, and 196 with rad/s.
RAD_S_PER_KRAD_S = 1e3
"""Number of rad/s in a krad/s. The motor speed is a state in krad/s and an output in rad/s."""


def motor_acceleration(
    command: Any, speed: Any, lag: Any, speed_limit: Any, acceleration_limit: Any
) -> Any:
    """Return the acceleration of the speed-controlled motor in rad/s².

    dω/dt = clip((clip(ω_cmd, ±ω_max) − ω)/τ, ±α_max). Speeds are in rad/s, ``lag`` τ is in s.
    """
    limited = clip(command, -speed_limit, speed_limit)
    return clip((limited - speed) / lag, -acceleration_limit, acceleration_limit)


def shaft_loss(speed: Any, p: Any) -> Any:
    """Return the torque in N·m that friction takes from the shaft, T_c tanh(ω/ω_0) + b ω.

    ``p`` has the numbers of `MotorParameters`.
    """
    coulomb = p.coulomb_torque_n_m * drake_math.tanh(speed / p.friction_band_rad_s)
    return coulomb + p.viscous_torque_n_m_s_per_rad * speed


def limited_current(
    torque: Any, speed: Any, *, torque_constant: Any, resistance: Any, supply: Any, limit: Any
) -> Any:
    """Return the current in A that comes closest to a ``torque`` in N·m at the shaft.

    i = T/k_t, within |k_t ω + R i| ≤ U, and then within ±i_max. If the induced voltage exceeds the
    ``supply`` U, the drive brakes with at most the ``limit`` i_max.
    """
    induced = torque_constant * speed
    low, high = (-supply - induced) / resistance, (supply - induced) / resistance
    return clip(clip(torque / torque_constant, low, high), -limit, limit)


def warm_resistance(temperature: Any, p: Any) -> Any:
    """Return the resistance of a winding at a ``temperature`` in °C, R (1 + α (T_w − 25 °C)).

    ``p`` has the numbers of `MotorParameters` and `ThermalParameters`.
    """
    return p.resistance_ohm * (1.0 + p.copper_per_k * (temperature - WINDING_REFERENCE_DEGC))


def derating(temperature: Any, p: Any) -> Any:
    """Return the share of the current limit that a winding at a ``temperature`` in °C may have.

    The share falls from exactly 1 at ``derating_min_degc`` to exactly 0 at ``derating_max_degc``.
    ``p`` has the numbers of `ThermalParameters`.
    """
    middle = 0.5 * (p.derating_min_degc + p.derating_max_degc)
    return smooth_step(middle - temperature, 0.5 * (p.derating_max_degc - p.derating_min_degc))


def load_flow(speed: Any, pressure: Any, displacement: Any, gear_ratio: Any, leakage: Any) -> Any:
    """Return the load flow Q_L = D_m ω/gear − C P_L in m³/s (Eq. 13).

    ``leakage`` is C = C_im + C_em/2, where C_im is internal and C_em external leakage coefficient.
    """
    return displacement * speed / gear_ratio - leakage * pressure


def context_values(
    parameters: BldcPumpParameters,
    motor: MotorParameters | None = None,
    thermal: ThermalParameters | None = None,
) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `BldcPump`."""
    values = values_of(
        parameters,
        "speed_limit_rad_s",
        "lag_s",
        "acceleration_limit_rad_s2",
        "gear_ratio",
        "displacement_m3_per_rad",
        "leakage_m3_per_s_pa",
    )
    if motor is not None:
        values |= vars(motor)
    if thermal is not None:
        values |= values_of(thermal, "copper_per_k", "derating_min_degc", "derating_max_degc")
    return values


def state_variables(ideal: bool = False) -> tuple[StateVariable, ...]:
    """Return the continuous states of `BldcPump` in their order; an ideal motor has none."""
    return () if ideal else (StateVariable("motor_speed_rad_s", RAD_S_PER_KRAD_S),)


class BldcPump(NamedLeaf):
    """Speed-controlled BLDC motor with gear and axial-piston pump.

    dω_m/dt = α_d = clip((clip(ω_cmd, ±ω_max) − ω_m)/τ_m, ±α_max),
    Q_L = D_m ω_m/gear − (C_im + C_em/2) P_L.

    With ``motor`` the drive asks for the torque that makes α_d, and gets what current and supply
    allow: J dω_m/dt = k_t i − T_l, with T_l = D_m P_L/gear + T_c tanh(ω_m/ω_0) + b ω_m and
    i = `limited_current` of J α_d + T_l. Within the limits dω_m/dt is α_d. A dead motor, with
    i_max = 0, is no brake: the oil can drive it. With six-step commutation one lost phase of three
    leaves a third of the mean torque, and so of i_max. Its ripple is left out. With ``thermal`` the
    resistance R is that of `warm_resistance`, and `derating` lowers i_max. Torque off
    (IEC 61800-5-2) makes i zero. The dynamic brake shorts the windings: i = −k_t ω_m/R.

    ===================  ====  =======  ==============================================
    input port           size  unit
    ===================  ====  =======  ==============================================
    motor_speed_command  1     rad/s    motor side of the gear
    load_pressure        1     Pa       P_L = P_1 − P_2
    torque_off           1     1        1: no current; 0 if unconnected; only with ``motor``
    dynamic_brake        1     1        1: shorted windings; 0 if unconnected; only with ``motor``
    motor_temperatures   2     °C       T_w of the winding, T_c; only with ``thermal``
    **output port**
    motor_speed          1     rad/s    motor side; positive drives the rod out
    load_flow            1     m³/s     Q_L
    shaft_torque         1     N·m      motor side, D_m P_L/gear (lossless pump)
    shaft_power          1     W        torque times motor speed
    hydraulic_power      1     W        Q_L P_L, after leakage
    motor_current        1     A        i; only with ``motor``
    motor_voltage        1     V        k_t ω_m + R i; only with ``motor``
    winding_loss         1     W        R i²; only with ``thermal``
    ===================  ====  =======  ==============================================

    The state is the motor speed in krad/s, a number of order one. If ``ideal`` is True, there is no
    state, and the speed equals the unlimited command, as in Eq. 17. Context parameters by name:
    ``speed_limit_rad_s, lag_s, acceleration_limit_rad_s2, gear_ratio, displacement_m3_per_rad,
    leakage_m3_per_s_pa`` (C_im + C_em/2), with ``motor`` all names of `MotorParameters`, and with
    ``thermal`` the last three of `ThermalParameters`. Raises `SimulationError` when the
    acceleration is not finite. Source: Lee et al. 2020, Eq. 12, 13; lag, acceleration limit,
    ``motor`` and ``thermal`` are assumptions.

    Parameters
    ----------
    parameters
        Numbers of the drive, the gear and the pump.
    ideal
        True: the speed equals the command, and there is no state.
    motor
        Numbers of torque, current and supply. None: the torque is not limited. An ideal motor has
        none.
    thermal
        Numbers of the hot winding. None: the winding stays at the temperature of ``motor``.
    """

    def __init__(
        self,
        parameters: BldcPumpParameters = BldcPumpParameters(),
        ideal: bool = False,
        motor: MotorParameters | None = None,
        thermal: ThermalParameters | None = None,
    ) -> None:
        self._declare_parameters(context_values(parameters, motor, thermal))
        self._ideal = ideal
        self._limited = motor is not None
        self._temperatures = None
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
        if self._limited:
            self._torque_off, self._brake = (
                self.DeclareVectorInputPort(name, 1) for name in ("torque_off", "dynamic_brake")
            )
            sources = [self._command, *both, self._torque_off, self._brake]
            if thermal is not None:
                self._temperatures = self.DeclareVectorInputPort("motor_temperatures", 2)
                sources.append(self._temperatures)
                declare("winding_loss", 1, self._loss, *sources)
            declare("motor_current", 1, lambda c: [self._current(c)], *sources)
            declare("motor_voltage", 1, self._voltage, *sources)

    def _speed(self, context: Any) -> Any:
        if self._ideal:
            return self._command.Eval(context)[0]
        return RAD_S_PER_KRAD_S * context.get_continuous_state_vector().GetAtIndex(0)

    def _flow(self, context: Any) -> Any:
        p = self.parameters(context)
        return load_flow(
            self._speed(context),
            self._pressure.Eval(context)[0],
            p.displacement_m3_per_rad,
            p.gear_ratio,
            p.leakage_m3_per_s_pa,
        )

    def _torque(self, context: Any) -> Any:
        p = self.parameters(context)
        return p.displacement_m3_per_rad * self._pressure.Eval(context)[0] / p.gear_ratio

    def _demanded_acceleration(self, context: Any) -> Any:
        """Return the acceleration in rad/s² that the speed loop of the drive asks for."""
        p = self.parameters(context)
        return motor_acceleration(
            self._command.Eval(context)[0],
            self._speed(context),
            p.lag_s,
            p.speed_limit_rad_s,
            p.acceleration_limit_rad_s2,
        )

    def _opposing_torque(self, context: Any) -> Any:
        return self._torque(context) + shaft_loss(self._speed(context), self.parameters(context))

    def _winding(self, context: Any) -> tuple[Any, Any]:
        """Return the resistance in Ω and the current limit in A of the winding as warm as it is."""
        p = self.parameters(context)
        if self._temperatures is None:
            return p.resistance_ohm, p.current_limit_a
        temperature = self._temperatures.Eval(context)[0]
        return warm_resistance(temperature, p), derating(temperature, p) * p.current_limit_a

    def _current(self, context: Any) -> Any:
        p = self.parameters(context)
        torque = p.inertia_kg_m2 * self._demanded_acceleration(context)
        torque += self._opposing_torque(context)
        resistance, limit = self._winding(context)
        speed = self._speed(context)
        current = limited_current(
            torque,
            speed,
            torque_constant=p.torque_constant_n_m_per_a,
            resistance=resistance,
            supply=p.supply_voltage_v,
            limit=limit,
        )
        is_off = value_or_zero(self._torque_off, context) - 0.5
        is_shorted = value_or_zero(self._brake, context) - 0.5
        current = where_positive(is_off, 0.0, current)
        return where_positive(
            is_shorted, -p.torque_constant_n_m_per_a * speed / resistance, current
        )

    def _voltage(self, context: Any) -> list[Any]:
        induced = self.parameters(context).torque_constant_n_m_per_a * self._speed(context)
        return [induced + self._winding(context)[0] * self._current(context)]

    def _loss(self, context: Any) -> list[Any]:
        current = self._current(context)
        return [self._winding(context)[0] * current * current]

    def _acceleration(self, context: Any) -> Any:
        if not self._limited:
            return self._demanded_acceleration(context)
        p = self.parameters(context)
        torque = p.torque_constant_n_m_per_a * self._current(context)
        return (torque - self._opposing_torque(context)) / p.inertia_kg_m2

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
