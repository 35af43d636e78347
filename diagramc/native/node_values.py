"""Emits the values of nodes of a graph, and the chain rule that makes derivatives of them."""

from __future__ import annotations

from collections.abc import Iterable

from ..equations.graph import SOURCES, Graph
from ..equations.passes import Place, deciding_nodes
from .ir import Array, Module, Operand, Value
from .printer import Nodes, Printer, Storage
from .types import BOOL, DOUBLE, INT, POINTER

VALUES = (*(kind for kind in SOURCES if kind != "constant"), "values", "partials")
"""Arguments of the emitted function ``values``."""
CHAIN = ("sizes", "edges", "partials", "rows")
"""Arguments of the emitted function ``chain``."""


def node_values_text(graph: Graph, targets: Iterable[tuple[Place, int]]) -> str:
    """Return the IR text of the functions ``values`` and ``chain``, which serve one lane.

    ``values`` computes nodes from the sources of the graph. ``targets`` says where the value of
    each node is stored: the array, ``values`` or ``partials``, and the index. A truth value becomes
    1 or 0.

    ``chain`` applies the chain rule. The matrix ``rows`` has a row of derivatives for each node,
    with ``sizes[1]`` columns. Each of the ``sizes[0]`` triples in ``edges`` has the row of a node,
    the row of one of its arguments, and the index of the partial derivative in ``partials``. The
    row of the argument, times the partial derivative, is added to the row of the node. Zero times
    any number, also times infinity, is zero.
    """
    targets = list(targets)
    module = Module()
    _define_values(module, graph, targets)
    _define_chain(module)
    return module.text()


def _define_values(module: Module, graph: Graph, targets: list[tuple[Place, int]]) -> None:
    f = module.function("values", dict.fromkeys(VALUES, POINTER), internal=False)
    arrays = {name: Array(f.arguments[name], DOUBLE) for name in VALUES}
    time = arrays.pop("time")[0]
    roots = [node for _, node in targets]
    nodes = Nodes(graph, deciding_nodes(graph, graph.reachable(roots)))
    Printer(f, nodes, _Numbers(time, **arrays)).emit(targets)


class _Numbers(Storage):
    """Stores a truth value as 1 or 0."""

    def store(self, place: Place, value: Operand) -> None:
        if isinstance(value, Value) and value.type == BOOL:
            value = value.function.select(value, 1.0, 0.0)
        super().store(place, value)


def _define_chain(module: Module) -> None:
    f = module.function("chain", dict.fromkeys(CHAIN, POINTER), internal=False)
    sizes, edges = (Array(f.arguments[name], INT) for name in ("sizes", "edges"))
    partials, rows = (Array(f.arguments[name], DOUBLE) for name in ("partials", "rows"))
    columns = sizes[1]
    for number in f.loop(sizes[0]):
        edge = edges.shifted(f.coerce(number, INT) * 3)
        row, below = rows.shifted(edge[0] * columns), rows.shifted(edge[1] * columns)
        partial = partials[edge[2]]
        with f.when(partial.differs(0.0)):
            for column in f.loop(columns):
                slope = below[column]
                with f.when(slope.differs(0.0)):
                    row[column] = row[column] + partial * slope
