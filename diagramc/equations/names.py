"""Names of the parameters and states of a leaf: ``path.name`` or ``path.group[element]``."""

from __future__ import annotations

from itertools import chain
from typing import Any

from pydrake.systems.framework import BasicVector

from .tree import Node


def parameter_groups(leaf: Node, context: Any) -> list[list[str]]:
    """Return one list of element names for each numeric parameter group of a leaf of floats.

    The names of the first group come from the leaf's attribute ``parameter_names``, if this
    attribute has as many names as the group has elements. Otherwise the names come from the
    accessors of Drake's vector. An element without accessor gets a number as its name. The elements
    of all other groups get numbers, too.
    """
    names = tuple(getattr(leaf.system, "parameter_names", ()))
    groups = []
    for group in range(context.num_numeric_parameter_groups()):
        vector = context.get_numeric_parameter(group)
        if group == 0 and len(names) == vector.size():
            groups.append([f"{leaf.path}.{name}" for name in names])
        elif group == 0:
            groups.append(_accessor_names(leaf.path, "0", vector))
        else:
            groups.append(numbered_names(leaf.path, group, vector.size()))
    return groups


def state_names(leaf: Node, context: Any) -> list[str]:
    """Return the names of a leaf's continuous states: Drake's names if any, otherwise numbers."""
    return _accessor_names(leaf.path, "x", context.get_continuous_state_vector())


def discrete_names(leaf: Node, context: Any) -> list[str]:
    """Return the names of a leaf's discrete states: numbers of the group and of the element."""
    vectors = map(context.get_discrete_state, range(context.num_discrete_state_groups()))
    groups = (numbered_names(leaf.path, g, vector.size()) for g, vector in enumerate(vectors))
    return list(chain(*groups))


def numbered_names(path: str, group: int | str, size: int) -> list[str]:
    """Return ``path.group[0]``, ``path.group[1]`` … for ``size`` elements."""
    return [f"{path}.{group}[{i}]" for i in range(size)]


def _accessor_names(path: str, group: str, vector: Any) -> list[str]:
    """Return the names of a vector's elements, taken from the accessors of its class.

    ``PendulumParams`` has ``mass()`` and ``set_mass()``, so an element of this vector is called
    ``mass``. An element without accessor is named by its number.
    """
    names = numbered_names(path, group, vector.size())
    values = vector.Clone()
    values.SetFromVector(range(vector.size()))
    for name in dir(vector):
        if hasattr(vector, f"set_{name}") and not hasattr(BasicVector, name):
            names[int(getattr(values, name)())] = f"{path}.{name}"
    return names
