"""Full-order single-rod cylinder with the valves of its closed circuit (Lee et al. 2020, Eq. 14).

Eq. 15 does not follow from Eq. 14 as printed. Therefore three signs of Eq. 14 are corrected:
A_2 dx/dt and C_im' in the second line, and A_2 x in V_2. The paper does not say how the closed
circuit of the pump exchanges the oil that the rod displaces. The make-up and relief valves are the
usual solution.
"""

from __future__ import annotations

import math
from typing import Any

import pydrake.math as drake_math

from kneexo.errors import ParameterError
from kneexo.parameters import (
    AIR_EXPONENT,
    ATMOSPHERE_PA,
    BypassParameters,
    CylinderParameters,
    FullCylinderParameters,
)
from kneexo.systems._leaf import clip, leaf_template, smooth_step
from kneexo.systems.cylinder import (
    Cylinder,
    EndStops,
    cylinder_states,
    cylinder_values,
    start_extension,
)

# Below a vacuum oil evaporates and the model ends (the verdict says when): this bound only keeps
# the power of the pressure finite.
_LOWEST_ABSOLUTE_PA = 1e3  # the bulk modulus is constant below this pressure


def opening(excess: Any, band: Any) -> Any:
    """Return max(excess, 0), with its corner rounded by a parabola over 0…``band``.

    The opening is exactly zero where ``excess`` ≤ 0.
    """
    # Without the parabola the Jacobian, from which exact_hold and rosenbrock step, would jump where
    # a valve opens.
    rounded = clip(excess, 0.0, band)
    return rounded * (excess - 0.5 * rounded) / band


def makeup_flow(
    pressure: Any, pilot: Any, *, reservoir: Any, conductance: Any, pilot_band: Any, band: Any
) -> Any:
    """Return the flow from the reservoir into a line through its check valve, in m³/s.

    ``pilot`` is the pressure of the other line. While ``pilot`` exceeds ``pressure``, the valve is
    open for both directions of flow. Otherwise the valve opens only if ``pressure`` is below the
    pressure of the reservoir.
    """
    # With plain check valves in place of piloted ones a rod that retracts would meet the relief
    # pressure.
    deficit = reservoir - pressure
    piloted = smooth_step(pilot - pressure, pilot_band)
    return conductance * (piloted * deficit + (1.0 - piloted) * opening(deficit, band))


def relief_flow(pressure: Any, *, limit: Any, conductance: Any, band: Any) -> Any:
    """Return the flow in m³/s from a line through its relief valve, which opens above ``limit``."""
    return conductance * opening(pressure - limit, band)


def effective_bulk_modulus(pressure: Any, *, bulk_modulus: Any, entrained_air: Any) -> Any:
    """Return the bulk modulus in Pa of oil with free air; ``pressure`` is relative to atmosphere.

    1/β_e = (1/β + α (p_0/p)^(1/n)/(n p))/(1 + α (p_0/p)^(1/n)) with the absolute pressure p.
    ``entrained_air`` is α, the volume of air per volume of oil at atmospheric pressure p_0. The
    volume of the air is proportional to p^(−1/n), with the polytropic exponent n.
    """
    absolute = drake_math.max(pressure + ATMOSPHERE_PA, _LOWEST_ABSOLUTE_PA)
    air = entrained_air * (ATMOSPHERE_PA / absolute) ** (1.0 / AIR_EXPONENT)
    return (1.0 + air) / (1.0 / bulk_modulus + air / (AIR_EXPONENT * absolute))


def seal_friction(velocity: Any, p: Any) -> Any:
    """Return the friction of the seals in N, (F_c + F_s exp(−(v/v_s)²)) tanh(v/v_0).

    The friction opposes the velocity v in m/s. ``p`` has the numbers of `FullCylinderParameters`.
    """
    # tanh in place of a sign: the rate of a state must not jump where the rod reverses.
    ratio = velocity / p.stribeck_speed_m_s
    force = p.coulomb_friction_n + p.stribeck_friction_n * drake_math.exp(-ratio * ratio)
    return force * drake_math.tanh(velocity / p.friction_band_m_s)


def holding_pressures(
    force: float, cylinder: CylinderParameters, reservoir: float
) -> tuple[float, float]:
    """Return the pressures P_1 and P_2 in Pa that hold ``force`` (N, positive opposes extension).

    If ``force`` exceeds P_r (A_1 − A_2), the cap side carries the load, otherwise the rod side. The
    other chamber is at the pressure P_r of the reservoir.
    """
    cap_area, rod_side_area = cylinder.cap_area_m2, cylinder.rod_side_area_m2
    if force > reservoir * (cap_area - rod_side_area):
        return (force + reservoir * rod_side_area) / cap_area, reservoir
    return reservoir, (reservoir * cap_area - force) / rod_side_area


def context_values(
    parameters: CylinderParameters,
    full_order: FullCylinderParameters,
    pump_external_leakage_m3_per_s_pa: float,
    bypass: BypassParameters | None = None,
    stops: EndStops | None = None,
) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `FullCylinder`."""
    values = {
        **cylinder_values(parameters, "cap_area_m2", "rod_side_area_m2"),
        "pump_external_leakage_m3_per_s_pa": pump_external_leakage_m3_per_s_pa,
        **vars(full_order),
    }
    if bypass is not None:
        values["bypass_conductance_m3_per_s_pa"] = bypass.conductance_m3_per_s_pa
    return values if stops is None else values | stops._asdict()


STATE_VARIABLES = cylinder_states("cap_pressure_pa", "rod_side_pressure_pa")
"""Continuous states of `FullCylinder` in their order."""


class FullCylinder(Cylinder):
    """Full-order cylinder with its valves and the mass that it moves.

    V_1/β_e dP_1/dt = Q_1 − A_1 v − C_im' P_L − C_em1' (P_1 − P_r) + Q_m1 − Q_r1,
    V_2/β_e dP_2/dt = A_2 v − Q_2 + C_im' P_L − C_em2' (P_2 − P_r) + Q_m2 − Q_r2,
    m dv/dt = P_1 A_1 − P_2 A_2 − F_f(v) − B v − K x − F_L,
    V_1 = V_d + A_1 x, V_2 = V_d + A_2 (stroke − x), P_L = P_1 − P_2.

    With a bypass, its flows s K_b (P_1 − P_r) and s K_b (P_2 − P_r) leave the chambers for the
    reservoir, where s is the opening. Both areas displace different volumes. So a valve that only
    joined the chambers would lock the difference of the areas, or leave P (A_1 − A_2) at relief.

    Eq. 12 gives Q_1, Q_2 = Q_L ∓ C_em/2 ((P_1 − P_r) + (P_2 − P_r)), because the external leakage
    of the pump returns to the reservoir. Q_m flows from the reservoir into the line with the lower
    pressure (`makeup_flow`), and Q_r relieves both lines (`relief_flow`). The rod speed therefore
    depends on the loaded chamber, not on the direction: it is Q/A_1 where
    F_L > P_r (A_1 − A_2), which loads the cap side, and Q/A_2 otherwise.

    Near this force, by default 15.7 N, the rod can oscillate between both speeds. The literature
    calls this mode switching (Actuators 2020, 9(1), 20; Energies 2022, 15(2), 424). With
    B = 200 N·s/m a rod that retracts with 10 cm³/s is unstable by small signals at 12…23 N. After
    a step of this flow it oscillates at 2…60 N and comes to rest at 100 N. A rod that extends with
    2 cm³/s oscillates too, at 20 and 24 N, less far. Coulomb friction shifts the range of forces
    by its own amount. While the rod oscillates, Drake's ``radau3`` takes ten times as long.

    =================  ====  ===========  ===============================================
    input port         size  unit
    =================  ====  ===========  ===============================================
    load_flow          1     m³/s         Q_L, positive drives the rod out
    load_force         1     N            F_L, positive opposes extension; 0 if unconnected
    moving_mass        2     kg, kg/m     M(x) and dM/dx in place of m; m if unconnected
    bypass_opening     1     1            s, from 0 to 1; only with ``bypass``
    **output port**
    rod_extension      1     m            x, grows as the rod leaves the cylinder
    rod_velocity       1     m/s          v
    load_pressure      1     Pa           P_L = P_1 − P_2
    rod_force          1     N            load cell: m dv/dt + F_L
    rod_state          3     m, m/s, …    x, v and the acceleration
    chamber_pressures  2     Pa           P_1 (cap side) and P_2 (rod side)
    makeup_flow        2     m³/s         Q_m1 and Q_m2, positive out of the reservoir
    relief_flow        2     m³/s         Q_r1 and Q_r2, positive into the reservoir
    =================  ====  ===========  ===============================================

    State: x in m, v in m/s, P_1 and P_2 in MPa, all of order one. The cylinder starts at rest.
    Context parameters by name:
    ``cap_area_m2`` and ``rod_side_area_m2``; all names of `ReducedCylinder` except ``mean_area_m2``
    and ``total_volume_m3``; all names of `FullCylinderParameters`; and
    ``pump_external_leakage_m3_per_s_pa``, C_em of the pump. ``leakage_m3_per_s_pa`` is C_im'. With
    ``bypass``, ``bypass_conductance_m3_per_s_pa`` is K_b. With ``stops``, the names of `EndStops`.

    Source: Lee et al. 2020, Eq. 12, 14 with the signs of Eq. 14 corrected; valves, air and friction
    are assumptions. At V_1 = V_2, with equal external leakages and closed valves, dP_L/dt is Eq. 15
    with V_t = V_1 + V_2 and C_L = C_im' + C_em'/2, for any areas.

    Parameters
    ----------
    parameters, full_order
        Numbers of the cylinder, and numbers that the full order has in addition.
    initial_extension_m
        Rod extension at the start in m. None: half the stroke.
    initial_pressures_pa
        P_1 and P_2 at the start in Pa. None: pressures that hold the spring and no load.
    pump_external_leakage_m3_per_s_pa
        C_em of the pump in m³/(s·Pa).
    bypass
        Numbers of the bypass valve. None: there is none.
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
        full_order: FullCylinderParameters = FullCylinderParameters(),
        initial_extension_m: float | None = None,
        initial_pressures_pa: tuple[float, ...] | None = None,
        pump_external_leakage_m3_per_s_pa: float = 0.0,
        bypass: BypassParameters | None = None,
        stops: EndStops | None = None,
    ) -> None:
        external = pump_external_leakage_m3_per_s_pa
        self._declare_parameters(context_values(parameters, full_order, external, bypass, stops))
        extension = start_extension(parameters, initial_extension_m)
        if initial_pressures_pa is None:
            force = parameters.stiffness_n_per_m * extension
            reservoir = full_order.reservoir_pressure_pa
            initial_pressures_pa = holding_pressures(force, parameters, reservoir)
        if not all(map(math.isfinite, initial_pressures_pa)):
            raise ParameterError(
                f"initial_pressures_pa = {initial_pressures_pa} Pa: must be finite"
            )
        self._declare_rod(extension, initial_pressures_pa)
        self._opening = None
        if bypass is not None:
            self._opening = self.DeclareVectorInputPort("bypass_opening", 1)
        state, declare = self.xc_ticket(), self._declare_output
        declare("chamber_pressures", 2, lambda c: self._state(c)[2:], state)
        declare("makeup_flow", 2, lambda c: self._valve_flows(*self._numbers(c))[0], state)
        declare("relief_flow", 2, lambda c: self._valve_flows(*self._numbers(c))[1], state)

    def _load_pressure(self, state: list[Any]) -> Any:
        _, _, cap, rod_side = state
        return cap - rod_side

    def _rod_force(self, p: Any, state: list[Any]) -> Any:
        x, v, cap, rod_side = state
        friction = seal_friction(v, p)
        pressure_force = cap * p.cap_area_m2 - rod_side * p.rod_side_area_m2
        return pressure_force - friction - p.damping_n_s_per_m * v - p.stiffness_n_per_m * x

    def _valve_flows(self, p: Any, state: list[Any]) -> tuple[list[Any], list[Any]]:
        """Return the make-up flows and the relief flows of both lines in m³/s."""
        _, _, cap, rod_side = state
        makeup = [
            makeup_flow(
                pressure,
                pilot,
                reservoir=p.reservoir_pressure_pa,
                conductance=p.makeup_conductance_m3_per_s_pa,
                pilot_band=p.makeup_band_pa,
                band=p.valve_band_pa,
            )
            for pressure, pilot in ((cap, rod_side), (rod_side, cap))
        ]
        relief = [
            relief_flow(
                pressure,
                limit=p.relief_pressure_pa,
                conductance=p.relief_conductance_m3_per_s_pa,
                band=p.valve_band_pa,
            )
            for pressure in (cap, rod_side)
        ]
        return makeup, relief

    def _pressure_rates(self, context: Any, p: Any, state: list[Any]) -> dict[str, Any]:
        x, v, cap, rod_side = state
        flow = self._flow.Eval(context)[0]
        (makeup_1, makeup_2), (relief_1, relief_2) = self._valve_flows(p, state)
        above_1, above_2 = cap - p.reservoir_pressure_pa, rod_side - p.reservoir_pressure_pa
        pump_loss = 0.5 * p.pump_external_leakage_m3_per_s_pa * (above_1 + above_2)
        internal_leakage = p.leakage_m3_per_s_pa * (cap - rod_side)
        into_1 = (flow - pump_loss) - p.cap_area_m2 * v - internal_leakage
        into_1 += makeup_1 - relief_1 - p.cap_external_leakage_m3_per_s_pa * above_1
        into_2 = p.rod_side_area_m2 * v - (flow + pump_loss) + internal_leakage
        into_2 += makeup_2 - relief_2 - p.rod_side_external_leakage_m3_per_s_pa * above_2
        if self._opening is not None:
            bypass = self._opening.Eval(context)[0] * p.bypass_conductance_m3_per_s_pa
            into_1 -= bypass * above_1
            into_2 -= bypass * above_2
        volume_1 = p.dead_volume_m3 + p.cap_area_m2 * x
        volume_2 = p.dead_volume_m3 + p.rod_side_area_m2 * (p.stroke_m - x)
        return {
            name: into
            / volume
            * effective_bulk_modulus(
                pressure, bulk_modulus=p.bulk_modulus_pa, entrained_air=p.entrained_air
            )
            for name, into, volume, pressure in (
                ("cap_pressure_rate", into_1, volume_1, cap),
                ("rod_side_pressure_rate", into_2, volume_2, rod_side),
            )
        }


FullCylinder_ = leaf_template(FullCylinder)
"""Template of `FullCylinder` classes by scalar type of Drake."""
