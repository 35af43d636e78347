"""Equations as one graph of shared scalar operations, which can be differentiated and printed.

Nodes are numbered in the order of their creation, so arguments come before what uses them; equal
operations on equal arguments are one node. Drake's own `Expression` shares as well, but every walk
over it unfolds it into a tree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

Operation = tuple[Any, ...]
"""Name of the operation and its arguments: numbers of nodes, or a plain value in a source."""

SOURCES = ("constant", "parameter", "time", "state", "discrete", "input")
"""Kinds of nodes without arguments; a ``discrete`` state is constant between two events."""

COMPARISONS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<=", "eq": "==", "ne": "!="}
"""Each comparison and its operator in Python and C."""

_DERIVATIVES_OF_ONE = {
    "exp": lambda g, a, f: f,
    "log": lambda g, a, f: g.divide(g.one, a),
    "sqrt": lambda g, a, f: g.divide(g.constant(0.5), f),
    "sin": lambda g, a, f: g.unary("cos", a),
    "cos": lambda g, a, f: g.negate(g.unary("sin", a)),
    "tan": lambda g, a, f: g.add(g.one, g.multiply(f, f)),
    "asin": lambda g, a, f: g.divide(g.one, g.unary("sqrt", g.subtract(g.one, g.multiply(a, a)))),
    "acos": lambda g, a, f: g.negate(
        g.divide(g.one, g.unary("sqrt", g.subtract(g.one, g.multiply(a, a))))
    ),
    "atan": lambda g, a, f: g.divide(g.one, g.add(g.one, g.multiply(a, a))),
    "sinh": lambda g, a, f: g.unary("cosh", a),
    "cosh": lambda g, a, f: g.unary("sinh", a),
    "tanh": lambda g, a, f: g.subtract(g.one, g.multiply(f, f)),
    "abs": lambda g, a, f: g.where(g.compare("lt", a, g.zero), g.constant(-1.0), g.one),
    "floor": lambda g, a, f: g.zero,
    "ceil": lambda g, a, f: g.zero,
}

UNARY = tuple(_DERIVATIVES_OF_ONE)
"""Elementary functions of one argument."""

_LARGEST_POWER = 16  # larger whole exponents are left to pow()


@dataclass
class Graph:
    """Nodes of scalar operations; the methods return the number of a new or an equal node."""

    nodes: list[Operation] = field(default_factory=list)
    depends: list[frozenset[str]] = field(default_factory=list)
    """Of each node, the kinds of `SOURCES` that its value depends on, but constants."""
    _known: dict[Operation, int] = field(default_factory=dict)
    _polynomials: dict[int, tuple[tuple[int, ...], int]] = field(default_factory=dict)

    def operation(self, name: str, *arguments: Any) -> int:
        """An operation as it is, without the simplifications of the methods below."""
        return self._node(name, *arguments)

    def _node(self, *operation: Any) -> int:
        key = ("constant", str(operation[1])) if operation == ("constant", 0.0) else operation
        number = self._known.setdefault(key, len(self.nodes))  # 0.0 equals -0.0
        if number == len(self.nodes):
            self.nodes.append(operation)
            of = (self.depends[argument] for argument in self.arguments(number))
            kind = str(operation[0])
            own = {kind} if kind in SOURCES and kind != "constant" else set()
            self.depends.append(frozenset(own).union(*of))
        return number

    def is_fixed(self, node: int) -> bool:
        """Whether the value depends on parameters at most."""
        return self.depends[node] <= {"parameter"}

    def constant(self, value: float) -> int:
        """A literal number."""
        return self._node("constant", float(value))

    def source(self, kind: str, index: int = 0) -> int:
        """Element ``index`` of a parameter, state, discrete or input vector, or the time."""
        return self._node(kind, index)

    @property
    def zero(self) -> int:
        """The number 0."""
        return self.constant(0.0)

    @property
    def one(self) -> int:
        """The number 1."""
        return self.constant(1.0)

    def value(self, node: int) -> float | None:
        """The number that a constant node stands for; None for every other node."""
        kind, *arguments = self.nodes[node]
        return arguments[0] if kind == "constant" else None

    def arguments(self, node: int) -> tuple[int, ...]:
        """The nodes that a node is made of."""
        kind, *arguments = self.nodes[node]
        return () if kind in SOURCES else tuple(arguments)

    def add(self, *terms: int) -> int:
        """Sum, from left to right."""
        kept = [term for term in terms if self.value(term) != 0.0]
        if len(kept) < 2:
            return kept[0] if kept else self.zero
        return self._as_polynomial(kept) or self._node("add", *kept)

    def _as_polynomial(self, terms: list[int]) -> int | None:
        """A step of Horner's rule, c + t·p(t), regrouped so that its products overlap in time."""
        for constant, product in (terms, terms[::-1]) if len(terms) == 2 else ():
            name, *factors = self.nodes[product]
            if not self.is_fixed(constant) or name != "multiply" or len(factors) != 2:
                continue
            for inner, t in (factors, factors[::-1]):
                higher: tuple[int, ...] = ()
                if self.is_fixed(inner) and not self.is_fixed(t):
                    higher = (inner,)
                elif self._polynomials.get(inner, ((), None))[1] == t:
                    higher = self._polynomials[inner][0]
                if higher:
                    coefficients = (constant, *higher)
                    node = self._polynomial(coefficients, t)
                    self._polynomials[node] = coefficients, t
                    return node
        return None

    def _polynomial(self, coefficients: tuple[int, ...], t: int) -> int:
        """Estrin's scheme, lowest power first."""
        if len(coefficients) > 4:
            square = self.multiply(t, t)
            even, odd = (self._polynomial(coefficients[n::2], square) for n in (0, 1))
            return self._node("add", even, self._node("multiply", odd, t))
        *lower, node = coefficients
        for coefficient in reversed(lower):
            node = self._node("add", coefficient, self._node("multiply", node, t))
        return node

    def multiply(self, *factors: int) -> int:
        """Product, from left to right."""
        values = [self.value(factor) for factor in factors]
        if 0.0 in values:
            return self.zero
        kept = [f for f, value in zip(factors, values, strict=True) if value != 1.0]
        if len(kept) < 2:
            return kept[0] if kept else self.one
        return self._node("multiply", *kept)

    def negate(self, node: int) -> int:
        """The negative."""
        value = self.value(node)
        return self.multiply(self.constant(-1.0), node) if value is None else self.constant(-value)

    def subtract(self, left: int, right: int) -> int:
        """The difference."""
        return self.add(left, self.negate(right))

    def divide(self, numerator: int, denominator: int) -> int:
        """The quotient."""
        if self.value(denominator) == 1.0 or self.value(numerator) == 0.0:
            return numerator
        return self._node("divide", numerator, denominator)

    def power(self, base: int, exponent: int) -> int:
        """The power; small whole exponents become products."""
        value = self.value(exponent)
        if value is not None and value.is_integer() and 0 <= value <= _LARGEST_POWER:
            return self.multiply(*[base] * int(value))
        return self._node("power", base, exponent)

    def unary(self, name: str, argument: int) -> int:
        """An elementary function of one argument, of `UNARY`."""
        return self._node(name, argument)

    def binary(self, name: str, left: int, right: int) -> int:
        """``min``, ``max`` or ``atan2``; atan2(sin a, cos a) becomes whole turns less."""
        (sine, *of), (cosine, *also) = self.nodes[left], self.nodes[right]
        if (name, sine, cosine) == ("atan2", "sin", "cos") and of == also:
            angle = self.arguments(left)[0]
            turn = self.constant(2.0 * math.pi)
            turns = self.unary("ceil", self.subtract(self.divide(angle, turn), self.constant(0.5)))
            return self.subtract(angle, self.multiply(turn, turns))
        return self._node(name, left, right)

    def compare(self, name: str, left: int, right: int) -> int:
        """A condition, of ``COMPARISONS``."""
        return self._node(name, left, right)

    def where(self, condition: int, positive: int, otherwise: int) -> int:
        """One of two values."""
        if positive == otherwise:
            return positive
        return self._node("where", condition, positive, otherwise)

    def logic(self, name: str, *conditions: int) -> int:
        """``and``, ``or`` or ``not`` of conditions."""
        return self._node(name, *conditions)

    def reachable(
        self, roots: Iterable[int], arguments: Callable[[int], Iterable[int]] | None = None
    ) -> list[int]:
        """All nodes that ``roots`` are made of, and they, arguments first.

        ``arguments``: of a node those to follow, all by default.
        """
        of = self.arguments if arguments is None else arguments
        reached: set[int] = set()
        pending = list(roots)
        while pending:
            node = pending.pop()
            if node not in reached:
                reached.add(node)
                pending.extend(of(node))
        return sorted(reached)

    def gradients(self, roots: Iterable[int], kind: str = "state") -> list[dict[int, int]]:
        """Of each root, its partial derivatives by the sources of ``kind`` that it depends on.

        At a corner (min, max, abs) the derivative is that of one side.
        """
        roots = list(roots)
        known: dict[int, dict[int, int]] = {}
        for node in self.reachable(roots):
            known[node] = self._gradient(node, known, kind)
        return [known[root] for root in roots]

    def _gradient(self, node: int, known: dict[int, dict[int, int]], kind: str) -> dict[int, int]:
        name, *_ = self.nodes[node]
        if name == kind:
            return {int(self.nodes[node][1]): self.one}
        arguments = self.arguments(node)
        by = {index for argument in arguments for index in known[argument]}
        if not by:
            return {}
        partials = self._partials(str(name), arguments, node)
        total = {}
        for index in sorted(by):
            terms = [
                self.multiply(partial, known[argument][index])
                for partial, argument in zip(partials, arguments, strict=True)
                if partial is not None and index in known[argument]
            ]
            total[index] = self.add(*terms)
        return {index: term for index, term in total.items() if term != self.zero}

    def _partials(self, name: str, a: tuple[int, ...], node: int) -> list[int | None]:
        """The derivative by each argument; None where an argument does not count."""
        if name == "add":
            return [self.one] * len(a)
        if name == "multiply":
            return [self.multiply(*a[:n], *a[n + 1 :]) for n in range(len(a))]
        if name == "divide":
            return [self.divide(self.one, a[1]), self.negate(self.divide(node, a[1]))]
        if name == "power":
            lower = self.power(a[0], self.subtract_one(a[1]))
            return [self.multiply(a[1], lower), self.multiply(node, self.unary("log", a[0]))]
        if name == "atan2":
            square = self.add(self.multiply(a[0], a[0]), self.multiply(a[1], a[1]))
            return [self.divide(a[1], square), self.negate(self.divide(a[0], square))]
        if name in {"min", "max"}:
            first = self.compare("lt" if name == "min" else "gt", *a)
            return [
                self.where(first, self.one, self.zero),
                self.where(first, self.zero, self.one),
            ]
        if name == "where":
            return [
                None,
                self.where(a[0], self.one, self.zero),
                self.where(a[0], self.zero, self.one),
            ]
        if name in _DERIVATIVES_OF_ONE:
            return [_DERIVATIVES_OF_ONE[name](self, a[0], node)]
        return [None] * len(a)  # comparisons

    def subtract_one(self, exponent: int) -> int:
        """An exponent less one, folded when it is a number."""
        value = self.value(exponent)
        if value is not None and math.isfinite(value):
            return self.constant(value - 1.0)
        return self.subtract(exponent, self.one)
