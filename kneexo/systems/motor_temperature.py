"""Temperatures of winding and case of the motor."""

from __future__ import annotations

from typing import Any

from pydrake.systems.framework import BasicVector_

from kneexo.parameters import ThermalParameters
from kneexo.systems._leaf import NamedLeaf, fill, leaf_template, values_of
from kneexo.systems.state_variable import StateVariable

DEGC_PER_STATE = 100.0
"""Number of °C in a unit of the states, which are of order one."""


def context_values(parameters: ThermalParameters) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `MotorTemperature`."""
    return values_of(
        parameters,
        "winding_capacity_j_per_k",
        "case_capacity_j_per_k",
        "winding_to_case_k_per_w",
        "case_to_air_k_per_w",
        "air_degc",
    )


STATE_VARIABLES = (
    StateVariable("winding_temperature_degc", DEGC_PER_STATE),
    StateVariable("case_temperature_degc", DEGC_PER_STATE),
)
"""Continuous states of `MotorTemperature` in their order."""


class MotorTemperature(NamedLeaf):
    """Winding and case of the motor as two thermal masses, each with one uniform temperature.

    C_w dT_w/dt = P − (T_w − T_c)/R_wc,  C_c dT_c/dt = (T_w − T_c)/R_wc − (T_c − T_a)/R_ca.

    ==================  ====  ====  ===============================================
    input port          size  unit
    ==================  ====  ====  ===============================================
    winding_loss        1     W     P, heat of the current
    **output port**
    motor_temperatures  2     °C    T_w of the winding, T_c of the case
    ==================  ====  ====  ===============================================

    The states are the temperatures in 100 °C, ``start_degc`` at the start. Context parameters by
    name: ``winding_capacity_j_per_k`` (C_w), ``case_capacity_j_per_k`` (C_c),
    ``winding_to_case_k_per_w`` (R_wc), ``case_to_air_k_per_w`` (R_ca) and ``air_degc`` (T_a).
    Friction of the shaft heats nothing. Source: the model of two resistances and two time constants
    that motors' data sheets assume.
    """

    def __init__(self, parameters: ThermalParameters = ThermalParameters()) -> None:
        self._declare_parameters(context_values(parameters))
        self._loss = self.DeclareVectorInputPort("winding_loss", 1)
        start = parameters.start_degc / DEGC_PER_STATE
        self.DeclareContinuousState(BasicVector_[self._scalar]([start, start]))
        self._declare_output("motor_temperatures", 2, self._temperatures, self.xc_ticket())

    def _temperatures(self, context: Any) -> list[Any]:
        states = context.get_continuous_state_vector().CopyToVector().tolist()
        return [DEGC_PER_STATE * state for state in states]

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
        """Set the rates of both temperatures."""
        p = self.parameters(context)
        winding, case = self._temperatures(context)
        to_case = (winding - case) / p.winding_to_case_k_per_w
        to_air = (case - p.air_degc) / p.case_to_air_k_per_w
        rates = (
            (self._loss.Eval(context)[0] - to_case) / p.winding_capacity_j_per_k,
            (to_case - to_air) / p.case_capacity_j_per_k,
        )
        fill(derivatives.get_mutable_vector(), [rate / DEGC_PER_STATE for rate in rates])


MotorTemperature_ = leaf_template(MotorTemperature)
"""Template of `MotorTemperature` classes by scalar type of Drake."""
