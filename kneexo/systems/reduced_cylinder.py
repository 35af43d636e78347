"""Reduced-order single-rod cylinder and its moving mass (Lee et al. 2020, Eq. 15, 16)."""

from __future__ import annotations

import math
from typing import Any

import pydrake.math as drake_math
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression
from pydrake.systems.framework import BasicVector_, LeafSystem_

from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import CylinderParameters
from kneexo.systems._leaf import (
    NamedLeaf,
    instances_of_float,
    leaf_template,
    require_finite,
    value_or_zero,
    values_of,
)

PA_PER_MPA = 1e6


def pressure_rate(
    flow: Any,
    velocity: Any,
    pressure: Any,
    *,
    bulk_modulus: Any,
    volume: Any,
    area: Any,
    leakage: Any,
) -> Any:
    """dP_L/dt = (4 β_e/V_t)(Q_L − Ā v − C_L P_L) in Pa/s (Eq. 15)."""
    return 4.0 * bulk_modulus / volume * (flow - area * velocity - leakage * pressure)


def rod_force(
    pressure: Any, velocity: Any, extension: Any, *, area: Any, damping: Any, stiffness: Any
) -> Any:
    """Force of the rod on its load, P_L Ā − B v − K x in N (Eq. 16); positive pushes."""
    return pressure * area - damping * velocity - stiffness * extension


def start_extension(parameters: CylinderParameters, initial_extension_m: float | None) -> float:
    """Rod extension at the start in m, by default half the stroke; checks the stroke."""
    if initial_extension_m is None:
        return 0.5 * parameters.stroke_m
    if not 0.0 <= initial_extension_m <= parameters.stroke_m:
        raise ParameterError(
            f"initial_extension_m = {initial_extension_m:g} m is outside the stroke "
            f"0 … {parameters.stroke_m:g} m"
        )
    return initial_extension_m


def stroke_margin(extension: Any, stroke: Any) -> Any:
    """Distance of the rod extension to the nearer end of the stroke in m; negative outside."""
    return drake_math.min(extension, stroke - extension)


def require_in_stroke(system: Any, context: Any, extension: float, stroke: float) -> None:
    """Raise `SimulationError` when the rod extension (m) has left 0…``stroke``."""
    if not stroke_margin(extension, stroke) >= 0.0:
        raise SimulationError(
            f"t = {context.get_time():.6g} s: {system.get_name()}: rod_extension = "
            f"{extension:.6g} m left the stroke 0 … {stroke:g} m; reduce the motion, the load or "
            f"the step"
        )


def context_values(parameters: CylinderParameters) -> dict[str, float]:
    """Context parameters of `ReducedCylinder`."""
    return values_of(
        parameters,
        "mean_area_m2",
        "total_volume_m3",
        "bulk_modulus_pa",
        "leakage_m3_per_s_pa",
        "mass_kg",
        "damping_n_s_per_m",
        "stiffness_n_per_m",
        "stroke_m",
    )


@leaf_template(__name__, "ReducedCylinder_")
def ReducedCylinder_(T: Any) -> Any:
    """Reduced-order cylinder for the scalar ``T``."""

    class Impl(NamedLeaf, LeafSystem_[T]):
        """Reduced-order cylinder with the mass that it moves.

        dP_L/dt = (4 β_e/V_t)(Q_L − Ā v − C_L P_L),  m dv/dt = P_L Ā − B v − K x − F_L.

        ==============  ====  ===========  ===============================================
        input port      size  unit
        ==============  ====  ===========  ===============================================
        load_flow       1     m³/s         Q_L, positive drives the rod out
        load_force      1     N            F_L, positive opposes extension; 0 if unconnected
        **output port**
        rod_extension   1     m            x, grows as the rod leaves the cylinder
        rod_velocity    1     m/s          v
        load_pressure   1     Pa           P_L = P_1 − P_2, positive pushes the rod out
        rod_force       1     N            load cell: P_L Ā − B v − K x = m dv/dt + F_L
        rod_state       3     m, m/s, …    x, v and the acceleration
        ==============  ====  ===========  ===============================================

        State: x in m, v in m/s, P_L in MPa (order one). Context parameters by name:
        ``mean_area_m2, total_volume_m3, bulk_modulus_pa, leakage_m3_per_s_pa, mass_kg,
        damping_n_s_per_m, stiffness_n_per_m, stroke_m``.

        Raises `ParameterError` when it would start outside the stroke; `SimulationError` at the
        end of a step that leaves the stroke, and when a derivative is not finite. Source: Lee et
        al. 2020, Eq. 15, 16; Eq. 15 holds at V_1 = V_2, and Eq. 16 drops the
        force (P_1 + P_2)(A_1 − A_2)/2.
        """

        def _construct(
            self,
            parameters: CylinderParameters = CylinderParameters(),
            initial_extension_m: float | None = None,
            initial_pressure_pa: float = 0.0,
            *,
            converter: Any = None,
        ) -> None:
            self._begin(T, converter, parameters, initial_extension_m, initial_pressure_pa)
            self._declare_parameters(context_values(parameters))
            extension = start_extension(parameters, initial_extension_m)
            if not math.isfinite(initial_pressure_pa):
                raise ParameterError(
                    f"initial_pressure_pa = {initial_pressure_pa} Pa: must be finite"
                )
            self._flow = self.DeclareVectorInputPort("load_flow", 1)
            self._force = self.DeclareVectorInputPort("load_force", 1)
            self.DeclareContinuousState(
                BasicVector_[T]([extension, 0.0, initial_pressure_pa / PA_PER_MPA])
            )
            state, given = self.xc_ticket(), self.all_parameters_ticket()
            declare = self._declare_output
            declare("rod_extension", 1, lambda c: self._state(c)[:1], state)
            declare("rod_velocity", 1, lambda c: self._state(c)[1:2], state)
            declare("load_pressure", 1, lambda c: self._state(c)[2:], state)
            declare("rod_force", 1, lambda c: [self._rod_force(c)], state, given)
            declare("rod_state", 3, self._motion, state, given, self._force)
            if T not in (AutoDiffXd, Expression):
                self.DeclarePerStepPublishEvent(self._check)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(self, *other._arguments, converter=converter)

        def _state(self, context: Any) -> list[Any]:
            """X in m, v in m/s, P_L in Pa."""
            x, v, pressure = context.get_continuous_state_vector().CopyToVector().tolist()
            return [x, v, PA_PER_MPA * pressure]

        def _rod_force(self, context: Any) -> Any:
            p = self.parameters(context)
            x, v, pressure = self._state(context)
            return rod_force(
                pressure,
                v,
                x,
                area=p.mean_area_m2,
                damping=p.damping_n_s_per_m,
                stiffness=p.stiffness_n_per_m,
            )

        def _motion(self, context: Any) -> list[Any]:
            x, v, _ = self._state(context)
            force = self._rod_force(context) - value_or_zero(self._force, context)
            return [x, v, force / self.parameters(context).mass_kg]

        def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
            p = self.parameters(context)
            _, v, pressure = self._state(context)
            pressure_dot = pressure_rate(
                self._flow.Eval(context)[0],
                v,
                pressure,
                bulk_modulus=p.bulk_modulus_pa,
                volume=p.total_volume_m3,
                area=p.mean_area_m2,
                leakage=p.leakage_m3_per_s_pa,
            )
            _, _, acceleration = self._motion(context)
            require_finite(self, context, rod_acceleration=acceleration, pressure_rate=pressure_dot)
            vector = derivatives.get_mutable_vector()
            vector.SetAtIndex(0, v)
            vector.SetAtIndex(1, acceleration)
            vector.SetAtIndex(2, pressure_dot / PA_PER_MPA)

        def margin(self, context: Any) -> Any:
            """Distance to the nearer end of the stroke in m; a compiled run stops below zero."""
            return stroke_margin(self._state(context)[0], self.parameters(context).stroke_m)

        def _check(self, context: Any) -> None:
            stroke = self.parameters(context).stroke_m
            require_in_stroke(self, context, self._state(context)[0], stroke)

    return Impl


__getattr__ = instances_of_float(__name__)
