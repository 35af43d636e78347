"""Markdown report on a `kneexo.analysis.identification.fit.FittedScenario`."""

from __future__ import annotations

from kneexo.analysis.identification.fit import FittedScenario
from kneexo.parameters import Scenario
from kneexo.studies.template import filled

FITTED_FILE = "fitted.yaml"
"""Name of the file of the fitted scenario."""


def report(result: FittedScenario) -> str:
    """Return the Markdown report on the fitted scenario."""
    numbers = result.results()
    return filled(
        "fit/report.md",
        result=result,
        own=numbers,
        unknowns=[{"name": name} | row for name, row in numbers["unknowns"].items()],
        outputs=[{"name": name} | row for name, row in numbers["outputs"].items()],
        fitted_file=FITTED_FILE,
    )


def scenarios(result: FittedScenario) -> dict[str, Scenario]:
    """Return the fitted scenario, by the name of its file."""
    return {FITTED_FILE: result.scenario}


def comments(result: FittedScenario) -> str:
    """Return a comment line for each fitted number, which says where the number comes from."""
    return "".join(f"# {path}: {text}\n" for path, text in result.provenance().items())
