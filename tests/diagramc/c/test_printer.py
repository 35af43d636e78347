"""C text of graphs, compiled and compared with the interpreter bit by bit."""

import ctypes
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from diagramc.c.printer import DOUBLE, FLOAT, WIDTH, CPrinter, comment_lines, literal
from diagramc.equations.equations import Section
from diagramc.equations.graph import Graph
from diagramc.equations.operations import UNARY
from diagramc.errors import CompilationError

ORDINARY = (0.0, -0.0, 1.0, -1.0, 0.5, 2.0, 3.0, 0.1, 1e200, 1e-200, math.pi, -1e9, 2.0**52 + 1.0)
"""Constants that a literal of C can say; the sources take the other edges."""

ARRAYS = {"parameter": "p", "state": "x", "discrete": "d", "input": "u"}

HEAD = """
#include <math.h>
#include <stdbool.h>
typedef {type} real;
static real minimum(real a, real b) {{ return (b < a) ? b : a; }}
static real maximum(real a, real b) {{ return (a < b) ? b : a; }}
"""


def text_of(graph, roots, precision=DOUBLE, sections=()):
    printer = CPrinter(graph, precision, sections)

    def load(kind, index):
        return "t" if kind == "time" else f"{ARRAYS[kind]}[{index}]"

    block = printer.block([(f"out[{i}]", root) for i, root in enumerate(roots)], load)
    arguments = ", ".join(f"const real *{name}" for name in ARRAYS.values())
    unused = "\n".join(f"    (void){name};" for name in ("t", *ARRAYS.values()))
    head = HEAD.format(type=precision.name)
    return (
        f"{head}void evaluate(real t, {arguments}, real *out)\n{{\n"
        f"{unused}\n" + "\n".join(block) + "\n    (void)minimum;\n    (void)maximum;\n}\n"
    )


def values_of(library, roots, samples, precision=DOUBLE):
    """Roots (roots, samples) of the compiled function."""
    real = {"double": ctypes.c_double, "float": ctypes.c_float}[precision.name]
    rows = []
    for column in range(samples["time"].shape[1]):
        arrays = [
            np.ascontiguousarray(
                samples.get(kind, np.zeros((1, column + 1)))[:, column], dtype=real
            )
            for kind in ARRAYS
        ]
        out = np.zeros(roots, dtype=real)
        pointers = (ctypes.c_void_p(array.ctypes.data) for array in (*arrays, out))
        library.evaluate(real(samples["time"][0, column]), *pointers)
        rows.append(out)
    return np.array(rows).T


def assert_same(values, expected):
    """Equal bits; nan is nan."""
    both = np.isnan(values) & np.isnan(expected)
    bits = values.view(np.int64) == np.ascontiguousarray(expected, dtype=float).view(np.int64)
    assert (bits | both).all()


@pytest.mark.parametrize("examples", [3, pytest.param(15, marks=pytest.mark.slow)])
def test_exact_operations_have_the_bits_of_the_interpreter(
    interpreted, random_graphs, c_text, examples
):
    @settings(max_examples=examples, derandomize=True)  # the same graphs in each run
    @given(st.data(), st.integers(0, 2**32 - 1))
    def check(data, seed):
        graph, roots = data.draw(random_graphs.graphs(constants=ORDINARY))
        samples = random_graphs.samples(seed, 16)
        with np.errstate(all="ignore"):
            values = interpreted(graph, roots, **samples)
        expected = np.array([np.broadcast_to(v, 16) for v in values])
        values = values_of(c_text(text_of(graph, roots)), len(roots), samples)
        assert_same(values, expected.astype(float))

    check()


def test_elementary_functions_are_those_of_the_c_library(c_text, interpreted):
    graph = Graph()
    x, y = (graph.source("state", i) for i in range(2))
    roots = [graph.node(name, x) for name in UNARY]
    roots += [graph.node("atan2", x, y), graph.node("power", x, y)]
    rng = np.random.default_rng(3)
    samples = {"time": np.zeros((1, 64)), "state": rng.uniform(0.01, 0.99, (2, 64))}
    expected = np.array(interpreted(graph, roots, **samples))
    np.testing.assert_allclose(
        values_of(c_text(text_of(graph, roots)), len(roots), samples), expected, rtol=1e-14
    )
    single = values_of(c_text(text_of(graph, roots, FLOAT)), len(roots), samples, FLOAT)
    np.testing.assert_allclose(single, expected, rtol=2e-5, atol=1e-6)


def test_what_is_used_twice_is_computed_once():
    graph = Graph()
    x = graph.source("state", 0)
    root = graph.node("sin", x)
    text = text_of(graph, [graph.add(root, x), graph.multiply(root, x)])
    assert text.count("sin(x[0])") == 1


def test_what_depends_on_parameters_alone_is_fixed():
    graph = Graph()
    p, q = (graph.source("parameter", i) for i in range(2))
    x = graph.source("state", 0)
    product = graph.multiply(p, q)
    printer = CPrinter(graph, DOUBLE, ())
    printer.collect_fixed([graph.add(graph.multiply(product, x), p)])
    assert printer.fixed == {product: 0}  # p itself is read where it is needed
    (line,) = printer.block([("y", graph.multiply(product, x))], lambda k, i: f"{k}[{i}]")
    assert line == "    y = constant[0] * state[0];"


def test_sections_are_comments_in_order():
    graph = Graph()
    x = graph.source("state", 0)
    first = graph.node("sin", x)
    second = graph.node("cos", graph.add(first, x))
    sections = [
        Section("plant: output y", "Plant: λ² */ of it", (first,)),
        Section("law: update", "Law.", (second,)),
        Section("unused: output", "Other.", (graph.node("tan", x),)),
    ]
    text = text_of(graph, [second, second, first], sections=sections)
    assert "/* plant: output y. Plant: lambda2 * / of it */" in text
    assert text.index("plant: output y") < text.index("sin(") < text.index("law: update")
    assert "unused" not in text


@pytest.mark.parametrize(
    "text", ["a*/b", "/*/", "**//", "a/*b", "??/", "a*\\", "＊/", "*＼", "\0*/"]
)
def test_a_comment_ends_at_its_end(text):
    (line,) = comment_lines(f"{text}\n{text}")
    assert line.count("*/") == 1
    assert line.count("/*") == 1
    assert "\\" not in line
    assert "??" not in line
    assert line.isprintable()
    assert line.isascii()


def test_lines_are_short():
    graph = Graph()
    sources = [graph.source("state", i) for i in range(60)]
    text = text_of(graph, [graph.add(*sources)])
    assert max(map(len, text.splitlines())) <= WIDTH


@pytest.mark.parametrize(
    ("value", "double", "single"),
    [
        (0.0, "0.0", "0.0f"),
        (-0.0, "-0.0", "-0.0f"),
        (0.1, "0.1", "0.1f"),
        (2e-13, "2.0e-13", "2.0e-13f"),
        (1.0 / 3.0, "0.3333333333333333", "0.33333334f"),
        (1.72e9, "1720000000.0", "1720000000.0f"),
        (-1e300, "-1.0e+300", None),
        (1e-300, "1.0e-300", None),
        (5e-324, None, None),
        (math.inf, None, None),
        (math.nan, None, None),
    ],
)
def test_literals(value, double, single):
    for precision, text in ((DOUBLE, double), (FLOAT, single)):
        if text is None:
            with pytest.raises(CompilationError, match="mass = "):
                literal(value, precision, "mass")
            continue
        printed = literal(value, precision, "mass")
        assert float(printed.removesuffix("f")) == pytest.approx(value, rel=1e-7, abs=0.0)
        assert precision.round(float(printed.removesuffix("f"))) == precision.round(value)
        assert "." in printed
        assert printed.endswith(precision.suffix)
