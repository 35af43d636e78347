"""Emits code for the matrix functions phi_1, phi_2 and phi_3, which `exact_hold` defines.

The functions at 2 z follow from those at z. There phi_1 = phi_1 + (z phi_1) phi_1 / 2. The product
z phi_1 = e^z - 1 loses digits if z has fast and slow modes: each doubling multiplies the rounding
errors of phi_1 by up to ||z||/2. So from `STIFF` on, e^z - 1 has a table of its own, whose doubling
(e^z - 1)² + 2 (e^z - 1) needs no z and keeps the digits of slow modes too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from .ir import Array, Function, Module, Operand, Value
from .types import DOUBLE, INT, POINTER

FINEST = 12
"""Largest number of halvings of a step: the exact hold's shortest step is tick/2^FINEST."""

STIFF = 256.0
"""Norm of A times the tick from which the tables contain e^(A h) - 1.

Below, chains of lags are right to 1e-12 without this table, which takes one more product. Most
knees have a norm of 6 … 230.
"""


class Columns:
    """Emits operations on square matrices with ``size`` rows.

    Each column is stored in one or more vectors, because one instruction works on a whole vector.
    Zeros fill up the last vector of a column.
    """

    def __init__(self, f: Function, size: int) -> None:
        self.f, self.size = f, size
        # Four doubles fill a vector of AVX2, and eight one of AVX-512.
        self.width = 4 if size <= 4 else 8
        self.blocks = -(-size // self.width)
        """Number of vectors that hold a column."""
        self.rows = self.blocks * self.width
        self.type = DOUBLE.of(self.width)

    def new(self) -> Array:
        """Return memory for a new matrix, which the code must fill."""
        return self.f.array(self.size * self.blocks, self.type)

    def zero(self) -> Array:
        """Return memory for a new matrix; emit code that sets all elements to zero."""
        matrix = self.new()
        for i in self.each():
            matrix[i] = 0.0
        return matrix

    def each(self) -> Iterator[Operand]:
        """Yield the index of each vector of a matrix to a Python loop: see `Function.each`."""
        return self.f.each(self.size * self.blocks)

    def element(self, row: Operand, column: Operand) -> Value:
        """Emit code that computes the index of an element among all doubles of a matrix.

        The zeros that fill up a column count as doubles of the matrix.
        """
        return self.f.coerce(column, INT) * self.rows + row

    def multiply(self, left: Array, right: Array, out: Array) -> None:
        """Emit the matrix product ``out`` = left · right."""
        f, blocks = self.f, range(self.blocks)
        for j in f.each(self.size):
            totals = [f.variable(f.constant(0.0, self.type)) for _ in blocks]
            for k in f.each(self.size):
                factor = right.cast(DOUBLE)[self.element(k, j)]
                column = left.shifted(f.coerce(k, INT) * self.blocks)
                for block, total in zip(blocks, totals, strict=True):
                    total.set(f.fma(column[block], f.coerce(factor, self.type), total.get()))
            for block, total in zip(blocks, totals, strict=True):
                out[f.coerce(j, INT) * self.blocks + block] = total.get()

    def combine(self, out: Array, *terms: tuple[Operand, Array]) -> None:
        """Emit ``out`` = Σ factor · matrix, where ``terms`` are the pairs (factor, matrix)."""
        f = self.f
        for e in self.each():
            total = f.coerce(0.0, self.type)
            for factor, matrix in terms:
                total = f.fma(f.coerce(factor, self.type), matrix[e], total)
            out[e] = total

    def norm(self, matrix: Array) -> Value:
        """Emit the infinity norm of ``matrix``, the largest sum of magnitudes in a row."""
        f, largest = self.f, self.f.variable(self.f.constant(0.0))
        for block in range(self.blocks):
            total = f.variable(f.constant(0.0, self.type))
            for j in f.each(self.size):
                element = matrix[f.coerce(j, INT) * self.blocks + block]
                total.set(total.get() + f.absolute(element))
            for lane in range(self.width):
                largest.set(f.maximum(largest.get(), f.lane(total.get(), lane)))
        return largest.get()


class Tables:
    """Layout of the tables of one matrix A, in doubles.

    The tables begin with a norm of A, its largest sum of magnitudes in a row, and the coarsest and
    the finest level that are filled. All levels between these two are filled too. The next element
    is 1 if the norm of A times the tick is `STIFF` or more. Then come A and, for each level
    0 … `FINEST` + 1, the matrices phi_1, phi_2, phi_3 and e^(A h) - 1 at A h, where
    h = tick/2^level. The last one is filled if A is stiff. Each matrix is stored as `Columns`
    describes.
    """

    NORM, BOUND, COARSEST, FINEST, STIFF, MATRIX = 0, 1, 2, 3, 4, 8

    def __init__(self, size: int) -> None:
        width = 4 if size <= 4 else 8
        self.rows = -(-size // width) * width
        """Number of doubles from one column to the next."""
        self.matrix = size * self.rows
        """Number of doubles of a matrix."""
        self.first = self.MATRIX + self.matrix
        """Place of phi_1 of level 0."""
        self.level = 4 * self.matrix
        """Number of doubles of a level."""
        self.size = self.first + (FINEST + 2) * self.level


# With three levels a step can be halved twice more without a new series. The number decides little:
# 15 s of preset ``leg`` take 20 ms with 1, 3 or 6 levels.
_SPARE = 3  # number of levels from a requested level to the first table of a small matrix
# The next term is below 1/(_DEGREE + 3)! = 8e-18, less than the rounding error of phi_3(0) = 1/6.
_DEGREE = 16  # number of terms of the Taylor series
# With groups of four, 16 terms take six products of matrices in place of 15.
_GROUP = 4  # number of terms between two powers of the matrix's fourth power


def step_of(f: Function, tick: Value, level: Value) -> Value:
    """Emit the step tick/2^level in s. Each lane has its level."""
    type_ = DOUBLE.of(level.type.lanes)
    span = f.coerce(f.constant(1 << (FINEST + 1), INT), level.type) >> level
    return f.coerce(tick, type_) * (f.to_double(span) * 0.5 ** (FINEST + 1))


def _matrices(array: Array, columns: Columns, at: Tables, count: int) -> list[Array]:
    """Return ``count`` matrices that are stored one after the other."""
    return [array.shifted(n * at.matrix).cast(columns.type) for n in range(count)]


def define_store_matrix(module: Module, size: int) -> Function:
    """Define the emitted function ``store_matrix(a, tables)``: see `Tables`.

    The function stores the matrix ``a``, which is given column by column, and its norm. No level is
    filled yet. The norm is ||a⁴||^(1/4), which is at most the largest sum of magnitudes in a row,
    and often far less, because the units of the states hardly change ||a⁴||^(1/4) (Al-Mohy and
    Higham 2009, SIAM J. Matrix Anal. Appl. 31).
    """
    f = module.function("store_matrix", dict.fromkeys(("a", "tables"), POINTER))
    a, tables = (Array(f.arguments[name], DOUBLE) for name in ("a", "tables"))
    columns, at = Columns(f, size), Tables(size)
    matrix = tables.shifted(at.MATRIX)
    (stored,) = _matrices(matrix, columns, at, 1)
    for e in columns.each():
        stored[e] = 0.0
    for j in f.loop(size):
        for i in f.each(size):
            matrix[columns.element(i, j)] = a[f.coerce(j, INT) * size + i]
    bound = columns.norm(stored)
    unit, square, fourth = (columns.new() for _ in range(3))
    columns.combine(unit, (f.select(bound > 0.0, 1.0 / bound, 0.0), stored))
    columns.multiply(unit, unit, square)
    columns.multiply(square, square, fourth)
    tables[at.BOUND] = bound
    tables[at.NORM] = bound * f.sqrt(f.sqrt(columns.norm(fourth)))
    tables.cast(INT)[at.COARSEST] = FINEST + 2
    tables.cast(INT)[at.FINEST] = -1
    return f


def _define_start_tables(module: Module, size: int) -> Function:
    """Define the emitted function ``start_tables(tick, tables, least)``: see `Tables`.

    The function fills a first table, from which `fill_tables` makes the others by doubling. Its
    level is at least ``least``, and so high that the norm of A h is at most 1, as the Taylor series
    requires. If that is more than `FINEST` + 1, the function doubles the table until it belongs to
    the level `FINEST` + 1. All levels that were filled before count as empty.
    """
    double = _double_table(module, size)
    arguments = {"tick": DOUBLE, "tables": POINTER, "least": INT}
    f = module.function("start_tables", arguments, attributes="noinline")
    tables, least = Array(f.arguments["tables"], DOUBLE), f.arguments["least"]
    tick, columns, at = f.arguments["tick"], Columns(f, size), Tables(size)
    matrix = tables.shifted(at.MATRIX)
    (stored,) = _matrices(matrix, columns, at, 1)
    unit = columns.zero()
    for j in f.loop(size):
        unit.cast(DOUBLE)[columns.element(j, j)] = 1.0
    level, h = f.variable(least), f.variable(step_of(f, tick, least))
    norm, bound = tables[at.NORM], tables[at.BOUND]
    stiff = ~(norm * tick < STIFF)
    tables.cast(INT)[at.STIFF] = f.flags(stiff)
    with f.forever() as loop:
        # A sum of magnitudes up to 8 hardly adds to the remainder of the series.
        large = (norm * h.get() > 1.0) | (bound * h.get() > 8.0)
        # The bound ends the loop for a norm that is infinite.
        loop.stop_if(~(large & (level.get() < 200)))
        level.set(level.get() + 1)
        h.set(h.get() * 0.5)
    powers = [unit, *(columns.new() for _ in range(_GROUP))]
    columns.combine(powers[1], (h.get(), stored))
    for n in range(1, _GROUP):
        columns.multiply(powers[n], powers[1], powers[n + 1])
    first = f.select(level.get() > FINEST + 1, FINEST + 1, level.get())
    table, doubled = tables.shifted(first * at.level + at.first), f.array(at.level)
    *phi, growth = _matrices(table, columns, at, 4)
    _taylor(columns, powers, phi)
    with f.when(stiff):
        columns.multiply(powers[1], phi[0], growth)
    with f.forever() as loop:
        loop.stop_if(level.get() <= first)
        f.call(double, h.get(), tables.pointer, table.pointer, doubled.pointer)
        for e in f.loop(at.level):
            table[e] = doubled[e]
        level.set(level.get() - 1)
        h.set(h.get() * 2.0)
    tables.cast(INT)[at.COARSEST] = first
    tables.cast(INT)[at.FINEST] = first
    return f


def fill_tables(module: Module, size: int) -> Function:
    """Return the emitted function ``fill_tables(tick, tables, level)``: see `Tables`.

    The function fills the tables of ``level`` and of ``level`` + 1, if they are missing. Each table
    comes from the table of half the step (Skaflestad and Wright 2009, Appl. Numer. Math. 59). If
    no table is fine enough, a Taylor series gives a first table, at least ``_SPARE`` levels finer
    than ``level`` unless `FINEST` + 1 is reached.
    """
    return module.shared("fill_tables", lambda: _define_fill_tables(module, size))


def _define_fill_tables(module: Module, size: int) -> Function:
    double, at = _double_table(module, size), Tables(size)
    start = _define_start_tables(module, size)
    arguments = {"tick": DOUBLE, "tables": POINTER, "level": INT}
    f = module.function("fill_tables", arguments, attributes="noinline")
    tick, tables, requested = f.arguments["tick"], f.arguments["tables"], f.arguments["level"]
    memory = Array(tables, DOUBLE)
    with f.when(requested + 1 > memory.cast(INT)[at.FINEST]):
        least = f.select(requested + _SPARE > FINEST + 1, FINEST + 1, requested + _SPARE)
        f.call(start, tick, tables, least)
    coarsest = f.variable(memory.cast(INT)[at.COARSEST])
    with f.forever() as loop:
        level = coarsest.get()
        loop.stop_if(level <= requested)
        h = step_of(f, tick, level)
        table, out = (memory.address((level - n) * at.level + at.first) for n in (0, 1))
        f.call(double, h, tables, table, out)
        coarsest.set(level - 1)
    memory.cast(INT)[at.COARSEST] = coarsest.get()
    return f


def _double_table(module: Module, size: int) -> Function:
    """Return ``double_table(h, tables, table, out)``: from the table for ``h`` to that for 2 ``h``.

    ``tables``: see `Tables`.
    """
    return module.shared("double_table", lambda: _define_double_table(module, size))


def _define_double_table(module: Module, size: int) -> Function:
    names = ("tables", "table", "out")
    arguments = {"h": DOUBLE} | dict.fromkeys(names, POINTER)
    f = module.function("double_table", arguments, attributes="noinline")
    h, columns, at = f.arguments["h"], Columns(f, size), Tables(size)
    tables, table, out = (Array(f.arguments[name], DOUBLE) for name in names)
    (matrix,) = _matrices(tables.shifted(at.MATRIX), columns, at, 1)
    phi_1, phi_2, phi_3, growth = _matrices(table, columns, at, 4)
    new_1, new_2, new_3, new_growth = _matrices(out, columns, at, 4)
    square, mixed, moved = (columns.new() for _ in range(3))
    columns.multiply(phi_1, phi_1, square)
    columns.multiply(phi_1, phi_2, mixed)
    columns.combine(new_3, (0.125, mixed), (0.25, phi_3), (0.125, phi_2))
    columns.combine(new_2, (0.25, square), (0.5, phi_2))
    stiff = tables.cast(INT)[at.STIFF].differs(0)
    with f.when(stiff):
        columns.multiply(growth, phi_1, moved)
        columns.combine(new_1, (0.5, moved), (1.0, phi_1))
        columns.multiply(growth, growth, moved)
        columns.combine(new_growth, (1.0, moved), (2.0, growth))
    with f.when(~stiff):
        columns.multiply(matrix, square, moved)
        columns.combine(new_1, (0.5 * h, moved), (1.0, phi_1))
    return f


def _taylor(columns: Columns, powers: list[Array], phi: list[Array]) -> None:
    """Emit phi_1, phi_2, phi_3 at a matrix z with a norm of at most 1, to ``phi``.

    ``powers``: 1, z, z², z³, z⁴. Between groups of `_GROUP` terms of the series of phi_3 the code
    multiplies by z⁴ (Paterson and Stockmeyer 1973, SIAM J. Comput. 2). The recursions
    phi_2 = 1/2 + z phi_3 and phi_1 = 1 + z phi_2 give the other two.
    """
    unit, z, total, spare = *powers[:2], columns.new(), columns.new()
    for start in reversed(range(0, _DEGREE, _GROUP)):
        factors = [1.0 / math.factorial(start + n + 3) for n in range(_GROUP)]
        terms = list(zip(factors, powers, strict=False))
        if start + _GROUP < _DEGREE:
            columns.multiply(total, powers[_GROUP], spare)
            terms.append((1.0, spare))
        columns.combine(total, *terms)
    columns.combine(phi[2], (1.0, total))
    columns.multiply(z, total, spare)
    columns.combine(phi[1], (0.5, unit), (1.0, spare))
    columns.multiply(z, phi[1], spare)
    columns.combine(phi[0], (1.0, unit), (1.0, spare))
