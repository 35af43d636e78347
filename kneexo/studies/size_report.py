"""The numbers and the text of `kneexo.studies.size.SizeStudy`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from kneexo.analysis.frequency_response import require_sine
from kneexo.analysis.hardware import HARDWARE, sliding_mode
from kneexo.parameters.paths import value_at
from kneexo.studies.markdown import markdown_table, number
from kneexo.studies.size import SizeStudy
from kneexo.studies.size_results import CHECKED

# ---------------------------------------------------------------------------------- numbers


# ------------------------------------------------------------------------------------- text


def report(sizing: SizeStudy) -> str:
    """Markdown: what sets bandwidth and error, and what walking needs."""
    found = sizing.results()
    parts = (_hardware_text, _demand_text, _controller_text, _designs_text, _around_text)
    return "\n\n".join("\n".join(part(sizing, found)) for part in parts) + "\n"


def _list(values: Iterable[float]) -> str:
    return " and ".join(number(value) for value in values)


_AT_REFERENCE = (
    "expected_bandwidth_hz",
    "small_signal_bandwidth_hz",
    "bandwidth_hz",
    "max_error_deg",
)


def _hardware_text(sizing: SizeStudy, found: Mapping[str, Any]) -> list[str]:
    limits = found["limits"]
    reference = require_sine(sizing.scenario)
    low, high = reference.range_deg
    # The ends of the sweep and the next to 1; results and figures have them all.
    below = sorted(factor for factor in sizing.settings.factors if factor < 1.0)
    above = sorted(factor for factor in sizing.settings.factors if factor > 1.0)
    shown = {*below[:1], *below[-1:], *above[:1], *above[-1:]}
    measured = [("hardware as it is", found["nominal"])]
    for path, sweep in found["sweeps"].items():
        label, unit, _ = HARDWARE[path]
        measured += [
            (f"{label} {one['value']:.4g} {unit}".rstrip(), one)
            for one in sweep
            if one["factor"] in shown
        ]
    failures = [f"- {name}: {one['failure']}" for name, one in measured if one["failure"]]
    return [
        "# Sizing",
        "",
        "## What sets bandwidth and error",
        "",
        f"The motor moves the rod at most at R = ω_max D_m/(gear Ā) = "
        f"{limits['rod_speed_limit_mm_s']:.1f} mm/s and accelerates it at most with "
        f"A = R α_max/ω_max = {limits['rod_acceleration_limit_m_s2']:.3f} m/s²; the reference "
        f"{low:g}…{high:g}° moves it by a = ±{limits['rod_amplitude_mm']:.2f} mm. No controller "
        f"reaches −3 dB beyond 0.2866 R/a, nor beyond 0.2136 √(A/a): motor speed, displacement, "
        f"gear and piston area count as R alone, until the acceleration limit, at this R, falls "
        f"below {limits['acceleration_limit_one_percent_rad_s2']:.0f} rad/s² (1 % of the "
        f"bandwidth); below {limits['acceleration_limit_alone_rad_s2']:.0f} rad/s² it decides "
        f"alone. Both marks grow with R.",
        "",
        f"One value at a time; η and Φ grow with R, λ and k/Φ stay. The bound is that of both "
        f"limits for a sine in the rod, the small signal that of the linear loop, the error the "
        f"largest at {reference.frequency_hz:g} Hz after the first period.",
        "",
        *markdown_table(
            ("hardware", "bound (Hz)", "small signal (Hz)", "measured −3 dB (Hz)", "error (deg)"),
            [[name, *(number(one[key]) for key in _AT_REFERENCE)] for name, one in measured],
        ),
        "",
        "– is a figure that does not exist (a gain that does not fall by 3 dB) or a run that failed"
        + (":" if failures else "."),
        *(["", *failures] if failures else []),
    ]


_DEMANDS = {
    "peak_knee_rate_deg_s": ("peak knee rate (deg/s)", ".0f"),
    "peak_rod_speed_mm_s": ("peak rod speed (mm/s)", ".0f"),
    "flow_factor": ("peak motor speed over its limit", ".1f"),
    "peak_rod_acceleration_m_s2": ("peak rod acceleration (m/s²)", ".2f"),
    "peak_motor_acceleration_rad_s2": ("at a motor with just that flow (rad/s²)", ".0f"),
    "peak_flow_l_min": ("peak flow (L/min)", ".2f"),
    "peak_rod_force_n": ("peak rod force (N)", ".1f"),
    "peak_pressure_mpa": ("peak pressure (MPa)", ".3f"),
    "peak_shaft_power_w": ("peak power (W)", ".1f"),
    "delivered_energy_j": ("energy delivered per stride (J)", ".2f"),
    "net_energy_j": ("of it not returned (J)", ".3f"),
}


def _demand_text(sizing: SizeStudy, found: Mapping[str, Any]) -> list[str]:
    demands = [
        *(("Eq. 16", demand) for demand in found["demand"]),
        *(("shank", demand) for demand in found["demand_with_segment_inertia"]),
    ]
    lines = [
        "## What walking asks for",
        "",
        "Inverse dynamics of the measured knee flexion, without limits, lag or controller, under "
        "the scenario's load. Moving mass: the constant one of Eq. 16, or the shank as a point "
        "mass, m l²/r² at the rod. The torques of a leg on the ground are not in it, nor is the "
        "inertia of motor and pump.",
        "",
        *markdown_table(
            ["", *(f"{one['frequency_hz']:.4g} Hz, {mass}" for mass, one in demands)],
            [
                [label, *(number(one[name], form) for _, one in demands)]
                for name, (label, form) in _DEMANDS.items()
            ],
        ),
    ]
    torques = found["demand_by_wearer_torque_n_m"]
    if not torques:
        return lines
    cylinder, pump = sizing.scenario.plant.cylinder, sizing.scenario.plant.pump
    names = ("peak_rod_force_n", "peak_pressure_mpa", "peak_shaft_power_w", "delivered_energy_j")
    return [
        *lines,
        "",
        f"With a constant torque of the wearer (positive flexes) and the shank's inertia, at "
        f"{found['demand'][0]['frequency_hz']:.4g} Hz; the ratings are "
        f"{1e-6 * cylinder.pressure_rating_pa:g} MPa and {pump.rated_power_w:g} W:",
        "",
        *markdown_table(
            ("torque (N·m)", *(_DEMANDS[name][0] for name in names)),
            [
                [torque, *(number(one[name], _DEMANDS[name][1]) for name in names)]
                for torque, one in torques.items()
            ],
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


def _walked(found: Mapping[str, Any], names: Sequence[str]) -> list[str]:
    if found["failure"]:
        return [f"fails: {found['failure'].split(';')[0]}", *["–"] * (len(names) - 1)]
    return [number(found[name], _WALKING[name][1]) for name in names]


def _controller_text(sizing: SizeStudy, found: Mapping[str, Any]) -> list[str]:
    best, settings, own = found["best_gains"], sizing.settings, found["controller"]
    scenario, as_it_is = sizing.scenario, next(iter(found["steps"].values()))[0]
    law = sliding_mode(scenario)
    errors = ("max_error_deg", "rms_error_deg")
    observer = value_at(scenario, "estimator.time_constant_s")
    changes = [
        f"{name} {old:.3g} {unit}"
        + ("" if f"{old:.3g}" == f"{new:.3g}" else f" → {new:.3g} {unit}")
        for name, unit, old, new in (
            ("λ", "1/s", law.lambda_per_s, best["lambda_per_s"]),
            ("k/Φ", "1/s", own["slope_per_s"], best["slope_per_s"]),
            ("T_f", "ms", 1e3 * observer, 1e3 * best["observer_s"]),
        )
    ]
    with_margin = (
        f"disk margin {best['disk_margin']:.2f}, phase margin {best['phase_margin_deg']:.0f}°"
        if best["meets"]
        else f"** none of the {len(found['gains'])} gains tried has a disk margin of "
        f"{settings.disk_margin_min:g} without chattering** (this one: "
        f"{number(best['disk_margin'])})"
    )
    return [
        "## What must change in the controller",
        "",
        f"The hardware as it is asks for its speed limit "
        f"{100.0 * as_it_is['saturated_share']:.0f} % of the time. With "
        f"{settings.largest_flow_factor:g} times the flow and "
        f"{settings.acceleration_limit_max_rad_s2:g} rad/s² no limit is in the way. Still:",
        "",
        *markdown_table(
            [
                "",
                *(
                    f"{what} error at {frequency:.4g} Hz (deg)"
                    for frequency in settings.stride_frequencies_hz
                    for what in ("largest", "rms")
                ),
            ],
            [
                [
                    name,
                    *(cell for one in ones for cell in _walked(one, errors)),
                ]
                for name, ones in found["steps"].items()
            ],
        ),
        "",
        f"The delay τ from command to motor speed asks of βη τ ω̂² |ẍ_d| = "
        f"{own['authority_asked_m_s3']:.2g} m/s³; the controller has {own['authority_m_s3']:.2g}, "
        f"so η must grow with the flow. Then the linear loop alone, without any limit, errs by "
        f"{own['linear_error_deg']:.1f}° at {sizing.demands[0].frequency_hz:.4g} Hz, and by "
        f"{own['linear_error_tuned_deg']:.2f}° with {'; '.join(changes)}: {with_margin}. λ raises "
        f"the loop's bandwidth, and k/Φ must fall for the margin that λ takes.",
    ]


def _searched(search: Mapping[str, Any], bound_deg: float) -> str:
    if search["reached"]:
        return f"{search['value']:.4g}"
    return (
        f"not reached in {search['low']:g} … {search['high']:g}: best "
        f"{number(search['max_error_deg'])}° (bound {bound_deg:g}°) at {search['value']:.4g}"
    )


_SIZED = {
    "rod_speed_limit_mm_s": ("sized: rod speed limit (mm/s)", ".0f"),
    "acceleration_limit_rad_s2": ("sized: acceleration limit (rad/s²)", ".0f"),
    "flow_at_speed_limit_l_min": ("sized: flow at the speed limit (L/min)", ".2f"),
    "displacement_cm3_per_rev": ("by displacement (cm³/rev)", ".2f"),
    "or_gear_ratio": ("or by gear ratio", ".3f"),
    "or_motor_speed_limit_rpm": ("or by motor speed (rpm)", ".0f"),
    "or_piston_area_without_gear_mm2": ("or by piston area, without gear (mm²)", ".0f"),
    "rated_force_of_that_piston_n": ("force of that piston at its rating (N)", ".0f"),
}


def _designs_text(sizing: SizeStudy, found: Mapping[str, Any]) -> list[str]:
    settings, designs = sizing.settings, found["designs"]
    bound = settings.error_bound_deg
    rows = [
        ["smallest flow, as a factor", *(_searched(one["flow_search"], bound) for one in designs)],
        [
            "smallest acceleration limit at the sized flow (rad/s²)",
            *(_searched(one["acceleration_search"], bound) for one in designs),
        ],
        *(
            [label, *(number(one[name], form) for one in designs)]
            for name, (label, form) in _SIZED.items()
        ),
    ]
    for name, (label, form) in _WALKING.items():
        kind = "halved_step" if name in CHECKED else "walking"
        rows.append([label, *(number(one[kind][name], form) for one in designs)])
    rows.append(
        [
            "change of error, pressure, power and energy by halving the step (%), at most",
            *(number(100.0 * max(one["step_agreement"].values()), ".2f") for one in designs),
        ]
    )
    return [
        f"## The smallest hardware that walks within {bound:g}°",
        "",
        f"Smallest flow with {settings.acceleration_limit_max_rad_s2:g} rad/s²; sized values are "
        f"{settings.margin:g} times the smallest. The motion itself asks for "
        f"{_list(one['flow_factor'] for one in found['demand'])} times the flow; the bound on the "
        f"error lets its peak be cut.",
        "",
        *markdown_table(["", *(f"{one['frequency_hz']:.4g} Hz" for one in designs)], rows),
    ]


def _around_text(sizing: SizeStudy, found: Mapping[str, Any]) -> list[str]:
    bound = sizing.settings.error_bound_deg
    at_sine, frequency = found["design_at_reference"], found["designs"][0]["frequency_hz"]
    reference = require_sine(sizing.scenario)
    low, high = reference.range_deg
    names = ("max_error_deg", "rms_error_deg", "peak_motor_speed_rpm", "peak_pressure_mpa")
    columns = (*names, "peak_shaft_power_w", "delivered_energy_j")
    kept = []
    for path, sweep in found["walking_sweeps"].items():
        good = [one["factor"] for one in sweep if one["max_error_deg"] <= bound]
        shown = f"{min(good):g} … {max(good):g}" if good else "none"
        kept.append([HARDWARE[path][0], shown])
    tried = sizing.settings.walking_factors
    return [
        f"## Around the hardware sized for {frequency:.4g} Hz",
        "",
        f"It follows {low:g}…{high:g}° at {reference.frequency_hz:g} Hz to "
        f"{number(at_sine['max_error_deg'])}°. Its −3 dB for that sine: "
        f"{number(at_sine['bandwidth_hz'])} Hz (bound of its limits "
        f"{number(at_sine['expected_bandwidth_hz'])} Hz, linear loop "
        f"{number(at_sine['small_signal_bandwidth_hz'])} Hz)"
        + (f"; {at_sine['failure']}." if at_sine["failure"] else "."),
        "",
        "Walking on plants that the controller does not know of:",
        "",
        *markdown_table(
            ("plant", *(_WALKING[name][0] for name in columns)),
            [[name, *_walked(one, columns)] for name, one in found["variations"].items()],
        ),
        "",
        f"Factors on one of its values, of those tried in {min(tried):g} … {max(tried):g}, that "
        f"keep the error within {bound:g}°:",
        "",
        *markdown_table(("value", "factors"), kept),
    ]
