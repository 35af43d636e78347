"""Emits code for the matrix functions phi_1, phi_2 and phi_3, which `exact_hold` defines."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from .ir import Array, Function, Module, Operand, Value
from .types import DOUBLE, INT, POINTER

FINEST = 12
"""Largest number of halvings of a step: the exact hold's shortest step is tick/2^FINEST."""


class Columns:
    """Emits operations on square matrices with ``size`` rows.

    Each column is stored in one or more vectors, because one instruction works on a whole vector.
    Zeros fill up the last vector of a column.
    """

    def __init__(self, f: Function, size: int) -> None:
        self.f, self.size = f, size
        self.width = 4 if size <= 4 else 8
        self.blocks = -(-size // self.width)
        """Number of vectors that hold a column."""
        self.rows = self.blocks * self.width
        self.type = DOUBLE.of(self.width)

    def zero(self) -> Array:
        """Return memory for a new matrix; emit code that sets all elements to zero."""
        matrix = self.f.array(self.size * self.blocks, self.type)
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

    def store(self, matrix: Callable[[Operand], Value], out: Array) -> None:
        """Emit code that copies a matrix to ``out``, column by column, without filling zeros.

        ``matrix(index)`` returns the vector ``index`` of the matrix.
        """
        f, last = self.f, (self.size - 1) * self.blocks
        for j in f.each(self.size - 1):  # the next column overwrites the rows of zeros
            for block in range(self.blocks):
                place = f.coerce(j, INT) * self.size + block * self.width
                out.shifted(place).cast(self.type)[0] = matrix(
                    f.coerce(j, INT) * self.blocks + block
                )
        for block in range(self.blocks):
            values = matrix(last + block)
            first = (self.size - 1) * self.size + block * self.width
            for lane in range(min(self.width, self.size - block * self.width)):
                out[first + lane] = f.lane(values, lane)


def define_fill_tables(module: Module, size: int) -> Function:
    """Define the emitted function ``fill_tables(a, tick, tables)``.

    The function computes h phi_1, h phi_2 and h (phi_2 - 4 phi_3) at the argument a h, where ``a``
    is a matrix, and writes these matrices to ``tables``. There is one table for each step
    h = tick/2^level, with the levels 0 … `FINEST` + 1. A Taylor series gives the functions at a
    small step, and doublings lead to each longer step (Skaflestad and Wright 2009, Appl. Numer.
    Math. 59).
    """
    square = size * size
    arguments = {"a": POINTER, "tick": DOUBLE, "tables": POINTER}
    f = module.function("fill_tables", arguments, attributes="noinline")
    a, tables = (Array(f.arguments[name], DOUBLE) for name in ("a", "tables"))
    tick, columns = f.arguments["tick"], Columns(f, size)
    z, power, spare, mixed, phi_1, phi_2, phi_3 = (columns.zero() for _ in range(7))
    norm = f.variable(f.constant(0.0))
    for i in f.loop(size):
        row = f.variable(f.constant(0.0))
        for j in f.loop(size):
            row.set(row.get() + f.absolute(a[f.coerce(j, INT) * size + i]))
        norm.set(f.maximum(norm.get(), row.get()))
    level = f.variable(f.constant(FINEST + 1, INT))
    limit = f.variable(f.constant(0.1 * 2.0 ** (FINEST + 1)))
    h = f.variable(tick * 0.5 ** (FINEST + 1))
    with f.forever() as loop:
        loop.stop_if(~((norm.get() * tick > limit.get()) & (level.get() < 200)))
        level.set(level.get() + 1)
        limit.set(limit.get() * 2.0)
        h.set(h.get() * 0.5)
    for j in f.loop(size):
        for i in f.loop(size):
            z.cast(DOUBLE)[columns.element(i, j)] = h.get() * a[f.coerce(j, INT) * size + i]
        power.cast(DOUBLE)[columns.element(j, j)] = 1.0
    factorial = 1.0
    for order in range(1, 10):  # Taylor: the next term is below 0.1^9/10!
        factorial *= order
        for e in columns.each():
            term = power[e]
            phi_1[e] = f.fma(term, 1.0 / factorial, phi_1[e])
            phi_2[e] = f.fma(term, 1.0 / factorial / (order + 1), phi_2[e])
            phi_3[e] = f.fma(term, 1.0 / factorial / ((order + 1) * (order + 2)), phi_3[e])
        columns.multiply(power, z, spare)
        power, spare = spare, power
    with f.forever() as loop:
        step = h.get()
        with f.when(level.get() <= FINEST + 1):
            to = tables.shifted(level.get() * (3 * square))
            columns.store(lambda e: step * phi_1[e], to)
            columns.store(lambda e: step * phi_2[e], to.shifted(square))
            columns.store(lambda e: step * f.fma(phi_3[e], -4.0, phi_2[e]), to.shifted(2 * square))
        loop.stop_if(level.get().equals(0))
        columns.multiply(phi_1, phi_1, spare)
        columns.multiply(phi_1, phi_2, mixed)
        columns.multiply(z, spare, power)
        for e in columns.each():
            phi_3[e] = 0.125 * (mixed[e] + f.fma(phi_3[e], 2.0, phi_2[e]))
            phi_2[e] = 0.25 * f.fma(phi_2[e], 2.0, spare[e])
            phi_1[e] = f.fma(power[e], 0.5, phi_1[e])
            z[e] = z[e] * 2.0
        h.set(step * 2.0)
        level.set(level.get() - 1)
    return f
