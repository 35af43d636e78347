"""Markdown report on a `kneexo.studies.size.result.SizeResult`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from kneexo.analysis.frequency.frequency_response import require_sine
from kneexo.parameters import FullCylinderParameters
from kneexo.parameters.device.plant import LOWEST_PRESSURE_PA
from kneexo.parameters.paths import value_at
from kneexo.studies.hardware import HARDWARE, sliding_mode
from kneexo.studies.markdown import number
from kneexo.studies.size.result import CHECKED, SizeResult
from kneexo.studies.template import filled

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
"""Heading and number format of each metric of walking."""

_ERRORS = ("max_error_deg", "rms_error_deg")  # columns of the table of steps
_VARIED = (  # columns of the table of variations
    *("max_error_deg", "rms_error_deg", "peak_motor_speed_rpm", "peak_pressure_mpa"),
    *("peak_shaft_power_w", "delivered_energy_j"),
)


def report(result: SizeResult) -> str:
    """Return the report on a sizing in Markdown."""
    numbers, settings = result.results(), result.settings
    reference = require_sine(result.scenario)
    low, high = reference.range_deg
    steps, bound = numbers["steps"], settings.error_bound_deg
    as_it_is = next(iter(steps.values()))  # the first step changes nothing; one run per frequency
    strides = {"Eq. 16": numbers["demand"], "shank": numbers["demand_with_segment_inertia"]}

    return filled(
        "size/report.md",
        **numbers,
        settings=settings,
        plant=result.scenario.plant,
        range_deg=f"{low:g}…{high:g}",
        frequency_hz=reference.frequency_hz,
        bound_deg=bound,
        measured=list(_measured(result, numbers)),
        demand_heads=[
            f"{stride['frequency_hz']:.4g} Hz, {mass}"
            for mass, demands in strides.items()
            for stride in demands
        ],
        by_torque=[
            {"torque": torque} | demand
            for torque, demand in numbers["demand_by_wearer_torque_n_m"].items()
        ],
        as_it_is=as_it_is[0],
        error_heads=[
            f"{kind} error at {frequency:.4g} Hz (deg)"
            for frequency in settings.stride_frequencies_hz
            for kind in ("largest", "rms")
        ],
        stages=[
            [name, *(cell for walk in walks for cell in _walked(walk, _ERRORS))]
            for name, walks in steps.items()
        ],
        changes=list(_changes(result, numbers)),
        # heading: name in the row, name and number format, or a function of the row
        stride_heads={
            "hardware": "hardware",
            "share": ("moment_share", "g"),
            "P_1 (MPa)": ("cap_pressure_mpa", ".2f"),
            "P_1 at (deg)": ("cap_angle_deg", ".1f"),
            "P_2 (MPa)": ("rod_side_pressure_mpa", ".2f"),
            "P_2 at (deg)": ("rod_side_angle_deg", ".1f"),
            "lowest (MPa)": ("lowest_pressure_mpa", ".2f"),
            "lowest at (deg)": ("lowest_angle_deg", ".1f"),
            "pump can follow (%)": lambda row: number(100.0 * row["share_within_speed"], ".0f"),
        },
        stride_warnings=dict.fromkeys(
            f"{row['hardware']}: {line}." for row in numbers["stride"] for line in row["warnings"]
        ),
        relief_mpa=1e-6
        * (result.scenario.plant.full_order or FullCylinderParameters()).relief_pressure_pa,
        vacuum_mpa=1e-6 * LOWEST_PRESSURE_PA,
        design_heads=[f"{design['frequency_hz']:.4g} Hz" for design in numbers["designs"]],
        searched=lambda name: lambda design: _searched(design[name], bound),
        walking={label: (_path(name), form) for name, (label, form) in _WALKING.items()},
        step_agreement=lambda design: number(100.0 * max(design["step_agreement"].values()), ".2f"),
        variation_heads=[_WALKING[name][0] for name in _VARIED],
        variation_rows=[
            [name, *_walked(row, _VARIED)] for name, row in numbers["variations"].items()
        ],
        good_factors=list(_good_factors(numbers, bound)),
    )


def _measured(result: SizeResult, numbers: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield rows with bandwidth and error.

    The first row has the scenario's hardware. In every other row one hardware value is changed by a
    factor: the smallest, the largest, or a factor next to 1.
    """
    below = sorted(factor for factor in result.settings.factors if factor < 1.0)
    above = sorted(factor for factor in result.settings.factors if factor > 1.0)
    shown = {*below[:1], *below[-1:], *above[:1], *above[-1:]}
    yield {"hardware": "hardware as it is"} | numbers["nominal"]
    for path, sweep in numbers["sweeps"].items():
        label, unit, _ = HARDWARE[path]
        for row in sweep:
            if row["factor"] in shown:
                yield {"hardware": f"{label} {number(row['value'], '.4g')} {unit}".rstrip()} | row


def _walked(numbers: Mapping[str, Any], names: Sequence[str]) -> list[str]:
    """Return table cells with the metrics ``names`` of a walking run.

    If the run failed, the first cell has the reason and the others have dashes.
    """
    if numbers["failure"]:
        reason = numbers["failure"].split(";")[0]  # without the advice
        return [f"fails: {reason}", *["–"] * (len(names) - 1)]
    return [number(numbers[name], _WALKING[name][1]) for name in names]


def _changes(result: SizeResult, numbers: Mapping[str, Any]) -> Iterator[str]:
    """Yield a text for each gain: the scenario's value and, if different, the value for walking."""
    best, law = numbers["best_gains"], sliding_mode(result.scenario)
    observer = value_at(result.scenario, "estimator.time_constant_s")
    for name, unit, old, new in (
        ("λ", "1/s", law.lambda_per_s, best["lambda_per_s"]),
        ("k/Φ", "1/s", numbers["controller"]["slope_per_s"], best["slope_per_s"]),
        ("T_f", "ms", 1e3 * observer, 1e3 * best["observer_s"]),
    ):
        before, after = f"{number(old)} {unit}", f"{number(new)} {unit}"
        yield f"{name} {before}" + ("" if before == after else f" → {after}")


def _searched(search: Mapping[str, Any], bound_deg: float) -> str:
    """Return the result of a search as text.

    If no value keeps the error within the bound, the text says so and has the value of least error.
    """
    if search["reached"]:
        return number(search["value"])
    return (
        f"not reached in {search['low']:g} … {search['high']:g}: best "
        f"{number(search['max_error_deg'])}° (bound {bound_deg:g}°) at {number(search['value'])}"
    )


def _path(name: str) -> str:
    """Return the path in a design's numbers to the walking metric ``name``.

    A metric in `CHECKED` is from the run at half the check step, others from the scenario's solver.
    """
    return f"halved_step.{name}" if name in CHECKED else f"walking.{name}"


def _good_factors(numbers: Mapping[str, Any], bound_deg: float) -> Iterator[list[str]]:
    """Yield a row for each hardware value: the range of factors with an error within the bound."""
    for path, sweep in numbers["walking_sweeps"].items():
        good = [row["factor"] for row in sweep if row["max_error_deg"] <= bound_deg]
        yield [HARDWARE[path][0], f"{min(good):g} … {max(good):g}" if good else "none"]
