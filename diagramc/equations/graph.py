"""A graph of shared scalar operations.

Nodes are numbered in the order of their creation, so the arguments of a node have smaller numbers.
Equal operations on equal arguments are one node. Drake's `Expression` shares nodes as well, but
every walk over an expression unfolds its shared nodes into a tree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

Entry: TypeAlias = tuple[Any, ...]
"""The content of a node: name of the operation or source, and its arguments.

An argument of an operation is the number of a node. The argument of a constant is its value. The
argument of any other source is the index of an element.
"""

SOURCES = ("constant", "parameter", "time", "state", "discrete", "input")
"""Kinds of nodes whose value no operation computes.

``discrete``: a discrete state; ``input``: an element of an open input port of the diagram.
"""

_LARGEST_POWER = 16  # largest whole exponent that becomes a product


@dataclass
class Graph:
    """Nodes of scalar operations and their sources.

    A node is known by its number. A method that "makes" a node returns the number of the new node,
    or of an equal node that exists already.
    """

    nodes: list[Entry] = field(default_factory=list)
    depends: list[frozenset[str]] = field(default_factory=list)
    """For each node, the kinds of `SOURCES` that its value depends on, except ``constant``."""
    _numbers: dict[Entry, int] = field(default_factory=dict)
    _polynomials: dict[int, tuple[tuple[int, ...], int]] = field(default_factory=dict)
    """Dictionary from the node of a polynomial to a pair: the nodes of the coefficients (lowest
    power first), and the node of the variable."""

    def copy(self) -> Graph:
        """Return an independent copy: new nodes of the copy do not appear in this graph."""
        lists = list(self.nodes), list(self.depends)
        return Graph(*lists, dict(self._numbers), dict(self._polynomials))

    def simplified(self, name: str, *arguments: int) -> int:
        """Make the node of an operation, with the simplifications of `add`, `divide` and so on."""
        simplifying: dict[str, Callable[..., int]] = {
            "add": self.add,
            "multiply": self.multiply,
            "divide": self.divide,
            "power": self.power,
            "where": self.where,
            "atan2": self.atan2,
        }
        if name in simplifying:
            return simplifying[name](*arguments)
        return self.node(name, *arguments)

    def node(self, *operation: Any) -> int:
        """Make the node of an operation or source as it is, without simplification.

        ``operation`` has its name, one of `SOURCES` or `OPERATIONS`, and then its arguments.
        """
        # 0.0 equals -0.0 as a key, but both are different nodes.
        key = ("constant", str(operation[1])) if operation == ("constant", 0.0) else operation
        number = self._numbers.setdefault(key, len(self.nodes))
        if number == len(self.nodes):
            self.nodes.append(operation)
            kind = str(operation[0])
            own = {kind} if kind in SOURCES and kind != "constant" else set()
            of_arguments = (self.depends[argument] for argument in self.arguments(number))
            self.depends.append(frozenset(own).union(*of_arguments))
        return number

    def is_fixed(self, node: int) -> bool:
        """Return whether the value of a node depends on nothing but parameters and constants."""
        return self.depends[node] <= {"parameter"}

    def constant(self, value: float) -> int:
        """Make the node of a literal number."""
        return self.node("constant", float(value))

    def source(self, kind: str, index: int = 0) -> int:
        """Make the node of a source: the time, or element ``index`` of the vector of this kind."""
        return self.node(kind, index)

    @property
    def zero(self) -> int:
        """The node of the number 0."""
        return self.constant(0.0)

    @property
    def one(self) -> int:
        """The node of the number 1."""
        return self.constant(1.0)

    def value(self, node: int) -> float | None:
        """Return the value of a constant; None for every other node."""
        kind, *arguments = self.nodes[node]
        return arguments[0] if kind == "constant" else None

    def arguments(self, node: int) -> tuple[int, ...]:
        """Return the nodes that are arguments of a node; none for a source."""
        kind, *arguments = self.nodes[node]
        return () if kind in SOURCES else tuple(arguments)

    def add(self, *terms: int) -> int:
        """Make a sum, added from left to right; constant terms that are 0 are left out.

        A sum c + t·p(t), where p is a polynomial, is rearranged for speed.
        """
        rest = [term for term in terms if self.value(term) != 0.0]
        if len(rest) < 2:
            return rest[0] if rest else self.zero
        return self._as_polynomial(rest) or self.node("add", *rest)

    def _as_polynomial(self, terms: list[int]) -> int | None:
        """If two ``terms`` are c and t·p(t) with a polynomial p, make their sum; else return None.

        The coefficients are fixed values. The sum uses Estrin's scheme, whose products do not wait
        for each other. (Each product of Horner's rule waits for the product before.)
        """
        if len(terms) != 2:
            return None
        for c, product in (terms, terms[::-1]):
            name, *factors = self.nodes[product]
            if not self.is_fixed(c) or name != "multiply" or len(factors) != 2:
                continue
            for p, t in (factors, factors[::-1]):
                p_coefficients: tuple[int, ...] = ()
                if self.is_fixed(p) and not self.is_fixed(t):
                    p_coefficients = (p,)
                elif self._polynomials.get(p, ((), None))[1] == t:
                    p_coefficients = self._polynomials[p][0]
                if p_coefficients:
                    coefficients = (c, *p_coefficients)
                    node = self._polynomial(coefficients, t)
                    # A longer polynomial that ends with this one finds the coefficients here.
                    self._polynomials[node] = coefficients, t
                    return node
        return None

    def _polynomial(self, coefficients: tuple[int, ...], t: int) -> int:
        """Make the polynomial in ``t`` by Estrin's scheme; the first coefficient belongs to t⁰."""
        if len(coefficients) > 4:
            square = self.multiply(t, t)
            even = self._polynomial(coefficients[::2], square)
            odd = self._polynomial(coefficients[1::2], square)
            return self.node("add", even, self.node("multiply", odd, t))
        *lower, node = coefficients
        for coefficient in reversed(lower):  # Horner's rule
            node = self.node("add", coefficient, self.node("multiply", node, t))
        return node

    def multiply(self, *factors: int) -> int:
        """Make a product, from left to right; factors 1 are left out, and a factor 0 gives 0."""
        values = [self.value(factor) for factor in factors]
        if 0.0 in values:
            return self.zero
        rest = [f for f, value in zip(factors, values, strict=True) if value != 1.0]
        if len(rest) < 2:
            return rest[0] if rest else self.one
        return self.node("multiply", *rest)

    def negate(self, node: int) -> int:
        """Make the product of a node and -1."""
        value = self.value(node)
        return self.multiply(self.constant(-1.0), node) if value is None else self.constant(-value)

    def subtract(self, left: int, right: int) -> int:
        """Make the difference ``left`` - ``right``."""
        return self.add(left, self.negate(right))

    def divide(self, numerator: int, denominator: int) -> int:
        """Make a quotient; if the denominator is 1 or the numerator is 0, return the numerator."""
        if self.value(denominator) == 1.0 or self.value(numerator) == 0.0:
            return numerator
        return self.node("divide", numerator, denominator)

    def power(self, base: int, exponent: int) -> int:
        """Make a power; a constant whole exponent from 0 to 16 gives a product."""
        value = self.value(exponent)
        if value is not None and value.is_integer() and 0 <= value <= _LARGEST_POWER:
            return self.multiply(*[base] * int(value))
        return self.node("power", base, exponent)

    def atan2(self, y: int, x: int) -> int:
        """Make the angle of a point; atan2(sin ψ, cos ψ) becomes ψ minus whole turns.

        These are faster to compute.
        """
        (first, *angles), (second, *others) = self.nodes[y], self.nodes[x]
        if (first, second) == ("sin", "cos") and angles == others:
            angle = self.arguments(y)[0]
            turn = self.constant(2.0 * math.pi)
            turns = self.node("ceil", self.subtract(self.divide(angle, turn), self.constant(0.5)))
            return self.subtract(angle, self.multiply(turn, turns))
        return self.node("atan2", y, x)

    def where(self, condition: int, positive: int, otherwise: int) -> int:
        """Make a choice: ``positive`` where the condition holds, else ``otherwise``."""
        if positive == otherwise:
            return positive
        return self.node("where", condition, positive, otherwise)

    def reachable(
        self, roots: Iterable[int], arguments: Callable[[int], Iterable[int]] | None = None
    ) -> list[int]:
        """Return ``roots`` and all nodes that they depend on; arguments come before their readers.

        ``arguments(node)`` returns the arguments that the search follows, by default all arguments.
        """
        followed = self.arguments if arguments is None else arguments
        reached: set[int] = set()
        pending = list(roots)
        while pending:
            node = pending.pop()
            if node not in reached:
                reached.add(node)
                pending.extend(followed(node))
        return sorted(reached)

    def subtract_one(self, exponent: int) -> int:
        """Make ``exponent`` - 1. If the exponent is a finite constant, the result is a constant."""
        value = self.value(exponent)
        if value is not None and math.isfinite(value):
            return self.constant(value - 1.0)
        return self.subtract(exponent, self.one)
