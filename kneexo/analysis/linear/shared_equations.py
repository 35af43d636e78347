"""Equations that loops or plants of one structure share, and the Contexts of their numbers.

Python 3.11 never frees a LeafSystem, and reading the equations of a diagram takes tenths of a
second. So a sweep over numbers uses one diagram, and reads its equations once.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from diagramc import DiagramEquations
from kneexo.diagrams.part import full_name
from kneexo.simulation.compiled import Recent

recent_equations = Recent()
"""The equations of the structures that were asked for last."""


def context_with(
    equations: DiagramEquations,
    values: Iterable[tuple[str, dict[str, float]]],
    continuous_state: Sequence[float],
) -> Any:
    """Return a new Context of a diagram, with given Context parameters and continuous states.

    ``values`` maps the path of a system to a dictionary from the name of a parameter to its value.
    States that ``continuous_state`` does not contain are zero.
    """
    context = equations.diagram.CreateDefaultContext()
    set_parameters(equations, context, values)
    missing = context.num_continuous_states() - len(continuous_state)
    context.SetContinuousState([*continuous_state, *[0.0] * missing])
    return context


def set_parameters(
    equations: DiagramEquations, context: Any, values: Iterable[tuple[str, dict[str, float]]]
) -> None:
    """Set Context parameters of the systems of a diagram, by path and name.

    Systems that are not in the diagram, such as the reference, are ignored.
    """
    names = equations.parameter_names
    numbers = dict(zip(names, equations.parameters(context).tolist(), strict=True))
    for path, named in values:
        numbers |= {full_name(path, name): value for name, value in named.items()}
    equations.set_parameters(context, np.array([numbers[name] for name in names]))
