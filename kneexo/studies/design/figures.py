"""Figure of a `kneexo.studies.design.design.DesignResult`."""

from __future__ import annotations

from matplotlib.figure import Figure

from kneexo.studies.design.design import DesignResult


def figures(result: DesignResult) -> dict[str, Figure]:
    """Draw the migration of the strap and the error of the rod. Return the figure by its name."""
    return {"design_errors": result.design.plot().figure}
