"""Prints nodes of the graph of equations as C99 statements, in double or single precision."""

from __future__ import annotations

import math
import re
import textwrap
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..equations.equations import Section
from ..equations.graph import SOURCES, Graph
from ..equations.operations import CONDITIONS, OPERATIONS, Role
from ..equations.partition import TICK_SOURCES, fixed_nodes
from ..errors import CompilationError

WIDTH = 96
"""Largest number of characters of a line of printed C."""

_LONGEST_EXPRESSION = 160

Load = Callable[[str, int], str]
"""Function of the kind and the index of an element; returns C text that reads the element.

The kinds are the sources of the graph (``graph.SOURCES``), ``constant`` and ``table``.
"""


@dataclass(frozen=True)
class Precision:
    """A floating-point type of C."""

    name: str
    suffix: str
    """Suffix of literals and of C library functions, such as the f of ``1.0f`` and ``sqrtf``."""
    largest: float
    smallest: float
    """Smallest positive normal number."""
    round: Callable[[float], np.floating]


DOUBLE = Precision("double", "", 1.7976931348623157e308, 2.2250738585072014e-308, np.float64)
"""C's ``double``: 64 bits."""
FLOAT = Precision("float", "f", 3.4028234663852886e38, 1.1754943508222875e-38, np.float32)
"""C's ``float``: 32 bits."""
PRECISIONS = {precision.name: precision for precision in (DOUBLE, FLOAT)}
"""Dictionary from the C names ``double`` and ``float`` to the precisions."""


def literal(value: float, precision: Precision, name: str = "a constant") -> str:
    """Return a number as a C literal, rounded to ``precision``.

    Raises `CompilationError` if the number is not finite, or if it is not zero and too large or too
    small for a normal number of the type. ``name`` is in the message.
    """
    if not math.isfinite(value):
        raise CompilationError(f"{name} = {value}: must be finite")
    if value != 0.0 and not precision.smallest <= abs(value) <= precision.largest:
        raise CompilationError(
            f"{name} = {value:g}: lies outside {precision.smallest:g} … {precision.largest:g}, "
            f"what a normal {precision.name} holds"
        )
    text = np.format_float_scientific(precision.round(value), trim="0")
    plain = np.format_float_positional(precision.round(value), trim="0")
    return (plain if len(plain) <= len(text) else text) + precision.suffix


@dataclass
class CPrinter:
    """Prints C statements that compute nodes of ``graph``.

    Nodes in ``fixed`` and ``tables`` are not computed. The statements read their values.
    """

    graph: Graph
    precision: Precision
    sections: Sequence[Section]
    """Groups of nodes that set the order of the statements. A comment precedes each group."""
    fixed: dict[int, int] = field(default_factory=dict)
    """Dictionary from a node that depends on parameters alone to its index in the C array ``c``."""
    tables: dict[int, int] = field(default_factory=dict)
    """Dictionary from a node whose value is looked up in a table to the number of the table."""
    names: dict[int, str] = field(default_factory=dict)
    """Dictionary from a node to the name of its variable. Other variables have numbered names."""
    functions: set[str] = field(default_factory=set)
    """Names of the C library functions that the printed code calls."""
    operations: Counter[str] = field(default_factory=Counter)
    """Number of uses of each operator and function. A caller may clear this counter."""

    def collect_fixed(self, roots: Iterable[int]) -> None:
        """Set `fixed` to those nodes required for ``roots`` that depend on parameters alone.

        Parameters themselves are left out, because the statements read their values directly.
        """
        nodes = fixed_nodes(self.graph, roots, self.tables)
        worthwhile = [node for node in nodes if self.graph.nodes[node][0] not in SOURCES]
        self.fixed = {node: number for number, node in enumerate(worthwhile)}

    def constant_in_a_tick(self, roots: Iterable[int]) -> dict[int, int]:
        """Return nodes that ``roots`` require and that change at ticks only, each with a number.

        Such a node depends on discrete states, inputs and parameters. Sources and nodes in `fixed`
        are left out, because the statements read their values directly.
        """
        nodes = fixed_nodes(self.graph, roots, kinds=TICK_SOURCES)
        read = {*self.fixed, *(node for node in nodes if self.graph.nodes[node][0] in SOURCES)}
        worthwhile = (node for node in nodes if node not in read)
        return {node: number for number, node in enumerate(worthwhile)}

    def block(
        self,
        targets: Sequence[tuple[str, int]],
        load: Load,
        *,
        fixed: Mapping[int, int] | None = None,
        held: Mapping[int, int] | None = None,
        indent: str = "    ",
    ) -> list[str]:
        """Return C statements that compute nodes and assign their values to C variables.

        Parameters
        ----------
        targets
            Pairs of a C variable and the node whose value it gets.
        load
            Returns the C text that reads an element of a source, a constant or a table.
        fixed
            Nodes that the statements read as constants, with their indices; None: those of the
            attribute `fixed`.
        held
            Nodes that the statements read as elements of the kind ``held``, with their indices.
        indent
            Spaces before each statement.
        """
        constants = self.fixed if fixed is None else fixed
        loads = {node: ("constant", number) for node, number in constants.items()}
        loads |= {node: ("table", number) for node, number in self.tables.items()}
        loads |= {node: ("held", number) for node, number in (held or {}).items()}
        return _Block(self, load, loads, indent).lines(targets)


class _Block:
    """C statements that compute some nodes and assign their values to C variables."""

    def __init__(
        self, printer: CPrinter, load: Load, loads: Mapping[int, tuple[str, int]], indent: str
    ) -> None:
        """Store the arguments. ``loads`` maps a node that ``load`` reads to its kind and index."""
        self.printer, self.graph, self.load, self.loads = printer, printer.graph, load, loads
        self.real = printer.precision
        self.indent = indent
        self.names: dict[int, str] = {}
        """Variables that the statements define, by node."""
        self.text: dict[int, str] = {}
        """C text that reads each node that has been printed, a variable or an expression."""
        self.assigned: set[int] = set()

    def lines(self, targets: Sequence[tuple[str, int]]) -> list[str]:
        """Return the statements for ``targets``, section by section."""
        self.assigned = {node for _, node in targets}
        needed = self._reachable(self.assigned)
        uses = Counter(node for _, node in targets)
        for node in needed:
            uses.update(self._arguments(node))
        lines: list[str] = []
        unprinted, unassigned = set(needed), list(targets)
        signals = {node for section in self.printer.sections for node in section.nodes}
        for section in self.printer.sections:
            new = unprinted & self._reachable(section.nodes)
            unprinted -= new
            # A section assigns its own signals, and values on the way that are nobody's signals.
            values = {*section.nodes, *(new - signals)}
            assigned = [target for target in unassigned if target[1] in values]
            unassigned = [target for target in unassigned if target not in assigned]
            statements = self._statements(sorted(new), uses) + self._assignments(assigned)
            if statements:
                lines += section_comment(section, self.indent)
            lines += statements
        rest = self._statements(sorted(unprinted), uses) + self._assignments(unassigned)
        if rest and lines:
            lines += comment_lines("Values of no single system.", self.indent)
        return lines + rest

    def _statements(self, nodes: Sequence[int], uses: Counter[int]) -> list[str]:
        """Return C statements that define a variable for each node that deserves one.

        A node gets a variable if another node uses it and it has a name, if it is used several
        times, or if its expression is long. Store the C text of each node, a variable or an
        expression, for the statements that follow.
        """
        lines = []
        for node in nodes:
            text = self._expression(node)
            is_read_directly = not self._arguments(node)
            is_named = node in self.printer.names and node not in self.assigned
            fits_its_use = uses[node] == 1 and len(text) < _LONGEST_EXPRESSION
            if is_read_directly or (fits_its_use and not is_named):
                self.text[node] = text
                continue
            condition = self.graph.nodes[node][0] in CONDITIONS
            number = f"{'is' if condition else 'v'}{len(self.names)}"
            name = self.printer.names.get(node, number)
            self.names[node] = self.text[node] = name
            kind = "bool" if condition else "real"
            lines.append(self._line(f"const {kind} {name} = {self._bare(text)};"))
        return lines

    def _assignments(self, targets: Sequence[tuple[str, int]]) -> list[str]:
        return [self._line(f"{place} = {self._bare(self.text[node])};") for place, node in targets]

    def _arguments(self, node: int) -> tuple[int, ...]:
        return () if node in self.loads else self.graph.arguments(node)

    def _reachable(self, roots: Iterable[int]) -> set[int]:
        return set(self.graph.reachable(roots, self._arguments))

    def _line(self, text: str) -> str:
        return "\n".join(
            textwrap.wrap(
                text,
                WIDTH,
                initial_indent=self.indent,
                subsequent_indent=f"{self.indent}    ",
                break_long_words=False,
                break_on_hyphens=False,
            )
        )

    @staticmethod
    def _bare(text: str) -> str:
        """Return a C expression without parentheses that enclose the whole expression."""
        if not (text.startswith("(") and text.endswith(")")):
            return text
        depth = 0
        for place, character in enumerate(text):
            depth += (character == "(") - (character == ")")
            if depth == 0:
                return text[1:-1] if place == len(text) - 1 else text
        return text

    def _count(self, operation: str, times: int = 1) -> None:
        self.printer.operations[operation] += times

    def _expression(self, node: int) -> str:
        """Return a C expression for a node whose arguments have been printed. Count operations."""
        if node in self.loads:
            return self.load(*self.loads[node])
        kind, *rest = self.graph.nodes[node]
        kind = str(kind)
        if kind == "constant":
            text = literal(float(rest[0]), self.real)
            return f"({text})" if text.startswith("-") else text
        if kind in SOURCES:
            return self.load(kind, int(rest[0]))
        arguments = self.graph.arguments(node)
        if kind == "add":
            return self._sum(arguments)
        if kind == "multiply":
            return self._product(node)
        texts = [self.text[argument] for argument in arguments]
        operation = OPERATIONS[kind]
        symbol = operation.c
        if symbol == "!":
            return f"(!{texts[0]})"
        if symbol == "?:":
            condition, positive, otherwise = texts
            self._count("choose")
            return f"({condition} ? {positive} : {otherwise})"
        if symbol in ("minimum", "maximum"):  # functions of the template
            self._count(kind)
            return f"{symbol}({', '.join(texts)})"
        if symbol.isidentifier():
            name = f"{symbol}{self.real.suffix}"
            self._count(name)
            self.printer.functions.add(name)
            return f"{name}({', '.join(map(self._bare, texts))})"
        if operation.role is not Role.LOGIC:
            self._count("compare" if operation.role is Role.COMPARISON else symbol)
        return f"({f' {symbol} '.join(texts)})"

    def _sum(self, terms: Sequence[int]) -> str:
        self._count("+", len(terms) - 1)
        text = ""
        for term in terms:
            minus = self._negated(term)
            value = self.text[term] if minus is None else minus
            sign = "" if minus is None else "-"
            text += f" {sign or '+'} {value}" if text else f"{sign}{value}"
        return f"({text})"

    def _negated(self, node: int) -> str | None:
        """If ``node`` is a product with the C text ``(-x)``, return ``x``, otherwise None."""
        kind, *_ = self.graph.nodes[node]
        text = self.text[node]
        return text[2:-1] if kind == "multiply" and text.startswith("(-") else None

    def _product(self, node: int) -> str:
        negative, factors = False, []
        for argument in self.graph.arguments(node):
            if self.graph.value(argument) == -1.0:
                negative = not negative
            else:
                factors.append(self.text[argument])
        self._count("*", max(len(factors) - 1, 0))
        product = " * ".join(factors) or literal(1.0, self.real)
        if negative:
            return f"(-{product})" if len(factors) < 2 else f"(-({product}))"
        return f"({product})" if len(factors) > 1 else product


def section_comment(section: Section, indent: str = "") -> list[str]:
    """Return the lines of the C comment that precedes the statements of a section."""
    return comment_lines(f"{section.where}. {section.equation}", indent)


def comment_lines(text: str, indent: str = "") -> list[str]:
    """Return the lines of a C comment in ASCII. Greek letters become their names."""
    text = re.sub(r"(?<=\*)(?=/)|(?<=/)(?=\*)|(?<=\?)(?=\?)", " ", plain_line(text))
    return textwrap.wrap(
        f"/* {text} */", WIDTH, initial_indent=indent, subsequent_indent=f"{indent} * "
    )


def in_ascii(character: str) -> str:
    """Return a character in ASCII: theta for θ, Delta for Δ, e for é, and - for a dash or Chinese.

    A control character becomes - too.
    """
    if character.isascii():
        return character if character.isprintable() else "-"
    base = unicodedata.normalize("NFKD", character)
    _, letter, words = unicodedata.name(base[0], "").rpartition("LETTER ")
    if (plain := base.encode("ascii", "ignore").decode()) or not letter:
        return plain or "-"
    name = words.partition(" ")[0].lower().replace("lamda", "lambda")  # Unicode spells it so
    return name.capitalize() if base[0].isupper() else name


def plain_line(text: str) -> str:
    """Return text as one line of ASCII without backslashes and control characters."""
    words = "".join(map(in_ascii, " ".join(text.split()))).split()
    return " ".join(words).replace("\\", "/")  # no splice of lines
