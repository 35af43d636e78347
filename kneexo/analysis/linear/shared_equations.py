"""Equations that loops or plants of one structure share, and the Contexts of their numbers.

Python 3.11 never frees a LeafSystem, and reading the equations of a diagram takes tenths of a
second. So a sweep over numbers uses one diagram, and reads its equations once.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

from kneexo.diagrams.part import full_name
from kneexo.simulation.compiled import Recent

recent_equations = Recent()
"""The equations of the structures that were asked for last."""


def context_with(
    diagram: Any, values: Iterable[tuple[str, dict[str, float]]], continuous_state: Sequence[float]
) -> Any:
    """Return a new Context of a diagram, with given Context parameters and continuous states.

    ``values`` maps the path of a system to a dictionary from the name of a parameter to its value.
    States that ``continuous_state`` does not contain are zero.
    """
    context = diagram.CreateDefaultContext()
    set_parameters(diagram, context, values)
    missing = context.num_continuous_states() - len(continuous_state)
    context.SetContinuousState([*continuous_state, *[0.0] * missing])
    return context


def set_parameters(
    diagram: Any, context: Any, values: Iterable[tuple[str, dict[str, float]]]
) -> None:
    """Set Context parameters of the systems of a diagram, by path and name.

    Systems that are not in the diagram, such as the reference, are ignored.
    """
    for path, named in values:
        for leaf, numbers in _by_leaf(path, named).items():
            if (system := _system(diagram, leaf)) is None:
                continue
            subcontext = system.GetMyMutableContextFromRoot(context)
            names = getattr(system, "parameter_names", ())
            for name, value in numbers.items():
                numbered = re.fullmatch(r"(\d+)\[(\d+)\]", name)
                group, index = map(int, numbered.groups()) if numbered else (0, 0)
                vector = subcontext.get_mutable_numeric_parameter(group)
                if numbered or name in names:
                    vector.SetAtIndex(index if numbered else names.index(name), value)
                else:  # a vector of Drake with accessors, such as ``PendulumParams``
                    getattr(vector, f"set_{name}")(value)


def _by_leaf(path: str, named: dict[str, float]) -> dict[str, dict[str, float]]:
    """Return the numbers of a part at a path by the paths of its leaf systems, and their names."""
    leaves: dict[str, dict[str, float]] = {}
    for name, value in named.items():
        leaf, _, own = full_name(path, name).rpartition(".")
        leaves.setdefault(leaf, {})[own] = value
    return leaves


def _system(diagram: Any, path: str) -> Any:
    """Return the system at a path in ``diagram``; None if there is no system at the path."""
    for name in path.split("/"):
        if not diagram.HasSubsystemNamed(name):
            return None
        diagram = diagram.GetSubsystemByName(name)
    return diagram
