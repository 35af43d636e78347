"""The equations of a diagram as data: nodes of one graph, and the names of what they belong to."""

from __future__ import annotations

from dataclasses import dataclass, field

from .graph import Graph


@dataclass(frozen=True)
class Update:
    """The discrete update of all leaves with one sample period and offset."""

    period_s: float
    offset_s: float
    values: tuple[tuple[int, int], ...]
    """Pairs: index of a discrete state, and the node of its next value."""


@dataclass(frozen=True)
class Limit:
    """The margin of a leaf; a run stops when the margin falls below zero."""

    system: str
    """Path of the leaf."""
    margin: int
    """Node of the margin."""


@dataclass(frozen=True)
class Section:
    """The nodes that one leaf computes for one purpose; printers write them under a comment."""

    where: str
    """Path of the leaf and the purpose: an output port, derivatives, an update …"""
    equation: str
    """Class of the leaf and the first line of its documentation."""
    nodes: tuple[int, ...]


@dataclass
class Equations:
    """All equations of a diagram as nodes of one graph."""

    graph: Graph = field(default_factory=Graph)
    parameters: list[str] = field(default_factory=list)
    """Names of the numeric parameters of all Contexts."""
    states: list[str] = field(default_factory=list)
    """Names of the continuous states."""
    discrete: list[str] = field(default_factory=list)
    """Names of the discrete states."""
    inputs: dict[str, int] = field(default_factory=dict)
    """Names of the input ports that stay open, with their sizes."""
    derivatives: list[int] = field(default_factory=list)
    """Nodes of the time derivatives of the continuous states."""
    initial_discrete: list[int] = field(default_factory=list)
    """Nodes of the discrete states after ``Simulator.Initialize()``."""
    updates: list[Update] = field(default_factory=list)
    outputs: dict[str, list[int]] = field(default_factory=dict)
    """Nodes of each output port by its name."""
    limits: list[Limit] = field(default_factory=list)
    sections: list[Section] = field(default_factory=list)
    """Sections in an order in which they can be computed."""
