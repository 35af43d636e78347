"""Reads and writes parameters and states of a Context as vectors, in the order of `Equations`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from ..run_data import Array, State
from .tree import Node


def parameters_of(root: Node, context: Any) -> Array:
    """Return the parameters in the Context of a diagram of floats, (parameters,)."""
    return _numbers(_parameters(root, context))


def set_parameters(root: Node, context: Any, parameters: Array) -> None:
    """Write the parameters (parameters,) into the Context of a diagram of floats."""
    _fill(_parameters(root, context, _WRITE), parameters)


def state_of(root: Node, context: Any) -> State:
    """Return the continuous and discrete states in the Context of a diagram of floats."""
    return State(_numbers(_continuous(root, context)), _numbers(_discrete(root, context)))


def set_state(root: Node, context: Any, state: State) -> None:
    """Write continuous and discrete states into the Context of a diagram of floats."""
    _fill(_continuous(root, context, _WRITE), state.continuous)
    _fill(_discrete(root, context, _WRITE), state.discrete)


class Source(NamedTuple):
    """What the values of a leaf system can depend on, such as its parameters or an input port."""

    name: str
    """``time``, ``parameters``, ``continuous_state``, ``discrete_state`` or an input port's name"""
    size: int
    read: Callable[[Any], Any]
    """Function of a Context that returns the scalars (size,); zeros of an open input port."""
    write: Callable[[Any, Any], None]
    """Function of a Context and scalars (size,), which writes this part of the Context alone."""


def sources_of(leaf: Any, inputs: Iterable[int], states_only: bool = False) -> list[Source]:
    """Return the time, the parameters, both states and input ports of a leaf, in this order.

    Of the parameters and states, those without elements are left out. ``inputs``: indices of the
    input ports, which must be vectors. ``states_only`` leaves out the time and parameters too.
    """
    root, default = Node(leaf), leaf.CreateDefaultContext()

    def part(name: str, vectors: Callable[..., Iterator[Any]]) -> Source:
        size = sum(vector.size() for vector in vectors(root, default))

        def read(context: Any) -> Any:
            return _numbers(vectors(root, context))

        return Source(name, size, read, lambda context, x: _fill(vectors(root, context, _WRITE), x))

    def input_port(port: Any) -> Source:
        def read(context: Any) -> Any:
            return port.Eval(context) if port.HasValue(context) else np.zeros(port.size())

        return Source(port.get_name(), port.size(), read, port.FixValue)

    own = [
        Source("time", 1, lambda c: [c.get_time()], lambda c, t: c.SetTime(t[0])),
        part("parameters", _parameters),
        part("continuous_state", _continuous),
        part("discrete_state", _discrete),
    ]
    ports = map(input_port, map(leaf.get_input_port, inputs))
    return [*(source for source in own[2 * states_only :] if source.size), *ports]


def discrete_values(values: Any) -> list[Any]:
    """Return the elements of all groups of Drake's DiscreteValues."""
    return [
        element
        for group in range(values.num_groups())
        for element in values.get_vector(group).CopyToVector().tolist()
    ]


def _contexts(root: Node, context: Any) -> Iterator[Any]:
    return (leaf.context(context) for leaf in root.equation_leaves)


_WRITE = "get_mutable"  # Drake then forgets what it has computed of the numbers


def _parameters(root: Node, context: Any, get: str = "get") -> Iterator[Any]:
    """Yield the vectors of the parameters of all leaves in the Context of a diagram."""
    for c in _contexts(root, context):
        yield from map(
            getattr(c, f"{get}_numeric_parameter"), range(c.num_numeric_parameter_groups())
        )


def _continuous(root: Node, context: Any, get: str = "get") -> Iterator[Any]:
    return (getattr(c, f"{get}_continuous_state_vector")() for c in _contexts(root, context))


def _discrete(root: Node, context: Any, get: str = "get") -> Iterator[Any]:
    for c in _contexts(root, context):
        yield from map(getattr(c, f"{get}_discrete_state"), range(c.num_discrete_state_groups()))


def _numbers(vectors: Iterable[Any]) -> Array:
    return np.array([number for vector in vectors for number in vector.CopyToVector()])


def _fill(vectors: Iterable[Any], values: Iterable[float]) -> None:
    """Write values into vectors one after the other."""
    left = list(values)
    for vector in vectors:
        vector.SetFromVector(left[: vector.size()])
        del left[: vector.size()]
