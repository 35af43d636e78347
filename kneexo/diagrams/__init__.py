"""Functions that build the diagrams of the polycentric knee exoskeleton."""

from kneexo.diagrams.closed_loop import make_closed_loop as make_closed_loop
from kneexo.diagrams.controller import make_controller as make_controller
from kneexo.diagrams.plant import PLANT_OUTPUTS as PLANT_OUTPUTS, make_plant as make_plant
from kneexo.diagrams.signals import (
    SIGNALS as SIGNALS,
    available_signals as available_signals,
    columns as columns,
)
