"""Traces exported C to the diagram: which system, equation and test vector a line belongs to."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from ..equations.equations import Equations, Section
from ..equations.graph import SOURCES
from .plan import Plan
from .printer import section_comment

FILE = "traceability.md"
"""Name of the file with the tables in an exported folder."""

_UNITS = (0.0, 1.0, -1.0)
"""Constants that no table of frozen numbers lists."""


@dataclass(frozen=True)
class Span:
    """Lines of a C file that compute the nodes of one section."""

    first: int
    """Number of the first line, the comment of the section; the file begins with line 1."""
    last: int
    function: str
    """Name of the C function that has the lines."""
    section: Section


def spans(text: str, sections: Sequence[Section]) -> Iterator[Span]:
    """Yield the lines of each comment of a section in C text, with the statements below it.

    The statements end before the next comment, empty line or end of a block.
    """
    by_comment = {_plain(section_comment(section)): section for section in sections}
    lines = text.splitlines()
    function, place = "", 0
    while place < len(lines):
        if name := re.match(r"(?:static )?\w+ (\w+)\(", lines[place]):
            function = name[1]
        start = place
        place += 1
        if not lines[start].lstrip().startswith("/*"):
            continue
        while "*/" not in lines[place - 1]:
            place += 1
        section = by_comment.get(_plain(lines[start:place]))
        if section is None:
            continue
        while place < len(lines) and not re.match(r"\s*(/\*|\}|$)", lines[place]):
            place += 1
        yield Span(start + 1, place, function, section)


def _plain(lines: Sequence[str]) -> str:
    """Return a C comment as one line without its stars."""
    return " ".join(line.strip().removeprefix("* ") for line in lines)


@dataclass(frozen=True)
class Trace:
    """The tables that trace a model in C to its diagram."""

    plan: Plan
    equations: Equations
    """The equations of the diagram, before the C printer rewrites them."""
    ports: Sequence[str]
    """Names of the exported output ports."""
    text: str
    """Text of the file ``NAME.c``."""

    @property
    def lines(self) -> list[tuple[str, ...]]:
        """Rows of the main table, one for each block of lines in C.

        A row has the line numbers, the C function, system and purpose, the equation, its source,
        and the numbers of the outputs that depend on the lines.
        """
        return [
            (
                f"{span.first}-{span.last}",
                span.function,
                span.section.where,
                span.section.equation,
                span.section.source,
                self._tests(span.section),
            )
            for span in spans(self.text, self.equations.sections)
        ]

    @property
    def names(self) -> list[tuple[str, str]]:
        """Rows of a table that explains expressions in C: (expression, name in the diagram)."""
        plan, equations = self.plan, self.equations
        rows = [(f"in->{f.name}", f"input port {f.port}") for f in plan.inputs]
        rows += [
            (f"out->{f.name}", f"output port {f.port}, output {number} of the test vectors")
            for number, f in enumerate(plan.outputs, 1)
        ]
        rows += [(f"x[{i}]", f"state {name}") for i, name in enumerate(equations.states)]
        rows += [(f"d[{i}]", f"state {name}") for i, name in enumerate(equations.discrete)]
        rows += self._constants()
        pairs = zip(plan.members, equations.parameters, strict=True)
        return rows + [(f"p->{member}", f"parameter {name}") for member, name in pairs]

    def _constants(self) -> list[tuple[str, str]]:
        """Return a row for each value ``c[i]`` that depends on parameters alone.

        A row has the text ``c[i]``, and the line and the system that compute the value.
        """
        lines, rows = self.text.splitlines(), []
        for span in spans(self.text, self.equations.sections):
            for number in range(span.first, span.last + 1):
                if target := re.match(r"\s+(c\[\d+\]) = ", lines[number - 1]):
                    rows.append((target[1], f"line {number}, {span.section.where}"))
        return sorted(rows, key=lambda row: int(row[0][2:-1]))

    @property
    def frozen(self) -> list[tuple[str, str, str]]:
        """Rows of a table of the numbers in equations that are no Context parameters.

        A row has the path of a system, its class, and its numbers.
        """
        graph = self.equations.graph
        numbers: dict[tuple[str, str], set[float]] = {}
        for section in self.equations.sections:
            system = section.where.rpartition(": ")[0], section.equation.partition(":")[0]
            found = numbers.setdefault(system, set())
            for operation in self._new_nodes[section.where]:
                values = map(graph.value, graph.arguments(operation))
                found.update(value for value in values if value is not None)
            found.difference_update(_UNITS)
        return [
            (path, kind.rstrip("."), ", ".join(f"{value:.6g}" for value in sorted(values)))
            for (path, kind), values in numbers.items()
            if values
        ]

    def _tests(self, section: Section) -> str:
        """Return a text about how the test vectors test a section.

        It has the numbers of the outputs that depend on the section, ``status`` for a margin, which
        only the status of a call shows, or ``none``.
        """
        value = self.equations.graph.value
        results = (node for node in section.nodes if value(node) is None)
        nodes = self._new_nodes[section.where].union(results)
        numbers = [n for n, needed in enumerate(self._needed_nodes, 1) if nodes & needed]
        status = ["status"] if section.where.endswith(": margin") else []
        return ", ".join([*_ranges(numbers), *status]) or "none"

    @cached_property
    def _new_nodes(self) -> dict[str, set[int]]:
        """Operations that each section computes, by its name, without those of earlier sections.

        These are the operations in the section's lines of C.
        """
        graph, earlier = self.equations.graph, set[int]()
        operations: dict[str, set[int]] = {}
        for section in self.equations.sections:
            nodes = set(graph.reachable(section.nodes)) - earlier
            earlier |= nodes
            is_source = {node for node in nodes if graph.nodes[node][0] in SOURCES}
            operations[section.where] = nodes - is_source
        return operations

    @cached_property
    def _needed_nodes(self) -> list[set[int]]:
        """For each output, all nodes that the output depends on, at the same or an earlier time."""
        graph, equations = self.equations.graph, self.equations
        updates = {i: node for update in equations.updates for i, node in update.values}

        def arguments(node: int) -> Sequence[int]:
            kind, *rest = graph.nodes[node]
            if kind == "state":
                return (equations.derivatives[rest[0]],)
            if kind == "discrete":
                initial = equations.initial_discrete[rest[0]]
                return (updates.get(rest[0], initial), initial)
            return graph.arguments(node)

        nodes = [node for port in self.ports for node in equations.outputs[port]]
        return [set(graph.reachable([node], arguments)) for node in nodes]


def _ranges(numbers: Sequence[int]) -> list[str]:
    """Return increasing numbers as text, neighbours as a range: 1, 2, 3, 5 as ``1-3`` and ``5``."""
    starts = [n for n in numbers if n - 1 not in numbers]
    ends = [n for n in numbers if n + 1 not in numbers]
    return [f"{a}-{b}" if a < b else f"{a}" for a, b in zip(starts, ends, strict=True)]
