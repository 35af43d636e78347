"""The result of one run of the compiled engine or of Drake's Simulator."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kneexo.common.result import Array, Result, data_frame
from kneexo.diagrams.signals import SIGNALS
from kneexo.errors import ResultError, close_names, question
from kneexo.parameters import SimulationParameters


@dataclass(frozen=True, repr=False)
class Run(Result):
    """Logged signals of one run: ``time_s`` (n,) and ``data`` by column name, each (n,).

    The logged output of a controller at time t is the value that was held until the update at t. So
    row n has the motor speed command that belongs to the measurement of row n − 1, or n − 1 − k
    with a bus of k samples latency.

    ``settings`` names the solver of this run. If the run was repeated, ``settings`` is the solver
    of the last attempt. All values are finite. ``reduced`` has the values of the reductions of a
    `RunRequest`.
    """

    time_s: Array
    data: dict[str, Array]
    settings: SimulationParameters
    reduced: Array = field(default_factory=lambda: np.empty(0), repr=False)

    def __getitem__(self, column: str) -> Array:
        """Return the values of a column by its name, (n,): ``time_s`` or a column of ``data``.

        Raises `ResultError` if the run has no such column.
        """
        if column in self.columns:
            return self.columns[column]
        if any(column in names for names in SIGNALS.values()):
            raise ResultError(
                f"column {column!r}: the run has not logged it; add all_signals=True to track, or "
                f"its signal to the signals of simulate"
            )
        advice = question(close_names(str(column), sorted(self.columns, key=len)))
        advice = advice or f"; the run has {', '.join(self.columns)}"
        raise ResultError(f"column {column!r} is unknown{advice}")

    @property
    def columns(self) -> dict[str, Array]:
        """Dictionary of ``time_s`` and all columns of ``data``."""
        return {"time_s": self.time_s, **self.data}

    def to_dataframe(self) -> Any:
        """Return ``data`` as a `pandas.DataFrame` with the index ``time_s``.

        Raises `PackageError` without pandas.
        """
        return data_frame(self.columns, "time_s")
