"""Load of the rod: weight of the shank, torque of the wearer, and disturbance."""

from __future__ import annotations

import math
from typing import Any

import pydrake.math as drake_math

from kneexo.parameters import KneeLoadParameters
from kneexo.systems._leaf import NamedLeaf, leaf_template, value_or_zero


def weight_torque(
    knee_angle: Any, *, mass: Any, centre_of_mass: Any, thigh_inclination: Any, gravity: Any
) -> Any:
    """Return the torque m g l sin(α − θ_p) of the shank's weight in N·m, positive in flexion.

    θ_p is ``knee_angle``, l ``centre_of_mass`` and α ``thigh_inclination``.
    """
    return mass * gravity * centre_of_mass * drake_math.sin(thigh_inclination - knee_angle)


def load_force(
    p: Any,
    knee_angle: Any,
    moment_arm: Any,
    time: Any,
    *,
    torque: Any = 0.0,
    disturbance: Any = 0.0,
) -> Any:
    """Return the force F_L of `KneeLoad` on the rod in N; positive opposes extension.

    ``p`` has the values of `KneeLoadParameters` as attributes. ``torque`` (N·m) and ``disturbance``
    (N) are added to the torque and disturbance of ``p``.
    """
    torque = (
        weight_torque(
            knee_angle,
            mass=p.segment_mass_kg,
            centre_of_mass=p.centre_of_mass_m,
            thigh_inclination=p.thigh_inclination_rad,
            gravity=p.gravity_m_s2,
        )
        + p.knee_torque_n_m
        + torque
    )
    phase = 2.0 * math.pi * p.disturbance_frequency_hz * time
    disturbance = p.disturbance_n + p.disturbance_amplitude_n * drake_math.sin(phase) + disturbance
    return torque / moment_arm + disturbance


def moving_mass(inertia: Any, moment_arm: Any, slope: Any) -> list[Any]:
    """Return the mass M = I/r² in kg that moves with the rod, and dM/dx in kg/m.

    ``slope`` is dr/dx, the change of the moment arm with the rod extension.
    """
    mass = inertia / (moment_arm * moment_arm)
    return [mass, -2.0 * mass * slope / moment_arm]


def context_values(parameters: KneeLoadParameters) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `KneeLoad`."""
    return {name: value for name, value in parameters if name != "kind" and value is not None}


class KneeLoad(NamedLeaf):
    """Computes the force that the leg exerts on the rod.

    F_L = (m g l sin(α − θ_p) + τ_0 + τ)/r + F_0 + F_1 sin(2πft) + F.

    =================  ====  ====  ======================================================
    input port         size  unit
    =================  ====  ====  ======================================================
    knee_angle         1     rad   θ_p
    moment_arm         1     m     r = −dx/dθ_p
    knee_torque        1     N·m   τ of the wearer, positive flexes; 0 if unconnected
    disturbance_force  1     N     F, positive opposes extension; 0 if unconnected
    moment_arm_slope   1     1     dr/dx, only with an inertia
    **output port**
    load_force         1     N     F_L, positive opposes extension of the rod
    moving_mass        2     kg,…  M = I/r² and dM/dx in kg/m, only with an inertia I
    =================  ====  ====  ======================================================

    Stateless. Context parameters by name: all numbers of `KneeLoadParameters` that are not None.
    The load force does not contain the inertial force. A torque that flexes
    the knee pushes the rod in: −F_L dx/dt = τ dθ_p/dt gives F_L = τ/r. While the thigh hangs
    (α = 0), the weight of the shank helps extension. Source: Lee et al. 2020, Eq. 16 contains F_L,
    but the paper does not specify F_L.
    """

    def __init__(self, parameters: KneeLoadParameters = KneeLoadParameters()) -> None:
        self._declare_parameters(context_values(parameters))
        self._angle = self.DeclareVectorInputPort("knee_angle", 1)
        self._arm = self.DeclareVectorInputPort("moment_arm", 1)
        self._torque = self.DeclareVectorInputPort("knee_torque", 1)
        self._disturbance = self.DeclareVectorInputPort("disturbance_force", 1)
        inputs = (self._angle, self._arm, self._torque, self._disturbance)
        self._declare_output("load_force", 1, self._calc, *inputs, self.time_ticket())
        if parameters.inertia_kg_m2 is not None:
            self._slope = self.DeclareVectorInputPort("moment_arm_slope", 1)
            self._declare_output("moving_mass", 2, self._calc_mass, self._arm, self._slope)

    def _calc_mass(self, context: Any) -> list[Any]:
        inertia = self.parameters(context).inertia_kg_m2
        return moving_mass(inertia, self._arm.Eval(context)[0], self._slope.Eval(context)[0])

    def _calc(self, context: Any) -> list[Any]:
        return [
            load_force(
                self.parameters(context),
                self._angle.Eval(context)[0],
                self._arm.Eval(context)[0],
                context.get_time(),
                torque=value_or_zero(self._torque, context),
                disturbance=value_or_zero(self._disturbance, context),
            )
        ]


KneeLoad_ = leaf_template(KneeLoad)
"""Template of `KneeLoad` classes by scalar type of Drake."""
