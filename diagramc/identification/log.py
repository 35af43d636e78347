"""Logs of a machine and the unknowns of its model: checked, and cut into segments at holes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from ..arguments import positive
from ..errors import ParameterError, shown
from ..run_data import Array, InputTable

HOLE = 10.0
"""Longest gap between two rows of a segment in sample times. The held command bridges it."""
FEWEST = 20
"""Least number of rows of a segment; fewer have no statistics of residuals."""


@dataclass(frozen=True)
class Unknown:
    """A number to be found in a range. In a range above zero the search is in its logarithm."""

    name: str
    """Parameter or state of the model, or ``OUTPUT.delay_s``, ``OUTPUT.gain``, ``OUTPUT.bias``."""
    low: float
    high: float
    start: float | None = None
    """Value at which the search begins; None: the middle of the range, or of its logarithm."""
    unit: str = ""
    """Unit for the table."""

    def __post_init__(self) -> None:
        """Raise `ParameterError` if the range is empty or not finite, or the start outside."""
        if not -math.inf < self.low < self.high < math.inf:
            raise ParameterError(
                f"{self.name}: low = {self.low:g} and high = {self.high:g} must be finite, and "
                f"low < high"
            )
        if self.start is not None and not self.low <= self.start <= self.high:
            raise ParameterError(
                f"{self.name}: start = {self.start:g} must be within {self.low:g} … {self.high:g}"
            )

    @property
    def logarithmic(self) -> bool:
        """Whether the search is in the logarithm of the number."""
        return self.low > 0.0

    @property
    def begin(self) -> float:
        """Place of the start in the range."""
        return 0.5 if self.start is None else self.place(self.start)

    def value(self, place: float) -> float:
        """Return the number at a place in the range: 0 is ``low``, 1 is ``high``."""
        if self.logarithmic:
            return float(self.low * (self.high / self.low) ** place)
        return float(self.low + place * (self.high - self.low))

    def place(self, value: float) -> float:
        """Return the place of a number in the range, the inverse of `value`."""
        if self.logarithmic:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def slope(self, value: float) -> float:
        """Return the derivative of `value` by the place, where the number is ``value``."""
        if self.logarithmic:
            return value * math.log(self.high / self.low)
        return self.high - self.low


@dataclass(frozen=True)
class Log:
    """What a machine logged. The stamps are never resampled: the model runs to each of them.

    ``time_s`` (n,) has the stamps in s. They ascend, and may jitter. They count from a sample of
    the machine: the machine takes its sample k at k·``sample_time_s``.

    ``measured`` maps an element of an output, ``name[index]`` or ``name`` of a port with a single
    element, to its values (n,). A value nan is missing.

    ``inputs`` maps each open input port to its values (n,) or (n, size). The value of a row holds
    from the machine's sample next to the row's stamp up to the sample of the next row, so the
    jitter of the stamps does not move the steps of a command. Or it is an `InputTable`.
    """

    time_s: Array
    measured: Mapping[str, Array]
    sample_time_s: float
    inputs: Mapping[str, Array] | InputTable = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise `ParameterError` for columns that are not numbers of one length, or for times."""
        given = {} if isinstance(self.inputs, InputTable) else self.inputs
        for name, values in {"time_s": self.time_s, **self.measured, **given}.items():
            column = np.asarray(values, dtype=float)
            if column.shape[:1] != np.shape(self.time_s):
                raise ParameterError(
                    f"log: {shown(name)} has the shape {column.shape} for {len(self.time_s)} times"
                )
            if np.isnan(column).all() or (name not in self.measured and np.isnan(column).any()):
                row = int(np.argmax(np.isnan(column)))
                raise ParameterError(f"log: {shown(name)} is nan from row {row} on")
        back = np.diff(self.time_s) <= 0.0
        if back.any():
            row = int(np.argmax(back)) + 1
            raise ParameterError(
                f"log: time goes back or stands at row {row}, {self.time_s[row]:g} s"
            )
        positive("log: sample_time_s", self.sample_time_s, "s")

    def samples(self) -> NDArray[np.int64]:
        """Return the number of the machine's sample next to each stamp, (n,)."""
        return np.rint(np.asarray(self.time_s) / self.sample_time_s).astype(np.int64)

    def table(self, inputs: Mapping[str, int]) -> InputTable:
        """Return the input table of the log, in the log's time.

        ``inputs`` has the number of elements of each open input port. Raises `ParameterError` for a
        port without a column, or for two rows of one sample.
        """
        if isinstance(self.inputs, InputTable):
            return self.inputs
        if set(self.inputs) != set(inputs):
            names = ", ".join(inputs) or "none"
            raise ParameterError(f"log: inputs must be those of the model: {names}")
        samples = self.samples()
        if not np.diff(samples).all():
            row = int(np.argmin(np.diff(samples)))
            raise ParameterError(
                f"log: rows {row} and {row + 1} are of one sample of {self.sample_time_s:g} s; "
                f"give an InputTable"
            )
        columns = [np.zeros((samples.size, int(not inputs)))]  # a table has at least one input
        for name, size in inputs.items():
            columns.append(np.reshape(self.inputs[name], (samples.size, -1)))
            if columns[-1].shape[1] != size:
                raise ParameterError(f"log: {name} has another size than the model's {size}")
        held: Array = np.concatenate(columns, axis=1)[:, :, None]
        return InputTable(np.multiply(samples[1:], self.sample_time_s), held)


@dataclass(frozen=True)
class Segment:
    """Rows of a log without a hole. The model runs from ``start_s`` of the log on."""

    log: Log
    label: str
    """Text behind the name of an initial state, empty for the only segment."""
    start_s: float
    time_s: Array
    """Times of the compared rows since the start, (n,)."""
    measured: Array
    """Values of the compared rows, (n, elements)."""
    trained: NDArray[np.bool_]
    """Whether a row takes part in the fit, (n,)."""


def segments_of(
    logs: Sequence[Log], elements: Sequence[str], longest_delay_s: float, validation: float
) -> list[Segment]:
    """Cut logs at their holes. The last share ``validation`` of each segment is not trained.

    Rows up to ``longest_delay_s`` after a start are left out: what a delayed sensor shows there
    happened before the start.
    """
    segments = []
    for number, log in enumerate(logs, 1):
        time = np.asarray(log.time_s, dtype=float)
        unknown = np.full(time.size, np.nan)
        measured = np.stack([log.measured.get(name, unknown) for name in elements], axis=1)
        holes = np.flatnonzero(np.diff(time) > HOLE * log.sample_time_s) + 1
        pieces = np.split(np.arange(time.size), holes)
        for index, rows in enumerate(pieces, 1):
            start = float(log.samples()[rows[0]] * log.sample_time_s)
            rows = rows[time[rows] - start >= max(longest_delay_s, 0.0)]
            label = f" (log {number}, segment {index})" * (len(logs) * len(pieces) > 1)
            if rows.size < FEWEST:
                raise ParameterError(
                    f"log{label}: has {rows.size} rows from {start:g} s; must have {FEWEST}"
                )
            trained = np.arange(rows.size) < round((1.0 - validation) * rows.size)
            segments.append(Segment(log, label, start, time[rows] - start, measured[rows], trained))
    return segments


def table_from(table: InputTable, start_s: float) -> InputTable:
    """Return a table whose time begins at ``start_s`` of the given table."""
    if start_s == 0.0:
        return table
    first = int(np.searchsorted(table.breaks, start_s, side="right"))
    coefficients = table.coefficients[first:].copy()
    shift = start_s - (table.breaks[first - 1] if first else 0.0)
    for row in coefficients[0]:
        shifted = Polynomial(row)(Polynomial([shift, 1.0])).coef
        row[:] = 0.0
        row[: shifted.size] = shifted
    return InputTable(table.breaks[first:] - start_s, coefficients)
