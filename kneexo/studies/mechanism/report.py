"""Markdown report on a `kneexo.studies.mechanism.study.MechanismResult`."""

from __future__ import annotations

from kneexo.parameters import GAIT2392
from kneexo.studies.mechanism.study import MechanismResult
from kneexo.studies.template import filled


def report(result: MechanismResult) -> str:
    """Return the Markdown report on the alignment of the devices."""
    rows = [{"name": name} | device.results() for name, device in result.devices.items()]
    by_name = {row["name"]: row for row in rows}
    return filled(
        "mechanism/report.md",
        settings=result.settings,
        rows=rows,
        own=rows[0],
        hinge=by_name["hinge"],
        best=min(rows, key=lambda row: float(row["rms_mm"])),
        slips=[name for name, device in result.devices.items() if device.forces.slips.any()],
        knee_is_gait2392=result.settings.knee == GAIT2392,
    )
