"""Markdown of `kneexo.studies.size.study`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kneexo.analysis.frequency_response import require_sine
from kneexo.analysis.hardware import HARDWARE, sliding_mode
from kneexo.parameters.paths import value_at
from kneexo.studies.markdown import Cell, column_table, document, markdown_table, number, row_table
from kneexo.studies.size.results import CHECKED
from kneexo.studies.size.study import SizeResult

Blocks = list[str | list[str]]
"""Paragraphs, and tables as lists of lines."""


def report(sizing: SizeResult) -> str:
    """Markdown: what sets bandwidth and error, and what walking needs."""
    numbers = sizing.results()
    parts = (_hardware_text, _demand_text, _controller_text, _designs_text, _around_text)
    return document(*(block for part in parts for block in part(sizing, numbers)))


_AT_REFERENCE = (
    "expected_bandwidth_hz",
    "small_signal_bandwidth_hz",
    "bandwidth_hz",
    "max_error_deg",
)


def _hardware_text(sizing: SizeResult, numbers: Mapping[str, Any]) -> Blocks:
    limits = numbers["limits"]
    reference = require_sine(sizing.scenario)
    low, high = reference.range_deg
    # The ends of the sweep and the next to 1; results and figures have them all.
    below = sorted(factor for factor in sizing.settings.factors if factor < 1.0)
    above = sorted(factor for factor in sizing.settings.factors if factor > 1.0)
    shown = {*below[:1], *below[-1:], *above[:1], *above[-1:]}
    measured = [("hardware as it is", numbers["nominal"])]
    for path, sweep in numbers["sweeps"].items():
        label, unit, _ = HARDWARE[path]
        measured += [
            (f"{label} {row['value']:.4g} {unit}".rstrip(), row)
            for row in sweep
            if row["factor"] in shown
        ]
    failures = [f"- {name}: {row['failure']}" for name, row in measured if row["failure"]]
    return [
        "# Sizing",
        "## What sets bandwidth and error",
        f"The motor moves the rod at most at R = ω_max D_m/(gear Ā) = "
        f"{limits['rod_speed_limit_mm_s']:.1f} mm/s and accelerates it at most with "
        f"A = R α_max/ω_max = {limits['rod_acceleration_limit_m_s2']:.3f} m/s²; the reference "
        f"{low:g}…{high:g}° moves it by a = ±{limits['rod_amplitude_mm']:.2f} mm. No controller "
        f"reaches −3 dB beyond 0.2866 R/a, nor beyond 0.2136 √(A/a): motor speed, displacement, "
        f"gear and piston area count as R alone, until the acceleration limit, at this R, falls "
        f"below {limits['acceleration_limit_one_percent_rad_s2']:.0f} rad/s² (1 % of the "
        f"bandwidth); below {limits['acceleration_limit_alone_rad_s2']:.0f} rad/s² it decides "
        f"alone. Both marks grow with R.",
        f"One value at a time; η and Φ grow with R, λ and k/Φ stay. The bound is that of both "
        f"limits for a sine in the rod, the small signal that of the linear loop, the error the "
        f"largest at {reference.frequency_hz:g} Hz after the first period.",
        markdown_table(
            ("hardware", "bound (Hz)", "small signal (Hz)", "measured −3 dB (Hz)", "error (deg)"),
            [[name, *(number(row[key]) for key in _AT_REFERENCE)] for name, row in measured],
        ),
        "– is a figure that does not exist (a gain that does not fall by 3 dB) or a run that failed"
        + (":" if failures else "."),
        failures,
    ]


_LOADS: dict[str, Cell] = {
    "peak rod force (N)": ("peak_rod_force_n", ".1f"),
    "peak pressure (MPa)": ("peak_pressure_mpa", ".3f"),
    "peak power (W)": ("peak_shaft_power_w", ".1f"),
    "energy delivered per stride (J)": ("delivered_energy_j", ".2f"),
}
_DEMANDS: dict[str, Cell] = {
    "peak knee rate (deg/s)": ("peak_knee_rate_deg_s", ".0f"),
    "peak rod speed (mm/s)": ("peak_rod_speed_mm_s", ".0f"),
    "peak motor speed over its limit": ("flow_factor", ".1f"),
    "peak rod acceleration (m/s²)": ("peak_rod_acceleration_m_s2", ".2f"),
    "at a motor with just that flow (rad/s²)": ("peak_motor_acceleration_rad_s2", ".0f"),
    "peak flow (L/min)": ("peak_flow_l_min", ".2f"),
    **_LOADS,
    "of it not returned (J)": ("net_energy_j", ".3f"),
}


def _demand_text(sizing: SizeResult, numbers: Mapping[str, Any]) -> Blocks:
    by_mass = {"Eq. 16": numbers["demand"], "shank": numbers["demand_with_segment_inertia"]}
    demands = [demand for of_mass in by_mass.values() for demand in of_mass]
    heads = [f"{d['frequency_hz']:.4g} Hz, {mass}" for mass, of in by_mass.items() for d in of]
    blocks: Blocks = [
        "## What walking asks for",
        "Inverse dynamics of the measured knee flexion, without limits, lag or controller, under "
        "the scenario's load. Moving mass: the constant one of Eq. 16, or the shank as a point "
        "mass, m l²/r² at the rod. The torques of a leg on the ground are not in it, nor is the "
        "inertia of motor and pump.",
        column_table(heads, demands, _DEMANDS),
    ]
    torques = numbers["demand_by_wearer_torque_n_m"]
    if not torques:
        return blocks
    cylinder, pump = sizing.scenario.plant.cylinder, sizing.scenario.plant.pump
    return [
        *blocks,
        f"With a constant torque of the wearer (positive flexes) and the shank's inertia, at "
        f"{numbers['demand'][0]['frequency_hz']:.4g} Hz; the ratings are "
        f"{1e-6 * cylinder.pressure_rating_pa:g} MPa and {pump.rated_power_w:g} W:",
        row_table(
            [{"torque": torque} | demand for torque, demand in torques.items()],
            {"torque (N·m)": "torque", **_LOADS},
        ),
    ]


_WALKING = {
    "max_error_deg": ("largest error (deg)", ".2f"),
    "rms_error_deg": ("rms error (deg)", ".2f"),
    "mean_command_change_rpm": ("mean change of command (rpm)", ".1f"),
    "peak_motor_speed_rpm": ("peak motor speed (rpm)", ".0f"),
    "peak_motor_acceleration_rad_s2": ("peak motor acceleration (rad/s²)", ".0f"),
    "peak_pressure_mpa": ("peak pressure (MPa)", ".3f"),
    "peak_shaft_power_w": ("peak power (W)", ".1f"),
    "delivered_energy_j": ("energy delivered per stride (J)", ".2f"),
}


def _walked(numbers: Mapping[str, Any], names: Sequence[str]) -> list[str]:
    if numbers["failure"]:
        return [f"fails: {numbers['failure'].split(';')[0]}", *["–"] * (len(names) - 1)]
    return [number(numbers[name], _WALKING[name][1]) for name in names]


def _controller_text(sizing: SizeResult, numbers: Mapping[str, Any]) -> Blocks:
    best, settings, control = numbers["best_gains"], sizing.settings, numbers["controller"]
    scenario, as_it_is = sizing.scenario, next(iter(numbers["steps"].values()))[0]
    law = sliding_mode(scenario)
    names = ("max_error_deg", "rms_error_deg")
    errors = [
        f"{what} error at {frequency:.4g} Hz (deg)"
        for frequency in settings.stride_frequencies_hz
        for what in ("largest", "rms")
    ]
    observer = value_at(scenario, "estimator.time_constant_s")
    changes = [
        f"{name} {old:.3g} {unit}"
        + ("" if f"{old:.3g}" == f"{new:.3g}" else f" → {new:.3g} {unit}")
        for name, unit, old, new in (
            ("λ", "1/s", law.lambda_per_s, best["lambda_per_s"]),
            ("k/Φ", "1/s", control["slope_per_s"], best["slope_per_s"]),
            ("T_f", "ms", 1e3 * observer, 1e3 * best["observer_s"]),
        )
    ]
    with_margin = (
        f"disk margin {best['disk_margin']:.2f}, phase margin {best['phase_margin_deg']:.0f}°"
        if best["meets"]
        else f"** none of the {len(numbers['gains'])} gains tried has a disk margin of "
        f"{settings.disk_margin_min:g} without chattering** (this one: "
        f"{number(best['disk_margin'])})"
    )
    return [
        "## What must change in the controller",
        f"The hardware as it is asks for its speed limit "
        f"{100.0 * as_it_is['saturated_share']:.0f} % of the time. With "
        f"{settings.largest_flow_factor:g} times the flow and "
        f"{settings.acceleration_limit_max_rad_s2:g} rad/s² no limit is in the way. Still:",
        markdown_table(
            ["", *errors],
            [
                [name, *(cell for stride in strides for cell in _walked(stride, names))]
                for name, strides in numbers["steps"].items()
            ],
        ),
        f"The delay τ from command to motor speed asks of βη τ ω̂² |ẍ_d| = "
        f"{control['authority_asked_m_s3']:.2g} m/s³; the controller has "
        f"{control['authority_m_s3']:.2g}, so η must grow with the flow. Then the linear loop "
        f"alone, without any limit, errs by {control['linear_error_deg']:.1f}° at "
        f"{sizing.demands[0].frequency_hz:.4g} Hz, and by "
        f"{control['linear_error_tuned_deg']:.2f}° with {'; '.join(changes)}: {with_margin}. λ "
        f"raises the loop's bandwidth, and k/Φ must fall for the margin that λ takes.",
    ]


def _searched(search: Mapping[str, Any], bound_deg: float) -> str:
    if search["reached"]:
        return f"{search['value']:.4g}"
    return (
        f"not reached in {search['low']:g} … {search['high']:g}: best "
        f"{number(search['max_error_deg'])}° (bound {bound_deg:g}°) at {search['value']:.4g}"
    )


def _designs_text(sizing: SizeResult, numbers: Mapping[str, Any]) -> Blocks:
    settings, designs = sizing.settings, numbers["designs"]
    flows = " and ".join(number(demand["flow_factor"]) for demand in numbers["demand"])
    bound = settings.error_bound_deg

    def searched(name: str) -> Cell:
        return lambda design: _searched(design[name], bound)

    def walked(name: str, form: str) -> Cell:
        run = "halved_step" if name in CHECKED else "walking"
        return lambda design: number(design[run][name], form)

    rows: dict[str, Cell] = {
        "smallest flow, as a factor": searched("flow_search"),
        "smallest acceleration limit at the sized flow (rad/s²)": searched("acceleration_search"),
        "sized: rod speed limit (mm/s)": ("rod_speed_limit_mm_s", ".0f"),
        "sized: acceleration limit (rad/s²)": ("acceleration_limit_rad_s2", ".0f"),
        "sized: flow at the speed limit (L/min)": ("flow_at_speed_limit_l_min", ".2f"),
        "by displacement (cm³/rev)": ("displacement_cm3_per_rev", ".2f"),
        "or by gear ratio": ("or_gear_ratio", ".3f"),
        "or by motor speed (rpm)": ("or_motor_speed_limit_rpm", ".0f"),
        "or by piston area, without gear (mm²)": ("or_piston_area_without_gear_mm2", ".0f"),
        "force of that piston at its rating (N)": ("rated_force_of_that_piston_n", ".0f"),
        **{label: walked(name, form) for name, (label, form) in _WALKING.items()},
        "change of error, pressure, power and energy by halving the step (%), at most": (
            lambda design: number(100.0 * max(design["step_agreement"].values()), ".2f")
        ),
    }
    return [
        f"## The smallest hardware that walks within {bound:g}°",
        f"Smallest flow with {settings.acceleration_limit_max_rad_s2:g} rad/s²; sized values are "
        f"{settings.margin:g} times the smallest. The motion itself asks for "
        f"{flows} times the flow; the bound on the error lets its peak be cut.",
        column_table([f"{design['frequency_hz']:.4g} Hz" for design in designs], designs, rows),
    ]


def _around_text(sizing: SizeResult, numbers: Mapping[str, Any]) -> Blocks:
    bound = sizing.settings.error_bound_deg
    at_sine, frequency = numbers["design_at_reference"], numbers["designs"][0]["frequency_hz"]
    reference = require_sine(sizing.scenario)
    low, high = reference.range_deg
    names = ("max_error_deg", "rms_error_deg", "peak_motor_speed_rpm", "peak_pressure_mpa")
    columns = (*names, "peak_shaft_power_w", "delivered_energy_j")
    kept = []
    for path, sweep in numbers["walking_sweeps"].items():
        good = [row["factor"] for row in sweep if row["max_error_deg"] <= bound]
        shown = f"{min(good):g} … {max(good):g}" if good else "none"
        kept.append([HARDWARE[path][0], shown])
    tried = sizing.settings.walking_factors
    return [
        f"## Around the hardware sized for {frequency:.4g} Hz",
        f"It follows {low:g}…{high:g}° at {reference.frequency_hz:g} Hz to "
        f"{number(at_sine['max_error_deg'])}°. Its −3 dB for that sine: "
        f"{number(at_sine['bandwidth_hz'])} Hz (bound of its limits "
        f"{number(at_sine['expected_bandwidth_hz'])} Hz, linear loop "
        f"{number(at_sine['small_signal_bandwidth_hz'])} Hz)"
        + (f"; {at_sine['failure']}." if at_sine["failure"] else "."),
        "Walking on plants that the controller does not know of:",
        markdown_table(
            ("plant", *(_WALKING[name][0] for name in columns)),
            [[name, *_walked(row, columns)] for name, row in numbers["variations"].items()],
        ),
        f"Factors on one of its values, of those tried in {min(tried):g} … {max(tried):g}, that "
        f"keep the error within {bound:g}°:",
        markdown_table(("value", "factors"), kept),
    ]
