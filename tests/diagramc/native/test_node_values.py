"""Emitted values of nodes, and the emitted chain rule."""

import math

import numpy as np
import pytest

from diagramc.equations.graph import Graph
from diagramc.native.llvm import Library, compile_text
from diagramc.native.node_values import CHAIN, VALUES, node_values_text
from diagramc.native.runner import address


def emitted(graph, targets):
    """The functions ``values`` and ``chain`` as functions of NumPy arrays."""
    library = Library(compile_text(node_values_text(graph, targets)))

    def function(name, arguments):
        code = library.function(name, len(arguments))
        return lambda **arrays: code(*(address(arrays[argument]) for argument in arguments))

    return function("values", VALUES), function("chain", CHAIN)


def test_each_source_and_truth_value_has_its_place():
    graph = Graph()
    kinds = ("time", "parameter", "state", "discrete", "input")
    nodes = [graph.source(kind, 0 if kind == "time" else 1) for kind in kinds]
    later = graph.node("gt", nodes[0], nodes[1])
    targets = [(("values", 5 - i), node) for i, node in enumerate([*nodes, later])]
    targets += [(("partials", 1), later), (("partials", 0), graph.constant(2.5))]
    values, _ = emitted(graph, targets)
    arrays = {kind: np.array([9.0, 2.0 + i]) for i, kind in enumerate(kinds)}
    found, partials = np.zeros(6), np.zeros(2)
    values(**arrays, values=found, partials=partials)
    assert found.tolist() == [1.0, 6.0, 5.0, 4.0, 3.0, 9.0]
    assert partials.tolist() == [2.5, 1.0]


@pytest.mark.parametrize(
    ("partial", "below", "expected"),
    [
        (2.0, 3.0, 11.0),
        (0.0, math.inf, 5.0),
        (math.inf, 0.0, 5.0),
        (math.nan, 0.0, 5.0),
        (math.inf, -3.0, -math.inf),
        (math.nan, 3.0, math.nan),
    ],
)
def test_the_chain_adds_products_and_zero_wins(partial, below, expected):
    _, chain = emitted(Graph(), [])
    rows = np.array([[1.0, below], [7.0, 7.0], [0.0, 5.0]])
    sizes, edges = np.array([1, 2]), np.array([[2, 0, 1]])
    chain(sizes=sizes, edges=edges, partials=np.array([9.0, partial]), rows=rows)
    assert rows[2, 1] == pytest.approx(expected, nan_ok=True)
    assert rows[:2].tolist() == [[1.0, below], [7.0, 7.0]]


def test_the_chain_goes_on_from_row_to_row():
    _, chain = emitted(Graph(), [])
    rows = np.array([[1.0], [0.0], [0.0]])
    edges = np.array([[1, 0, 0], [2, 1, 1], [2, 0, 0]])
    sizes = np.array([3, 1])
    chain(sizes=sizes, edges=edges, partials=np.array([2.0, 10.0]), rows=rows)
    assert rows.tolist() == [[1.0], [2.0], [22.0]]
