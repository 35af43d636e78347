"""Markdown of `kneexo.studies.controller.study`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kneexo.parameters import RPM
from kneexo.studies.controller.study import ControllerResult, TrapCase
from kneexo.studies.markdown import document, markdown_table, number, percent, row_table


def report(study: ControllerResult) -> str:
    """The findings as Markdown."""
    claims, sound = study.claims(), study.settings.sound_disk_margin
    return document(
        "# Sliding-mode controller: λ, Φ and η",
        f"{study.values['stable'].size} points; {len(study.failures)} of them have a run that "
        f"failed.",
        row_table(
            claims,
            {
                "the paper says": lambda claim: f"“{claim.quote}”",
                "a case": "case",
                "cases": ("cases", "d"),
                "holds": lambda claim: percent(claim.share),
                "verdict": lambda claim: f"**{claim.verdict}**",
                f"between loops of disk margin ≥ {sound:g}: cases": ("sound_cases", "d"),
                "holds there": lambda claim: percent(claim.sound_share),
            },
        ),
        [f"- {claim.finding}" for claim in claims],
        *_line_tables(study),
        "A loop without margins is linearly unstable.",
        *_trap_report(study),
    )


def _line_tables(study: ControllerResult) -> Iterator[str | list[str]]:
    """One table along each axis through the grid's centre."""
    grid, centre, band = study.settings, study.centre, study.settings.settling_band_deg
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
        f"{grid.step_deg:g}° step, settling to ±{band:g}° (s)": "settling_s",
        f"{grid.large_step_deg:g}° step, settling to ±{band:g}° (s)": "large_settling_s",
        "disk margin": "disk_margin",
        "phase margin (deg)": "phase_margin_deg",
    }
    for axis, (name, along) in enumerate(axes.items()):
        fixed = ", ".join(
            f"{other} = {values[centre[n]]:g}"
            for n, (other, values) in enumerate(axes.items())
            if n != axis
        )
        rows = []
        for n, value in enumerate(along):
            at = tuple(n if i == axis else centre[i] for i in range(3))
            figures = [number(study.values[column][at]) for column in columns.values()]
            rows.append([f"{value:g}", f"{study.slope_per_s[at[1:]]:.2g}", *figures])
        yield f"## {name[0]}, at {fixed}"
        yield markdown_table((name, "k/Φ (1/s)", *columns), rows)


def _trap_report(study: ControllerResult) -> Iterator[str | list[str]]:
    grid = study.settings
    limit = study.scenario.plant.pump.acceleration_limit_rad_s2
    per_sample = RPM / study.scenario.controller.sample_time_s
    error = study.map_values["max_error_deg"]
    stable = np.where(study.map_values["stable"] == 1.0, error, -np.inf)
    time, slope = np.unravel_index(np.argmax(np.nan_to_num(stable, nan=-np.inf)), error.shape)
    demand = study.trap[0].mean_command_change_rpm * per_sample / limit
    yield (
        f"## A trap: T_f = {1e3 * grid.trap_time_constant_s:g} ms, "
        f"k/Φ = {grid.trap_slope_per_s:g} 1/s"
    )

    def acceleration(case: TrapCase) -> str:
        return number(case.mean_command_change_rpm * per_sample)

    yield row_table(
        study.trap,
        {
            "λ (1/s)": ("lambda_per_s", "g"),
            "variant": "variant",
            "linear loop": lambda case: "stable" if case.stable else "unstable",
            "disk margin": ("disk_margin", ".3g"),
            "max error (deg)": ("max_error_deg", ".3g"),
            "command change (rpm/sample)": ("mean_command_change_rpm", ".3g"),
            "the same (rad/s²)": acceleration,
            "oscillation at rest (deg, peak to peak)": ("oscillation_at_rest_deg", ".2f"),
        },
    )
    yield (
        "û gives back the rod's own damping by the measured velocity, so that a small k/Φ leaves "
        "next to no margin even where the eigenvalues say stable. The counts of the encoder keep "
        "such a loop moving, and a fast observer passes them on: as built the command's mean "
        f"change is {demand:.2g} times what the motor's acceleration limit can follow."
    )
    yield (
        f"On the map of T_f and k/Φ a linearly stable loop errs by up to {error[time, slope]:.3g}° "
        f"(T_f = {1e3 * grid.map_time_constants_s[time]:g} ms, "
        f"k/Φ = {grid.map_slopes_per_s[slope]:.2g} 1/s)."
    )
