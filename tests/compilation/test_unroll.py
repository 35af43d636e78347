"""Loops written out: the same results as the loops, and no vector left."""

import ast

import numpy as np
import pytest

from kneexo.compilation.unroll import unrolled

SOURCE = """
OK = 0

@unrolled("x f")
def rate(x, matrix, scale):
    for i in range(STATE_COUNT):
        f[i] = 0.0
        for k in range(STATE_COUNT):
            f[i] += matrix[i * STATE_COUNT + k] * x[k]
    return f

@unrolled("x f g")
def advance(matrix, state, steps):
    for i in range(STATE_COUNT):
        x[i] = state[i]
    for step in range(steps):
        f = rate(x, matrix, 1.0)
        g = f
        for i in range(STATE_COUNT):
            x[i] = x[i] + 0.5 * g[i] + step
    for i in range(STATE_COUNT):
        state[i] = x[i]
    return OK

def left_alone(x):
    for i in range(STATE_COUNT):
        x[i] = 2 * x[i]
"""


@pytest.mark.parametrize("size", [1, 2, 5])
def test_results_are_those_of_the_loops(size):
    text = unrolled(SOURCE, size)
    module = {"inline": lambda function: function}
    exec(text, module)
    rng = np.random.default_rng(size)
    matrix, state = rng.normal(size=(size, size)), rng.normal(size=size)
    expected = state.copy()
    for step in range(3):
        expected = expected + 0.5 * matrix @ expected + step
    assert module["advance"](matrix.ravel(), state, 3) == 0
    np.testing.assert_allclose(state, expected, rtol=1e-13)


def test_no_vector_and_no_loop_over_states_is_left():
    functions = {f.name: f for f in ast.parse(unrolled(SOURCE, 3)).body if hasattr(f, "name")}
    names = {n.id for n in ast.walk(functions["advance"]) if isinstance(n, ast.Name)}
    assert not names & {"x", "f", "g", "STATE_COUNT"}
    assert {"x_0", "f_2", "g_1", "state"} <= names
    assert sum(isinstance(n, ast.For) for n in ast.walk(functions["advance"])) == 1
    assert ast.unparse(functions["left_alone"]) == ast.unparse(ast.parse(SOURCE).body[-1])


def test_without_states_there_is_nothing_to_do():
    module = {"inline": lambda function: function}
    exec(unrolled(SOURCE, 0), module)
    assert module["rate"](None, None) == ()
    assert module["advance"](None, None, 3) == 0
