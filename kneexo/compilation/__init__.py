"""Diagrams as machine code: 30 s of closed loop in milliseconds, from the symbolic diagram.

The equations are written once, in the leaf systems. `expressions` reads them off the symbolic form
into a `graph`; `codegen` prints that as a module for numba, behind it the integrators of `loops`,
written out by `unroll`; `linear_parts` is what all models share; `cache` keeps the modules on disk.
`model` is what a user sees, `runner` one run of it, `compiled_system` the way back into Drake.
`scenarios` does all that for a scenario without building a diagram.
"""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import Any

from kneexo.compilation.cache import cache_directory
from kneexo.compilation.model import (
    CompiledModel,
    DiagramModel,
    Simulation,
    compile_diagram,
)
from kneexo.compilation.runner import InputTable, State
from kneexo.compilation.scenarios import compile_scenario, scenario_run, simulate_compiled
from kneexo.parameters import Scenario
from kneexo.scenario import load_scenario

__all__ = [
    "CompiledModel",
    "DiagramModel",
    "InputTable",
    "Simulation",
    "State",
    "cache_directory",
    "compile_diagram",
    "compile_model",
    "compile_scenario",
    "scenario_run",
    "simulate_compiled",
]


def compile_model(system: Any = Scenario(), *, inputs: Iterable[str] = ()) -> CompiledModel:
    """Compile the closed loop of a scenario or of a scenario file, or a diagram.

    See `compile_scenario` and `compile_diagram`. Raises `ScenarioError` for a faulty file.
    """
    if isinstance(system, str | PathLike):
        system = load_scenario(system)
    if isinstance(system, Scenario):
        return compile_scenario(system)
    return compile_diagram(system, inputs=inputs)
