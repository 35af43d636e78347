"""The partition of nodes: fixed, by count, or at each tick."""

import pytest

from diagramc.equations.graph import Graph
from diagramc.equations.partition import fixed_nodes, is_rounded, nodes_by_count, zero_factors


@pytest.fixture
def graph():
    return Graph()


def test_a_fixed_node_is_returned_where_code_that_is_not_fixed_reads_it(graph):
    p, q, x = graph.source("parameter", 0), graph.source("parameter", 1), graph.source("state")
    inner = graph.node("exp", p)
    outer = graph.node("sin", inner)
    root = graph.multiply(x, outer)
    assert fixed_nodes(graph, [root]) == [outer]
    assert fixed_nodes(graph, [root, graph.add(inner, x), graph.add(q, x)]) == [q, inner, outer]


def test_a_fixed_condition_is_not_returned_but_the_numbers_behind_it_are(graph):
    p, x = graph.source("parameter", 0), graph.source("state")
    square = graph.multiply(p, p)
    root = graph.where(graph.node("gt", square, graph.one), x, graph.zero)
    assert fixed_nodes(graph, [root]) == [square]


def test_a_node_that_is_looked_up_reads_nothing(graph):
    angle = graph.multiply(graph.source("parameter"), graph.source("input"))
    sine = graph.node("sin", angle)
    root = graph.add(sine, graph.source("state"))
    assert fixed_nodes(graph, [root]) == [graph.source("parameter")]
    assert fixed_nodes(graph, [root], {sine}) == []


def by_count(graph, roots, is_count, most=0):
    return nodes_by_count(graph, roots, is_count, lambda operation: operation.cost, most)


def test_a_rounding_of_a_count_is_no_count_of_its_own(graph):
    count = graph.node("floor", graph.source("state"))
    again = graph.node("floor", graph.node("sin", count))
    rounded = by_count(graph, [again], lambda node: is_rounded(graph, node))
    assert rounded == {count: [again]}


def test_a_source_can_be_a_count(graph):
    count, other = graph.source("input", 0), graph.source("input", 1)
    sine = graph.node("sin", count)
    roots = [graph.multiply(sine, other), graph.node("cos", other)]
    assert by_count(graph, roots, {count}.__contains__) == {count: [sine]}


def test_a_node_must_cost_more_than_a_look_up(graph):
    count = graph.source("input")
    sine = graph.node("sin", count)
    assert by_count(graph, [sine], {count}.__contains__, most=9) == {count: [sine]}
    assert by_count(graph, [sine], {count}.__contains__, most=10) == {}


def test_a_condition_is_in_no_table_and_reads_from_none(graph):
    count = graph.source("input")
    sine = graph.node("sin", count)
    root = graph.where(graph.node("gt", sine, graph.zero), graph.source("state"), graph.one)
    assert by_count(graph, [root], {count}.__contains__) == {}


def test_a_factor_counts_on_each_way_from_a_node_to_the_roots(graph):
    p, q, x, y = (
        *(graph.source("parameter", i) for i in (0, 1)),
        *map(graph.source, ("state", "time")),
    )
    one_way, two_ways, also_bare = (graph.node(name, x) for name in ("exp", "sin", "tanh"))
    fraction = graph.node("divide", p, q)
    roots = [
        graph.multiply(p, graph.add(one_way, y)),
        graph.add(graph.multiply(p, q, two_ways), graph.multiply(fraction, y, two_ways)),
        graph.add(graph.multiply(q, also_bare), graph.node("divide", p, also_bare)),
    ]
    factors = zero_factors(graph, roots, {p, q, fraction}, graph.arguments)
    assert factors[one_way] == {p}
    assert factors[two_ways] == {p}
    assert factors[also_bare] == set()


def test_all_factors_of_a_fixed_product_count(graph):
    p, q, x = graph.source("parameter", 0), graph.source("parameter", 1), graph.source("state")
    sine, both = graph.node("sin", x), graph.multiply(p, q)
    root = graph.multiply(both, sine)
    assert zero_factors(graph, [root], {p, both}, graph.arguments)[sine] == {p, both}


def test_a_divisor_and_the_argument_of_a_function_have_no_factors(graph):
    p, x = graph.source("parameter"), graph.source("state")
    names = ("exp", "sin", "tanh", "atan")
    above, below, inside, both = (graph.node(name, x) for name in names)
    quotients = [graph.node("divide", *pair) for pair in ((above, x), (x, below), (both, both))]
    roots = [graph.multiply(p, node) for node in (*quotients, graph.node("log", inside))]
    factors = zero_factors(graph, roots, {p}, graph.arguments)
    assert [bool(factors[node]) for node in (above, below, inside, both)] == [1, 0, 0, 0]
