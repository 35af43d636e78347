"""The result of one simulation, by either engine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kneexo.parameters import SimulationParameters
from kneexo.result import Array, Result, data_frame


@dataclass(frozen=True, repr=False)
class Run(Result):
    """Logged signals of one simulation: ``time_s`` (n,) and ``data`` by column name, each (n,).

    A command at time t is the value that was held up to t. ``settings`` are those of the solver.
    All values of a run are finite, with either engine.
    """

    time_s: Array
    data: dict[str, Array]
    settings: SimulationParameters

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
