"""One run of a closed loop: by compiled equations or by Drake's Simulator.

`compiled` makes structure, parameters and initial state of a scenario for `kneexo.compilation`;
`drake` runs a diagram; `engines` chooses between both; `run` is the result of either.
"""

from kneexo.simulation.compiled import compile_scenario, scenario_run, simulate_compiled
from kneexo.simulation.drake import simulate_diagram
from kneexo.simulation.engines import simulate
from kneexo.simulation.run import Run

__all__ = [
    "Run",
    "compile_scenario",
    "scenario_run",
    "simulate",
    "simulate_compiled",
    "simulate_diagram",
]
