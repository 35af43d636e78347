"""Reads and writes parameters and states of a Context as vectors, in the order of `Equations`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from ..run_data import Array, State
from .tree import Node


def parameters_of(root: Node, context: Any) -> Array:
    """Return the parameters in the Context of a diagram of floats, (parameters,)."""
    return _numbers(_parameters(root, context))


def set_parameters(root: Node, context: Any, parameters: Array) -> None:
    """Write the parameters (parameters,) into the Context of a diagram of floats."""
    _fill(_parameters(root, context), parameters)


def state_of(root: Node, context: Any) -> State:
    """Return the continuous and discrete states in the Context of a diagram of floats."""
    return State(_numbers(_continuous(root, context)), _numbers(_discrete(root, context)))


def set_state(root: Node, context: Any, state: State) -> None:
    """Write continuous and discrete states into the Context of a diagram of floats."""
    _fill(_continuous(root, context), state.continuous)
    _fill(_discrete(root, context), state.discrete)


def set_all(root: Node, context: Any, numbers: Array) -> list[float]:
    """Write time, parameters, continuous and discrete states, in this order, into a Context.

    Returns the numbers that follow them in ``numbers``, such as the values of input ports.
    """
    context.SetTime(numbers[0])
    left = _fill(_parameters(root, context), numbers[1:])
    return _fill(_discrete(root, context), _fill(_continuous(root, context), left))


def discrete_values(values: Any) -> list[Any]:
    """Return the elements of all groups of Drake's DiscreteValues."""
    return [
        element
        for group in range(values.num_groups())
        for element in values.get_vector(group).CopyToVector().tolist()
    ]


def _contexts(root: Node, context: Any) -> Iterator[Any]:
    return (leaf.context(context) for leaf in root.equation_leaves)


def _parameters(root: Node, context: Any) -> Iterator[Any]:
    """Yield the vectors of the parameters of all leaves in the Context of a diagram."""
    for c in _contexts(root, context):
        yield from map(c.get_mutable_numeric_parameter, range(c.num_numeric_parameter_groups()))


def _continuous(root: Node, context: Any) -> Iterator[Any]:
    return (c.get_mutable_continuous_state_vector() for c in _contexts(root, context))


def _discrete(root: Node, context: Any) -> Iterator[Any]:
    for c in _contexts(root, context):
        yield from map(c.get_mutable_discrete_state, range(c.num_discrete_state_groups()))


def _numbers(vectors: Iterable[Any]) -> Array:
    return np.array([number for vector in vectors for number in vector.CopyToVector()])


def _fill(vectors: Iterable[Any], values: Iterable[float]) -> list[float]:
    """Write values into vectors one after the other; return the values that are left."""
    left = list(values)
    for vector in vectors:
        vector.SetFromVector(left[: vector.size()])
        del left[: vector.size()]
    return left
