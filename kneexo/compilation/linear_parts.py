"""Linear parts of the exact hold: Jacobians met before, and the functions of their exponentials.

The same for every model, so it is compiled but once; `codegen` loads it through the cache.
"""

# Arrays are written element by element: numba makes the fastest code from plain loops.

from typing import Any

import numpy as np
from numba import njit

FINEST = 12  # the exact hold halves its step at most so often
SLOTS = 4  # linear parts that it remembers

_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
_options["fastmath"] = {"contract"}
jit = njit(**_options)  # called from Python
inner = njit(**_options | {"no_cpython_wrapper": True, "no_cfunc_wrapper": True})


@inner
def multiply(left: Any, right: Any, product: Any) -> None:
    """Product of two small square matrices."""
    n = left.shape[0]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += left[i, k] * right[k, j]
            product[i, j] = total


@jit
def fill_tables(a: Any, tick: float, tables: Any) -> float:
    """tables[level] = h phi_1, h phi_2, h (phi_2 - 4 phi_3) of A h, with h = tick/2^level.

    The functions of all halvings come from the smallest by doubling (Skaflestad and Wright 2009,
    Appl. Numer. Math. 59). Returns the norm of A.
    """
    n = a.shape[0]
    norm = 0.0
    for i in range(n):
        row = 0.0
        for j in range(n):
            row += abs(a[i, j])
        norm = max(norm, row)
    level = FINEST + 1
    while norm * tick > 0.1 * 2.0**level and level < 200:
        level += 1
    h = tick / 2.0**level
    work = np.zeros((8, n, n))
    z, power, square, mixed, next_1 = work[0], work[1], work[2], work[3], work[4]
    phi_1, phi_2, phi_3 = work[5], work[6], work[7]
    for i in range(n):
        power[i, i] = 1.0
        for j in range(n):
            z[i, j] = h * a[i, j]
    factorial = 1.0
    for k in range(1, 10):  # Taylor: the next term is below 0.1^9/10!
        factorial *= k
        for i in range(n):
            for j in range(n):
                term = power[i, j] / factorial
                phi_1[i, j] += term
                phi_2[i, j] += term / (k + 1)
                phi_3[i, j] += term / ((k + 1) * (k + 2))
        multiply(power, z, square)
        power, square = square, power
    while True:
        if level < tables.shape[0]:
            for i in range(n):
                for j in range(n):
                    tables[level, 0, i, j] = h * phi_1[i, j]
                    tables[level, 1, i, j] = h * phi_2[i, j]
                    tables[level, 2, i, j] = h * (phi_2[i, j] - 4.0 * phi_3[i, j])
        if level == 0:
            return norm
        multiply(phi_1, phi_1, square)
        multiply(phi_1, phi_2, mixed)
        multiply(z, square, next_1)
        for i in range(n):
            for j in range(n):
                phi_3[i, j] = 0.125 * (mixed[i, j] + phi_2[i, j] + 2.0 * phi_3[i, j])
                phi_2[i, j] = 0.25 * (square[i, j] + 2.0 * phi_2[i, j])
                phi_1[i, j] += 0.5 * next_1[i, j]
                z[i, j] *= 2.0
        h *= 2.0
        level -= 1


@jit
def choose_slot(
    x: Any,
    settings: Any,
    w: Any,
    memory: Any,
    jacobians: Any,
    tables: Any,
    norms: Any,
    current: int,
) -> int:
    """Slot of the Jacobian in the last place; its tables are made when it is a new one.

    It stays the ``current`` one when another would not take a tenth off the remainder ``w[1]`` that
    a change ``w[0]`` of the state ``x`` has left. The rest: see `loops.advance_exact_hold`.
    """
    n, filled = x.size, memory[1]
    a = jacobians.reshape((SLOTS + 1, n, n))
    j = a[SLOTS]
    for i in range(n):
        for k in range(n):
            if not np.isfinite(j[i, k]):  # a root at zero; any matrix will do, if slowly
                j[i, k] = 0.0
    if filled > 0:
        explained = left = 0.0
        for i in range(n):
            total = 0.0
            for k in range(n):
                total += (j[i, k] - a[current, i, k]) * w[0, k]
            explained += abs(total) / (1.0 + abs(x[i]))
            left += abs(w[1, i]) / (1.0 + abs(x[i]))
        if explained < 0.1 * left:
            return current
    for slot in range(filled):
        same = True
        for i in range(n):
            for k in range(n):
                same = same and a[slot, i, k] == j[i, k]
        if same:
            return slot
    slot = memory[2] % SLOTS
    memory[2] += 1
    memory[1] = min(filled + 1, SLOTS)
    for i in range(n):
        for k in range(n):
            a[slot, i, k] = j[i, k]
    all_tables = tables.reshape((SLOTS, FINEST + 2, 3, n, n))
    norms[slot] = fill_tables(a[slot], settings[0], all_tables[slot])
    return slot
