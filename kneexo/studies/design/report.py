"""Markdown report on a `kneexo.studies.design.design.DesignResult`."""

from __future__ import annotations

from kneexo.parameters import Scenario
from kneexo.studies.design.design import DesignResult
from kneexo.studies.template import filled

LINKAGE_FILE = "linkage.yaml"
"""Name of the file of the scenario with the designed linkage."""


def report(result: DesignResult) -> str:
    """Return the Markdown report on the designed linkage."""
    numbers = result.results()
    return filled(
        "design/report.md",
        settings=result.settings,
        own=numbers,
        rows=[{"name": "designed linkage"} | numbers]
        + [{"name": name} | other for name, other in numbers["others"].items()],
        linkage_file=LINKAGE_FILE,
        best=[row[0] for row in numbers["finished_mm"][:4]],
    )


def scenarios(result: DesignResult) -> dict[str, Scenario]:
    """Return the scenario with the designed linkage, by the name of its file."""
    return {LINKAGE_FILE: result.scenario}
