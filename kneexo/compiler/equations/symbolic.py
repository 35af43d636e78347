"""Drake's symbolic expressions as nodes of a graph."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import Any, TypeAlias, TypeVar

from pydrake.symbolic import ExpressionKind, FormulaKind

from ..errors import CompilationError
from .graph import Graph

T = TypeVar("T")

LARGEST_TREE = 20_000
"""Largest number of nodes of an expression; a leaf with a larger one is refused."""

Steps: TypeAlias = Generator[Any, Any, T]
"""A computation that yields the computations whose results it needs; `completed` runs it."""

_UNARY = {
    getattr(ExpressionKind, name): name.lower()
    for name in (
        *("Log", "Abs", "Exp", "Sqrt", "Sin", "Cos", "Tan", "Asin", "Acos", "Atan"),
        *("Sinh", "Cosh", "Tanh", "Ceil", "Floor"),
    )
}
_BINARY = {
    ExpressionKind.Min: "min",
    ExpressionKind.Max: "max",
    ExpressionKind.Atan2: "atan2",
}
_COMPARISONS = {
    FormulaKind.Gt: "gt",
    FormulaKind.Geq: "ge",
    FormulaKind.Lt: "lt",
    FormulaKind.Leq: "le",
    FormulaKind.Eq: "eq",
    FormulaKind.Neq: "ne",
}
_LOGIC = {FormulaKind.And: "and", FormulaKind.Or: "or", FormulaKind.Not: "not"}


def completed(steps: Steps[T]) -> T:
    """Run a computation and return its result.

    The computations in progress are kept in a list. So a deep chain of blocks or expressions does
    not reach Python's limit of recursion.
    """
    pending: list[Steps[Any]] = [steps]
    value: Any = None
    while pending:
        try:
            pending.append(pending[-1].send(value))
            value = None
        except StopIteration as finished:
            pending.pop()
            value = finished.value
    result: T = value
    return result


class Conversion:
    """Converts the expressions of one leaf and one purpose."""

    def __init__(
        self, graph: Graph, where: str, node_of_variable: Callable[[Any], Steps[int]]
    ) -> None:
        """``where``: beginning of each error's message."""
        self._graph, self._where = graph, where
        self._node_of_variable = node_of_variable
        self._size = 0

    def nodes(self, expressions: Sequence[Any]) -> Steps[list[int]]:
        """Return the nodes of expressions or floats.

        Raises `CompilationError` for an expression that is too large, and for an operation that
        does not compile.
        """
        nodes = []
        for expression in expressions:
            self._size = 0
            nodes.append((yield self._node(expression)))
        return nodes

    def _node(self, expression: Any) -> Steps[int]:
        graph = self._graph
        if isinstance(expression, float | int):
            return graph.constant(expression)
        self._size += 1
        if self._size > LARGEST_TREE:
            raise CompilationError(
                f"{self._where}: its expression has more than {LARGEST_TREE} nodes; give shared "
                f"intermediate results a port of their own"
            )
        kind = expression.get_kind()
        if kind == ExpressionKind.Var:
            (variable,) = expression.GetVariables()
            return (yield self._node_of_variable(variable))
        if kind == ExpressionKind.Constant:
            return graph.constant(expression.Evaluate())
        _, arguments = expression.Unapply()
        if kind == ExpressionKind.IfThenElse:
            condition = yield self._condition(arguments[0])
            positive = yield self._node(arguments[1])
            otherwise = yield self._node(arguments[2])
            return graph.where(condition, positive, otherwise)
        nodes = []
        for argument in arguments:
            nodes.append((yield self._node(argument)))
        if kind == ExpressionKind.Add:
            return graph.add(*nodes)
        if kind == ExpressionKind.Mul:
            return graph.multiply(*nodes)
        if kind == ExpressionKind.Div:
            return graph.divide(*nodes)
        if kind == ExpressionKind.Pow:
            return graph.power(*nodes)
        if kind in _UNARY:
            return graph.unary(_UNARY[kind], nodes[0])
        if kind in _BINARY:
            return graph.binary(_BINARY[kind], *nodes)
        raise CompilationError(f"{self._where}: {kind} does not compile")

    def _condition(self, formula: Any) -> Steps[int]:
        graph = self._graph
        kind = formula.get_kind()
        if kind in (FormulaKind.True_, FormulaKind.False_):
            holds = 1.0 if kind == FormulaKind.True_ else 0.0
            return graph.compare("gt", graph.constant(holds), graph.zero)
        if kind not in _COMPARISONS and kind not in _LOGIC:
            raise CompilationError(f"{self._where}: the condition {kind} does not compile")
        _, arguments = formula.Unapply()
        convert = self._node if kind in _COMPARISONS else self._condition
        nodes = []
        for argument in arguments:
            nodes.append((yield convert(argument)))
        if kind in _COMPARISONS:
            return graph.compare(_COMPARISONS[kind], *nodes)
        return graph.logic(_LOGIC[kind], *nodes)
