"""Functions of a matrix against the matrix exponential."""

import numpy as np
import pytest
import scipy.linalg

from kneexo.compiler.native.ir import Array, Module
from kneexo.compiler.native.llvm import Library, compile_text
from kneexo.compiler.native.phi_functions import FINEST, define_fill_tables
from kneexo.compiler.native.types import DOUBLE, POINTER


def fill_tables(a, tick):
    """Tables (levels, 3, n, n) of a matrix."""
    size = len(a)
    module = Module()
    fill = define_fill_tables(module, size)
    f = module.function("fill", dict.fromkeys(("a", "tick", "tables"), POINTER), internal=False)
    tick_s = Array(f.arguments["tick"], DOUBLE)
    f.call(fill, f.arguments["a"], tick_s[0], f.arguments["tables"])
    tables, numbers = np.empty((FINEST + 2, 3, size, size)), np.array([tick])
    by_columns = np.ascontiguousarray(a.T)
    library = Library(compile_text(module.text()))
    library.function("fill", 3)(by_columns.ctypes.data, numbers.ctypes.data, tables.ctypes.data)
    return tables.swapaxes(2, 3)


@pytest.mark.parametrize("size", [1, 2, 4, 5, 8, 9, 17])
def test_tables_are_the_functions_of_the_matrix_exponential(size):
    rng = np.random.default_rng(3)
    a = rng.normal(size=(size, size)) * np.geomspace(1.0, 3e4, size)
    tick = 2e-3
    tables = fill_tables(a, tick)
    for level in (0, 1, 5, FINEST + 1):
        h = tick / 2**level
        block = np.zeros((4 * size, 4 * size))  # phi_k by one exponential (Sidje 1998)
        block[:size, :size] = a * h
        block[: 3 * size, size:] += np.eye(3 * size)
        phi = scipy.linalg.expm(block)[:size]
        phi_1, phi_2, phi_3 = (phi[:, n * size : (n + 1) * size] for n in (1, 2, 3))
        for ours, exact in zip(
            tables[level], (h * phi_1, h * phi_2, h * (phi_2 - 4.0 * phi_3)), strict=True
        ):
            np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-11 * np.abs(exact).max())
