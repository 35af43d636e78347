"""Base class of the single-rod cylinders of reduced and of full order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import pydrake.math as drake_math
from pydrake.systems.framework import BasicVector_

from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import CylinderParameters
from kneexo.systems._leaf import (
    NamedLeaf,
    fill,
    require_finite,
    value_or_zero,
    values_of,
)
from kneexo.systems.state_variable import StateVariable

# Solvers bound the error of a state in its own unit, so all states are of order one. With pressures
# in Pa Drake's default integrator takes 979 steps for 0.01 s of the closed loop, with MPa 19.
PA_PER_MPA = 1e6
"""Number of Pa in a MPa. Pressures are states in MPa and outputs in Pa."""


class EndStops(NamedTuple):
    """Stops of the rod. The names are those of Context parameters of a `Cylinder`."""

    stop_low_m: float
    """Extension at which the rod meets the stop inside the cylinder."""
    stop_high_m: float
    """Extension at which the rod meets the outer stop."""
    stop_stiffness_n_per_m: float
    stop_dissipation_s_per_m: float


def stop_force(extension: Any, velocity: Any, p: Any) -> Any:
    """Return the force of both stops on the rod in N, positive where it pushes the rod out.

    F = k δ max(1 + c dδ/dt, 0) at a penetration δ, so a stop never pulls. ``p`` has the numbers of
    `EndStops`. Source: Hunt and Crossley 1975, with a linear spring.
    """
    inside = drake_math.max(p.stop_low_m - extension, 0.0)
    outside = drake_math.max(extension - p.stop_high_m, 0.0)
    damped = p.stop_dissipation_s_per_m * velocity
    inward = inside * drake_math.max(1.0 - damped, 0.0)
    outward = outside * drake_math.max(1.0 + damped, 0.0)
    return p.stop_stiffness_n_per_m * (inward - outward)


def start_extension(parameters: CylinderParameters, initial_extension_m: float | None) -> float:
    """Return the initial rod extension in m; None means half the stroke.

    Raises `ParameterError` when the extension lies outside the stroke.
    """
    if initial_extension_m is None:
        return 0.5 * parameters.stroke_m
    if not 0.0 <= initial_extension_m <= parameters.stroke_m:
        raise ParameterError(
            f"initial_extension_m = {initial_extension_m:g} m is outside the stroke "
            f"0 … {parameters.stroke_m:g} m"
        )
    return initial_extension_m


def cylinder_values(parameters: CylinderParameters, *others: str) -> dict[str, float]:
    """Read the Context parameters of a `Cylinder` from ``parameters``: {name: value}.

    The order is that of the Context. ``others`` are names of further attributes of ``parameters``,
    which only one kind of cylinder needs. They come first.
    """
    return values_of(
        parameters,
        *others,
        "bulk_modulus_pa",
        "leakage_m3_per_s_pa",
        "mass_kg",
        "damping_n_s_per_m",
        "stiffness_n_per_m",
        "stroke_m",
    )


def cylinder_states(*pressures: str) -> tuple[StateVariable, ...]:
    """Return the states of a `Cylinder` in order; ``pressures`` are names of columns in Pa."""
    rod = (StateVariable("rod_extension_m"), StateVariable("rod_velocity_m_s"))
    return (*rod, *(StateVariable(column, PA_PER_MPA) for column in pressures))


class Cylinder(NamedLeaf):
    """Base of the cylinders of reduced and full order, with common ports: m dv/dt = F_rod − F_L.

    If the input ``moving_mass`` is connected, the mass M(x) of the input replaces m. Lagrange's
    equation of the kinetic energy ½ M v² is then M dv/dt + ½ (dM/dx) v² = F_rod − F_L. With
    `EndStops` F_rod includes `stop_force`.

    State: x in m, v in m/s and the pressures in MPa, all of order one. A subclass defines load
    pressure, rod force and pressure rates. Raises `SimulationError` if the rod is outside the
    stroke at the end of a step, and if a derivative is not finite.
    """

    def _declare_rod(self, extension: float, pressures_pa: Sequence[float]) -> None:
        """Declare the common ports and the initial state: the rod at rest at an extension in m."""
        self._flow = self.DeclareVectorInputPort("load_flow", 1)
        self._force = self.DeclareVectorInputPort("load_force", 1)
        self._mass = self.DeclareVectorInputPort("moving_mass", 2)
        pressures = [pressure / PA_PER_MPA for pressure in pressures_pa]
        self.DeclareContinuousState(BasicVector_[self._scalar]([extension, 0.0, *pressures]))
        state, declare = self.xc_ticket(), self._declare_output
        declare("rod_extension", 1, lambda c: self._state(c)[:1], state)
        declare("rod_velocity", 1, lambda c: self._state(c)[1:2], state)
        declare("load_pressure", 1, lambda c: [self._load_pressure(self._state(c))], state)
        declare("rod_force", 1, lambda c: [self._stopped_force(*self._numbers(c))], state)
        sources = (state, self._force, self._mass)
        declare("rod_state", 3, lambda c: self._motion(c, *self._numbers(c)), *sources)
        self._declare_check(self._require_in_stroke)

    def _load_pressure(self, state: list[Any]) -> Any:
        """Return the load pressure P_L in Pa for a state in SI units."""
        raise NotImplementedError

    def _rod_force(self, p: Any, state: list[Any]) -> Any:
        """Return the force of the rod on its load in N, positive when the rod pushes."""
        raise NotImplementedError

    def _stopped_force(self, p: Any, state: list[Any]) -> Any:
        """Return the force of rod and stops on the load in N."""
        force = self._rod_force(p, state)
        if EndStops._fields[0] in self.parameter_names:
            force = force + stop_force(state[0], state[1], p)
        return force

    def _pressure_rates(self, context: Any, p: Any, state: list[Any]) -> dict[str, Any]:
        """Return a dictionary from pressure name to its rate in Pa/s, in the order of the state."""
        raise NotImplementedError

    def _state(self, context: Any) -> list[Any]:
        """Return the state in SI units: x in m, v in m/s and the pressures in Pa."""
        x, v, *pressures = context.get_continuous_state_vector().CopyToVector().tolist()
        return [x, v, *[PA_PER_MPA * pressure for pressure in pressures]]

    def _numbers(self, context: Any) -> tuple[Any, list[Any]]:
        """Return the Context parameters and the state in SI units, to read each only once."""
        return self.parameters(context), self._state(context)

    def _motion(self, context: Any, p: Any, state: list[Any]) -> list[Any]:
        """Return x, v and the acceleration dv/dt in SI units."""
        force = self._stopped_force(p, state) - value_or_zero(self._force, context)
        mass = p.mass_kg
        if self._mass.HasValue(context):
            mass, slope = self._mass.Eval(context)
            force -= 0.5 * slope * state[1] * state[1]
        return [*state[:2], force / mass]

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
        """Set dx/dt, dv/dt and the pressure rates.

        Raises `SimulationError` when one of these rates is not finite.
        """
        p, state = self._numbers(context)
        _, v, acceleration = self._motion(context, p, state)
        rates = self._pressure_rates(context, p, state)
        require_finite(self, context, rod_acceleration=acceleration, **rates)
        scaled = (rate / PA_PER_MPA for rate in rates.values())
        fill(derivatives.get_mutable_vector(), (v, acceleration, *scaled))

    def margin(self, context: Any) -> Any:
        """Return the distance to the nearer end of the stroke in m.

        A compiled run stops when this distance falls below zero.
        """
        x, *_ = self._state(context)
        return drake_math.min(x, self.parameters(context).stroke_m - x)

    def _require_in_stroke(self, context: Any) -> None:
        if not self.margin(context) >= 0.0:
            raise SimulationError(
                f"t = {context.get_time():.6g} s: {self.get_name()}: rod_extension = "
                f"{self._state(context)[0]:.6g} m left the stroke 0 … "
                f"{self.parameters(context).stroke_m:g} m; reduce the motion, the load, the push, "
                f"the fault or the step"
            )
