"""Drake diagrams of the polycentric knee exoskeleton: plant, controller and closed loop."""

from kneexo.diagrams.closed_loop import available_signals, make_closed_loop
from kneexo.diagrams.controller import make_controller
from kneexo.diagrams.plant import cylinder_start, make_plant
from kneexo.diagrams.signals import PLANT_OUTPUTS, SIGNALS, columns

__all__ = [
    "PLANT_OUTPUTS",
    "SIGNALS",
    "available_signals",
    "columns",
    "cylinder_start",
    "make_closed_loop",
    "make_controller",
    "make_plant",
]
