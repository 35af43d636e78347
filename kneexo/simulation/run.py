"""The result of one simulation, by either engine."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kneexo.errors import SimulationError
from kneexo.parameters import SimulationParameters
from kneexo.result import Result, data_frame

Array = NDArray[np.float64]
"""An array of doubles."""


@dataclass(frozen=True, repr=False)
class Run(Result):
    """Logged signals of one simulation: ``time_s`` (n,) and ``data`` by column name, each (n,).

    A command at time t is the one held up to t. ``settings`` are those of the solver. Raises
    `SimulationError` for a value that is not finite, with its time and column.
    """

    time_s: Array
    data: dict[str, Array]
    settings: SimulationParameters

    def __post_init__(self) -> None:
        """Refuse a value that is not finite, whichever engine it comes from."""
        with np.errstate(all="ignore"):
            # A sum takes a tenth of the time, and is finite only where all values are.
            suspects = [name for name in self.data if not math.isfinite(self.data[name].sum())]
        bad = {name: np.flatnonzero(~np.isfinite(self.data[name])) for name in suspects}
        faults = [(rows[0], name) for name, rows in bad.items() if rows.size]
        if faults:
            row, name = min(faults, key=lambda fault: fault[0])
            raise SimulationError(
                f"t = {self.time_s[row]:.6g} s: {name} is not finite; reduce the step or check "
                f"the parameters"
            )

    def __getitem__(self, column: str) -> Array:
        """The column of that name, (n,)."""
        return self.data[column]

    @property
    def columns(self) -> dict[str, Array]:
        """``time_s`` and the signals."""
        return {"time_s": self.time_s, **self.data}

    def to_dataframe(self) -> Any:
        """The signals as `pandas.DataFrame` over ``time_s``; names end in the unit.

        Raises `PackageError` without pandas.
        """
        return data_frame(self.columns, "time_s")
