"""Makes parameters of an FMU from the Context parameters and the initial states of a model."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Literal

from ..c.checks import require_type
from ..c.interface import parameter_members
from ..c.source import CSource
from ..errors import CompilationError, shown
from ..run_data import Array
from .variables import FmuParameter, sources, start_members


def context_parameters(source: CSource) -> list[FmuParameter]:
    """Return a tunable FMU parameter for each Context parameter, under its name in C."""
    rows = zip(
        source.equations.parameters, source.plan.members, source.parameters.tolist(), strict=True
    )
    return [
        FmuParameter(member, value, (member,), f"Context parameter {name.removeprefix('.')}")
        for name, member, value in rows
    ]


def initial_states(source: CSource) -> list[FmuParameter]:
    """Return a fixed FMU parameter for the start value of each state.

    The name of the parameter is ``initial.`` with the name of the state, such as
    ``initial.pendulum.theta``, ``initial.lag.x[0]`` or ``initial.counter.group_0[0]``. A
    discrete state whose start value the initialization events replace has no parameter.
    """
    equations, state = source.equations, source.state
    graph = equations.graph
    initial = [graph.nodes[node] for node in graph.reachable(equations.initial_discrete)]
    used = {index for kind, index in sources(initial) if kind == "discrete"}
    discrete = _start_values(source, "d", equations.discrete, state.discrete)
    return [
        *_start_values(source, "x", equations.states, state.continuous),
        *(parameter for index, parameter in enumerate(discrete) if index in used),
    ]


def _start_values(
    source: CSource, vector: Literal["x", "d"], names: Sequence[str], values: Array
) -> list[FmuParameter]:
    members = start_members(vector, len(names))
    # `parameter_members` knows no group x.
    numbered = [re.sub(r"\.x(?=\[\d+\]$)", ".0", name) for name in names]
    variables = parameter_members(numbered, source.name)
    if vector == "x":
        variables = tuple(name.replace(".group_0[", ".x[") for name in variables)
    rows = zip(variables, members, names, values.tolist(), strict=True)
    return [
        FmuParameter(
            f"initial.{variable}",
            value,
            (member,),
            f"start value of the state {name.removeprefix('.')}",
            tunable=False,
        )
        for variable, member, name, value in rows
    ]


def chosen_parameters(
    source: CSource, chosen: Iterable[FmuParameter | str] | None
) -> list[FmuParameter]:
    """Return the parameters of an FMU.

    ``chosen`` has parameters, or names of the parameters that `context_parameters` and
    `initial_states` return. With None, the function returns all these parameters. Raises
    `CompilationError` for an unknown name.
    """
    every = [*context_parameters(source), *initial_states(source)]
    if chosen is None:
        return every
    known = {parameter.name: parameter for parameter in every}
    parameters = []
    require_type("parameters", chosen, Iterable, "a list of names or of FmuParameter")
    for choice in (chosen,) if isinstance(chosen, str) else chosen:
        require_type(
            "an element of parameters", choice, (str, FmuParameter), "a name or an FmuParameter"
        )
        if isinstance(choice, str) and choice not in known:
            raise CompilationError(
                f"parameter {shown(repr(choice))}: is unknown; known: {', '.join(known) or 'none'}"
            )
        parameters.append(choice if isinstance(choice, FmuParameter) else known[choice])
    return parameters
