"""Figure of a `kneexo.analysis.identification.fit.FittedScenario`."""

from __future__ import annotations

from matplotlib.figure import Figure

from kneexo.analysis.identification.fit import FittedScenario


def figures(result: FittedScenario) -> dict[str, Figure]:
    """Draw what was measured and predicted, and the residuals. Return the figure by its name."""
    return {"fit": result.plot()[0, 0].figure}
