"""The result of a sizing, as objects and as plain numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from kneexo.analysis.frequency.bandwidth import rod_amplitude_m, rod_limits
from kneexo.analysis.signals import to_rpm
from kneexo.analysis.walking.stride import StrideLoad, stride_load
from kneexo.analysis.walking.walking import WalkingDemand, linear_error_deg
from kneexo.common.result import Array, Result
from kneexo.parameters import Scenario
from kneexo.parameters.paths import value_at
from kneexo.studies.hardware import (
    ACCELERATION_ALONE_RATIO,
    DISPLACEMENT,
    HARDWARE,
    ONE_PERCENT_RATIO,
    scaled,
    sliding_mode,
    tuned,
)
from kneexo.studies.size.error_model import error_model
from kneexo.studies.size.settings import SizeSettings


@dataclass(frozen=True)
class Search:
    """Result of a search for the smallest value that keeps an error within a bound.

    If no value keeps the error within the bound, ``reached`` is False and ``value`` is the tried
    value with the least error.
    """

    value: float
    max_error_deg: float
    reached: bool
    low: float
    high: float


@dataclass(frozen=True)
class WalkingDesign:
    """Hardware sized for one stride frequency, and metrics of walking with this hardware.

    ``flow`` is the search for the smallest factor on the scenario's flow per motor revolution.
    ``acceleration`` is the search for the smallest acceleration limit of the motor in rad/s².
    ``scenario`` has the results of the two searches, times ``margin``. ``carrying`` is this
    hardware with a larger piston and pump, which carry the share of the knee moment in a whole
    stride. ``walking`` and ``carried`` have the `walking_metrics` of ``scenario`` and ``carrying``
    with the scenario's solver. ``checked`` and ``halved`` have the metrics of ``scenario`` with
    RK4, at the check step and at half the check step.
    """

    frequency_hz: float
    flow: Search
    acceleration: Search
    scenario: Scenario
    carrying: Scenario
    walking: Mapping[str, Any]
    checked: Mapping[str, Any]
    halved: Mapping[str, Any]
    carried: Mapping[str, Any]


@dataclass(frozen=True, repr=False)
class SizeResult(Result):
    """Result of `size_study`: measurements of the hardware, demands of walking, gains, designs."""

    scenario: Scenario
    settings: SizeSettings
    nominal: Mapping[str, Any]
    """Bandwidth and error with the scenario's own hardware, controller and sine."""
    sweeps: Mapping[str, Sequence[Mapping[str, Any]]]
    """Dictionary from a hardware value's path to results as in ``nominal`` for each factor."""
    bandwidth_map_hz: Array
    """Bandwidth in Hz over factors on the acceleration limit (rows) and the flow (columns)."""
    demands: Sequence[WalkingDemand]
    """Motion and load that walking requires at each stride frequency, with the mass of Eq. 16."""
    segment_demands: Sequence[WalkingDemand]
    """Demands as in ``demands`` with the shank's inertia in place of the mass of Eq. 16.

    Empty without a load.
    """
    torque_demands: Mapping[float, WalkingDemand]
    """Dictionary from the wearer's torque in N·m to the demand at the first stride frequency."""
    gains: Sequence[Mapping[str, Any]]
    """All tried gains, each with margins and metrics of walking at the highest stride frequency."""
    best_gains: Mapping[str, Any]
    steps: Mapping[str, Sequence[Mapping[str, Any]]]
    """Dictionary from a stage of the tuning to its `walking_metrics` at each stride frequency."""
    designs: Sequence[WalkingDesign]
    """The design for each stride frequency. The fields below belong to the first design."""
    design_at_reference: Mapping[str, Any]
    variations: Mapping[str, Mapping[str, Any]]
    walking_sweeps: Mapping[str, Sequence[Mapping[str, Any]]]
    walking_map_deg: Array
    """Largest error in deg over factors on the acceleration limit (rows) and the flow (columns)."""
    traces: Mapping[str, Mapping[str, Array]]
    """Signals of walking with ``nominal`` and with ``sized`` hardware, empty if the run failed."""

    def results(self) -> dict[str, Any]:
        """Return the sizing as plain data, with units in the names."""
        settings, scenario = self.settings, self.scenario

        def demands(values: Iterable[WalkingDemand]) -> list[dict[str, float]]:
            return [_demand(demand, scenario) for demand in values]

        torques = (f"{torque:g}" for torque in self.torque_demands)
        return {
            "limits": _limits(scenario),
            "nominal": self.nominal,
            "sweeps": {
                path: [
                    {"factor": factor, "value": _shown(scenario, path, factor), **metrics}
                    for factor, metrics in zip(settings.factors, sweep, strict=True)
                ]
                for path, sweep in self.sweeps.items()
            },
            "bandwidth_map": {
                "factors": list(settings.factors),
                "bandwidth_hz": self.bandwidth_map_hz.tolist(),
            },
            "demand": demands(self.demands),
            "demand_with_segment_inertia": demands(self.segment_demands),
            "demand_by_wearer_torque_n_m": dict(
                zip(torques, demands(self.torque_demands.values()), strict=True)
            ),
            "stride": [
                _stride(hardware, share, load)
                for hardware, loads in self.strides().items()
                for share, load in loads.items()
            ],
            "controller": _controller(self),
            "gains": self.gains,
            "best_gains": self.best_gains,
            "steps": self.steps,
            "designs": [_design(design, scenario) for design in self.designs],
            "design_at_reference": self.design_at_reference,
            "variations": self.variations,
            "walking_sweeps": {
                path: [
                    {"factor": factor, **metrics}
                    for factor, metrics in zip(settings.walking_factors, sweep, strict=True)
                ]
                for path, sweep in self.walking_sweeps.items()
            },
            "walking_map": {
                "factors": list(settings.walking_factors),
                "max_error_deg": self.walking_map_deg.tolist(),
            },
        }

    def strides(self) -> dict[str, dict[float, StrideLoad]]:
        """Return the loads in a measured stride, by hardware and by share of the knee moment."""
        first, shares = self.designs[0], {1.0, 0.5, self.settings.moment_share}
        return {
            name: {share: stride_load(plant, share=share) for share in sorted(shares)[::-1]}
            for name, plant in (
                ("hardware as it is", self.scenario),
                ("sized", first.scenario),
                ("sized, with its piston", first.carrying),
            )
        }


CHECKED = ("max_error_deg", "peak_pressure_mpa", "peak_shaft_power_w", "delivered_energy_j")
"""Metrics of walking that are compared between the check step and half the check step."""


def _limits(scenario: Scenario) -> dict[str, float]:
    speed, acceleration = rod_limits(scenario)
    amplitude = rod_amplitude_m(scenario)
    motor = scenario.plant.pump.speed_limit_rad_s
    return {
        "rod_speed_limit_mm_s": 1e3 * speed,
        "rod_acceleration_limit_m_s2": acceleration,
        "rod_amplitude_mm": 1e3 * amplitude,
        # α_max at which the bound loses 1 %, and below which R no longer counts
        "acceleration_limit_one_percent_rad_s2": ONE_PERCENT_RATIO * motor * speed / amplitude,
        "acceleration_limit_alone_rad_s2": ACCELERATION_ALONE_RATIO * motor * speed / amplitude,
    }


def _shown(scenario: Scenario, path: str, factor: float) -> float:
    """Return the hardware value at ``path`` times ``factor``, in the unit that `HARDWARE` names."""
    return float(value_at(scaled(scenario, {path: factor}), path)) * HARDWARE[path][2]


def _demand(demand: WalkingDemand, scenario: Scenario) -> dict[str, float]:
    """Return the peaks of motion and load that walking requires.

    The dictionary also has the flow and the motor acceleration that these peaks require.
    """
    peaks = demand.peaks()
    limit = scenario.plant.pump.speed_limit_rad_s
    needed = peaks["peak_motor_speed_rad_s"] / limit
    return {
        "frequency_hz": demand.frequency_hz,
        "peak_knee_rate_deg_s": peaks["peak_knee_rate_deg_s"],
        "peak_rod_speed_mm_s": 1e3 * peaks["peak_rod_speed_m_s"],
        "flow_factor": needed,
        "peak_rod_acceleration_m_s2": peaks["peak_rod_acceleration_m_s2"],
        # of a motor whose speed limit the peak flow just reaches
        "peak_motor_acceleration_rad_s2": peaks["peak_motor_acceleration_rad_s2"] / needed,
        "peak_flow_l_min": 6e4 * peaks["peak_load_flow_m3_s"],
        "peak_rod_force_n": peaks["peak_rod_force_n"],
        "peak_pressure_mpa": 1e-6 * peaks["peak_load_pressure_pa"],
        "peak_shaft_power_w": peaks["peak_shaft_power_w"],
        "delivered_energy_j": peaks["delivered_energy_j"],
        "net_energy_j": peaks["net_energy_j"],
    }


def _stride(hardware: str, share: float, load: StrideLoad) -> dict[str, Any]:
    """Return the extreme pressures of a stride, each with its knee angle."""
    row: dict[str, Any] = {"hardware": hardware, "moment_share": share}
    for name, values, sign in (
        ("cap", load.cap_pressure_pa, 1.0),
        ("rod_side", load.rod_side_pressure_pa, 1.0),
        ("lowest", load.overrun_pressure_pa, -1.0),
    ):
        index = int(np.argmax(sign * values))
        row[f"{name}_pressure_mpa"] = 1e-6 * float(values[index])
        row[f"{name}_angle_deg"] = float(load.knee_angle_deg[index])
    return row | {"share_within_speed": load.share_within_speed, "warnings": load.warnings()}


def _controller(result: SizeResult) -> dict[str, float]:
    """Return the controller's authority βη, the βη that walking requires, k/Φ, and two errors.

    The linear loop predicts the two errors, in deg, with ample flow at the first stride frequency.
    The first error is with the scenario's gains, the second is with the tuned gains.
    """
    demand = result.demands[0]
    ample = scaled(result.scenario, {DISPLACEMENT: result.settings.largest_flow_factor})
    law, model = sliding_mode(result.scenario), error_model(result.scenario)
    acceleration = demand.peaks()["peak_rod_acceleration_m_s2"]
    return {
        "authority_m_s3": law.gain_ratio * law.eta_m_s3,
        "authority_asked_m_s3": model.stiffness_per_s2 * model.delay_s * acceleration,
        "slope_per_s": model.slope_per_s,
        "linear_error_deg": float(np.max(np.abs(linear_error_deg(ample, demand)))),
        "linear_error_tuned_deg": float(
            np.max(np.abs(linear_error_deg(tuned(ample, result.best_gains), demand)))
        ),
    }


def _design(design: WalkingDesign, scenario: Scenario) -> dict[str, Any]:
    pump, printed = design.scenario.plant.pump, scenario.plant.pump
    cylinder = scenario.plant.cylinder
    speed, acceleration = rod_limits(design.scenario)
    flow = speed / rod_limits(scenario)[0]
    area = cylinder.mean_area_m2 * printed.gear_ratio / flow
    return {
        "frequency_hz": design.frequency_hz,
        "flow_search": asdict(design.flow),
        "acceleration_search": asdict(design.acceleration),
        "flow_factor": flow,
        "rod_speed_limit_mm_s": 1e3 * speed,
        "rod_acceleration_limit_m_s2": acceleration,
        "flow_at_speed_limit_l_min": 6e4 * speed * cylinder.mean_area_m2,
        "acceleration_limit_rad_s2": pump.acceleration_limit_rad_s2,
        # Each of the next values alone gives this flow, with all other values unchanged.
        "displacement_cm3_per_rev": HARDWARE[DISPLACEMENT][2] * pump.displacement_m3_per_rad,
        "or_gear_ratio": printed.gear_ratio / flow,
        "or_motor_speed_limit_rpm": to_rpm(printed.speed_limit_rad_s * flow),
        "or_piston_area_without_gear_mm2": 1e6 * area,
        "rated_force_of_that_piston_n": area * cylinder.pressure_rating_pa,
        "piston_factor": design.carrying.plant.cylinder.mean_area_m2 / cylinder.mean_area_m2,
        "bore_mm": 1e3 * design.carrying.plant.cylinder.bore_m,
        "rod_mm": 1e3 * design.carrying.plant.cylinder.rod_diameter_m,
        "with_piston_cm3_per_rev": _shown(design.carrying, DISPLACEMENT, 1.0),
        "walking": dict(design.walking),
        "carried": dict(design.carried),
        "checked": dict(design.checked),
        "halved_step": dict(design.halved),
        "step_agreement": {
            name: abs(design.halved[name] / design.checked[name] - 1.0) for name in CHECKED
        },
    }
