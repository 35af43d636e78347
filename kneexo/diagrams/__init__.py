"""Functions that build the diagrams of the polycentric knee exoskeleton."""

from kneexo.diagrams.closed_loop import make_closed_loop
from kneexo.diagrams.controller import make_controller
from kneexo.diagrams.plant import PLANT_OUTPUTS, make_plant
from kneexo.diagrams.signals import SIGNALS, available_signals, columns

__all__ = [
    "PLANT_OUTPUTS",
    "SIGNALS",
    "available_signals",
    "columns",
    "make_closed_loop",
    "make_controller",
    "make_plant",
]
