"""Reads and writes parameters and states of a Context as vectors, in the order of `Equations`."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..run_data import Array, State
from .tree import Node


def parameters_of(root: Node, context: Any) -> Array:
    """Return the parameters in the Context of a diagram of floats, (parameters,)."""
    values: list[float] = []
    for leaf in root.equation_leaves():
        leaf_context = leaf.context(context)
        for group in range(leaf_context.num_numeric_parameter_groups()):
            values += leaf_context.get_numeric_parameter(group).CopyToVector().tolist()
    return np.array(values)


def set_parameters(root: Node, context: Any, parameters: Array) -> None:
    """Write the parameters (parameters,) into the Context of a diagram of floats."""
    values = parameters.tolist()
    for leaf in root.equation_leaves():
        leaf_context = leaf.context(context)
        for group in range(leaf_context.num_numeric_parameter_groups()):
            vector = leaf_context.get_mutable_numeric_parameter(group)
            vector.SetFromVector(values[: vector.size()])
            del values[: vector.size()]


def state_of(root: Node, context: Any) -> State:
    """Return the continuous and discrete states in the Context of a diagram of floats."""
    continuous: list[float] = []
    discrete: list[float] = []
    for leaf in root.equation_leaves():
        leaf_context = leaf.context(context)
        continuous += leaf_context.get_continuous_state_vector().CopyToVector().tolist()
        for group in range(leaf_context.num_discrete_state_groups()):
            discrete += leaf_context.get_discrete_state(group).CopyToVector().tolist()
    return State(np.array(continuous), np.array(discrete))


def set_state(root: Node, context: Any, state: State) -> None:
    """Write continuous and discrete states into the Context of a diagram of floats."""
    continuous, discrete = list(state.continuous), list(state.discrete)
    for leaf in root.equation_leaves():
        leaf_context = leaf.context(context)
        size = leaf_context.num_continuous_states()
        if size:
            leaf_context.SetContinuousState(continuous[:size])
        del continuous[:size]
        for group in range(leaf_context.num_discrete_state_groups()):
            vector = leaf_context.get_mutable_discrete_state(group)
            vector.SetFromVector(discrete[: vector.size()])
            del discrete[: vector.size()]


def discrete_values(values: Any) -> list[Any]:
    """Return the elements of all groups of Drake's DiscreteValues."""
    return [
        element
        for group in range(values.num_groups())
        for element in values.get_vector(group).CopyToVector().tolist()
    ]
