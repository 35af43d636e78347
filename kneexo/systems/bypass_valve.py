"""Bypass valve: how far it is open, with the lag of its solenoid."""

from __future__ import annotations

from typing import Any

from pydrake.systems.framework import BasicVector_

from kneexo.parameters import BypassParameters
from kneexo.systems._leaf import NamedLeaf, clip, leaf_template, value_or_zero, values_of
from kneexo.systems.state_variable import StateVariable


def context_values(parameters: BypassParameters) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `BypassValve`."""
    return values_of(parameters, "time_constant_s", "minimum_opening")


STATE_VARIABLES = (StateVariable("bypass_valve_travel"),)
"""Continuous state of `BypassValve`."""


class BypassValve(NamedLeaf):
    """Computes how far the bypass valve is open. `FullCylinder` computes the flows through it.

    ds/dt = (clip(u, 0, 1) − s)/τ, and the opening is s_min + (1 − s_min) s.

    ===============  ====  ====  =======================================================
    input port       size  unit
    ===============  ====  ====  =======================================================
    bypass           1     1     u, 1 opens the valve fully; 0 if unconnected
    **output port**
    bypass_opening   1     1     0 is closed, 1 is fully open
    ===============  ====  ====  =======================================================

    The state is the travel s, 0 at the start. Context parameters by name: ``time_constant_s`` (τ)
    and ``minimum_opening`` (s_min). A valve that its spring opens without power has u = 1 when
    power is lost. A valve that its spring closes has u = 0. Source: an assumption, Lee et al. 2020
    have no bypass.
    """

    def __init__(self, parameters: BypassParameters = BypassParameters()) -> None:
        self._declare_parameters(context_values(parameters))
        self._command = self.DeclareVectorInputPort("bypass", 1)
        self.DeclareContinuousState(BasicVector_[self._scalar]([0.0]))
        self._declare_output("bypass_opening", 1, self._opening, self.xc_ticket())

    def _opening(self, context: Any) -> list[Any]:
        least = self.parameters(context).minimum_opening
        return [least + (1.0 - least) * context.get_continuous_state_vector().GetAtIndex(0)]

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
        """Set the speed of the valve in 1/s."""
        command = clip(value_or_zero(self._command, context), 0.0, 1.0)
        travel = context.get_continuous_state_vector().GetAtIndex(0)
        speed = (command - travel) / self.parameters(context).time_constant_s
        derivatives.get_mutable_vector().SetAtIndex(0, speed)


BypassValve_ = leaf_template(BypassValve)
"""Template of `BypassValve` classes by scalar type of Drake."""
