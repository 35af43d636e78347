"""The data of a model in C, from which the C functions and the templates are filled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from ..equations.equations import Equations
from ..run_data import Array, State
from .interface import Field
from .printer import FLOAT, Precision
from .schedule import Schedule
from .tables import Table


@dataclass(frozen=True)
class Plan:
    """The data of a model in C: equations, parameter values, C names, times and tables."""

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
    """For each Context parameter its member of the C parameter struct: see `parameter_members`."""
    inputs: tuple[Field, ...]
    """Elements of the input ports, in the order of the members of the C struct of inputs."""
    outputs: tuple[Field, ...]
    """Elements of the exported output ports, in the order of the members of the C struct."""
    output_nodes: tuple[int, ...]
    """For each element of ``outputs``, the graph node that computes the element."""
    schedule: Schedule
    tables: tuple[Table, ...]
    """Tables in which the code looks up node values that depend on one integer input."""
    sums: Mapping[int, tuple[int, ...]]
    """Dictionary from the index of a discrete state to the nodes that a compensated sum adds."""
    faster: Mapping[int, int] = field(default_factory=dict)
    """Dictionary from a node of the diagram's derivatives to its faster node; see `fast_rates`."""
    gradients: tuple[Mapping[int, int], ...] = ()
    """For the Rosenbrock method the gradient of each derivative; see `equations.gradients`."""
    by_time: tuple[int, ...] = ()
    """For the Rosenbrock method the node of each derivative's partial derivative by the time."""

    @property
    def integrator(self) -> str:
        """``rosenbrock`` or ``rk4``: the method that integrates the continuous states."""
        return "rosenbrock" if self.gradients else "rk4"

    @property
    def depends_on_time(self) -> bool:
        """Whether a partial derivative by the time is not always zero."""
        return any(node != self.equations.graph.zero for node in self.by_time)

    @cached_property
    def needs_time(self) -> bool:
        """Whether any value that a step computes depends on the time."""
        graph = self.equations.graph
        return any("time" in graph.depends[node] for node in self.step_nodes)

    @property
    def counts_steps(self) -> bool:
        """Whether the C state counts steps, to compute the time or to find the due updates."""
        return self.needs_time or self.schedule.counts_ticks

    @property
    def step_nodes(self) -> list[int]:
        """Nodes of the graph whose values one step computes."""
        partials = [node for gradient in self.gradients for node in gradient.values()]
        return [*step_nodes(self.equations, self.output_nodes), *partials, *self.by_time]


def step_nodes(equations: Equations, output_nodes: tuple[int, ...]) -> list[int]:
    """Return the graph nodes of all updates, limits, derivatives and exported outputs."""
    updates = [node for update in equations.updates for _, node in update.values]
    limits = [limit.margin for limit in equations.limits]
    return [*updates, *limits, *equations.derivatives, *output_nodes]


def compensated_sums(equations: Equations, real: Precision) -> dict[int, tuple[int, ...]]:
    """Return the discrete states that are sums, each with the nodes that its update adds.

    In single precision a float would lose increments far smaller than the sum, and an integrator
    would drift. So the code adds the nodes by Kahan's compensated summation, in which each addition
    corrects the rounding error of the addition before. In double precision the result is empty.
    """
    if real is not FLOAT:
        return {}
    # An hour as a sum of 2 ms is 3600.000 s with compensation, and 3544.783 s without.
    graph, sums = equations.graph, {}
    for update in equations.updates:
        for state, node in update.values:
            kind, *terms = graph.nodes[node]
            previous = graph.source("discrete", state)
            if kind == "add" and terms.count(previous) == 1:
                sums[state] = tuple(term for term in terms if term != previous)
    return sums
