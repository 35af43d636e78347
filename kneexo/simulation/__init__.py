"""Simulates closed loops by compiled equations or by Drake's Simulator.

`compiled` runs a scenario with `kneexo.compiler`, `drake` runs a diagram with Drake's Simulator.
`engines` chooses between these two engines. `run` holds the result of a run. `coroutines` lets
async functions share batches of runs.
"""

from kneexo.simulation.compiled import (
    compile_scenario as compile_scenario,
    scenario_run as scenario_run,
    simulate_compiled as simulate_compiled,
)
from kneexo.simulation.coroutines import awaitable as awaitable, search_async as search_async
from kneexo.simulation.drake import simulate_diagram as simulate_diagram
from kneexo.simulation.engines import needs_runs as needs_runs, simulate as simulate
from kneexo.simulation.run import Run as Run
