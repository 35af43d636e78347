"""Drake diagrams of the polycentric knee exoskeleton: plant, controller and closed loop."""

from kneexo.diagrams.closed_loop import (
    available_signals as available_signals,
    make_closed_loop as make_closed_loop,
)
from kneexo.diagrams.controller import make_controller as make_controller
from kneexo.diagrams.plant import make_plant as make_plant
from kneexo.diagrams.signals import (
    PLANT_OUTPUTS as PLANT_OUTPUTS,
    SIGNALS as SIGNALS,
    columns as columns,
)
