"""Names and order of the arguments and results that the runner and the machine code exchange."""

from __future__ import annotations

INTEGRATORS = ("exact_hold", "rk4", "runge_kutta3", "rosenbrock")
"""Names of the time integrators that every compiled model offers."""

OK, NOT_FINITE, OUTSIDE, TOO_ROUGH, OUTPUT_NOT_FINITE, TOO_MANY_SUBSTEPS = range(6)
"""Outcomes of a run.

`OK`: the run reached its end. `NOT_FINITE`: a state is not finite. `OUTSIDE`: the margin of a leaf
system, its distance from a limit, is below zero. `TOO_ROUGH`: the integrator ``exact_hold`` cannot
hold its tolerance (index 0), or a mode is too fast for it (index 1). `OUTPUT_NOT_FINITE`: a
recorded output is not finite. `TOO_MANY_SUBSTEPS`: the substeps of the integrator ``rosenbrock`` do
not reach the end of a tick.
"""

MEMO_LINES = 4096
"""Number of rows of each look-up table for functions of one whole number; a power of two.

A 12-bit encoder has 4096 counts.
"""

RUN = (
    *("c", "lane_c", "x", "d", "inputs", "tick", "unit", "split", "first", "last", "longest"),
    *("periods", "offsets", "record_every", "row", "rows", "requested", "columns"),
    *("column_count", "record"),
    *("step", "tolerance", "memory", "shared", "tags", "values", "status"),
    *("snapshots", "snapshot_count", "snapshot_x", "snapshot_d"),
    *("checked_count", "reductions", "reduction_ends", "unseen", "begins", "bounds", "reduced"),
    *("windows", "suspects", "begins_of_lanes", "times", "time_ticks", "steps"),
)
"""Arguments of the machine code's function ``run``, which makes one run in each lane.

Each argument has eight bytes: a number, or the address of an array.

- ``c`` (constants, lanes) and ``lane_c`` (lanes, constants): values that depend on parameters alone
- ``x`` (states, lanes), ``d`` (discrete states, lanes): states; the call replaces the states at the
  start by the states at the end
- ``inputs`` (lanes, 4): the open inputs of each lane, as `INPUT` lists them
- ``tick`` and ``unit`` in s; a unit has ``split`` ticks: see `Timing`
- ``first``: number of the first tick; ``last`` (lanes,): number of each lane's last tick;
  ``longest``: the largest element of ``last``
- ``periods``, ``offsets`` (updates,) of the discrete updates in ticks
- ``record_every``: ticks between two records; ``row``: row of the first record
- ``requested`` (output ports,) bytes: 1 if a port is recorded or reduced, else 0
- ``columns`` (checked_count,): indices among the elements of all outputs: first ``column_count``
  indices of recorded elements, then the indices of elements that are reduced alone
- ``record`` (lanes, column_count, ``rows``): memory for the records
- ``step`` in s and ``tolerance`` of the integrator; ``memory`` and ``shared`` of the exact hold;
  the integrator ``rosenbrock`` has the length of each lane's next substep in ``shared``
- ``tags``, ``values``: look-up tables for functions of one whole number; ``tags`` has the whole
  number of each row, ``values`` the values of the functions
- ``status`` (lanes, 3): the call writes the outcome, the tick at which the run failed, and the
  index of the limit that was passed, of the output element that is not finite, or of the state that
  changes too fast
- ``snapshots`` (snapshot_count,): ticks whose states, after the events, are written to
  ``snapshot_x`` (snapshot_count, states) and ``snapshot_d``; with a single lane only
- ``reductions``, ``reduction_ends``, ``begins``, ``bounds``, ``reduced``: arrays of `Reducer`;
  ``unseen``: first row whose samples no earlier call has reduced, or a row that no run reaches if
  there are no reductions
- ``suspects`` (lanes, `SUSPECTS`, 4 + states + discrete states + inputs): for each window of time
  a tick in which a Runge-Kutta integrator may be unstable: ratio of its rates, start and end in s,
  length of a step in s, states and inputs; the ratio is zero if there is none. ``windows``
  (lanes,): length of a window in ticks
- ``begins_of_lanes`` (lanes,): tick at which each lane begins; a lane waits until then. -1 stands
  for a run from t = 0, which reduces its record at tick 0 too
- ``times`` (rows,): times in s of the records, if the code records at given times; ``time_ticks``
  (rows,): the last tick before each time, or -1; ``steps`` (rows in one tick, 2 + 2 states, lanes):
  memory for the step that contains each time of a tick
"""

DOUBLES = ("tick", "unit", "step", "tolerance")
"""Names of the arguments that are doubles; all other arguments are integers or addresses."""

SUSPECTS = 32
"""Number of windows of time, of equal length, for the log of steps that may be unstable.

The log keeps one step of each window of a run.
"""

INPUT = ("break_count", "breaks", "powers", "coefficients")
"""Names of the four items, of eight bytes each, that pass an `InputTable` to the machine code.

``break_count`` is the number of breaks, and ``powers`` the number of coefficients of a polynomial.
``breaks`` and ``coefficients`` are the addresses of the arrays with the same names.
"""
