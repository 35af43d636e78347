"""Speed-controlled motor with limits of torque, current and supply, a brake, and a hot winding.

The motor turns the pump of `kneexo.systems.bldc_pump`. All of it but the pump is an assumption: the
paper's motor follows the demand of its speed loop.
"""

from __future__ import annotations

from typing import Any

import pydrake.math as drake_math

from kneexo.parameters import BldcPumpParameters, MotorParameters, ThermalParameters
from kneexo.parameters.device.plant import WINDING_REFERENCE_DEGC
from kneexo.systems import bldc_pump
from kneexo.systems._leaf import (
    clip,
    leaf_template,
    smooth_step,
    value_or_zero,
    values_of,
    where_positive,
)
from kneexo.systems.bldc_pump import BldcPump


def shaft_loss(speed: Any, p: Any) -> Any:
    """Return the torque in N·m that friction takes from the shaft, M_c tanh(ω/ω_0) + b ω.

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


def context_values(
    parameters: BldcPumpParameters,
    motor: MotorParameters,
    thermal: ThermalParameters | None = None,
) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `TorqueLimitedPump`."""
    values = bldc_pump.context_values(parameters) | vars(motor)
    if thermal is not None:
        values |= values_of(thermal, "copper_per_k", "derating_min_degc", "derating_max_degc")
    return values


class TorqueLimitedPump(BldcPump):
    """`BldcPump` whose motor gets the torque that current and supply allow.

    The drive asks for the torque that makes the acceleration α_d of `BldcPump`, and gets what
    current and supply allow: J dω_m/dt = k_t i − T_l, with
    T_l = D_m P_L/gear + M_c tanh(ω_m/ω_0) + b ω_m and i = `limited_current` of J α_d + T_l. Within
    the limits dω_m/dt is α_d. A dead motor, with i_max = 0, is no brake: the oil can drive it. With
    six-step commutation one lost phase of three leaves a third of the mean torque, and so of i_max.
    Its ripple is left out. With ``thermal`` the resistance R is that of `warm_resistance`, and
    `derating` lowers i_max. Torque off (IEC 61800-5-2) makes i zero. The dynamic brake shorts the
    windings: i = −k_t ω_m/R. The brake goes before torque off, and no limit of the drive holds its
    current.

    Ports beside those of `BldcPump`:

    ===================  ====  =======  ==============================================
    input port           size  unit
    ===================  ====  =======  ==============================================
    torque_off           1     1        1: no current; 0 if unconnected
    dynamic_brake        1     1        1: shorted windings; 0 if unconnected
    motor_temperatures   2     °C       winding and case; only with ``thermal``
    **output port**
    motor_current        1     A        i
    motor_voltage        1     V        k_t ω_m + R i
    winding_loss         1     W        R i²; only with ``thermal``
    ===================  ====  =======  ==============================================

    Context parameters by name: those of `BldcPump`, all names of `MotorParameters`, and with
    ``thermal`` the last three of `ThermalParameters`. Raises `SimulationError` when the
    acceleration is not finite. Source: assumptions, see `MotorParameters` and `ThermalParameters`.

    Parameters
    ----------
    parameters
        Numbers of the drive, the gear and the pump.
    motor
        Numbers of torque, current and supply.
    thermal
        Numbers of the hot winding. None: the resistance of the winding stays that of ``motor``.
    """

    def __init__(
        self,
        parameters: BldcPumpParameters = BldcPumpParameters(),
        motor: MotorParameters = MotorParameters(),
        thermal: ThermalParameters | None = None,
    ) -> None:
        self._declare_parameters(context_values(parameters, motor, thermal))
        self._declare_pump(ideal=False)
        self._torque_off, self._brake = (
            self.DeclareVectorInputPort(name, 1) for name in ("torque_off", "dynamic_brake")
        )
        self._temperatures = None
        sources = [self._command, self.xc_ticket(), self._pressure, self._torque_off, self._brake]
        if thermal is not None:
            self._temperatures = self.DeclareVectorInputPort("motor_temperatures", 2)
            sources.append(self._temperatures)
            self._declare_output("winding_loss", 1, self._loss, *sources)
        self._declare_output("motor_current", 1, lambda c: [self._current(c)], *sources)
        self._declare_output("motor_voltage", 1, self._voltage, *sources)

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
        torque = p.inertia_kg_m2 * super()._acceleration(context)
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
        p = self.parameters(context)
        torque = p.torque_constant_n_m_per_a * self._current(context)
        return (torque - self._opposing_torque(context)) / p.inertia_kg_m2


TorqueLimitedPump_ = leaf_template(TorqueLimitedPump)
"""Template of `TorqueLimitedPump` classes by scalar type of Drake."""
