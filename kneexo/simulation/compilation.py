"""Compiles scenarios, scenario files and Drake diagrams by one function."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import overload

from pydrake.systems.framework import System

from diagramc import CompiledModel, DiagramModel, compile_diagram
from kneexo.errors import CompilationError
from kneexo.parameters import Scenario
from kneexo.parameters.scenario_file import as_scenario
from kneexo.simulation.compiled import compile_scenario, why_python_in_run


@overload
def compile(system: Scenario | str | PathLike[str]) -> CompiledModel: ...


@overload
def compile(system: System, *, inputs: Iterable[str] = ()) -> DiagramModel: ...


def compile(
    system: Scenario | str | PathLike[str] | System, *, inputs: Iterable[str] = ()
) -> CompiledModel:
    """Compile a Drake diagram, or the closed loop of a scenario or scenario file.

    See `kneexo.simulation.compile_scenario` and `diagramc.compile_diagram`.

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
        are given for a scenario, because the reference of the scenario determines its inputs, and
        if the law of the scenario is called as Python.

    Examples
    --------
    A run of Drake's pendulum from 90°, without torque.

    >>> import kneexo as kx
    >>> from pydrake.examples import PendulumPlant
    >>> model = kx.compile(PendulumPlant(), inputs=["tau"])
    >>> state = model.state()
    >>> state.continuous[:] = 1.5708, 0.0  # angle in rad, rate in rad/s
    >>> run = model.simulate(model.parameters(), state, 10.0, record_period_s=0.01)
    >>> print(f"after 10 s: {run['state'][-1, 0]:.2f} rad")
    after 10 s: 0.04 rad
    """
    if not isinstance(system, Scenario | str | PathLike):
        return compile_diagram(system, inputs=inputs)
    if isinstance(inputs, str) or tuple(inputs):
        raise CompilationError(
            "inputs: must be left out for a scenario; compile a diagram to choose them"
        )
    scenario = as_scenario(system)
    if reason := why_python_in_run(scenario):
        raise CompilationError(
            f"controller: the law is called as Python: {reason}; docs/your_controller.md says how "
            f"to get it compiled"
        )
    return compile_scenario(scenario)
