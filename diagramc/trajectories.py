"""Makes input tables from Drake's trajectories, and combines several tables in one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from pydrake.trajectories import PiecewisePolynomial

from .run_data import Array, InputTable


def input_table(
    trajectory: Any, derivatives: int = 0, *, zero_derivatives_beyond_limits: bool = True
) -> InputTable:
    """Return a table with the outputs of Drake's ``TrajectorySource(trajectory, derivatives)``.

    Parameters
    ----------
    trajectory
        A PiecewisePolynomial with one column. Before the first time of the trajectory the inputs
        have its first values, and after the last time its last values.
    derivatives
        Number of time derivatives that follow the value. The table has ``1 + derivatives`` inputs
        for each row of the trajectory.
    zero_derivatives_beyond_limits
        If True, the derivatives are zero before the start and after the end. If False, the
        derivatives keep their values at the start and at the end.

    Raises
    ------
    ValueError
        The trajectory is of another kind or has several columns, or ``derivatives`` is negative.
    """
    if not isinstance(trajectory, PiecewisePolynomial):
        raise ValueError(
            f"trajectory: is a {type(trajectory).__name__}; must be a PiecewisePolynomial, for "
            f"instance PiecewisePolynomial.CubicShapePreserving of its samples"
        )
    if trajectory.cols() != 1:
        raise ValueError(f"trajectory: has {trajectory.cols()} columns; must have 1")
    if derivatives < 0:
        raise ValueError(f"derivatives = {derivatives}: must be >= 0")
    signals = [trajectory.derivative(order) for order in range(derivatives + 1)]
    times = np.array(trajectory.get_segment_times())
    if not np.isfinite(times).all():  # a constant, without start and end
        value = np.concatenate([signal.value(0.0)[:, 0] for signal in signals])
        return InputTable(coefficients=value[None, :, None])
    rows = trajectory.rows()
    coefficient_count = 1 + max(
        trajectory.getSegmentPolynomialDegree(segment, row)
        for segment in range(times.size - 1)
        for row in range(rows)
    )
    # Segment 0 of the table lies before the first time, and the last segment after the last time.
    table = np.zeros((times.size + 1, rows * len(signals), coefficient_count))
    for order, signal in enumerate(signals):
        first = order * rows
        if order == 0 or not zero_derivatives_beyond_limits:
            for segment, time in ((0, times[0]), (-1, times[-1])):
                table[segment, first : first + rows, 0] = signal.value(time)[:, 0]
        for segment in range(times.size - 1):
            for row in range(rows):
                coefficients = signal.getPolynomial(segment, row, 0).GetCoefficients()
                table[segment + 1, first + row, : coefficients.size] = coefficients
    return InputTable(times, table)


def stack_tables(*tables: InputTable) -> InputTable:
    """Return one table with the inputs of several tables, in the order of the tables.

    The result has the breaks of all tables. A segment of a table can become several segments, each
    with powers of the time since its own beginning.
    """
    breaks = np.unique(np.concatenate([_breaks(table) for table in tables]))
    input_count = sum(table.coefficients.shape[1] for table in tables)
    coefficient_count = max(table.coefficients.shape[2] for table in tables)
    stacked = np.zeros((breaks.size + 1, input_count, coefficient_count))
    for segment in range(breaks.size + 1):
        start = breaks[segment - 1] if segment else -np.inf
        row = 0
        for table in tables:
            old_segment = int(np.searchsorted(_breaks(table), start, side="right"))
            shift = 0.0  # the first segments have powers of t
            if segment:
                shift = start - (table.breaks[old_segment - 1] if old_segment else 0.0)
            for coefficients in table.coefficients[old_segment]:
                shifted = Polynomial(coefficients)(Polynomial([shift, 1.0])).coef
                stacked[segment, row, : shifted.size] = shifted
                row += 1
    return InputTable(breaks, stacked)


def _breaks(table: InputTable) -> Array:
    """Return the breaks of a table in s. If there are several, the last is one bit later.

    `stack_tables` begins a new segment at each break. In an `InputTable` the last of several breaks
    still belongs to the segment before, so the new segment must begin one bit later.
    """
    breaks = table.breaks.copy()
    if breaks.size > 1:
        breaks[-1] = np.nextafter(breaks[-1], np.inf)
    return breaks
