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
FINEST = SLOTS = 0


def jit(function: Any) -> Any:
    """Stand-in for numba's decorator."""
    return function


inner = inline = jit
"""The same for functions that Python does not call, and for those called in the inner loops:
passing ten arrays costs more than they do."""


def unrolled(vectors: str) -> Any:
    """Mark of functions that `unroll` writes out, with the names of their vectors of states."""
    return jit


x = f = a = f_a = b = f_b = g_a = g_b = weight = z = k1 = k2 = k3 = k4 = [0.0]  # such vectors


def derivatives(t: Any, x: Any, d: Any, u: Any, c: Any) -> Any:
    """Stand-in: elements of dx/dt; ``x`` too is passed element by element."""


def jacobian(t: Any, x: Any, d: Any, u: Any, c: Any, j: Any) -> None:
    """Stand-in: j = df/dx, row by row."""


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
    """Stand-in for that of `linear_parts`."""
    return 0


def instant(
    t: Any, x: Any, d: Any, u: Any, c: Any, fires: Any, wanted: Any, after: Any, y: Any, m: Any
) -> None:
    """Stand-in: discrete states ``after`` the updates that fire, wanted outputs, margins."""


def advance(
    t: Any,
    end: Any,
    x: Any,
    d: Any,
    u: Any,
    c: Any,
    breaks: Any,
    coefficients: Any,
    settings: Any,
    w: Any,
    memory: Any,
    jacobians: Any,
    tables: Any,
    norms: Any,
) -> int:
    """Stand-in for one of the integrators below: advance ``x`` from ``t`` to ``end``."""
    return 0


# ----- copied into each generated module from here on -----

NEGLIGIBLE = 0.01  # share of the tolerance that is not worth a correction
STIFF = 0.5  # norm of A h below which the choice of A does not matter
INDEX = (1 << 40) - 1  # bits of an index
MOST_EXCESS = 1e-2  # sum of the errors of its finest steps that miss the tolerance

OK, NOT_FINITE, OUTSIDE, TOO_ROUGH = range(4)


@inline
def evaluate_inputs(t: Any, breaks: Any, coefficients: Any, u: Any) -> None:
    """Evaluate the inputs at ``t``: polynomials in the time since the last of ``breaks``.

    ``coefficients[segment, input, power]``; the first segment ends and the last one starts at a
    break, where a value belongs to the segment on its right; at the last of several breaks, the end
    of a spline, to that on its left.
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
    t: Any,
    end: Any,
    state: Any,
    d: Any,
    u: Any,
    c: Any,
    breaks: Any,
    coefficients: Any,
    settings: Any,
    w: Any,
    memory: Any,
    jacobians: Any,
    tables: Any,
    norms: Any,
) -> int:
    """Advance with the fixed steps of Drake's RungeKutta3Integrator, which may stretch by 1 %."""
    step = settings[1]
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
    t: Any,
    end: Any,
    state: Any,
    d: Any,
    u: Any,
    c: Any,
    breaks: Any,
    coefficients: Any,
    settings: Any,
    w: Any,
    memory: Any,
    jacobians: Any,
    tables: Any,
    norms: Any,
) -> int:
    """Advance with equal steps of the classical fourth-order Runge-Kutta method."""
    steps = max(1, int(np.ceil((end - t) / settings[1] - 1e-9)))
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
# start, and then halves; corners (a clip, a valve) are passed by halving. `linear_parts` keeps A
# and its functions.


@unrolled("x f a f_a b f_b g_a g_b weight")
def advance_exact_hold(
    t: Any,
    end: Any,
    state: Any,
    d: Any,
    u: Any,
    c: Any,
    breaks: Any,
    coefficients: Any,
    settings: Any,
    w: Any,
    memory: Any,
    jacobians: Any,
    tables: Any,
    norms: Any,
) -> int:
    """Advance one tick with the exponential integrator; see the comment above.

    ``settings``: tick, step, tolerance, excess so far; ``memory``: level, slots filled, slots made,
    slot; work vectors, Jacobians, their tables and their norms. They are not a tuple because
    numba counts references to what it unpacks, at every tick.
    """
    tick, tolerance = settings[0], settings[2]
    full, size = 1 << FINEST, STATE_COUNT * STATE_COUNT
    level, slot, position = memory[0], memory[3], 0
    if memory[1] == 0:
        jacobian(t, state, d, u, c, jacobians[SLOTS * size :])
        slot = choose_slot(state, settings, w, memory, jacobians, tables, norms, slot)
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
            # No views, which count references; the mask says that no index is negative.
            of = (slot * size) & INDEX
            at = (3 * (slot * (FINEST + 2) + level) * size) & INDEX
            for i in range(STATE_COUNT):
                middle = last = 0.0
                for k in range(STATE_COUNT):
                    middle += tables[at + ((3 * STATE_COUNT + i) * STATE_COUNT + k)] * f[k]
                    last += tables[at + (i * STATE_COUNT + k)] * f[k]
                a[i], b[i] = x[i] + middle, x[i] + last
            f_a = rate(now + 0.5 * h, a, d, u, c, breaks, coefficients)
            left = 0.0
            for i in range(STATE_COUNT):
                total = f_a[i] - f[i]
                for k in range(STATE_COUNT):
                    total -= jacobians[of + (i * STATE_COUNT + k)] * (a[k] - x[k])
                g_a[i] = total
                left += abs(total) * weight[i]
            if not h * left < NEGLIGIBLE:
                for i in range(STATE_COUNT):
                    total = 0.0
                    for k in range(STATE_COUNT):
                        total += tables[at + ((STATE_COUNT + i) * STATE_COUNT + k)] * g_a[k]
                    b[i] += 2.0 * total
            f_b = rate(now + h, b, d, u, c, breaks, coefficients)
            for i in range(STATE_COUNT):
                total = f_b[i] - f[i]
                for k in range(STATE_COUNT):
                    total -= jacobians[of + (i * STATE_COUNT + k)] * (b[k] - x[k])
                g_b[i] = total
                left += abs(total) * weight[i]
            worst = 0.0
            if not h * left < NEGLIGIBLE:
                for i in range(STATE_COUNT):
                    total = 0.0
                    for k in range(STATE_COUNT):
                        total += tables[
                            at + (2 * STATE_COUNT * STATE_COUNT + i * STATE_COUNT + k)
                        ] * (2.0 * g_a[k] - g_b[k])
                    b[i] += total
                    worst += abs(total) * weight[i]
            if worst <= 1.0:
                break
            if not local and h * norms[slot] > STIFF:
                local = True
                before = slot
                for i in range(STATE_COUNT):
                    state[i], w[0, i], w[1, i] = x[i], a[i] - x[i], g_a[i]
                jacobian(now, state, d, u, c, jacobians[SLOTS * size :])
                slot = choose_slot(state, settings, w, memory, jacobians, tables, norms, slot)
                if slot != before:
                    continue
            if level == FINEST:
                settings[3] += worst * tolerance
                if not np.isfinite(worst):
                    for i in range(STATE_COUNT):
                        state[i] = b[i]
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


@inner
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
    settings: Any,
    w: Any,
    memory: Any,
    jacobians: Any,
    tables: Any,
    norms: Any,
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
        keep = copy_state(x, d, kept_x, kept_d, keep)
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
            status = advance(
                t,
                (k + 1) * tick,
                x,
                d,
                u,
                c,
                breaks,
                coefficients,
                settings,
                w,
                memory,
                jacobians,
                tables,
                norms,
            )
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
    settings: Any,
    w: Any,
    memory: Any,
    jacobians: Any,
    tables: Any,
    norms: Any,
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
            advance_rk4(
                now,
                t,
                x,
                d,
                u,
                c,
                breaks,
                coefficients,
                settings,
                w,
                memory,
                jacobians,
                tables,
                norms,
            )
            now = t
        if INPUT_COUNT > 0:
            evaluate_inputs(t, breaks, coefficients, u)
        for i in range(HELD_COUNT):
            after[i] = d[i]
        instant(t, x, d, u, c, fires, wanted, after, y, m)
        for i in range(columns.size):
            record[row, i] = y[columns[i]]
