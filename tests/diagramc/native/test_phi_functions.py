"""Functions of a matrix against the matrix exponential."""

import numpy as np
import pytest
import scipy.linalg

from diagramc.native.ir import Array, Module
from diagramc.native.llvm import Library, compile_text
from diagramc.native.phi_functions import FINEST, Tables, define_store_matrix, fill_tables
from diagramc.native.types import DOUBLE, INT, POINTER


class Filler:
    """Tables of a matrix, as the emitted functions fill them."""

    def __init__(self, a, tick):
        self.size, self.tick, self.at = len(a), np.array([tick]), Tables(len(a))
        module = Module()
        store, fill = define_store_matrix(module, self.size), fill_tables(module, self.size)
        names = ("argument", "tick", "tables")
        f = module.function("store", dict.fromkeys(names, POINTER), internal=False)
        f.call(store, f.arguments["argument"], f.arguments["tables"])
        f = module.function("fill", dict.fromkeys(names, POINTER), internal=False)
        tick_s = Array(f.arguments["tick"], DOUBLE)[0]
        level = Array(f.arguments["argument"], INT)[0]
        f.call(fill, tick_s, f.arguments["tables"], level)
        self.library = Library(compile_text(module.text()))
        self.tables = np.full(self.at.size, np.nan)
        self.call("store", np.ascontiguousarray(a.T))

    def fill(self, level):
        self.call("fill", np.array([level]))

    def call(self, name, argument):
        arrays = (argument, self.tick, self.tables)
        self.library.function(name, 3)(*(array.ctypes.data for array in arrays))

    @property
    def norm(self):
        return self.tables[Tables.NORM]

    @property
    def levels(self):
        """The coarsest and the finest level that are filled."""
        return self.tables.view(np.int64)[[Tables.COARSEST, Tables.FINEST]].tolist()

    def phi(self, level):
        """phi_1, phi_2, phi_3 (3, n, n) at a level."""
        first = self.at.first + level * self.at.level
        flat = self.tables[first : first + self.at.level]
        return flat.reshape(4, self.size, self.at.rows)[:3, :, : self.size].swapaxes(1, 2)


def exact_phi(z):
    """phi_1, phi_2, phi_3 of a matrix by one exponential (Sidje 1998)."""
    size = len(z)
    block = np.zeros((4 * size, 4 * size))
    block[:size, :size] = z
    block[: 3 * size, size:] += np.eye(3 * size)
    phi = scipy.linalg.expm(block)[:size]
    return [phi[:, n * size : (n + 1) * size] for n in (1, 2, 3)]


@pytest.mark.parametrize(
    "size", [1, 2, 4, *(pytest.param(n, marks=pytest.mark.slow) for n in (5, 8, 9, 17))]
)
def test_tables_are_the_functions_of_the_matrix_exponential(size):
    rng = np.random.default_rng(3)
    a = rng.normal(size=(size, size)) * np.geomspace(1.0, 3e4, size)
    filler = Filler(a, 2e-3)
    for level in (3, 0, FINEST, 5):
        filler.fill(level)
        coarsest, finest = filler.levels
        assert coarsest <= level < finest
        for filled in (level, level + 1):
            exact = exact_phi(a * 2e-3 / 2**filled)
            for ours, phi in zip(filler.phi(filled), exact, strict=True):
                np.testing.assert_allclose(ours, phi, rtol=0, atol=1e-11 * np.abs(phi).max())


def test_a_table_that_is_filled_stays():
    filler = Filler(np.array([[-2.0, 1.0], [3.0, -5.0]]), 2e-3)
    filler.fill(1)
    before = filler.tables.copy()
    filler.fill(filler.levels[1] - 1)
    np.testing.assert_array_equal(filler.tables, before)
    filler.fill(filler.levels[1])  # whose half step has no table yet
    assert filler.levels[1] > before.view(np.int64)[Tables.FINEST]


def test_a_huge_matrix_has_its_first_table_at_the_finest_step():
    a = np.array([[-1e9, 3e8], [0.0, -1.0]])
    filler = Filler(a, 2e-3)
    filler.fill(FINEST)
    assert filler.levels == [FINEST, FINEST + 1]
    exact = exact_phi(a * 2e-3 / 2 ** (FINEST + 1))
    np.testing.assert_allclose(filler.phi(FINEST + 1), exact, rtol=0, atol=1e-9)


@pytest.mark.parametrize("unit", [1.0, 1e3])
def test_units_of_the_states_hardly_change_the_norm(unit):
    """An oscillator of 2000 rad/s, whose second state has a unit that scales the matrix."""
    filler = Filler(np.array([[0.0, unit], [-4e6 / unit, 0.0]]), 2e-3)
    assert filler.norm == pytest.approx(2000.0, rel=1e-12)
