"""Emits a step of the explicit Runge-Kutta method of Dormand and Prince.

The method has seven stages and order five (Dormand and Prince 1980, J. Comput. Appl. Math. 6). Its
error estimate is the difference from a formula of order four. The last stage is dx/dt at the end of
the step, so the next step begins with it.
"""

from __future__ import annotations

from .integrators import Tick, before_end
from .ir import Array, Function, Value
from .types import INT

_NODES = (1 / 5, 3 / 10, 4 / 5, 8 / 9)
_STAGES = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
_ERROR = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)
_ROW = 8  # number of elements in a row of the emitted table of coefficients


class DormandPrince:
    """Emits steps of the method."""

    def __init__(self, f: Function) -> None:
        """Emit code that stores the coefficients of the stages in local memory of ``f``."""
        self._table = f.array(_ROW * len(_STAGES))
        for number, row in enumerate(_STAGES):
            node = [*_NODES, 1.0, 1.0][number]
            for place, value in enumerate((*row, *[0.0] * (_ROW - 1 - len(row)), node)):
                self._table[_ROW * number + place] = value

    def step(
        self, tick: Tick, time: Value, h: Value, after: Value, slope: Array
    ) -> tuple[Array, Array, Array]:
        """Emit one step from the states ``tick.x`` at ``time`` to ``after``, ``h`` s later.

        ``slope``: dx/dt at the start. Returns the states at the end, dx/dt there, and the error
        estimate of each state.
        """
        f, size = tick.function, tick.size
        end, error = tick.vector(), tick.vector()
        slopes = f.array((len(_STAGES) + 1) * size, tick.type)
        for i in f.each(size):
            slopes[i] = slope[i]
        for stage in f.loop(len(_STAGES)):  # in a loop, so that the derivatives are emitted once
            number = f.coerce(stage, INT)
            row = self._table.shifted(number * _ROW)
            for i in f.each(size):
                end[i] = 0.0
            for before in f.loop(number + 1):
                factor = f.coerce(row[before], tick.type)
                earlier = slopes.shifted(f.coerce(before, INT) * size)
                for i in f.each(size):
                    end[i] = f.fma(factor, earlier[i], end[i])
            tick.along(end, (h, end))
            now = before_end(tick, f.fma(h, f.coerce(row[_ROW - 1], tick.type), time))
            now = f.select(number.equals(len(_STAGES) - 1), after, now)
            tick.rate(now, end, slopes.shifted((number + 1) * size))
        for i in f.each(size):
            total = f.constant(0.0, tick.type)
            for at, share in enumerate(_ERROR):
                if share:
                    total = f.fma(slopes[f.coerce(i, INT) + at * size], share, total)
            error[i] = h * total
        return end, slopes.shifted(len(_STAGES) * size), error
