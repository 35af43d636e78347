"""Simulates closed loops by compiled equations or by Drake's Simulator.

`compiled` runs a scenario with `diagramc`, `drake` runs a diagram with Drake's Simulator.
`engines` chooses between these two engines. `run` holds the result of a run. `lockstep` lets many
calls of a function share batches of runs.
"""

from kneexo.simulation.compilation import compile
from kneexo.simulation.compiled import compile_scenario, scenario_run, simulate_compiled
from kneexo.simulation.drake import simulate_diagram
from kneexo.simulation.engines import can_reduce, reduce_run, simulate
from kneexo.simulation.lockstep import needs_runs
from kneexo.simulation.run import Run

__all__ = [
    "Run",
    "can_reduce",
    "compile",
    "compile_scenario",
    "needs_runs",
    "reduce_run",
    "scenario_run",
    "simulate",
    "simulate_compiled",
    "simulate_diagram",
]
