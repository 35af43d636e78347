"""Markdown of `kneexo.studies.controller`."""

from __future__ import annotations

import numpy as np

from kneexo.parameters import RPM
from kneexo.studies.controller import ControllerStudy, percent
from kneexo.studies.markdown import markdown_table, number


def report(study: ControllerStudy) -> str:
    """The findings as Markdown."""
    return "\n".join([*_claims_report(study), *_lines_report(study), *_trap_report(study)])


def _claims_report(study: ControllerStudy) -> list[str]:
    claims, sound = study.claims(), study.settings.sound_disk_margin
    return [
        "# Sliding-mode controller: λ, Φ and η",
        "",
        f"{study.values['stable'].size} points; {len(study.failures)} of them have a run that "
        f"failed.",
        "",
        f"| the paper says | a case | cases | holds | verdict | between loops of disk margin ≥ "
        f"{sound:g}: cases | holds |",
        "|---|---|---|---|---|---|---|",
        *(
            f"| “{claim.quote}” | {claim.case} | {claim.cases} | {percent(claim.share)} "
            f"| **{claim.verdict}** | {claim.sound_cases} | {percent(claim.sound_share)} |"
            for claim in claims
        ),
        "",
        *(f"- {claim.finding}" for claim in claims),
        "",
    ]


def _lines_report(study: ControllerStudy) -> list[str]:
    """One table along each axis through the grid's centre."""
    grid, centre = study.settings, study.centre
    axes = {
        "λ (1/s)": grid.lambdas_per_s,
        "Φ (m/s²)": grid.phis_m_s2,
        "η (m/s³)": grid.etas_m_s3,
    }
    columns = {
        "max error (deg)": "max_error_deg",
        "command change (rpm/sample)": "mean_command_change_rpm",
        "saturated share": "saturated_share",
        f"max error at {grid.fast_frequency_hz:g} Hz (deg)": "fast_max_error_deg",
        f"settling, {grid.step_deg:g}° (s)": "settling_s",
        f"settling, {grid.large_step_deg:g}° (s)": "large_settling_s",
        "disk margin": "disk_margin",
        "phase margin (deg)": "phase_margin_deg",
    }
    lines = []
    for axis, (name, along) in enumerate(axes.items()):
        fixed = ", ".join(
            f"{other} = {values[centre[n]]:g}"
            for n, (other, values) in enumerate(axes.items())
            if n != axis
        )
        rows = []
        for n, value in enumerate(along):
            at = tuple(n if i == axis else centre[i] for i in range(3))
            own = [number(study.values[column][at]) for column in columns.values()]
            rows.append([f"{value:g}", f"{study.slope_per_s[at[1:]]:.2g}", *own])
        table = markdown_table((name, "k/Φ (1/s)", *columns), rows)
        lines += [f"## {name[0]}, at {fixed}", "", *table, ""]
    return [*lines, "A loop without margins is linearly unstable.", ""]


def _trap_report(study: ControllerStudy) -> list[str]:
    grid = study.settings
    limit = study.scenario.plant.pump.acceleration_limit_rad_s2
    per_sample = RPM / study.scenario.controller.sample_time_s
    error = study.map_values["max_error_deg"]
    stable = np.where(study.map_values["stable"] == 1.0, error, -np.inf)
    time, slope = np.unravel_index(np.argmax(np.nan_to_num(stable, nan=-np.inf)), error.shape)
    demand = study.trap[0].mean_command_change_rpm * per_sample / limit
    return [
        f"## A trap: T_f = {1e3 * grid.trap_time_constant_s:g} ms, "
        f"k/Φ = {grid.trap_slope_per_s:g} 1/s",
        "",
        "| λ (1/s) | variant | linear loop | disk margin | max error (deg) | command change "
        "(rpm/sample) | the same (rad/s²) | oscillation at rest (deg, peak to peak) |",
        "|---|---|---|---|---|---|---|---|",
        *(
            f"| {case.lambda_per_s:g} | {case.variant} "
            f"| {'stable' if case.stable else 'unstable'} | {number(case.disk_margin)} "
            f"| {number(case.max_error_deg)} | {number(case.mean_command_change_rpm)} "
            f"| {number(case.mean_command_change_rpm * per_sample)} "
            f"| {case.oscillation_at_rest_deg:.2f} |"
            for case in study.trap
        ),
        "",
        "û gives back the rod's own damping by the measured velocity, so that a small k/Φ leaves "
        "next to no margin even where the eigenvalues say stable. The counts of the encoder keep "
        "such a loop moving, and a fast observer passes them on: as built the command's mean "
        f"change is {demand:.2g} times what the motor's acceleration limit can follow.",
        "",
        f"On the map of T_f and k/Φ a linearly stable loop errs by up to {error[time, slope]:.3g}° "
        f"(T_f = {1e3 * grid.map_time_constants_s[time]:g} ms, "
        f"k/Φ = {grid.map_slopes_per_s[slope]:.2g} 1/s).",
        "",
    ]
