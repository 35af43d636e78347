"""The content of a model in C as data, which the C functions and templates print."""

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
    """The content of a model in C: equations, parameter values, C names, times and tables."""

    name: str
    """Prefix of all C names and file names."""
    real: Precision
    """Floating-point type of the code."""
    equations: Equations
    parameters: Array
    """Values of the Context parameters."""
    state: State
    """Values of the states before the initialization events of the diagram."""
    members: tuple[str, ...]
    """Member of the C parameter struct for each Context parameter: see `parameter_members`."""
    inputs: tuple[Field, ...]
    """Elements of the input ports in their order, one member of the C struct of inputs each."""
    outputs: tuple[Field, ...]
    """Elements of the exported output ports, one member of the C struct of outputs each."""
    output_nodes: tuple[int, ...]
    """Node of the graph that computes each element of ``outputs``."""
    schedule: Schedule
    tables: tuple[Table, ...]
    """Tables of the nodes whose values the code looks up by an integer input."""
    sums: Mapping[int, tuple[int, ...]]
    """Indices of the discrete states that compensated sums update, with the nodes added to each."""

    @cached_property
    def needs_time(self) -> bool:
        """Whether a step depends on the time."""
        graph = self.equations.graph
        return any("time" in graph.depends[node] for node in self.step_nodes)

    @property
    def counts_steps(self) -> bool:
        """Whether the C state counts steps: for the time, or for updates not due at every tick."""
        return self.needs_time or self.schedule.counts_ticks

    @property
    def step_nodes(self) -> list[int]:
        """Nodes of the graph whose values one step computes."""
        return step_nodes(self.equations, self.output_nodes)


def step_nodes(equations: Equations, output_nodes: tuple[int, ...]) -> list[int]:
    """Return the graph nodes of all updates, limits, derivatives and exported outputs."""
    updates = [node for update in equations.updates for _, node in update.values]
    limits = [limit.margin for limit in equations.limits]
    return [*updates, *limits, *equations.derivatives, *output_nodes]


def compensated_sums(equations: Equations, real: Precision) -> dict[int, tuple[int, ...]]:
    """Return each discrete state whose update adds other nodes to the state, with these nodes.

    In single precision the code adds the nodes by Kahan's compensated summation: each addition
    corrects the rounding error of the addition before. Otherwise a float would lose increments far
    smaller than the sum, so that an integrator would drift. In double precision the result is
    empty.
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
