"""Time loops of a compiled model.

`codegen` copies the text below the mark behind the functions that it generates, so that numba
compiles both as one module; here, above the mark, are stand-ins for them. ``x``: continuous
states, ``d``: discrete states (held between two events), ``u``: inputs, ``c``: constants of the
run, ``table``: the inputs as a piecewise polynomial (see `evaluate_inputs`).
"""

# Arrays are written element by element: numba makes the fastest code from plain loops.

from __future__ import annotations

from typing import Any

import numpy as np

STATE_COUNT = HELD_COUNT = INPUT_COUNT = OUTPUT_COUNT = LIMIT_COUNT = 0


def jit(function: Any) -> Any:
    """Stand-in for numba's decorator."""
    return function


inline = jit
"""The same for functions called in the inner loops: passing ten arrays costs more than they do."""


def unrolled(vectors: str) -> Any:
    """Mark of functions that `unroll` writes out, with the names of their vectors of states."""
    return jit


x = f = a = f_a = b = f_b = g_a = g_b = weight = z = k1 = k2 = k3 = k4 = [0.0]  # such vectors


def derivatives(t: Any, x: Any, d: Any, u: Any, c: Any) -> Any:
    """Stand-in: elements of dx/dt; ``x`` too is passed element by element."""


def jacobian(t: Any, x: Any, d: Any, u: Any, c: Any, j: Any) -> None:
    """Stand-in: j = df/dx."""


def instant(
    t: Any, x: Any, d: Any, u: Any, c: Any, fires: Any, wanted: Any, after: Any, y: Any, m: Any
) -> None:
    """Stand-in: discrete states ``after`` the updates that fire, wanted outputs, margins."""


def advance(
    t: Any, end: Any, x: Any, d: Any, u: Any, c: Any, breaks: Any, coefficients: Any, hold: Any
) -> int:
    """Stand-in for one of the integrators below: advance ``x`` from ``t`` to ``end``."""
    return 0


# ----- copied into each generated module from here on -----

NEGLIGIBLE = 0.01  # share of the tolerance that is not worth a correction
STIFF = 0.5  # norm of A h below which the choice of A does not matter
FINEST = 12  # the exact hold halves its step at most so often
SLOTS = 4  # linear parts that it remembers
MOST_EXCESS = 1e-2  # sum of the errors of its finest steps that miss the tolerance

OK, NOT_FINITE, OUTSIDE, TOO_ROUGH = range(4)


@inline
def evaluate_inputs(t: Any, breaks: Any, coefficients: Any, u: Any) -> None:
    """Evaluate the inputs at ``t``: polynomials in the time since the last of ``breaks``.

    ``coefficients[segment, input, power]``; the first segment ends and the last one starts at a
    break, where a value belongs to the segment on its right, at the last break to that on its left.
    """
    segment = np.searchsorted(breaks, t, side="right")
    if segment > 1 and segment == breaks.size and t == breaks[segment - 1]:
        segment -= 1
    s = t - breaks[segment - 1] if segment > 0 else 0.0
    for i in range(INPUT_COUNT):
        value = 0.0
        for power in range(coefficients.shape[2] - 1, -1, -1):
            value = value * s + coefficients[segment, i, power]
        u[i] = value


@unrolled("x")
def rate(t: Any, x: Any, d: Any, u: Any, c: Any, breaks: Any, coefficients: Any) -> Any:
    """Elements of dx/dt, with the inputs at ``t``."""
    if INPUT_COUNT > 0:
        evaluate_inputs(t, breaks, coefficients, u)
    return derivatives(t, x, d, u, c)


@unrolled("x z k1 k2 k3")
def advance_runge_kutta3(
    t: Any, end: Any, state: Any, d: Any, u: Any, c: Any, breaks: Any, coefficients: Any, hold: Any
) -> int:
    """Advance with the fixed steps of Drake's RungeKutta3Integrator, which may stretch by 1 %."""
    step = hold[0][1]
    for i in range(STATE_COUNT):
        x[i] = state[i]
    while t < end:
        h = step
        last = t + 1.01 * h >= end
        if last:
            h = end - t
        k1 = rate(t, x, d, u, c, breaks, coefficients)
        for i in range(STATE_COUNT):
            z[i] = x[i] + 0.5 * h * k1[i]
        k2 = rate(t + 0.5 * h, z, d, u, c, breaks, coefficients)
        for i in range(STATE_COUNT):
            z[i] = x[i] - h * k1[i] + 2.0 * h * k2[i]
        k3 = rate(t + h, z, d, u, c, breaks, coefficients)
        for i in range(STATE_COUNT):
            x[i] += h / 6.0 * (k1[i] + 4.0 * k2[i] + k3[i])
        t = end if last else t + h
    for i in range(STATE_COUNT):
        state[i] = x[i]
    return OK


@unrolled("x z k1 k2 k3 k4")
def advance_rk4(
    t: Any, end: Any, state: Any, d: Any, u: Any, c: Any, breaks: Any, coefficients: Any, hold: Any
) -> int:
    """Advance with equal steps of the classical fourth-order Runge-Kutta method."""
    steps = max(1, int(np.ceil((end - t) / hold[0][1] - 1e-9)))
    h = (end - t) / steps
    for i in range(STATE_COUNT):
        x[i] = state[i]
    for step in range(steps):
        s = t + step * h
        k1 = rate(s, x, d, u, c, breaks, coefficients)
        for i in range(STATE_COUNT):
            z[i] = x[i] + 0.5 * h * k1[i]
        k2 = rate(s + 0.5 * h, z, d, u, c, breaks, coefficients)
        for i in range(STATE_COUNT):
            z[i] = x[i] + 0.5 * h * k2[i]
        k3 = rate(s + 0.5 * h, z, d, u, c, breaks, coefficients)
        for i in range(STATE_COUNT):
            z[i] = x[i] + h * k3[i]
        k4 = rate(s + h, z, d, u, c, breaks, coefficients)
        for i in range(STATE_COUNT):
            x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
    for i in range(STATE_COUNT):
        state[i] = x[i]
    return OK


# The exact hold splits dx/dt = A x + g(t, x), with A a Jacobian met before. A step h solves the
# linear part exactly, by the functions of A h
#   phi_1 = (e^z - 1)/z, phi_2 = (phi_1 - 1)/z, phi_3 = (phi_2 - 1/2)/z,
# and takes g as a parabola through the start, the middle and the end: ETD3RK of Cox and Matthews
# (2002, J. Comput. Phys. 176), of third order, and exact while g is constant. Its difference from
# the same with a straight line is the error estimate. A step that fails tries the Jacobian at its
# start, and then halves; corners (a clip, a valve) are passed by halving. The functions of all
# halvings come from the smallest by doubling (Skaflestad and Wright 2009, Appl. Numer. Math. 59).


@jit
def multiply(left: Any, right: Any, product: Any) -> None:
    """Product of two small square matrices."""
    for i in range(STATE_COUNT):
        for j in range(STATE_COUNT):
            total = 0.0
            for k in range(STATE_COUNT):
                total += left[i, k] * right[k, j]
            product[i, j] = total


@jit
def fill_tables(a: Any, tick: float, tables: Any) -> float:
    """tables[level] = h phi_1, h phi_2, h (phi_2 - 4 phi_3) of A h, with h = tick/2^level.

    Returns the norm of A.
    """
    norm = 0.0
    for i in range(STATE_COUNT):
        row = 0.0
        for j in range(STATE_COUNT):
            row += abs(a[i, j])
        norm = max(norm, row)
    level = FINEST + 1
    while norm * tick > 0.1 * 2.0**level and level < 200:
        level += 1
    h = tick / 2.0**level
    z = np.empty((STATE_COUNT, STATE_COUNT))
    power = np.zeros((STATE_COUNT, STATE_COUNT))
    square, mixed, next_1 = np.empty_like(z), np.empty_like(z), np.empty_like(z)
    phi_1, phi_2, phi_3 = np.zeros_like(z), np.zeros_like(z), np.zeros_like(z)
    for i in range(STATE_COUNT):
        power[i, i] = 1.0
        for j in range(STATE_COUNT):
            z[i, j] = h * a[i, j]
    factorial = 1.0
    for k in range(1, 10):  # Taylor: the next term is below 0.1^9/10!
        factorial *= k
        for i in range(STATE_COUNT):
            for j in range(STATE_COUNT):
                term = power[i, j] / factorial
                phi_1[i, j] += term
                phi_2[i, j] += term / (k + 1)
                phi_3[i, j] += term / ((k + 1) * (k + 2))
        multiply(power, z, square)
        power, square = square, power
    while True:
        if level < tables.shape[0]:
            for i in range(STATE_COUNT):
                for j in range(STATE_COUNT):
                    tables[level, 0, i, j] = h * phi_1[i, j]
                    tables[level, 1, i, j] = h * phi_2[i, j]
                    tables[level, 2, i, j] = h * (phi_2[i, j] - 4.0 * phi_3[i, j])
        if level == 0:
            return norm
        multiply(phi_1, phi_1, square)
        multiply(phi_1, phi_2, mixed)
        multiply(z, square, next_1)
        for i in range(STATE_COUNT):
            for j in range(STATE_COUNT):
                phi_3[i, j] = 0.125 * (mixed[i, j] + phi_2[i, j] + 2.0 * phi_3[i, j])
                phi_2[i, j] = 0.25 * (square[i, j] + 2.0 * phi_2[i, j])
                phi_1[i, j] += 0.5 * next_1[i, j]
                z[i, j] *= 2.0
        h *= 2.0
        level -= 1


@jit
def linear_part(t: Any, x: Any, d: Any, u: Any, c: Any, hold: Any, current: int) -> int:
    """Slot of the Jacobian at ``x``; its tables are made when it is a new one.

    It stays the ``current`` one when another would not take a tenth off the remainder ``w[1]`` that
    a change ``w[0]`` of the state has left. A negative ``current`` is none.
    """
    settings, w, memory, jacobians, all_tables, norms = hold
    a = jacobians.reshape((SLOTS + 1, STATE_COUNT, STATE_COUNT))
    j = a[SLOTS]
    jacobian(t, x, d, u, c, j)
    if current >= 0:
        explained = left = 0.0
        for i in range(STATE_COUNT):
            total = 0.0
            for k in range(STATE_COUNT):
                total += (j[i, k] - a[current, i, k]) * w[0, k]
            explained += abs(total) / (1.0 + abs(x[i]))
            left += abs(w[1, i]) / (1.0 + abs(x[i]))
        if explained < 0.1 * left:
            return current
    for slot in range(memory[1]):
        same = True
        for i in range(STATE_COUNT):
            for k in range(STATE_COUNT):
                same = same and a[slot, i, k] == j[i, k]
        if same:
            return slot
    slot = memory[2] % SLOTS
    memory[2] += 1
    memory[1] = min(memory[1] + 1, SLOTS)
    for i in range(STATE_COUNT):
        for k in range(STATE_COUNT):
            a[slot, i, k] = j[i, k]
    tables = all_tables.reshape((SLOTS, FINEST + 2, 3, STATE_COUNT, STATE_COUNT))
    norms[slot] = fill_tables(a[slot], settings[0], tables[slot])
    return slot


@unrolled("x f a f_a b f_b g_a g_b weight")
def advance_exact_hold(
    t: Any, end: Any, state: Any, d: Any, u: Any, c: Any, breaks: Any, coefficients: Any, hold: Any
) -> int:
    """Advance one tick with the exponential integrator; see the comment above.

    ``hold``: settings (tick, step, tolerance, excess so far), work vectors, memory (level, slots
    filled, slots made, slot), Jacobians, their tables and their norms.
    """
    settings, w, memory, jacobians, tables, norms = hold
    tick, tolerance = settings[0], settings[2]
    full, size = 1 << FINEST, STATE_COUNT * STATE_COUNT
    level, slot, position = memory[0], memory[3], 0
    if memory[1] == 0:
        slot = linear_part(t, state, d, u, c, hold, -1)
    for i in range(STATE_COUNT):
        x[i] = state[i]
    while position < full:
        now = t + tick * (position / full)
        f = rate(now, x, d, u, c, breaks, coefficients)
        for i in range(STATE_COUNT):
            weight[i] = 1.0 / (tolerance * (1.0 + abs(x[i])))
        local = False
        while True:
            span = full >> level
            h = tick * (span / full)
            # Views of one dimension: the compiler then knows where each element is.
            j = jacobians[slot * size : (slot + 1) * size]
            at = 3 * (slot * (FINEST + 2) + level) * size
            to_end, bend, skew = tables[at:], tables[at + size :], tables[at + 2 * size :]
            to_middle = tables[at + 3 * size :]
            for i in range(STATE_COUNT):
                middle = last = 0.0
                for k in range(STATE_COUNT):
                    middle += to_middle[i * STATE_COUNT + k] * f[k]
                    last += to_end[i * STATE_COUNT + k] * f[k]
                a[i], b[i] = x[i] + middle, x[i] + last
            f_a = rate(now + 0.5 * h, a, d, u, c, breaks, coefficients)
            left = 0.0
            for i in range(STATE_COUNT):
                total = f_a[i] - f[i]
                for k in range(STATE_COUNT):
                    total -= j[i * STATE_COUNT + k] * (a[k] - x[k])
                g_a[i] = total
                left += abs(total) * weight[i]
            if not h * left < NEGLIGIBLE:
                for i in range(STATE_COUNT):
                    total = 0.0
                    for k in range(STATE_COUNT):
                        total += bend[i * STATE_COUNT + k] * g_a[k]
                    b[i] += 2.0 * total
            f_b = rate(now + h, b, d, u, c, breaks, coefficients)
            for i in range(STATE_COUNT):
                total = f_b[i] - f[i]
                for k in range(STATE_COUNT):
                    total -= j[i * STATE_COUNT + k] * (b[k] - x[k])
                g_b[i] = total
                left += abs(total) * weight[i]
            worst = 0.0
            if not h * left < NEGLIGIBLE:
                for i in range(STATE_COUNT):
                    total = 0.0
                    for k in range(STATE_COUNT):
                        total += skew[i * STATE_COUNT + k] * (2.0 * g_a[k] - g_b[k])
                    b[i] += total
                    worst += abs(total) * weight[i]
            if worst <= 1.0:
                break
            if not local and h * norms[slot] > STIFF:
                local = True
                before = slot
                for i in range(STATE_COUNT):
                    state[i], w[0, i], w[1, i] = x[i], a[i] - x[i], g_a[i]
                slot = linear_part(now, state, d, u, c, hold, slot)
                if slot != before:
                    continue
            if level == FINEST:
                settings[3] += worst * tolerance
                if not np.isfinite(worst):
                    return NOT_FINITE
                if settings[3] > MOST_EXCESS:
                    return TOO_ROUGH
                break
            level += 1
        for i in range(STATE_COUNT):
            x[i] = b[i]
        position += span
        while level > 0 and worst <= 0.05 and position % (2 * (full >> level)) == 0:
            level -= 1
            worst *= 16.0  # the estimate is of third order, and one more in a step
    for i in range(STATE_COUNT):
        state[i] = x[i]
    memory[0] = level
    memory[3] = slot
    return OK


@jit
def copy_state(x: Any, d: Any, kept_x: Any, kept_d: Any, row: int) -> int:
    """Write the state into a row of those to be kept; returns the next row."""
    for i in range(STATE_COUNT):
        kept_x[row, i] = x[i]
    for i in range(HELD_COUNT):
        kept_d[row, i] = d[i]
    return row + 1


@jit
def run(
    c: Any,
    x: Any,
    d: Any,
    breaks: Any,
    coefficients: Any,
    tick: float,
    first: int,
    last: int,
    periods: Any,
    offsets: Any,
    record_every: int,
    wanted: Any,
    columns: Any,
    hold: Any,
    record: Any,
    kept: Any,
    kept_x: Any,
    kept_d: Any,
) -> tuple[int, int, int]:
    """Run from tick ``first`` to tick ``last`` and record ``columns`` of the wanted outputs.

    Changes ``x`` and ``d``. Events at t see the states before them, as in Drake; those at ``last``
    are left to the next run. The state after the events at each of the ``kept`` ticks is kept;
    tick -1 is the start. Returns the status, the tick where the run ended, and which limit or state
    ended it.
    """
    u = np.zeros(max(INPUT_COUNT, 1))
    after, y, m = np.empty(HELD_COUNT), np.zeros(OUTPUT_COUNT), np.empty(LIMIT_COUNT)
    fires = np.zeros(periods.size, dtype=np.bool_)
    row = keep = 0
    if kept.size > 0 and kept[0] < first:
        keep = copy_state(x, d, kept_x, kept_d, 0)
    for k in range(first, last + 1):
        t = k * tick
        recording = k % record_every == 0 and row < record.shape[0]
        firing = False
        for i in range(periods.size):
            fires[i] = k < last and k >= offsets[i] and (k - offsets[i]) % periods[i] == 0
            firing = firing or fires[i]
        if recording or firing:
            if INPUT_COUNT > 0:
                evaluate_inputs(t, breaks, coefficients, u)
            for i in range(HELD_COUNT):
                after[i] = d[i]
            instant(t, x, d, u, c, fires, wanted, after, y, m)
            if recording:
                for i in range(columns.size):
                    record[row, i] = y[columns[i]]
                row += 1
            for i in range(LIMIT_COUNT):
                if not m[i] >= 0.0:
                    return OUTSIDE, k, i
            if firing:
                for i in range(HELD_COUNT):
                    d[i] = after[i]
        if keep < kept.size and kept[keep] == k:
            keep = copy_state(x, d, kept_x, kept_d, keep)
        if k < last and STATE_COUNT > 0:
            status = advance(t, (k + 1) * tick, x, d, u, c, breaks, coefficients, hold)
            for i in range(STATE_COUNT):
                if not np.isfinite(x[i]):
                    return NOT_FINITE, k + 1, i
            if status != OK:
                return status, k, 0
    return OK, last, 0


@jit
def outputs_between(
    c: Any,
    breaks: Any,
    coefficients: Any,
    tick: float,
    periods: Any,
    wanted: Any,
    columns: Any,
    hold: Any,
    kept: Any,
    kept_x: Any,
    kept_d: Any,
    times: Any,
    places: Any,
    record: Any,
) -> None:
    """Record at ``times`` (ascending), each by RK4 from the kept state at its place."""
    u = np.zeros(max(INPUT_COUNT, 1))
    after, y, m = np.empty(HELD_COUNT), np.zeros(OUTPUT_COUNT), np.empty(LIMIT_COUNT)
    fires = np.zeros(periods.size, dtype=np.bool_)
    x, place, now = np.empty(STATE_COUNT), -1, 0.0
    for row in range(times.size):
        if places[row] != place:
            place = places[row]
            for i in range(STATE_COUNT):
                x[i] = kept_x[place, i]
            now = max(kept[place], 0) * tick
        d, t = kept_d[place], times[row]
        if t > now and STATE_COUNT > 0:
            advance_rk4(now, t, x, d, u, c, breaks, coefficients, hold)
            now = t
        if INPUT_COUNT > 0:
            evaluate_inputs(t, breaks, coefficients, u)
        for i in range(HELD_COUNT):
            after[i] = d[i]
        instant(t, x, d, u, c, fires, wanted, after, y, m)
        for i in range(columns.size):
            record[row, i] = y[columns[i]]
