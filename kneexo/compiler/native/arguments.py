"""Names and order of the arguments and results that the runner and the machine code exchange."""

from __future__ import annotations

INTEGRATORS = ("exact_hold", "rk4", "runge_kutta3")
"""Names of the time integrators that every compiled model offers."""

OK, NOT_FINITE, OUTSIDE, TOO_ROUGH, OUTPUT_NOT_FINITE = range(5)
"""Outcomes of a run.

`OK`: the run reached its end. `NOT_FINITE`: a state is not finite. `OUTSIDE`: the margin of a leaf
system, its distance from a limit, is below zero. `TOO_ROUGH`: the integrator ``exact_hold`` cannot
hold its tolerance. `OUTPUT_NOT_FINITE`: a recorded output is not finite.
"""

MEMO_LINES = 4096
"""Number of rows in a look-up table of functions of one whole number; must be a power of two.

The number is that of the counts of a 12-bit encoder, 4096.
"""

RUN = (
    *("c", "lane_c", "x", "d", "inputs", "tick", "unit", "split", "first", "last", "longest"),
    *("periods", "offsets", "record_every", "row", "rows", "requested", "columns"),
    *("column_count", "record"),
    *("step", "tolerance", "memory", "shared", "tags", "values", "status"),
    *("snapshots", "snapshot_count", "snapshot_x", "snapshot_d"),
)
"""Arguments of the machine code's function ``run``, which makes one run in each lane.

Each argument has eight bytes: a number, or the address of an array.

- ``c`` (constants, lanes) and ``lane_c`` (lanes, constants): values that depend on parameters alone
- ``x`` (states, lanes), ``d`` (discrete states, lanes): the states at the start, then at the end
- ``inputs`` (lanes, 4): the open inputs of each lane, as `INPUT` lists them
- ``tick`` and ``unit`` in s; a unit has ``split`` ticks: see `Timing`
- ``first``: number of the first tick; ``last`` (lanes,): number of the last one; ``longest``: the
  largest of ``last``
- ``periods``, ``offsets`` (updates,) of the discrete updates in ticks
- ``record_every``: ticks between two records; ``row``: row of the first record
- ``requested`` (output ports,) bytes: whether a port is recorded; ``columns`` (column_count,):
  numbers of the recorded elements among the elements of all outputs
- ``record`` (lanes, column_count, ``rows``): memory for the records
- ``step`` in s and ``tolerance`` of the integrator; ``memory`` and ``shared`` of the exact hold
- ``tags``, ``values``: arguments and values in the look-up tables of whole-number functions
- ``status`` (lanes, 3), out: outcome, tick of the end, index of the limit that was passed
- ``snapshots`` (snapshot_count,): ticks whose states, after the events, are written to
  ``snapshot_x`` (snapshot_count, states) and ``snapshot_d``; with a single lane only
"""

BETWEEN = (
    *("c", "inputs", "tick", "unit", "split", "requested", "columns", "column_count", "record"),
    *("rows", "step", "snapshots", "snapshot_x", "snapshot_d", "times", "places"),
)
"""Arguments of the machine code's function ``between``, which makes records between two ticks.

They mean the same as those of ``run``. In addition ``times`` (rows,) are the times of the records
in s, and ``places`` (rows,) the indices of the snapshots from which the integration starts.
"""

DOUBLES = ("tick", "unit", "step", "tolerance")
"""Those arguments of the machine code that are doubles; all others are integers or addresses."""

INPUT = ("break_count", "breaks", "powers", "coefficients")
"""How the machine code gets an `InputTable`: two numbers and the addresses of two arrays.

Each has eight bytes. ``powers`` is the number of powers in a polynomial.
"""
