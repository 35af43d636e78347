"""Computes force, speed and pressure of an actuator that carries the moment of a whole stride.

Unlike `kneexo.analysis.walking.walking`, the moment includes the reaction of the ground in stance
and the braking of the leg in late swing.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import scipy

from kneexo.analysis.frequency.bandwidth import rod_limits
from kneexo.analysis.signals import share_above
from kneexo.analysis.walking.walking import moment_arm_m
from kneexo.common.files.reading import file_error
from kneexo.common.files.table import read_table
from kneexo.common.result import Array, Result, data_frame
from kneexo.errors import ParameterError
from kneexo.parameters import FullCylinderParameters, Scenario
from kneexo.parameters.device.plant import LOWEST_PRESSURE_PA
from kneexo.parameters.task.gait import gait_knee_moment
from kneexo.parameters.task.reference import LONGEST_TIME_S
from kneexo.parameters.wearer.wearer import LARGEST_MOMENT_N_M
from kneexo.systems.full_cylinder import holding_pressures

_SHORTEST_SAMPLE_S = 1e-6
_FEWEST_SAMPLES = 4  # of a cubic spline


@dataclass(frozen=True, repr=False)
class StrideLoad(Result):
    """Quasi-static load of the actuator in a stride, each array (n,). `stride_load` computes it."""

    time_s: Array
    knee_angle_deg: Array
    knee_moment_n_m: Array
    """Moment of the actuator on the knee, positive in flexion."""
    rod_force_n: Array
    rod_speed_m_s: Array
    knee_power_w: Array
    """Power of the actuator into the knee, negative where the knee drives the actuator."""
    load_pressure_pa: Array
    """Load pressure P_L of the reduced order."""
    cap_pressure_pa: Array
    """Pressure P_1 of the full order."""
    rod_side_pressure_pa: Array
    """Pressure P_2 of the full order."""
    overrun_pressure_pa: Array
    """Pressure of the chamber that grows, if the leg moves the rod faster than the pump can."""
    rod_speed_limit_m_s: float
    relief_pressure_pa: float

    @property
    def share_within_speed(self) -> float:
        """Share of the samples in which the pump can follow the rod."""
        return 1.0 - share_above(self.rod_speed_m_s, self.rod_speed_limit_m_s)

    def events(self) -> dict[str, int]:
        """Return a dictionary from the name of an event to the index of its sample.

        The events are the largest pushing and pulling force of the rod, the largest moment in
        extension and in flexion, and the fastest motion of the rod.
        """
        return {
            "rod pushes most": int(np.argmax(self.rod_force_n)),
            "rod pulls most": int(np.argmin(self.rod_force_n)),
            "most extension moment": int(np.argmin(self.knee_moment_n_m)),
            "most flexion moment": int(np.argmax(self.knee_moment_n_m)),
            "fastest rod": int(np.argmax(np.abs(self.rod_speed_m_s))),
        }

    def warnings(self) -> tuple[str, ...]:
        """Return a line for each chamber above relief pressure, and for a pressure that is too low.

        Each line says time and knee angle of the extreme value and its share of the samples. A
        pressure below −0.1 MPa, relative to the atmosphere, is too low.
        """
        lines = []
        chambers = {"cap": self.cap_pressure_pa, "rod side": self.rod_side_pressure_pa}
        for chamber, values in chambers.items():
            above = values > self.relief_pressure_pa
            if above.any():
                extreme = self._extreme(values, int(values.argmax()), above)
                lines.append(
                    f"pressure of the {chamber} is {extreme}: above the relief pressure of "
                    f"{1e-6 * self.relief_pressure_pa:g} MPa; reduce share, or enlarge the piston"
                )
        below = self.overrun_pressure_pa < LOWEST_PRESSURE_PA
        if below.any():
            index = int(self.overrun_pressure_pa.argmin())
            chamber = "cap" if self.rod_speed_m_s[index] > 0.0 else "rod side"
            extreme = self._extreme(self.overrun_pressure_pa, index, below)
            lines.append(
                f"pressure of the {chamber} would be {extreme}: below "
                f"{1e-6 * LOWEST_PRESSURE_PA:g} MPa, where oil evaporates; enlarge the flow of "
                f"the pump or plant.full_order.makeup_conductance_m3_per_s_pa"
            )
        return tuple(lines)

    def _extreme(self, values: Array, index: int, flagged: Any) -> str:
        return (
            f"{1e-6 * values[index]:.3g} MPa at t = {self.time_s[index]:.4g} s and "
            f"{self.knee_angle_deg[index]:.3g} deg, {np.mean(flagged):.1%} of the samples"
        )

    def to_dataframe(self) -> Any:
        """Return the signals as a `pandas.DataFrame` with the index ``time_s``.

        Raises `PackageError` without pandas.
        """
        columns = {field.name: getattr(self, field.name) for field in fields(self)[:-2]}
        return data_frame(columns, "time_s")


def stride_load(
    scenario: Scenario = Scenario(),
    file: str | os.PathLike[str] | None = None,
    *,
    share: float = 1.0,
) -> StrideLoad:
    """Compute the load of an actuator that carries a share of the knee's moment in a stride.

    Virtual work gives rod force and speed from moment M, knee angle θ and moment arm r,
    F = −M/r and v = −r dθ/dt. Reduced order has P_L = F/Ā (Eq. 16). In full order the
    loaded chamber holds F, and the other chamber has the reservoir's pressure P_r (Eq. 14).
    Inertia, friction and compression of the oil are neglected.

    If the leg moves the rod faster than the pump can, the chamber that grows draws oil through its
    make-up valve. Its pressure is then P_r − max(A_i |v| − Q_max, 0)/G, with the largest flow of
    the pump Q_max, the conductance G of the valve, i = 1 for v > 0 and i = 2 otherwise.

    Parameters
    ----------
    scenario
        Its plant gives linkage, pump, cylinder and valves. Without full order, the valves have
        their default values.
    file
        CSV file with the columns ``time_s``, ``knee_angle_deg`` and ``knee_moment_nm``, positive in
        flexion. None stands for the measured stride
        (`kneexo.parameters.task.gait.gait_knee_moment`).
    share
        Share of the moment that the actuator carries, 0 … 1.

    Raises
    ------
    ParameterError
        The share is out of range, the file is faulty, or its knee angles leave the range of motion.
    """
    if not 0.0 <= share <= 1.0:
        raise ParameterError(f"share = {share:g}: must be >= 0 and <= 1")
    plant = scenario.plant
    time, angle_deg, moment = gait_knee_moment() if file is None else _read(file)
    plant.knee.require_in_range(float(angle_deg.min()), float(angle_deg.max()))
    angle = np.radians(angle_deg)
    arm = moment_arm_m(scenario, angle)
    rate = scipy.interpolate.CubicSpline(time, angle)(time, 1)
    torque, speed = share * moment, -arm * rate
    force = -torque / arm
    cap, rod_side = _pressures(scenario, force)
    return StrideLoad(
        time_s=time,
        knee_angle_deg=angle_deg,
        knee_moment_n_m=torque,
        rod_force_n=force,
        rod_speed_m_s=speed,
        knee_power_w=torque * rate,
        load_pressure_pa=force / plant.cylinder.mean_area_m2,
        cap_pressure_pa=cap,
        rod_side_pressure_pa=rod_side,
        overrun_pressure_pa=_overrun_pressure(scenario, speed),
        rod_speed_limit_m_s=rod_limits(scenario)[0],
        relief_pressure_pa=_valves(scenario).relief_pressure_pa,
    )


def smallest_piston_factor(scenario: Scenario = Scenario(), share: float = 1.0) -> float:
    """Return the factor on both piston areas with which a stride just reaches the relief pressure.

    With the factor f the loaded chamber has the pressure P_1 = F/(f A_1) + P_r A_2/A_1 or
    P_2 = −F/(f A_2) + P_r A_1/A_2, where F is the rod force of `stride_load`.

    Raises `ParameterError` as `stride_load` does, and if no area holds a pulling force.
    """
    cylinder, valves = scenario.plant.cylinder, _valves(scenario)
    cap, rod_side = cylinder.cap_area_m2, cylinder.rod_side_area_m2
    reservoir, relief = valves.reservoir_pressure_pa, valves.relief_pressure_pa
    if rod_side * relief <= cap * reservoir:
        raise ParameterError(
            f"plant.full_order.relief_pressure_pa = {relief:g} Pa: must be > "
            f"{cap / rod_side * reservoir:.4g} Pa, or the reservoir pushes the rod out"
        )
    force = stride_load(scenario, share=share).rod_force_n
    pushing = float(force.max()) / (cap * relief - rod_side * reservoir)
    return max(pushing, -float(force.min()) / (rod_side * relief - cap * reservoir))


def _read(file: str | os.PathLike[str]) -> tuple[Array, Array, Array]:
    names = ("time_s", "knee_angle_deg", "knee_moment_nm")
    table = read_table(file, names)
    if len(table.lines) < _FEWEST_SAMPLES:
        message = f"has {len(table.lines)} rows; must have at least {_FEWEST_SAMPLES}"
        raise file_error(file, None, message)
    table.require("time_s", -LONGEST_TIME_S, LONGEST_TIME_S, "s")
    table.require_increase("time_s", _SHORTEST_SAMPLE_S, "s")
    table.require("knee_moment_nm", -LARGEST_MOMENT_N_M, LARGEST_MOMENT_N_M, "N·m")
    time, angle, moment = (np.array(table.columns[name]) for name in names)
    return time, angle, moment


def _valves(scenario: Scenario) -> FullCylinderParameters:
    return scenario.plant.full_order or FullCylinderParameters()


def _pressures(scenario: Scenario, force: Array) -> tuple[Array, Array]:
    """Return P_1 and P_2 in Pa, each (n,), that hold the forces (n,) in N."""
    cylinder, reservoir = scenario.plant.cylinder, _valves(scenario).reservoir_pressure_pa
    both = [holding_pressures(value, cylinder, reservoir) for value in force.tolist()]
    cap, rod_side = np.array(both).T
    return cap, rod_side


def _overrun_pressure(scenario: Scenario, speed: Array) -> Array:
    """Return the pressure in Pa, (n,), of the growing chamber, which the make-up valve fills too.

    Where the pump delivers less than this chamber takes, the pressure is −inf without the valve.
    """
    cylinder, valves = scenario.plant.cylinder, _valves(scenario)
    area = np.where(speed > 0.0, cylinder.cap_area_m2, cylinder.rod_side_area_m2)
    most = rod_limits(scenario)[0] * cylinder.mean_area_m2
    lacking = np.maximum(area * np.abs(speed) - most, 0.0)
    drop = np.where(lacking > 0.0, np.inf, 0.0)
    conductance = valves.makeup_conductance_m3_per_s_pa
    if conductance > 0.0:
        drop = lacking / conductance
    return valves.reservoir_pressure_pa - drop
