"""The result of one run of the compiled engine or of Drake's Simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kneexo.parameters import SimulationParameters
from kneexo.result import Array, Result, data_frame


@dataclass(frozen=True, repr=False)
class Run(Result):
    """Logged signals of one run: ``time_s`` (n,) and ``data`` by column name, each (n,).

    The logged output of a controller at time t is the value that was held until the update at t.
    ``settings`` names the solver of this run. If the run was repeated, it is the solver of the last
    attempt. All values are finite.
    """

    time_s: Array
    data: dict[str, Array]
    settings: SimulationParameters

    def __getitem__(self, column: str) -> Array:
        """Return the values of the column of ``data`` with this name, (n,)."""
        return self.data[column]

    @property
    def columns(self) -> dict[str, Array]:
        """Dictionary of ``time_s`` and all columns of ``data``."""
        return {"time_s": self.time_s, **self.data}

    def to_dataframe(self) -> Any:
        """Return ``data`` as a `pandas.DataFrame` with the index ``time_s``.

        Raises `PackageError` without pandas.
        """
        return data_frame(self.columns, "time_s")
