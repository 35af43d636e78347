"""Reduced-order single-rod cylinder and its moving mass (Lee et al. 2020, Eq. 15, 16)."""

from __future__ import annotations

import math
from typing import Any

from kneexo.errors import ParameterError
from kneexo.parameters import CylinderParameters
from kneexo.systems._leaf import leaf_template
from kneexo.systems.cylinder import (
    Cylinder,
    EndStops,
    cylinder_states,
    cylinder_values,
    start_extension,
)


def context_values(
    parameters: CylinderParameters, stops: EndStops | None = None
) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `ReducedCylinder`."""
    values = cylinder_values(parameters, "mean_area_m2", "total_volume_m3")
    return values if stops is None else values | stops._asdict()


STATE_VARIABLES = cylinder_states("load_pressure_pa")
"""Continuous states of `ReducedCylinder` in their order."""


class ReducedCylinder(Cylinder):
    """Reduced-order cylinder with the mass that it moves.

    dP_L/dt = (4 β_e/V_t)(Q_L − Ā v − C_L P_L),  m dv/dt = P_L Ā − B v − K x − F_L.

    ===============  ====  ===========  ===============================================
    input port       size  unit
    ===============  ====  ===========  ===============================================
    load_flow        1     m³/s         Q_L, positive drives the rod out
    load_force       1     N            F_L, positive opposes extension; 0 if unconnected
    moving_mass      2     kg, kg/m     M(x) and dM/dx in place of m; m if unconnected
    **output port**
    rod_extension    1     m            x, grows as the rod leaves the cylinder
    rod_velocity     1     m/s          v
    load_pressure    1     Pa           P_L = P_1 − P_2, positive pushes the rod out
    rod_force        1     N            load cell: P_L Ā − B v − K x = m dv/dt + F_L
    rod_state        3     m, m/s, …    x, v and the acceleration
    ===============  ====  ===========  ===============================================

    State: x in m, v in m/s, P_L in MPa, all of order one. Context parameters by name:
    ``mean_area_m2, total_volume_m3, bulk_modulus_pa, leakage_m3_per_s_pa, mass_kg,
    damping_n_s_per_m, stiffness_n_per_m, stroke_m``, and with ``stops`` the names of `EndStops`.

    Source: Lee et al. 2020, Eq. 15, 16. Eq. 15 is exact at V_1 = V_2, and Eq. 16 neglects the force
    (P_1 + P_2)(A_1 − A_2)/2.

    Parameters
    ----------
    parameters
        Numbers of the cylinder.
    initial_extension_m
        Rod extension at the start in m. None: half the stroke.
    initial_pressure_pa
        P_L at the start in Pa.
    stops
        End stops of the rod. None: nothing stops it.

    Raises
    ------
    ParameterError
        The rod would start outside the stroke.
    SimulationError
        The rod is outside the stroke at the end of a step, or a derivative is not finite.
    """

    def __init__(
        self,
        parameters: CylinderParameters = CylinderParameters(),
        initial_extension_m: float | None = None,
        initial_pressure_pa: float = 0.0,
        stops: EndStops | None = None,
    ) -> None:
        self._declare_parameters(context_values(parameters, stops))
        extension = start_extension(parameters, initial_extension_m)
        if not math.isfinite(initial_pressure_pa):
            raise ParameterError(f"initial_pressure_pa = {initial_pressure_pa} Pa: must be finite")
        self._declare_rod(extension, [initial_pressure_pa])

    def _load_pressure(self, state: list[Any]) -> Any:
        return state[2]

    def _rod_force(self, p: Any, state: list[Any]) -> Any:
        x, v, pressure = state
        return pressure * p.mean_area_m2 - p.damping_n_s_per_m * v - p.stiffness_n_per_m * x

    def _pressure_rates(self, context: Any, p: Any, state: list[Any]) -> dict[str, Any]:
        _, v, pressure = state
        flow = self._flow.Eval(context)[0] - p.mean_area_m2 * v - p.leakage_m3_per_s_pa * pressure
        return {"pressure_rate": 4.0 * p.bulk_modulus_pa / p.total_volume_m3 * flow}


ReducedCylinder_ = leaf_template(ReducedCylinder)
"""Template of `ReducedCylinder` classes by scalar type of Drake."""
