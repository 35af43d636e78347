"""One run of a closed loop: by compiled equations or by Drake's Simulator.

`compiled` makes structure, parameters and initial state of a scenario for `kneexo.compiler`;
`drake` runs a diagram; `engines` chooses between both; `run` is the result of either.
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
