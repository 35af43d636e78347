"""Runs of scenarios: closed loops as compiled models.

`compiled` makes structure, parameters and initial state of a scenario for `kneexo.compilation`.
"""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import Any

from kneexo.compilation.model import CompiledModel, compile_diagram
from kneexo.parameters import Scenario
from kneexo.scenario import load_scenario
from kneexo.simulation.compiled import compile_scenario, scenario_run, simulate_compiled

__all__ = ["compile_model", "compile_scenario", "scenario_run", "simulate_compiled"]


def compile_model(system: Any = Scenario(), *, inputs: Iterable[str] = ()) -> CompiledModel:
    """Compile the closed loop of a scenario or of a scenario file, or a diagram.

    See `compile_scenario` and `compile_diagram`. Raises `ScenarioError` for a faulty file.
    """
    if isinstance(system, str | PathLike):
        system = load_scenario(system)
    if isinstance(system, Scenario):
        return compile_scenario(system)
    return compile_diagram(system, inputs=inputs)
