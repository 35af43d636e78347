"""Generated code against the interpreter, bit by bit."""

import math
import platform

import llvmlite.binding as llvm
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import diagramc.native.llvm as native
from diagramc.equations.equations import Equations
from diagramc.equations.graph import Graph
from diagramc.equations.operations import COMPARISONS, UNARY
from diagramc.equations.passes import ALWAYS, Group, Memo, Program
from diagramc.native.arguments import MEMO_LINES
from diagramc.native.time_loop import run_text

LANES = (1, 2, 4, 8, 16)
FUNCTIONS = (*(name for name in UNARY if name not in ("sqrt", "abs", "floor", "ceil")),)
ULPS = 4  # of two libraries, each below 2

property_test = settings(max_examples=25, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def assert_same_bits(values, expected):
    values, expected = np.broadcast_arrays(np.asarray(values), np.asarray(expected, dtype=float))
    same = (values.view(np.int64) == expected.copy().view(np.int64)) | (
        np.isnan(values) & np.isnan(expected)
    )
    assert same.all(), (np.argwhere(~same)[0], values[~same][0], expected[~same][0])


def assert_ulps(values, expected, ulps=ULPS):
    """Signs, infinities and nan are equal; the distance is counted in steps of doubles."""
    nan = np.isnan(expected)
    np.testing.assert_array_equal(np.isnan(values), nan)
    values, expected = values[~nan], np.array(expected[~nan])
    np.testing.assert_array_equal(np.signbit(values), np.signbit(expected))
    distance = np.abs(values.view(np.int64) - expected.view(np.int64))
    assert (distance <= ulps).all(), distance.max()


# ------------------------------------------------------------------------ single operations


def pairs(edges):
    """Two sources of state with every pair of edge values."""
    first, second = (values.ravel() for values in np.meshgrid(edges, edges))
    count = -first.size % 16  # a whole number of vectors
    return {
        "time": np.zeros((1, first.size + count)),
        "state": np.pad(np.array([first, second]), ((0, 0), (0, count))),
    }


def number_of(graph, name, *arguments):
    """An operation as a number: a condition chooses between two."""
    node = graph.node(name, *arguments)
    if name in (*COMPARISONS, "and", "or", "not"):
        return graph.where(node, graph.constant(3.0), graph.constant(-0.0))
    return node


BINARY = ("add", "multiply", "divide", "min", "max", *COMPARISONS)


def single_operations(edges=()):
    """Each exact operation, of two states, and of a state and each of some constants."""
    graph = Graph()
    x, y = (graph.source("state", i) for i in range(2))
    a, b = graph.node("lt", x, y), graph.node("gt", y, graph.zero)
    c = graph.node("ne", x, graph.one)
    roots = [number_of(graph, name, x, y) for name in BINARY]
    roots += [number_of(graph, name, x) for name in ("sqrt", "abs", "floor", "ceil")]
    roots += [number_of(graph, name, a, b) for name in ("and", "or")]
    roots += [number_of(graph, name, a, b, c) for name in ("and", "or")]
    roots += [number_of(graph, "not", a), graph.node("where", a, x, y), x, y]
    roots += [graph.node(name, x, y, x) for name in ("add", "multiply")]
    for constant in map(graph.constant, edges):
        roots += [number_of(graph, name, x, constant) for name in BINARY]
        roots += [number_of(graph, name, constant, x) for name in BINARY]
        roots += [
            graph.node("where", a, x, constant),
            graph.node("where", a, constant, x),
        ]
    return graph, roots


def test_each_operation_is_that_of_ieee_754(interpreted, printed, random_graphs):
    graph, roots = single_operations(random_graphs.edges)
    values = pairs(random_graphs.edges)
    expected = interpreted(graph, roots, **values)
    assert_same_bits(printed.plain(graph, roots)(**values), expected)


def function_graph():
    graph = Graph()
    x, y = (graph.source("state", i) for i in range(2))
    roots = [graph.node(name, x) for name in FUNCTIONS]
    return graph, [*roots, graph.node("atan2", x, y), graph.node("power", x, y)]


@pytest.fixture(scope="module")
def functions(printed):
    """Code of all elementary functions."""
    return printed.plain(*function_graph())


def function_values(edges):
    values = pairs(edges)
    rng = np.random.default_rng(4)
    size = 2000
    x = rng.normal(size=(2, size)) * 10.0 ** rng.uniform(-12, 12, (2, size))
    x[:, : size // 2] = rng.uniform(-1.5, 1.5, (2, size // 2))  # within the range of asin
    return {
        key: np.hstack([v, x if key == "state" else np.zeros((1, size))])
        for key, v in values.items()
    }


def test_elementary_functions_are_those_of_c(interpreted, functions, random_graphs):
    values = function_values(random_graphs.edges)
    expected = interpreted(*function_graph(), **values)
    for name, ours, theirs in zip(
        (*FUNCTIONS, "atan2", "power"), functions(**values), expected, strict=True
    ):
        try:
            assert_ulps(ours, theirs)
        except AssertionError as error:
            raise AssertionError(name) from error


# -------------------------------------------------------------------------- composed graphs


@pytest.fixture(scope="module")
def operations(functions):
    """The elementary functions of generated code, for the interpreter."""

    def function(place):
        def evaluate(*arguments):
            arrays = np.broadcast_arrays(*arguments, np.zeros(1))[:-1]
            state = np.array([arrays[0], arrays[-1]], dtype=float)
            return functions(time=np.zeros((1, state.shape[1])), state=state)[place]

        return evaluate

    return {name: function(i) for i, name in enumerate((*FUNCTIONS, "atan2", "power"))}


@pytest.mark.slow
@property_test
@given(data=st.data(), seed=seeds)
def test_composed_graphs_in_all_lanes(
    printed, interpreted_fused, operations, random_graphs, data, seed
):
    kinds = (*random_graphs.exact, *FUNCTIONS, "atan2", "power")
    graph, roots = data.draw(random_graphs.graphs(kinds))
    values = random_graphs.samples(seed, 32)
    expected = np.broadcast_arrays(
        *interpreted_fused(graph, roots, operations=operations, **values), np.zeros(32)
    )[:-1]
    code = printed.plain(graph, roots, lanes=LANES)
    for lanes in LANES:
        assert_same_bits(code(lanes, **values), expected)


@property_test
@given(data=st.data(), seed=seeds)
def test_what_decides_is_not_fused(printed, interpreted, random_graphs, data, seed):
    graph, roots = data.draw(random_graphs.graphs())
    values = random_graphs.samples(seed, 16)
    expected = np.broadcast_arrays(*interpreted(graph, roots, **values), np.zeros(16))[:-1]
    code = printed.plain(graph, roots, deciding=range(len(graph.nodes)))
    assert_same_bits(code(**values), expected)


def test_sums_are_fused(printed, interpreted_fused, random_graphs):
    graph = Graph()
    a, b, c = (graph.source("state", i) for i in range(3))
    minus = graph.constant(-1.0)
    product = graph.multiply(a, b)
    cases = {
        graph.add(c, graph.multiply(a, b, b)): 1,
        graph.add(graph.multiply(a, c), graph.multiply(b, c)): 1,
        graph.add(c, graph.multiply(minus, b, a)): 1,
        graph.add(c, graph.multiply(minus, a)): 0,  # a difference
        graph.add(graph.multiply(minus, a), graph.multiply(b, minus, c)): 1,
        graph.add(graph.multiply(a, minus, b, c), graph.multiply(minus, b)): 0,
        graph.add(graph.multiply(minus, minus), c): 0,
        graph.add(product, product): 0,
        graph.add(product, graph.one): 0,  # used twice
    }
    for node, count in cases.items():
        roots = [node, product] if product in graph.arguments(node) else [node]
        code = printed.plain(graph, roots)
        assert code.text.count("call double @llvm.fma") == count
        values = random_graphs.samples(1, 64)
        assert_same_bits(code(**values), interpreted_fused(graph, roots, **values))


# ---------------------------------------------------------------------- groups, conditions


@pytest.mark.slow
@property_test
@given(data=st.data(), seed=seeds)
def test_groups_under_conditions(printed, interpreted_fused, operations, random_graphs, data, seed):
    graph, roots = data.draw(random_graphs.graphs((*random_graphs.exact, *FUNCTIONS), roots=10))
    numbers = data.draw(st.lists(st.integers(-1, 3), min_size=10, max_size=10))
    conditions = [ALWAYS, *(("update", i) for i in range(4))]
    order = data.draw(st.permutations(range(-1, 4)))
    groups = [
        Group(
            conditions[number + 1],
            tuple((("output", i), roots[i]) for i in range(10) if numbers[i] == number),
        )
        for number in order
    ]
    code = printed.groups(_Plain(graph), groups, lanes=(1, 4))
    values = random_graphs.samples(seed, 8)
    expected = np.array(
        np.broadcast_arrays(
            *interpreted_fused(graph, roots, operations=operations, **values), np.zeros(8)
        )[:-1]
    )
    fires = data.draw(st.lists(st.integers(0, 1), min_size=4, max_size=4))
    for i, number in enumerate(numbers):
        if number >= 0 and not fires[number]:
            expected[i] = 77.0
    for lanes in (1, 4):
        out = np.full((10, 8), 77.0)
        written = code(lanes, fires, **values)
        out[: len(written)] = written
        assert_same_bits(out, expected)


class _Plain:
    """A program that is printed as it is."""

    hoisted, memos, deciding = {}, (), frozenset()

    def __init__(self, graph, memos=()):
        self.graph, self.memos = graph, memos


@pytest.mark.parametrize("fires", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_a_pair_of_sine_and_cosine_first_met_under_a_condition(printed, fires):
    graph = Graph()
    x = graph.source("state", 0)
    groups = [
        Group(("update", i), ((("output", i), graph.node(name, x)),))
        for i, name in enumerate(("sin", "cos"))
    ]
    groups.append(Group(ALWAYS, ((("output", 2), x),)))
    code = printed.groups(_Plain(graph), groups, lanes=(1, 2))
    x = np.array([[0.3, 2.0]])
    expected = [np.sin(x[0]) if fires[0] else 77.0, np.cos(x[0]) if fires[1] else 77.0, x[0]]
    for lanes in (1, 2):
        for value, ours in zip(expected, code(lanes, fires, time=x, state=x), strict=True):
            # 2 ulp of ours and 1 of NumPy's, of at most 2.2e-16 each, times 10.
            np.testing.assert_allclose(ours, value, rtol=7e-15)


def test_what_one_group_needs_is_computed_under_its_condition(printed):
    graph = Graph()
    x = graph.source("state", 0)
    shared = graph.node("exp", x)
    roots = [graph.node("tan", shared), graph.node("sinh", shared)]
    groups = [Group(("update", i), ((("output", i), root),)) for i, root in enumerate(roots)]
    text = printed.groups(_Plain(graph), groups).text
    body = text[text.index("@f1") :]
    parts = body.split("br i1")
    assert len(parts) == 3
    counts = [[part.count(f"call double @{name}(") for part in parts] for name in ("tan", "sinh")]
    assert counts == [[0, 1, 0], [0, 0, 1]]


# ------------------------------------------------------------------------------------ memos

COUNTS = (
    0.0,
    -0.0,
    1.0,
    -1.0,
    5.0,
    5.0 + MEMO_LINES,
    5.0 - MEMO_LINES,
    5.0,
    2.0**31,
    2.0**31,
    -(2.0**31),
    2.0**31 - 1.0,
    1e300,
    math.inf,
    -math.inf,
    math.nan,
    math.nan,
    0.0,
    7.0,
    7.0,
)


def memo_graph(count_of=1):
    """For each count three functions, of which one tells -0 from 0, and a product with another."""
    graph = Graph()
    memos, roots = [], []
    for i in range(count_of):
        count = graph.node("floor", graph.source("state", i))
        nodes = (
            graph.node("divide", graph.constant(1.0 + i), count),
            graph.node("cos" if i else "sin", count),
            graph.add(graph.node("tan", count), graph.multiply(count, graph.source("parameter"))),
        )
        memos.append(Memo(count, nodes[i:]))
        roots += [*nodes, graph.multiply(nodes[1], graph.source("discrete", 0))]
    return graph, memos, roots


def hoisting(graph, memos):
    """The program of a graph whose parameter 0 is loaded as constant 0."""
    program = _Plain(graph, tuple(memos))
    program.hoisted = {graph.source("parameter"): 0}
    return program


def memo_values(counts):
    counts = np.atleast_2d(counts)
    ones = np.ones((1, counts.shape[1]))
    return {"time": ones, "state": counts, "discrete": 3.0 * ones, "constant": 0.7 * ones}


def always(roots):
    return [Group(ALWAYS, tuple((("output", i), root) for i, root in enumerate(roots)))]


@pytest.mark.parametrize("lanes", [1, 2, 4])
def test_a_function_whose_factor_is_zero_is_not_computed(printed, lanes):
    graph = Graph()
    x, p = graph.source("state"), graph.source("parameter")
    roots = [graph.multiply(p, graph.node("exp", x)), graph.node("exp", x)]
    code = printed.groups(hoisting(graph, ()), always(roots[:1]), lanes=(lanes,))
    both = printed.groups(hoisting(graph, ()), always(roots), lanes=(lanes,))
    x = np.array([[1e3, 1e3, 0.5, 1e3, 0.5, 0.5, -1e3, 0.5]])
    p = np.array([[0.0, 1.0, 3.0, -0.0, 0.0, -2.0, np.inf, np.nan]])
    values = {"time": x, "state": x, "constant": p}
    with np.errstate(over="ignore", invalid="ignore"):
        products = p * both(lanes, **values)[1]
    assert_same_bits(both(lanes, **values)[0], products[0])  # 0 times infinity is nan
    products[0, [0, 3]] = 0.0, -0.0
    assert_same_bits(code(lanes, **values)[0], products[0])


@pytest.mark.parametrize("lanes", [1, 4])
def test_a_memo_changes_nothing(printed, lanes):
    graph, memos, roots = memo_graph()
    program = hoisting(graph, memos)
    counts = np.random.default_rng(2).permutation(np.repeat(COUNTS, 4))
    values = memo_values(counts)
    expected = printed.groups(program, always(roots))(**values)
    code = printed.groups(program, always(roots), lanes=(lanes,), memory=True)
    for _ in range(2):
        assert_same_bits(code(lanes, **values), expected)


def test_lines_of_a_memo(printed):
    graph, memos, roots = memo_graph()
    code = printed.groups(hoisting(graph, memos), always(roots), lanes=(2,), memory=True)
    tags, rows = code.memory[2]
    assert code.text.count("call <2 x double> @llvm.floor") == 1

    def run(*counts):
        return code(2, **memo_values(counts))[1]

    run(5.0, -3.0)
    assert np.argwhere(~np.isnan(tags)).tolist() == [[5, 0], [MEMO_LINES - 3, 1]]
    assert tags[5, 0] == 5.0
    assert tags[-3, 1] == -3.0
    rows[5, 0, 1] = 0.25  # a look-up reads the row
    rows[-3, 1, 1] = 0.5
    assert run(5.0, -3.0).tolist() == [0.25, 0.5]
    # A lane that misses fills the lines of all: they are computed anew.
    np.testing.assert_allclose(run(5.0, -4.0), np.sin([5.0, -4.0]), rtol=4e-16)
    rows[5, 0, 1] = 0.25
    np.testing.assert_allclose(run(5.0 + MEMO_LINES, -4.0), np.sin([4101.0, -4.0]), rtol=4e-16)
    assert tags[5, 0] == 5.0 + MEMO_LINES
    np.testing.assert_allclose(run(5.0, -4.0), np.sin([5.0, -4.0]), rtol=4e-16)
    run(2.0**31, -(2.0**31))  # too large for an index
    assert tags[0].tolist() == [2.0**31, -(2.0**31)]
    run(2.0**31 + 5.0, 2.0**31 - 5.0)
    assert tags[0].tolist() == [2.0**31 + 5.0, -(2.0**31)]
    assert tags[-5, 1] == 2.0**31 - 5.0
    assert np.isnan(run(math.nan, math.nan)).all()
    assert np.isnan(rows[0]).all()
    run(2.0**31 - 1.0, 0.0)
    assert tags[-1, 0] == 2.0**31 - 1.0


@pytest.mark.slow
@property_test
@given(data=st.data())
def test_memos_under_conditions(printed, data):
    graph, memos, roots = memo_graph(2)
    program = hoisting(graph, memos)
    numbers = data.draw(st.lists(st.integers(-1, 2), min_size=8, max_size=8))
    conditions = [ALWAYS, *(("update", i) for i in range(3))]
    groups = [
        Group(
            conditions[number + 1],
            tuple((("output", i), roots[i]) for i in range(8) if numbers[i] == number),
        )
        for number in range(-1, 3)
    ]
    codes = [printed.groups(program, groups, lanes=(2,), memory=memory) for memory in (False, True)]
    count = st.sampled_from((0.0, -0.0, 1.0, 1.0 + MEMO_LINES, math.inf, math.nan))
    for _ in range(4):
        counts = np.array(data.draw(st.lists(count, min_size=8, max_size=8))).reshape(2, 4)
        fires = data.draw(st.lists(st.integers(0, 1), min_size=3, max_size=3))
        plain, memo = (code(2, fires, **memo_values(counts)) for code in codes)
        assert_same_bits(memo, plain)


# ------------------------------------------------------------------------ other processors

AVX512 = ("avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl")


def can_run(name):
    if platform.machine() != "x86_64":
        return False
    features = llvm.get_host_cpu_features()
    return all(
        features.get(feature)
        for feature in {
            "x86-64-v2": ("sse4.2",),
            "x86-64-v3": ("avx2", "fma"),
            "x86-64-v4": AVX512,
        }[name]
    )


@pytest.mark.parametrize(
    "name", [pytest.param("x86-64-v2", marks=pytest.mark.slow), "x86-64-v3", "x86-64-v4"]
)
def test_other_processors_give_the_same_bits(printed, random_graphs, name):
    if not can_run(name):
        pytest.skip(f"this machine is no {name}")
    graph, roots = function_graph()
    x, y = (graph.source("state", i) for i in range(2))
    roots = [
        *roots,
        graph.add(graph.multiply(x, y), graph.node("sin", x)),
        graph.node("floor", y),
        graph.node("max", x, y),
    ]
    values = function_values(random_graphs.edges)
    host = printed.plain(graph, roots, lanes=(1, 8))
    target = native.Processor(name, "")
    if name == "x86-64-v2":
        with pytest.warns(UserWarning, match="no fused multiply-add"):
            other = printed.plain(graph, roots, lanes=(1, 8), target=target)
    else:
        other = printed.plain(graph, roots, lanes=(1, 8), target=target)
    assert other.text == host.text
    expected = host(**values)
    for lanes in (1, 8):
        assert_same_bits(other(lanes, **values), expected)


@pytest.mark.parametrize("lanes", [1, 8])
def test_a_whole_model_is_built_for_aarch64(lanes):
    graph = Graph()
    x, p, u = (graph.source(kind) for kind in ("state", "parameter", "input"))
    rate = graph.add(graph.node("sin", x), graph.multiply(p, u), graph.node("exp", x))
    equations = Equations(
        graph=graph,
        parameters=["p"],
        states=["x"],
        inputs={"u": 1},
        derivatives=[rate],
        outputs={"y": [graph.node("atan2", x, u)]},
    )
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple("aarch64-unknown-linux-gnu")
    machine = target.create_target_machine("generic", opt=0)
    module = llvm.parse_assembly(run_text(Program(equations), "exact_hold", lanes))
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    module.verify()
    code = machine.emit_object(module)
    assert code[:4] == b"\x7fELF"
    assert int.from_bytes(code[18:20], "little") == 183  # EM_AARCH64
