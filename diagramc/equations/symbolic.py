"""Converts Drake's symbolic expressions to nodes of a graph."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Sequence
from typing import Any, NamedTuple, TypeAlias, TypeVar

from pydrake.symbolic import ExpressionKind, FormulaKind

from ..errors import CompilationError
from .graph import Graph
from .operations import OPERATIONS

T = TypeVar("T")

LARGEST_TREE = 20_000
"""Largest number of nodes that are read of an expression; a larger expression is an error.

A quotient that is used again counts once. So does, in a large expression, any part that is used
again. In this count the largest expression of the knee has 1,006 nodes, and all expressions of a
loop have 2,900 to 3,800.
"""
_LARGE = 1000  # nodes; below, to look for parts that are used again takes longer than to read them

Steps: TypeAlias = Generator[Any, Any, T]
"""A generator that computes a value and yields other such generators to get their values.

`completed` runs the generator.
"""

_KINDS = {
    ExpressionKind.Var: "variable",
    ExpressionKind.Constant: "constant",
    FormulaKind.True_: "true",
    FormulaKind.False_: "false",
} | {
    getattr(FormulaKind if row.is_condition else ExpressionKind, row.drake): name
    for name, row in OPERATIONS.items()
}
# A reading looks up thousands of kinds, and Drake compares its kinds slower than their numbers.
_NAMES = {(type(kind), kind.value): name for kind, name in _KINDS.items()}


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


class _Operation(NamedTuple):
    """An operation whose arguments are converted first."""

    expression: Any
    name: str
    argument_count: int


class Conversion:
    """Converts symbolic expressions of one leaf, such as an output port's, to nodes of a graph."""

    def __init__(
        self, graph: Graph, where: str, node_of_variable: Callable[[Any], Steps[int]]
    ) -> None:
        """``where``: text with which each error message begins, such as the path of the leaf."""
        self._graph, self._where = graph, where
        self._node_of_variable = node_of_variable
        self._size = 0
        self.is_large = False
        """Whether an expression is so large that the reading looks for parts used again."""
        self._known: dict[tuple[str, tuple[int, ...]], int] = {}
        """Dictionary from an operation and its arguments to its node.

        Drake's expression contains a shared part several times, once for each use.
        """
        self._variables: dict[int, int] = {}
        """Dictionary from the id of a variable to its node."""
        self._latest: dict[str, deque[tuple[Any, int]]] = {}
        """The last expressions with their nodes, by operation, the newest first. Drake sees at once
        that two uses of one expression are equal, so the second use is not read again. A bound
        keeps the search short."""

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
        """Return the node of an expression. The nodes of its arguments come first, in order.

        Two stacks replace a recursion, which a deep expression would drive to Python's limit.
        ``pending`` has expressions to convert, and operations whose arguments stand above them.
        ``nodes`` has the nodes of the finished arguments, which an operation replaces by its own.
        """
        graph = self._graph
        nodes: list[int] = []
        pending: list[Any] = [expression]
        while pending:
            item = pending.pop()
            if isinstance(item, _Operation):
                arguments = tuple(nodes[-item.argument_count :])
                key = item.name, arguments
                if key not in self._known:
                    self._known[key] = graph.simplified(item.name, *arguments)
                nodes[-item.argument_count :] = [self._known[key]]
                latest = self._latest.setdefault(item.name, deque(maxlen=128))
                latest.appendleft((item.expression, self._known[key]))
            elif isinstance(item, float | int):
                nodes.append(graph.constant(item))
            elif (name := self._name(item.get_kind())) in ("true", "false"):
                nodes.append(graph.node("gt", graph.constant(name == "true"), graph.zero))
            elif (known := self._used_before(name, item)) is not None:
                nodes.append(known)
            else:
                _, arguments = item.Unapply()
                if name == "variable":
                    variable = arguments[0].get_id()
                    if variable not in self._variables:
                        self._variables[variable] = yield self._node_of_variable(*arguments)
                    nodes.append(self._variables[variable])
                elif name == "constant":
                    nodes.append(graph.constant(*arguments))
                else:
                    pending.append(_Operation(item, name, len(arguments)))
                    pending += reversed(arguments)
        return nodes[0]

    def _used_before(self, name: str, expression: Any) -> int | None:
        """Return the node of an expression ``name`` that was converted before, else None."""
        self.is_large |= self._size > _LARGE
        # Quotients are worth a search in small expressions too: when each use was read anew,
        # a reading of the knee took 2.4 times as long.
        if name == "divide" or self.is_large:
            for known, node in self._latest.get(name, ()):
                if known.EqualTo(expression):
                    return node
        return None

    def _name(self, kind: Any) -> str:
        """Return the name of a kind of node in `_NAMES`, and count the node.

        Raises `CompilationError` for an expression that is too large or does not compile.
        """
        self._size += 1
        if self._size > LARGEST_TREE:
            raise CompilationError(
                f"{self._where}: its expression has more than {LARGEST_TREE} nodes; give shared "
                f"intermediate results a port of their own"
            )
        name = _NAMES.get((type(kind), kind.value))
        if name is None:
            what = kind if isinstance(kind, ExpressionKind) else f"the condition {kind}"
            raise CompilationError(f"{self._where}: {what} does not compile")
        return name
