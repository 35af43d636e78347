"""Markdown report on a `kneexo.studies.controller.result.ControllerResult`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from kneexo.analysis.linear.margins import soundness
from kneexo.parameters import RPM
from kneexo.studies.controller.result import ControllerResult, LimitCycleCase
from kneexo.studies.markdown import number
from kneexo.studies.template import filled


def report(result: ControllerResult) -> str:
    """Return the report on a controller study in Markdown."""
    per_sample = RPM / result.scenario.controller.sample_time_s

    def acceleration_rad_s2(case: LimitCycleCase) -> float:
        return case.mean_command_change_rpm * per_sample

    limit = result.scenario.plant.pump.acceleration_limit_rad_s2
    return filled(
        "controller/report.md",
        result=result,
        grid=result.settings,
        claims=result.claims(),
        quote=lambda claim: f"“{claim.quote}”",
        verdict=lambda claim: f"**{claim.verdict}**",
        lines=list(_tables(result)),
        soundness=lambda row: soundness(row["disk_margin"], result.settings.sound_disk_margin),
        linear_loop=lambda case: "stable" if case.stable else "unstable",
        acceleration=lambda case: number(acceleration_rad_s2(case)),
        # The first case is the loop as built, with the first λ of the settings.
        demand=acceleration_rad_s2(result.limit_cycle[0]) / limit,
        largest=_largest_error_of_a_stable_loop(result),
    )


def _tables(result: ControllerResult) -> Iterator[dict[str, Any]]:
    """Yield a table for each of λ, Φ and η, which varies while the other two keep their values.

    The table has the metrics. ``fixed`` names the two constant values, from the grid's centre.
    """
    grid, centre = result.settings, result.centre
    axes = {
        "λ (1/s)": grid.lambdas_per_s,
        "Φ (m/s²)": grid.phis_m_s2,
        "η (m/s³)": grid.etas_m_s3,
    }
    for axis, (label, values) in enumerate(axes.items()):
        fixed = ", ".join(
            f"{other} = {others[centre[n]]:g}"
            for n, (other, others) in enumerate(axes.items())
            if n != axis
        )
        rows = []
        for n, value in enumerate(values):
            at = tuple(n if i == axis else centre[i] for i in range(3))
            metrics = {name: array[at] for name, array in result.values.items()}
            # The slope k/Φ depends on Φ and η alone.
            rows.append({"value": value, "slope_per_s": result.slope_per_s[at[1:]]} | metrics)
        yield {"symbol": label[0], "label": label, "fixed": fixed, "rows": rows}


def _largest_error_of_a_stable_loop(result: ControllerResult) -> dict[str, float]:
    """Return the largest error among the stable loops of the map, with T_f and k/Φ of this loop."""
    grid, error = result.settings, result.map_values["max_error_deg"]
    stable = np.where(result.map_values["stable"] == 1.0, error, -np.inf)
    time, slope = np.unravel_index(np.argmax(np.nan_to_num(stable, nan=-np.inf)), error.shape)
    return {
        "error_deg": error[time, slope],
        "time_constant_s": grid.map_time_constants_s[time],
        "slope_per_s": grid.map_slopes_per_s[slope],
    }
