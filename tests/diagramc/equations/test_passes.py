"""Rewriting of the graph: values stay, decisions stay to the bit, and operations go away."""

import json
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from diagramc.equations.equations import Equations, Limit, Update
from diagramc.equations.graph import SOURCES, Graph
from diagramc.equations.operations import CONDITIONS
from diagramc.equations.passes import Layout, Program, regrouped
from diagramc.native.llvm import Library, compile_text
from diagramc.native.time_loop import start_text

property_test = settings(max_examples=40, derandomize=True)
short_property_test = settings(max_examples=15, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def sources(graph, kind, count):
    return [graph.source(kind, i) for i in range(count)]


# ------------------------------------------------------------------------------ regrouping

PRIME = 2**61 - 1
"""Equal formulas have equal residues; functions that are no arithmetic become hashes of theirs."""


def product(*factors):
    total = 1
    for factor in factors:
        total = total * factor % PRIME
    return total


def residue(value):
    value = Fraction(value)
    return value.numerator * pow(value.denominator, -1, PRIME) % PRIME


RESIDUES = {
    "add": lambda *a: sum(a) % PRIME,
    "multiply": product,
    "divide": lambda a, b: a * pow(b, -1, PRIME) % PRIME,
}


@property_test
@given(data=st.data(), seed=seeds)
def test_regrouped_formulas_are_equal(interpreted, random_graphs, data, seed):
    kinds = ("add", "multiply", "divide", "add", "multiply", "divide", "sin", "where", "floor")
    constants = (1.0, -1.0, 0.5, 3.0, 0.1)
    graph, roots = data.draw(random_graphs.graphs(kinds, constants=constants))
    functions = RESIDUES | {
        name: lambda *a, number=number: hash((number, *a)) % PRIME
        for number, name in enumerate((*CONDITIONS, "sin", "where", "floor"))
    }
    values = {
        kind: [(seed * 7919 + 104729 * i + len(kind)) ** 5 % PRIME for i in range(size)]
        for kind, size in random_graphs.sizes.items()
    }

    def evaluate(nodes):
        return interpreted(graph, nodes, operations=functions, number=residue, **values)

    try:
        expected = evaluate(roots)
    except ValueError:  # a division by zero
        return
    assert evaluate(regrouped(graph, roots)) == expected


def free_operations(graph, root):
    """Operations that are not fixed, by name."""
    kinds = [graph.nodes[n][0] for n in graph.reachable([root]) if not graph.is_fixed(n)]
    return sorted(kind for kind in kinds if kind not in SOURCES)


def nested(g, x, y, p, q):
    return g.add(g.multiply(p, g.add(g.multiply(q, x), p)), q)


CASES = {
    "quotient": (lambda g, x, y, p, q: g.divide(g.divide(x, p), q), ["multiply"]),
    "sum of quotients": (lambda g, x, y, p, q: g.add(g.divide(x, p), g.divide(x, q)), ["multiply"]),
    "nested": (nested, ["add", "multiply"]),
    "like terms": (
        lambda g, x, y, p, q: g.add(g.multiply(p, x), y, g.multiply(q, x), q, p),
        ["add", "multiply"],
    ),
    "factors": (lambda g, x, y, p, q: g.multiply(p, g.multiply(x, y), q), ["multiply", "multiply"]),
    "factor of two plain terms": (
        lambda g, x, y, p, q: g.multiply(p, g.add(x, y)),
        ["add", "multiply"],
    ),
    "factor of a plain and a scaled term": (
        lambda g, x, y, p, q: g.multiply(p, g.add(x, g.multiply(q, y))),
        ["add", "multiply", "multiply"],
    ),
    "fourth power": (lambda g, x, y, p, q: g.multiply(x, x, p, x, x, y), ["multiply", "multiply"]),
    "fifth power": (lambda g, x, y, p, q: g.multiply(x, x, x, x, x), ["multiply"]),
    "free quotient": (lambda g, x, y, p, q: g.divide(p, x), ["divide"]),
}


@pytest.mark.parametrize("case", CASES)
def test_operations_after_regrouping(case):
    make, expected = CASES[case]
    graph = Graph()
    x, y = sources(graph, "state", 2)
    p, q = sources(graph, "parameter", 2)
    (root,) = regrouped(graph, [make(graph, x, y, p, q)])
    assert free_operations(graph, root) == expected


def test_a_fourth_power_is_a_square_of_a_square():
    graph = Graph()
    x = graph.source("state")
    (root,) = regrouped(graph, [graph.multiply(x, x, x, x)])
    square = graph.multiply(x, x)
    assert graph.nodes[root] == ("multiply", square, square)


@pytest.mark.parametrize(("count", "distributed"), [(6, True), (7, False)])
def test_a_factor_goes_into_sums_of_a_few_terms(count, distributed):
    graph = Graph()
    x, p = sources(graph, "state", count), sources(graph, "parameter", count + 1)
    terms = [graph.multiply(a, b) for a, b in zip(x, p[1:], strict=True)]
    (root,) = regrouped(graph, [graph.multiply(p[0], graph.add(*terms))])
    assert graph.nodes[root][0] == ("add" if distributed else "multiply")


def test_a_sum_with_two_users_stays_one_sum():
    graph = Graph()
    x, y = sources(graph, "state", 2)
    p, q = sources(graph, "parameter", 2)
    total = graph.add(graph.multiply(p, x), y)
    roots = regrouped(graph, [graph.multiply(q, total), graph.multiply(p, total)])
    assert roots == [graph.multiply(q, total), graph.multiply(p, total)]
    roots = regrouped(graph, [graph.multiply(q, total), total])
    assert roots == [graph.multiply(q, total), total]


# ----------------------------------------------------------------------- programs at work


def equations_of(graph, outputs, sizes, **fields):
    return Equations(
        graph=graph,
        parameters=[f"p{i}" for i in range(sizes["parameter"])],
        states=[f"x{i}" for i in range(sizes["state"])],
        discrete=[f"d{i}" for i in range(sizes["discrete"])],
        inputs={"u": sizes["input"]},
        outputs={"y": outputs},
        **fields,
    )


def constants_of(program, parameters):
    """Values of ``constants``, (constants, samples)."""
    function = Library(compile_text(start_text(program))).function("constants", 2)
    constants = np.empty((parameters.shape[1], len(program.hoisted)))
    for row, column in zip(constants, np.ascontiguousarray(parameters.T), strict=True):
        function(column.ctypes.data, row.ctypes.data)
    return constants.T


def decisions(graph):
    """Each condition and each rounding of a graph as a number."""
    one, zero = graph.one, graph.zero
    roots = []
    for node, (kind, *_) in enumerate(list(graph.nodes)):
        if kind in CONDITIONS:
            roots.append(graph.where(node, one, zero))
        elif kind in ("floor", "ceil"):
            roots.append(node)
    return roots


@pytest.mark.slow
@property_test
@given(data=st.data(), seed=seeds)
def test_decisions_stay_to_the_bit(printed, interpreted, random_graphs, data, seed):
    graph, _ = data.draw(random_graphs.graphs())
    roots = decisions(graph)
    values = random_graphs.samples(seed, 16)
    expected = np.array(
        np.broadcast_arrays(*interpreted(graph, roots, **values), np.zeros(16))[:-1]
    )
    program = Program(equations_of(graph, roots, random_graphs.sizes))
    constants = constants_of(program, values["parameter"])
    code = printed.groups(program, program.groups, lanes=(1, 8), memory=True)
    for lanes in (1, 8):
        np.testing.assert_array_equal(code(lanes, constant=constants, **values), expected)


BEHIND = {
    "sum": lambda g, n, p, zero: zero,
    "multiply": lambda g, n, p, zero: g.multiply(zero, p, n),
    "divide": lambda g, n, p, zero: g.divide(zero, p),
    "sqrt": lambda g, n, p, zero: g.node("sqrt", zero),
    "abs": lambda g, n, p, zero: g.node("abs", zero),
    "min": lambda g, n, p, zero: g.node("min", zero, g.one),
    "max": lambda g, n, p, zero: g.node("max", g.constant(-1.0), zero),
    "where": lambda g, n, p, zero: g.where(g.node("ge", n, p), zero, g.zero),
}


@pytest.mark.parametrize("operation", BEHIND)
def test_a_difference_of_equal_times_is_zero(printed, operation):
    # The rounded product of number and period is the time; fused, the difference is its error.
    graph = Graph()
    t, n, period = graph.source("time"), graph.source("discrete"), graph.source("parameter")
    zero = graph.subtract(t, graph.multiply(n, period))
    equal = graph.node("eq", BEHIND[operation](graph, n, period, zero), graph.zero)
    root = graph.where(equal, graph.one, graph.zero)
    sizes = {"parameter": 1, "state": 0, "discrete": 1, "input": 0}
    program = Program(equations_of(graph, [root], sizes))
    n = np.arange(100.0)[None]
    constants = np.repeat(constants_of(program, np.array([[0.1]])), 100, axis=1)
    code = printed.groups(program, program.groups)
    assert (code(time=n * 0.1, discrete=n, constant=constants) == 1.0).all()


def test_quotients_behind_a_decision_stay(printed):
    graph = Graph()
    n = graph.source("discrete")
    p = graph.source("parameter")
    root = graph.node("floor", graph.divide(graph.divide(n, p), p))
    sizes = {"parameter": 1, "state": 0, "discrete": 1, "input": 0}
    program = Program(equations_of(graph, [root], sizes))
    n = np.arange(2000.0)[None]
    code = printed.groups(program, program.groups)
    for p in (7.0, 49.0, 0.1):
        constants = np.repeat(constants_of(program, np.array([[p]])), n.size, axis=1)
        ours = code(time=n, discrete=n, constant=constants)
        np.testing.assert_array_equal(ours, np.floor(n / p / p))


# -------------------------------------------------------------------------------- hoisting


@short_property_test
@given(data=st.data())
def test_hoisted_is_what_depends_on_parameters_alone(random_graphs, data):
    graph, roots = data.draw(random_graphs.graphs())
    program = Program(equations_of(graph, roots, random_graphs.sizes))
    graph = program.graph
    hoisted = set(program.hoisted)
    assert sorted(program.hoisted.values()) == list(range(len(hoisted)))
    reachable = graph.reachable(program.instant)
    users = {node: [] for node in reachable}
    for node in reachable:
        for argument in graph.arguments(node):
            users[argument].append(node)
    for node in reachable:
        fixed = not any(
            graph.nodes[n][0] in ("time", "state", "discrete", "input")
            for n in graph.reachable([node])
        )
        kind = graph.nodes[node][0]

        def needed(user):
            """Whether it is computed at an instant."""
            if not graph.is_fixed(user):
                return True
            return graph.nodes[user][0] in CONDITIONS and any(map(needed, users[user]))

        number = fixed and kind not in (*CONDITIONS, "constant")
        used = node in program.instant or any(map(needed, users[node]))
        assert (node in hoisted) == (number and used), graph.nodes[node]


def test_a_condition_within_a_hoisted_choice_is_not_hoisted():
    graph = Graph()
    p, q = sources(graph, "parameter", 2)
    choice = graph.where(graph.node("gt", graph.multiply(p, q), q), p, q)
    root = graph.multiply(graph.source("state"), choice)
    sizes = {"parameter": 2, "state": 1, "discrete": 0, "input": 0}
    assert set(Program(equations_of(graph, [root], sizes)).hoisted) == {choice}


def test_a_condition_on_parameters_is_computed_where_it_is_used(printed):
    graph = Graph()
    x = graph.source("state")
    p, q = sources(graph, "parameter", 2)
    condition = graph.simplified(
        "and",
        graph.node("gt", p, graph.zero),
        graph.simplified("not", graph.node("gt", graph.multiply(p, q), q)),
    )
    root = graph.where(condition, x, graph.negate(x))
    sizes = {"parameter": 2, "state": 1, "discrete": 0, "input": 0}
    program = Program(equations_of(graph, [root], sizes))
    assert set(program.hoisted) == {p, q, graph.multiply(p, q)}
    code = printed.groups(program, program.groups, lanes=(1, 4))
    parameters = np.array([[0.5, -0.5, 2.0, 0.0], [1.0, 1.0, 1.0, 1.0]])
    constants = constants_of(program, parameters)
    x = np.array([[3.0, 3.0, 3.0, 3.0]])
    for lanes in (1, 4):
        ours = code(lanes, time=x, state=x, constant=constants)
        assert ours.tolist() == [[3.0, -3.0, -3.0, -3.0]]


# ---------------------------------------------------------------------- layout, derivatives


def test_a_program_leaves_the_graph_of_its_equations_as_it_is():
    graph = Graph()
    x, p = graph.source("state"), graph.source("parameter")
    roots = [graph.divide(graph.multiply(p, x), p)]
    before = list(graph.nodes)
    sizes = {"parameter": 1, "state": 1, "discrete": 0, "input": 0}
    program = Program(equations_of(graph, roots, sizes, derivatives=roots))
    assert graph.nodes == before
    assert len(program.graph.nodes) > len(before)


def test_layout_survives_json():
    graph = Graph()
    x, (d, e), (u, v) = (
        graph.source("state"),
        sources(graph, "discrete", 2),
        sources(graph, "input", 2),
    )
    count = graph.node("floor", x)
    costly = graph.node("sin", graph.node("sin", graph.node("sin", graph.node("sin", count))))
    equations = Equations(
        graph=graph,
        parameters=["p"],
        states=["x"],
        discrete=["d", "e"],
        inputs={"u": 1, "v": 1},
        derivatives=[graph.multiply(graph.source("parameter"), u)],
        initial_discrete=[d, e],
        updates=[Update(0.1, 0.0, ((0, x),)), Update(0.25, 0.05, ((1, v),))],
        outputs={"a": [costly, x], "b": [u], "c": []},
        limits=[Limit("plant", x)],
    )
    layout = Program(equations).layout
    assert Layout.from_plain(json.loads(json.dumps(layout.plain()))) == layout
    assert (layout.feedthrough, layout.memos, layout.input_count) == (("b",), (1,), 2)


@short_property_test
@given(data=st.data(), seed=seeds)
def test_jacobian_is_that_of_complex_steps(interpreted, random_graphs, data, seed):
    kinds = ("add", "multiply", "sin", "cos", "tanh", "sinh", "exp", "sin", "cos")
    sizes = {"time": 1, "parameter": 2, "state": 3, "discrete": 1, "input": 1}
    graph, roots = data.draw(
        random_graphs.graphs(kinds, nodes=15, roots=3, constants=(0.5, -1.0, 2.0), sizes=sizes)
    )
    program = Program(equations_of(graph, [], sizes, derivatives=roots))
    graph = program.graph
    rng = np.random.default_rng(seed)
    values = {kind: rng.uniform(-1.0, 1.0, size) for kind, size in sizes.items()}
    places, nodes = [at for at, _ in program.jacobian], [node for _, node in program.jacobian]
    assert len(set(places)) == len(places)
    jacobian = np.zeros(9)
    jacobian[places] = interpreted(graph, nodes, **values)
    expected = np.zeros((3, 3))
    for column in range(3):
        near = values["state"].astype(complex)
        near[column] += 1e-100j
        with np.errstate(all="ignore"):
            expected[column] = (
                np.imag(interpreted(graph, roots, **values | {"state": near})) / 1e-100
            )
    parts = np.abs(interpreted(graph, graph.reachable([*nodes, *roots]), **values)).max()
    if parts < 1e100:
        np.testing.assert_allclose(
            jacobian.reshape(3, 3), expected, rtol=1e-12, atol=1e-12 * max(parts, 1.0)
        )


@short_property_test
@given(data=st.data(), seed=seeds)
def test_second_derivatives_are_those_of_complex_time(interpreted, random_graphs, data, seed):
    kinds = ("add", "multiply", "sin", "cos", "tanh", "sinh", "exp", "sin", "cos")
    sizes = {"time": 1, "parameter": 2, "state": 3, "discrete": 1, "input": 2}
    graph, roots = data.draw(
        random_graphs.graphs(kinds, nodes=15, roots=3, constants=(0.5, -1.0, 2.0), sizes=sizes)
    )
    program = Program(equations_of(graph, [], sizes, derivatives=roots))
    if not program.second_derivatives:
        assert not any(graph.depends[node] & {"time", "input"} for node in roots)
        return
    rng = np.random.default_rng(seed)
    values = {kind: rng.uniform(-1.0, 1.0, size) for kind, size in sizes.items()}
    input_rates = rng.uniform(-1.0, 1.0, 2)
    given_values = values | {"input": np.append(values["input"], input_rates)}
    nodes = program.graph.reachable(program.second_derivatives)
    parts = np.abs(interpreted(program.graph, nodes, **given_values)).max()
    if parts < 1e100:
        results = interpreted(program.graph, program.second_derivatives, **given_values)
        rates = interpreted(graph, roots, **values)
        changes = {"time": 1.0, "state": np.array(rates), "input": input_rates}
        later = {kind: values[kind] + 1e-100j * change for kind, change in changes.items()}
        second = np.imag(interpreted(graph, roots, **values | later)) / 1e-100
        expected = [*rates, *second]
        np.testing.assert_allclose(results, expected, rtol=1e-12, atol=1e-12 * max(parts, 1.0))


# ------------------------------------------------------------------------------------ memos


def memos_of(make):
    """Memos of a program with the outputs ``make(graph, first count, second count)``."""
    graph = Graph()
    counts = [graph.node("floor", graph.source("state", i)) for i in range(2)]
    roots = make(graph, *counts)
    sizes = {"parameter": 1, "state": 2, "discrete": 1, "input": 0}
    program = Program(equations_of(graph, roots, sizes))
    return graph, counts, [(memo.count, memo.nodes) for memo in program.memos]


def costly(graph, node, functions=("sin", "tan", "exp", "tanh")):
    for name in functions:
        node = graph.node(name, node)
    return node


def test_each_encoder_has_a_table():
    graph, (n, m), memos = memos_of(lambda g, n, m: [costly(g, n), costly(g, m)])
    assert memos == [(n, (costly(graph, n),)), (m, (costly(graph, m),))]


def test_a_cheap_function_has_no_table():
    def make(g, n, m):
        return [costly(g, n, ("sin", "tan", "exp")), g.add(n, g.multiply(n, n), g.one)]

    assert memos_of(make)[2] == []


@pytest.mark.parametrize("kind", ["time", "state", "discrete"])
def test_a_function_of_a_count_and_another_source_has_no_table(kind):
    def make(g, n, m):
        return [costly(g, g.multiply(n, g.source(kind, 0)))]

    assert memos_of(make)[2] == []


def test_a_function_of_two_counts_has_no_table():
    graph, (n, m), memos = memos_of(lambda g, n, m: [costly(g, g.add(costly(g, n), costly(g, m)))])
    assert memos == [(n, (costly(graph, n),)), (m, (costly(graph, m),))]


def test_a_table_holds_what_something_else_uses():
    def parts(g, n):
        p = g.source("parameter", 0)
        inner = costly(g, g.multiply(p, n))  # used within, and by a product with the state
        outer = g.node("cos", inner)
        return inner, outer

    def make(g, n, m):
        inner, outer = parts(g, n)
        condition = g.node("gt", outer, g.zero)
        free = g.where(condition, g.multiply(inner, g.source("state", 1)), n)
        return [free, g.node("cos", outer)]

    graph, (n, _), memos = memos_of(make)
    inner, outer = parts(graph, n)
    assert memos == [(n, (inner, graph.node("cos", outer)))]
