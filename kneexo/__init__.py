"""kneexo: a polycentric knee exoskeleton with electro-hydraulic actuator, on Drake.

The short names for users, as in ``import kneexo as kx``:

- `kneexo.parameters.Scenario`: a knee with its controller, reference and simulation settings
- `kneexo.analysis.track`: simulate it, with metrics, verdict and plots
- `kneexo.analysis.responses.linearize`: poles and margins of its sampled closed loop
- `kneexo.analysis.responses.bode`: its frequency response
- `kneexo.analysis.responses.step`: its step response
- `kneexo.analysis.design_linkage`: search a four-bar linkage that follows a knee
- `kneexo.analysis.identification.fit.fit`: fit it to a log of the real machine
- `kneexo.analysis.batches.batch`: simulate many variants of it
- `kneexo.analysis.identification.experiment.design_experiment`: choose the motion that tells most
  about its numbers
- `kneexo.page.play.play`: make a page with sliders on which a scenario runs in the browser
- `kneexo.simulation.compile`: machine code of a scenario, or of a Drake diagram with symbolic
  support

All but `design_linkage` accept a scenario or the path of a scenario file.

The packages of kneexo, in an order in which each imports only packages before it. ``diagramc``
turns Drake diagrams into machine code, C and FMU, and imports nothing of kneexo.

- `kneexo.common`: results, plots, progress, files, code of the user
- `kneexo.parameters`: every physical number
- `kneexo.geometry`: four-bar mathematics as plain functions
- `kneexo.systems`: leaf systems
- `kneexo.diagrams`: systems wired to plant, controller and loop
- `kneexo.simulation`: one run
- `kneexo.sweeps`: many runs
- `kneexo.export`: C and FMU of a scenario
- `kneexo.analysis`: one scenario in, one result out
- `kneexo.view`: the knee in three dimensions, drawings
- `kneexo.studies`: comparisons of many scenarios
- `kneexo.page`: the page to play with
- `kneexo.command_line`
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from kneexo.version import __version__ as __version__

__all__ = [
    "Scenario",
    "batch",
    "bode",
    "compile",
    "design_experiment",
    "design_linkage",
    "fit",
    "linearize",
    "play",
    "step",
    "track",
]

if TYPE_CHECKING:  # for mypy, which would accept any name of `__getattr__`, and for editors
    from kneexo.analysis import design_linkage as design_linkage, track as track
    from kneexo.analysis.batches import batch as batch
    from kneexo.analysis.identification.experiment import design_experiment as design_experiment
    from kneexo.analysis.identification.fit import fit as fit
    from kneexo.analysis.responses import bode as bode, linearize as linearize, step as step
    from kneexo.page.play import play as play
    from kneexo.parameters import Scenario as Scenario
    from kneexo.simulation import compile as compile
else:
    _MODULES = {
        "Scenario": "kneexo.parameters",
        "batch": "kneexo.analysis.batches",
        "bode": "kneexo.analysis.responses",
        "compile": "kneexo.simulation",
        "design_experiment": "kneexo.analysis.identification.experiment",
        "design_linkage": "kneexo.analysis",
        "fit": "kneexo.analysis.identification.fit",
        "linearize": "kneexo.analysis.responses",
        "play": "kneexo.page.play",
        "step": "kneexo.analysis.responses",
        "track": "kneexo.analysis",
    }
    """Module of each name. It is imported at the first use, so that kneexo alone loads no Drake."""

    def __getattr__(name: str) -> Any:
        """Import and return a public name of this package."""
        if name not in _MODULES:
            raise AttributeError(
                f"module 'kneexo' has no attribute {name!r}; it has {', '.join(__all__)}",
                name=name,
                obj=import_module("kneexo"),
            )
        value = globals()[name] = getattr(import_module(_MODULES[name]), name)
        return value

    if "IPython" in sys.modules:  # a notebook shows a scenario with a drawing of its mechanism
        import_module("kneexo.view.notebook").register()

    def __dir__() -> list[str]:
        """Return the public names, without the subpackages that are loaded."""
        special = [name for name in globals() if name[:2] == name[-2:] == "__"]
        return sorted([*__all__, *special])
