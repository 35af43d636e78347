"""Markdown report on a `kneexo.studies.mechanism.mechanism.MechanismResult`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from kneexo.parameters import GAIT2392
from kneexo.studies.markdown import number
from kneexo.studies.mechanism.mechanism import MechanismResult
from kneexo.studies.template import filled


def _angles(name: str) -> Callable[[dict[str, Any]], str]:
    """Return the rule for a cell with the angles ``name`` of a row in deg, or the word none."""
    return lambda row: ", ".join(number(angle, ".4g") for angle in row[name]) or "none"


def report(result: MechanismResult) -> str:
    """Return the Markdown report on the alignment of the devices."""
    numbers = result.results()
    rows = [{"name": name} | row for name, row in numbers["devices"].items()]
    by_name = {row["name"]: row for row in rows}
    return filled(
        "mechanism/report.md",
        settings=result.settings,
        rows=rows,
        own=rows[0],
        hinge=by_name["hinge"],
        slips=[name for name, device in result.devices.items() if device.forces.slips.any()],
        angles=_angles,
        trade_off=numbers["trade_off"],
        stride=numbers["stride"],
        knee_is_gait2392=result.settings.knee == GAIT2392,
    )
