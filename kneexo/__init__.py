"""kneexo: a polycentric knee exoskeleton with electro-hydraulic actuator, on Drake.

Each subpackage of this list imports only those before it: ``kneexo.compiler`` (Drake diagrams as
machine code, C and FMU), ``kneexo.parameters`` (every physical number), ``kneexo.linkage``
(four-bar mathematics as plain functions), ``kneexo.systems`` (leaf systems), ``kneexo.diagrams``
(systems wired to plant, controller and loop), ``kneexo.simulation`` (one run), ``kneexo.sweeps``
(many runs), ``kneexo.export`` (C and FMU of a scenario), ``kneexo.analysis`` (measures of one
scenario), ``kneexo.studies`` (comparisons of many scenarios), ``kneexo.view`` (the knee in three
dimensions) and ``kneexo.command_line``.
"""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import TYPE_CHECKING, overload

from kneexo.version import __version__ as __version__

if TYPE_CHECKING:
    from pydrake.systems.framework import System

    from kneexo.compiler import CompiledModel, DiagramModel
    from kneexo.parameters import Scenario


@overload
def compile(system: Scenario | str | PathLike[str]) -> CompiledModel: ...


@overload
def compile(system: System, *, inputs: Iterable[str] = ()) -> DiagramModel: ...


def compile(
    system: Scenario | str | PathLike[str] | System, *, inputs: Iterable[str] = ()
) -> CompiledModel:
    """Compile a Drake diagram, or the closed loop of a scenario or scenario file.

    See `kneexo.simulation.compile_scenario` and `kneexo.compiler.compile_diagram`.

    Parameters
    ----------
    system
        A scenario, the path of a scenario file, or a Diagram or leaf system of floats.
    inputs
        Names of the input ports of a diagram that become inputs of the model.

    Raises
    ------
    ScenarioError
        The file is faulty.
    CompilationError
        ``system`` has another type, or a subsystem cannot be converted. Also raised if ``inputs``
        are given for a scenario, because the reference of the scenario determines its inputs.
    """
    # Importing kneexo alone loads neither LLVM nor Drake.
    from kneexo.compiler import compile_diagram
    from kneexo.errors import CompilationError
    from kneexo.parameters import Scenario
    from kneexo.parameters.scenario_file import load_scenario
    from kneexo.simulation import compile_scenario

    if isinstance(system, str | PathLike):
        system = load_scenario(system)
    if not isinstance(system, Scenario):
        return compile_diagram(system, inputs=inputs)
    if isinstance(inputs, str) or tuple(inputs):
        raise CompilationError(
            "inputs: must be left out for a scenario; compile a diagram to choose them"
        )
    return compile_scenario(system)
