"""The plan of a model in C: everything that functions and templates print, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from ..equations.equations import Equations
from ..run_data import Array, State
from .interface import Field
from .printer import FLOAT, Precision
from .schedule import Schedule
from .tables import Table


@dataclass(frozen=True)
class Plan:
    """What a model in C computes, from which data, and how the data are named."""

    name: str
    """Beginning of all names and files."""
    real: Precision
    """Floating-point type."""
    equations: Equations
    parameters: Array
    """Values of the Context parameters."""
    state: State
    """State before the initialization events."""
    members: tuple[str, ...]
    """Member of the struct in C for each Context parameter: see `parameter_members`."""
    inputs: tuple[Field, ...]
    """Elements of the open input ports."""
    outputs: tuple[Field, ...]
    """Elements of the exported output ports."""
    output_nodes: tuple[int, ...]
    """Node of each element of ``outputs``."""
    schedule: Schedule
    tables: tuple[Table, ...]
    """Nodes that the code looks up by an integer input, with their values."""
    sums: Mapping[int, tuple[int, ...]]
    """Discrete states that compensated sums update, with the nodes that each sum adds."""

    @cached_property
    def needs_time(self) -> bool:
        """Whether a step depends on the time."""
        graph = self.equations.graph
        return any("time" in graph.depends[node] for node in self.step_nodes)

    @property
    def counts_steps(self) -> bool:
        """Whether the state counts steps: for the time, or for several sample times."""
        return self.needs_time or self.schedule.counts_ticks

    @property
    def step_nodes(self) -> list[int]:
        """Nodes whose values a step computes."""
        return step_nodes(self.equations, self.output_nodes)


def step_nodes(equations: Equations, output_nodes: tuple[int, ...]) -> list[int]:
    """Return the nodes of all updates, limits, derivatives and exported outputs."""
    updates = [node for update in equations.updates for _, node in update.values]
    limits = [limit.margin for limit in equations.limits]
    return [*updates, *limits, *equations.derivatives, *output_nodes]


def compensated_sums(equations: Equations, real: Precision) -> dict[int, tuple[int, ...]]:
    """Return each discrete state whose update is a sum of itself and others, with the others.

    In single precision the code adds them by Kahan's compensated summation: the rounding error of
    an addition is kept, and taken into account by the next one. Otherwise a float would lose
    increments far smaller than the sum, so that an integrator would drift. In double precision the
    result is empty.
    """
    if real is not FLOAT:
        return {}
    graph, sums = equations.graph, {}
    for update in equations.updates:
        for state, node in update.values:
            kind, *terms = graph.nodes[node]
            previous = graph.source("discrete", state)
            if kind == "add" and terms.count(previous) == 1:
                sums[state] = tuple(term for term in terms if term != previous)
    return sums
