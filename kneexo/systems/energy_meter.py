"""Integrates the powers of a full-order actuator and its load, for an energy balance."""

from __future__ import annotations

from typing import Any

from kneexo.parameters import (
    BldcPumpParameters,
    CylinderParameters,
    FullCylinderParameters,
    KneeLoadParameters,
    NoLoad,
)
from kneexo.systems import full_cylinder, knee_load
from kneexo.systems._leaf import NamedLeaf, fill, leaf_template, values_of

ENERGIES = (
    "motor_j",
    "reservoir_j",
    "wearer_j",
    "leakage_j",
    "valves_j",
    "friction_j",
    "load_j",
    "displaced_j",
)
"""Names of the energies of `EnergyMeter`, in the order of its state and output."""

_INPUTS = {
    "shaft_power": 1,
    "rod_extension": 1,
    "rod_velocity": 1,
    "chamber_pressures": 2,
    "makeup_flow": 2,
    "relief_flow": 2,
    "knee_angle": 1,
    "moment_arm": 1,
}


class EnergyMeter(NamedLeaf):
    """Energies that flow through a full-order actuator since t = 0, in J.

    With E_i = (C_em + C_em,i') (P_i − P_r), the external leakage of chamber i, the powers are

    motor τ ω, reservoir P_r Σ(Q_mi − Q_ri − E_i), wearer τ_i dθ/dt,
    leakage (C_im + C_im') P_L² + Σ E_i (P_i − P_r), valves Σ[Q_mi (P_r − P_i) + Q_ri (P_i − P_r)],
    friction (F_f + B v) v, load F_L v, displaced (P_1² A_1 − P_2² A_2) v/(2 β_e).

    The first three powers flow into actuator and oil, the next four out of actuator and oil. The
    load is weight, constant torque and disturbance of `KneeLoad`. The oil stores Σ V_i P_i²/(2 β_e)
    minus the displaced energy, because the volumes V_i change under pressure.

    Context parameters by name: all names of `FullCylinder`, ``internal_leakage_m3_per_s_pa`` of the
    pump, and, with a load, all names of `KneeLoad`.

    =================  ====  =====  =============================================
    input port         size  unit
    =================  ====  =====  =============================================
    shaft_power        1     W      τ ω of the motor
    rod_extension      1     m      x
    rod_velocity       1     m/s    v
    chamber_pressures  2     Pa     P_1 and P_2
    makeup_flow        2     m³/s   Q_m1 and Q_m2, out of the reservoir
    relief_flow        2     m³/s   Q_r1 and Q_r2, into the reservoir
    knee_angle         1     rad    θ
    moment_arm         1     m      r
    interaction_power  2     W      power of the wearer, power into the exoskeleton; 0 unconnected
    **output port**
    energies           8     J      `ENERGIES`
    =================  ====  =====  =============================================

    State: the energies. Source: Lee et al. 2020, Eq. 12, 14, 16, each multiplied by its pressure or
    speed.

    Parameters
    ----------
    pump, cylinder, full_order, load
        Numbers of the motor with its pump, of the cylinder, of its full order, and of the load.
    """

    def __init__(
        self,
        pump: BldcPumpParameters = BldcPumpParameters(),
        cylinder: CylinderParameters = CylinderParameters(),
        full_order: FullCylinderParameters = FullCylinderParameters(),
        load: KneeLoadParameters | NoLoad = NoLoad(),
    ) -> None:
        self._loaded = isinstance(load, KneeLoadParameters)
        external = pump.external_leakage_m3_per_s_pa
        self._declare_parameters(
            full_cylinder.context_values(cylinder, full_order, external)
            | values_of(pump, "internal_leakage_m3_per_s_pa")
            | (knee_load.context_values(load) if isinstance(load, KneeLoadParameters) else {})
        )
        self._ports = {name: self.DeclareVectorInputPort(name, n) for name, n in _INPUTS.items()}
        self._wearer = self.DeclareVectorInputPort("interaction_power", 2)
        # The solver of the run integrates the powers, because records of 2 ms cannot resolve the
        # 447 Hz mode of the oil.
        self.DeclareContinuousState(len(ENERGIES))
        self._declare_output(
            "energies",
            len(ENERGIES),
            lambda c: c.get_continuous_state_vector().CopyToVector().tolist(),
            self.xc_ticket(),
        )

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
        """Set the powers in W."""
        p = self.parameters(context)
        signals = {name: port.Eval(context) for name, port in self._ports.items()}
        wearer = self._wearer.Eval(context)[1] if self._wearer.HasValue(context) else 0.0
        load = 0.0
        if self._loaded:
            angle, arm = signals["knee_angle"][0], signals["moment_arm"][0]
            force = knee_load.load_force(p, angle, arm, context.get_time())
            load = force * signals["rod_velocity"][0]
        reservoir, leakage, valves = _oil_powers(p, signals)
        friction, displaced = _rod_powers(p, signals)
        powers = (
            signals["shaft_power"][0],
            reservoir,
            wearer,
            leakage,
            valves,
            friction,
            load,
            displaced,
        )
        fill(derivatives.get_mutable_vector(), powers)


def _oil_powers(p: Any, signals: dict[str, Any]) -> tuple[Any, Any, Any]:
    """Return the powers of reservoir, leakage and valves in W."""
    cap, rod_side = signals["chamber_pressures"]
    p_r, pump = p.reservoir_pressure_pa, p.pump_external_leakage_m3_per_s_pa
    external_coefficients = (
        pump + p.cap_external_leakage_m3_per_s_pa,
        pump + p.rod_side_external_leakage_m3_per_s_pa,
    )
    internal_coefficient = p.internal_leakage_m3_per_s_pa + p.leakage_m3_per_s_pa
    reservoir, valves = 0.0, 0.0
    leakage = internal_coefficient * (cap - rod_side) * (cap - rod_side)
    for pressure, coefficient, makeup, relief in zip(
        (cap, rod_side),
        external_coefficients,
        signals["makeup_flow"],
        signals["relief_flow"],
        strict=True,
    ):
        over_reservoir = pressure - p_r
        external_leakage = coefficient * over_reservoir
        reservoir = reservoir + p_r * (makeup - relief - external_leakage)
        leakage = leakage + external_leakage * over_reservoir
        valves = valves + (relief - makeup) * over_reservoir
    return reservoir, leakage, valves


def _rod_powers(p: Any, signals: dict[str, Any]) -> tuple[Any, Any]:
    """Return the power of friction and the rate of the displaced energy in W."""
    (cap, rod_side), (velocity,) = signals["chamber_pressures"], signals["rod_velocity"]
    seals = full_cylinder.seal_friction(velocity, p)
    friction = (seals + p.damping_n_s_per_m * velocity) * velocity
    # Volumes change under pressure: without this energy the stored energy is wrong by 0.15 J in a
    # stride with a wearer.
    p2_a = cap * cap * p.cap_area_m2 - rod_side * rod_side * p.rod_side_area_m2
    return friction, 0.5 * p2_a * velocity / p.bulk_modulus_pa


EnergyMeter_ = leaf_template(EnergyMeter)
"""Template of `EnergyMeter` classes by scalar type of Drake."""
