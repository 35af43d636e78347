"""Converts Drake's symbolic expressions to nodes of a graph."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import Any, TypeAlias, TypeVar

from pydrake.symbolic import ExpressionKind, FormulaKind

from ..errors import CompilationError
from .graph import Graph
from .operations import COMPARISONS, OPERATIONS

T = TypeVar("T")

LARGEST_TREE = 20_000
"""Largest number of nodes in the tree of an expression; a larger expression is an error."""

Steps: TypeAlias = Generator[Any, Any, T]
"""A generator that computes a value and yields other such generators to get their values.

`completed` runs the generator.
"""

_EXPRESSIONS = {
    getattr(ExpressionKind, row.drake): name
    for name, row in OPERATIONS.items()
    if not row.is_condition
}
_FORMULAS = {
    getattr(FormulaKind, row.drake): name for name, row in OPERATIONS.items() if row.is_condition
}


def completed(steps: Steps[T]) -> T:
    """Run a generator of the type `Steps` to its end; return the value that it computes.

    The function also runs each generator that a generator yields. A list holds the generators in
    progress, so a deep chain of blocks or expressions does not reach Python's limit of recursion.
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
    """Converts symbolic expressions of one leaf, such as an output port's, to nodes of a graph."""

    def __init__(
        self, graph: Graph, where: str, node_of_variable: Callable[[Any], Steps[int]]
    ) -> None:
        """``where``: text with which each error message begins, such as the path of the leaf."""
        self._graph, self._where = graph, where
        self._node_of_variable = node_of_variable
        self._size = 0

    def nodes(self, expressions: Sequence[Any]) -> Steps[list[int]]:
        """Return the node of each expression or float.

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
        name = _EXPRESSIONS.get(kind)
        if name is None:
            raise CompilationError(f"{self._where}: {kind} does not compile")
        _, arguments = expression.Unapply()
        nodes = []
        for position, argument in enumerate(arguments):
            is_condition = name == "where" and position == 0
            convert = self._condition if is_condition else self._node
            nodes.append((yield convert(argument)))
        return graph.simplified(name, *nodes)

    def _condition(self, formula: Any) -> Steps[int]:
        graph = self._graph
        kind = formula.get_kind()
        if kind in (FormulaKind.True_, FormulaKind.False_):
            holds = 1.0 if kind == FormulaKind.True_ else 0.0
            return graph.compare("gt", graph.constant(holds), graph.zero)
        name = _FORMULAS.get(kind)
        if name is None:
            raise CompilationError(f"{self._where}: the condition {kind} does not compile")
        _, arguments = formula.Unapply()
        convert = self._node if name in COMPARISONS else self._condition
        nodes = []
        for argument in arguments:
            nodes.append((yield convert(argument)))
        return graph.operation(name, *nodes)
