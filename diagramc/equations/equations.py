"""The equations of a diagram as data: nodes of one graph, with names of states, ports and so on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from .graph import Graph


@dataclass(frozen=True)
class Update:
    """The discrete updates of all leaves that have the same sample period and offset."""

    period_s: float
    offset_s: float
    values: tuple[tuple[int, int], ...]
    """Pairs (index of a discrete state, node that computes this state's value after the update)."""


@dataclass(frozen=True)
class Limit:
    """A limit of a leaf. A run stops when the margin, the distance to the limit, is below zero."""

    system: str
    """Path of the leaf that states the margin."""
    margin: int
    """Node of the margin, a scalar."""


@dataclass(frozen=True)
class Section:
    """The nodes that one leaf computes for one purpose. In C a comment precedes each section."""

    where: str
    """Path of the leaf and the purpose of the nodes: an output port, derivatives, an update …"""
    equation: str
    """Class of the leaf and the first line of its docstring, which states the equation."""
    nodes: tuple[int, ...]
    source: str = ""
    """Equations that the docstring of the class cites, such as ``Lee et al. 2020, Eq. 15``."""


@dataclass
class Equations:
    """All equations of a diagram as nodes of one graph."""

    graph: Graph = field(default_factory=Graph)
    parameters: list[str] = field(default_factory=list)
    """Names of the numeric parameters of all leaves."""
    states: list[str] = field(default_factory=list)
    """Names of the continuous states."""
    discrete: list[str] = field(default_factory=list)
    """Names of the discrete states."""
    inputs: dict[str, int] = field(default_factory=dict)
    """Dictionary from name to size of the open input ports. A run gives the ports their values."""
    derivatives: list[int] = field(default_factory=list)
    """Nodes of the time derivatives of the continuous states."""
    initial_discrete: list[int] = field(default_factory=list)
    """Nodes of the discrete states after ``Simulator.Initialize()``."""
    updates: list[Update] = field(default_factory=list)
    outputs: dict[str, list[int]] = field(default_factory=dict)
    """Dictionary from the name of each output port of the diagram to the nodes of its elements."""
    limits: list[Limit] = field(default_factory=list)
    sections: list[Section] = field(default_factory=list)
    """All sections; each section comes after the sections whose nodes it depends on."""

    def add_update(self, timing: Any, values: Iterable[tuple[int, int]]) -> None:
        """Add an update of discrete states at the times of Drake's ``timing``.

        Leaves with equal times share one update, because the machine code asks once for each update
        whether it is due, and a single update can share nodes with the outputs.
        """
        period, offset = timing.period_sec(), timing.offset_sec()
        for number, update in enumerate(self.updates):
            if (update.period_s, update.offset_s) == (period, offset):
                self.updates[number] = Update(period, offset, (*update.values, *values))
                return
        self.updates.append(Update(period, offset, tuple(values)))
