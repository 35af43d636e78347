"""The only table of operations: value, derivative, cost, and form in machine code and in C.

A new row of this table adds an operation. No other code is necessary, unless a backend (machine
code or C) has to write the operation in a new way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum, auto
from functools import reduce
from typing import Any, TypeAlias

import numpy as np

from .graph import Graph

Partials: TypeAlias = Callable[[Graph, tuple[int, ...], int], list[int | None]]
"""``partials(graph, arguments, node)`` returns the derivatives of ``node`` by its arguments.

Each derivative is a node, or None. None means that the derivative counts as zero, because the value
changes only in jumps when the argument changes.
"""


class Role(Enum):
    """How the value of an operation changes with its arguments."""

    SMOOTH = auto()
    """The derivative exists wherever the value is finite, except at the edge of the domain."""
    CORNER = auto()
    """The derivative jumps where the operation changes its branch, as abs does at zero."""
    ROUNDING = auto()
    """The value is a whole number."""
    COMPARISON = auto()
    """The value is a truth value that depends on numbers, such as a > b."""
    LOGIC = auto()
    """The value is a truth value that depends on truth values: and, or, not."""


@dataclass(frozen=True)
class Operation:
    """An operation of a graph: one row of `OPERATIONS`."""

    value: Callable[..., Any]
    """Function that returns the value for arguments that are numbers or NumPy arrays."""
    partials: Partials
    """Function that makes the nodes of the derivatives by the arguments: see `Partials`."""
    drake: str
    """Name of Drake's ExpressionKind or FormulaKind."""
    native: str
    """Name of the emitter in `native.printer` that writes the operation as LLVM IR. A dot and an
    argument of the emitter can follow the name."""
    c: str
    """The operation in C: an operator, or the name of a function in double precision."""
    role: Role = Role.SMOOTH
    exact: bool = False
    """True if IEEE 754 fixes every bit of the result, on all processors and in all libraries."""
    arguments: int | None = 2
    """Number of arguments; None stands for any number."""
    cost: int = 10
    """Duration of the operation divided by the duration of a sum."""
    simple: bool = False
    """True if a small processor computes the operation without a library and without division."""

    @property
    def is_condition(self) -> bool:
        """True if the value of the operation is a truth value."""
        return self.role in (Role.COMPARISON, Role.LOGIC)

    @property
    def decides(self) -> bool:
        """True if the last bit of an argument can change the value by much, as in a comparison."""
        return self.role in (Role.COMPARISON, Role.ROUNDING)


def _no_derivatives(g: Graph, a: tuple[int, ...], f: int) -> list[int | None]:
    """Return None for each argument: the partials of an operation without derivatives."""
    return [None] * len(a)


def _of_one(derivative: Callable[[Graph, int, int], int]) -> Partials:
    """Return the `Partials` of a function of one argument.

    ``derivative(graph, argument, node)`` makes the node of the derivative.
    """
    return lambda g, a, f: [derivative(g, a[0], f)]


def _extreme(comparison: str) -> Partials:
    """Return the `Partials` of a minimum or maximum: 1 for the chosen argument, 0 for the other.

    ``comparison`` of both arguments is true if the first argument is chosen.
    """

    def partials(g: Graph, a: tuple[int, ...], f: int) -> list[int | None]:
        is_first = g.node(comparison, *a)
        return [g.where(is_first, g.one, g.zero), g.where(is_first, g.zero, g.one)]

    return partials


def _power(g: Graph, a: tuple[int, ...], f: int) -> list[int | None]:
    base, exponent = a
    lower = g.power(base, g.subtract_one(exponent))
    return [g.multiply(exponent, lower), g.multiply(f, g.node("log", base))]


def _atan2(g: Graph, a: tuple[int, ...], f: int) -> list[int | None]:
    y, x = a
    square = g.add(g.multiply(y, y), g.multiply(x, x))
    return [g.divide(x, square), g.negate(g.divide(y, square))]


def _root_of_one_minus_square(g: Graph, a: int) -> int:
    return g.node("sqrt", g.subtract(g.one, g.multiply(a, a)))


def _comparison(value: Any, drake: str, name: str, c: str) -> Operation:
    native = f"compare.{name}"
    return Operation(value, _no_derivatives, drake, native, c, Role.COMPARISON, simple=True)


def _logic(value: Any, drake: str, native: str, c: str, arguments: int | None = None) -> Operation:
    row = Operation(value, _no_derivatives, drake, native, c, Role.LOGIC, simple=True)
    return replace(row, arguments=arguments)


def _function(
    value: Any,
    derivative: Callable[[Graph, int, int], int],
    drake: str,
    native: str,
    c: str,
    role: Role = Role.SMOOTH,
    **properties: Any,
) -> Operation:
    partials = _of_one(derivative)
    return Operation(value, partials, drake, native, c, role, arguments=1, **properties)


# The lambdas of the derivatives take the graph g, the argument or arguments a and the node f of the
# value. The texts behind a star are `drake`, `native` and `c`.
OPERATIONS: dict[str, Operation] = {
    "add": Operation(
        lambda *a: reduce(np.add, a),
        lambda g, a, f: [g.one] * len(a),
        *("Add", "sum", "+"),
        arguments=None,
        exact=True,
        cost=1,
        simple=True,
    ),
    "multiply": Operation(
        lambda *a: reduce(np.multiply, a),
        lambda g, a, f: [g.multiply(*a[:n], *a[n + 1 :]) for n in range(len(a))],
        *("Mul", "product", "*"),
        arguments=None,
        exact=True,
        cost=1,
        simple=True,
    ),
    "divide": Operation(
        np.divide,
        lambda g, a, f: [g.divide(g.one, a[1]), g.negate(g.divide(f, a[1]))],
        *("Div", "binary.div", "/"),
        exact=True,
    ),
    "power": Operation(np.power, _power, "Pow", "elementary.power", "pow"),
    "exp": _function(np.exp, lambda g, a, f: f, "Exp", "elementary.exp", "exp"),
    "log": _function(np.log, lambda g, a, f: g.divide(g.one, a), "Log", "elementary.log", "log"),
    "sqrt": _function(
        np.sqrt,
        lambda g, a, f: g.divide(g.constant(0.5), f),
        *("Sqrt", "instruction.sqrt", "sqrt"),
        exact=True,
    ),
    "sin": _function(np.sin, lambda g, a, f: g.node("cos", a), "Sin", "sincos.0", "sin"),
    "cos": _function(np.cos, lambda g, a, f: g.negate(g.node("sin", a)), "Cos", "sincos.1", "cos"),
    "tan": _function(
        np.tan, lambda g, a, f: g.add(g.one, g.multiply(f, f)), "Tan", "library.tan", "tan"
    ),
    "asin": _function(
        np.arcsin,
        lambda g, a, f: g.divide(g.one, _root_of_one_minus_square(g, a)),
        *("Asin", "elementary.asin", "asin"),
    ),
    "acos": _function(
        np.arccos,
        lambda g, a, f: g.negate(g.divide(g.one, _root_of_one_minus_square(g, a))),
        *("Acos", "elementary.acos", "acos"),
    ),
    "atan": _function(
        np.arctan,
        lambda g, a, f: g.divide(g.one, g.add(g.one, g.multiply(a, a))),
        *("Atan", "elementary.atan", "atan"),
    ),
    "atan2": Operation(np.arctan2, _atan2, "Atan2", "elementary.atan2", "atan2"),
    "sinh": _function(np.sinh, lambda g, a, f: g.node("cosh", a), "Sinh", "library.sinh", "sinh"),
    "cosh": _function(np.cosh, lambda g, a, f: g.node("sinh", a), "Cosh", "library.cosh", "cosh"),
    "tanh": _function(
        np.tanh,
        lambda g, a, f: g.subtract(g.one, g.multiply(f, f)),
        *("Tanh", "elementary.tanh", "tanh"),
    ),
    "abs": _function(
        np.abs,
        lambda g, a, f: g.where(g.node("lt", a, g.zero), g.constant(-1.0), g.one),
        *("Abs", "instruction.absolute", "fabs"),
        role=Role.CORNER,
        exact=True,
        simple=True,
    ),
    # As std::min and std::max: the first argument where one is not a number.
    "min": Operation(
        lambda a, b: np.where(b < a, b, a),
        _extreme("lt"),
        *("Min", "instruction.minimum", "minimum"),
        role=Role.CORNER,
        exact=True,
        simple=True,
    ),
    "max": Operation(
        lambda a, b: np.where(a < b, b, a),
        _extreme("gt"),
        *("Max", "instruction.maximum", "maximum"),
        role=Role.CORNER,
        exact=True,
        simple=True,
    ),
    "where": Operation(
        np.where,
        lambda g, a, f: [None, g.where(a[0], g.one, g.zero), g.where(a[0], g.zero, g.one)],
        *("IfThenElse", "select", "?:"),
        arguments=3,
        role=Role.CORNER,
        exact=True,
        simple=True,
    ),
    "floor": _function(
        np.floor,
        lambda g, a, f: g.zero,
        *("Floor", "instruction.floor", "floor"),
        role=Role.ROUNDING,
        exact=True,
    ),
    "ceil": _function(
        np.ceil,
        lambda g, a, f: g.zero,
        *("Ceil", "instruction.ceil", "ceil"),
        role=Role.ROUNDING,
        exact=True,
    ),
    "gt": _comparison(np.greater, "Gt", "gt", ">"),
    "ge": _comparison(np.greater_equal, "Geq", "ge", ">="),
    "lt": _comparison(np.less, "Lt", "lt", "<"),
    "le": _comparison(np.less_equal, "Leq", "le", "<="),
    "eq": _comparison(np.equal, "Eq", "eq", "=="),
    "ne": _comparison(np.not_equal, "Neq", "ne", "!="),
    "and": _logic(
        lambda *conditions: reduce(np.logical_and, conditions), "And", "binary.and", "&&"
    ),
    "or": _logic(lambda *conditions: reduce(np.logical_or, conditions), "Or", "binary.or", "||"),
    "not": _logic(np.logical_not, "Not", "not", "!", 1),
}
"""Dictionary from the name of an operation in the nodes of a graph to its row of the table."""

COMPARISONS = tuple(n for n, row in OPERATIONS.items() if row.role is Role.COMPARISON)
"""Names of the comparisons of two numbers."""

UNARY = tuple(n for n, row in OPERATIONS.items() if row.arguments == 1 and not row.is_condition)
"""Names of the functions of one number."""

CONDITIONS = tuple(name for name, row in OPERATIONS.items() if row.is_condition)
"""Names of the operations whose value is a truth value."""
