"""Runs of scenarios: closed loops as compiled models.

`compiled` makes structure, parameters and initial state of a scenario for `kneexo.compilation`.
"""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import overload

from pydrake.systems.framework import System

from kneexo.compilation.model import CompiledModel, DiagramModel, compile_diagram
from kneexo.errors import CompilationError
from kneexo.parameters import Scenario
from kneexo.scenario import load_scenario
from kneexo.simulation.compiled import compile_scenario, scenario_run, simulate_compiled

__all__ = ["compile_model", "compile_scenario", "scenario_run", "simulate_compiled"]


@overload
def compile_model(system: Scenario | str | PathLike[str] = Scenario()) -> CompiledModel: ...


@overload
def compile_model(system: System, *, inputs: Iterable[str] = ()) -> DiagramModel: ...


def compile_model(
    system: Scenario | str | PathLike[str] | System = Scenario(), *, inputs: Iterable[str] = ()
) -> CompiledModel:
    """Compile the closed loop of a scenario or of a scenario file, or a diagram.

    See `compile_scenario` and `compile_diagram`.

    Parameters
    ----------
    system
        A scenario, the path of a scenario file, or a Diagram or leaf system of floats.
    inputs
        Names of the input ports of a diagram that stay inputs of the model.

    Raises
    ------
    ScenarioError
        The file is faulty.
    CompilationError
        ``system`` is something else, or a subsystem cannot be converted; ``inputs`` are given for
        a scenario, whose inputs follow from its reference.
    """
    if isinstance(system, str | PathLike):
        system = load_scenario(system)
    if not isinstance(system, Scenario):
        return compile_diagram(system, inputs=inputs)
    if isinstance(inputs, str) or tuple(inputs):
        raise CompilationError(
            "inputs: must be left out for a scenario; compile a diagram to choose them"
        )
    return compile_scenario(system)
