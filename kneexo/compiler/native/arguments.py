"""Arguments and results of the machine code: what the time loop reads and the runner fills in."""

from __future__ import annotations

INTEGRATORS = ("exact_hold", "rk4", "runge_kutta3")
"""Time integrators of every compiled model."""

OK, NOT_FINITE, OUTSIDE, TOO_ROUGH, OUTPUT_NOT_FINITE = range(5)
"""Outcomes of a run.

`OK`: the run reached its end. `NOT_FINITE`: a state is not finite. `OUTSIDE`: a margin is below
zero. `TOO_ROUGH`: the exact hold cannot hold its tolerance. `OUTPUT_NOT_FINITE`: a recorded output
is not finite.
"""

MEMO_LINES = 4096
"""Rows of a table of whole-number functions, a power of two: all counts of a 12-bit encoder."""

RUN = (
    *("c", "lane_c", "x", "d", "inputs", "tick", "unit", "split", "first", "last", "longest"),
    *("periods", "offsets", "record_every", "row", "rows", "requested", "columns"),
    *("column_count", "record"),
    *("step", "tolerance", "memory", "shared", "tags", "values", "status"),
    *("snapshots", "snapshot_count", "snapshot_x", "snapshot_d"),
)
"""Arguments of ``run``, each in eight bytes: a number, or the address of an array.

- ``c`` (constants, lanes) and ``lane_c`` (lanes, constants): values that depend on parameters alone
- ``x`` (states, lanes), ``d`` (discrete states, lanes): the state, in and out
- ``inputs`` (lanes, `INPUT`)
- ``tick`` and ``unit`` in s; a unit has ``split`` ticks: see `Timing`
- ``first``: number of the first tick; ``last`` (lanes,): number of the last one; ``longest``: the
  largest of ``last``
- ``periods``, ``offsets`` (updates,) in ticks
- ``record_every``: ticks between two records; ``row``: row of the first record
- ``requested`` (output ports,) bytes: whether a port is recorded; ``columns`` (column_count,):
  numbers of the recorded elements among the elements of all outputs
- ``record`` (lanes, column_count, rows)
- ``step`` in s and ``tolerance`` of the integrator; ``memory`` and ``shared`` of the exact hold
- ``tags``, ``values``: tables of whole-number functions
- ``status`` (lanes, 3): outcome, tick, index of the limit
- ``snapshots`` (snapshot_count,): ticks whose states, after the events, are written to
  ``snapshot_x`` (snapshot_count, states) and ``snapshot_d``; with a single lane only
"""

BETWEEN = (
    *("c", "inputs", "tick", "unit", "split", "requested", "columns", "column_count", "record"),
    *("rows", "step", "snapshots", "snapshot_x", "snapshot_d", "times", "places"),
)
"""Arguments of ``between``: those of ``run``, and ``times`` (rows,) in s of the records with the
``places`` (rows,) of the snapshots that they start from."""

DOUBLES = ("tick", "unit", "step", "tolerance")
"""The arguments of both that are doubles; the others are integers or addresses."""

INPUT = ("break_count", "breaks", "powers", "coefficients")
"""An `InputTable`: two numbers and two addresses of arrays, each in eight bytes."""
