"""One run of a closed loop: by compiled equations or by Drake's Simulator.

`compiled` makes structure, parameters and initial state of a scenario for `kneexo.compilation`;
`drake` runs a diagram; `engines` chooses between both; `run` is the result of either.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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

_MODULE_OF = {
    "Run": "kneexo.simulation.run",
    "compile_scenario": "kneexo.simulation.compiled",
    "scenario_run": "kneexo.simulation.compiled",
    "simulate": "kneexo.simulation.engines",
    "simulate_compiled": "kneexo.simulation.compiled",
    "simulate_diagram": "kneexo.simulation.drake",
}

if not TYPE_CHECKING:  # mypy accepts every name of a module with a visible __getattr__

    def __getattr__(name: str) -> Any:
        """Import a public name at its first use: Drake and LLVM take a second."""
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
