"""The result of one run, by the compiled engine or by Drake's Simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kneexo.parameters import SimulationParameters
from kneexo.result import Array, Result, data_frame


@dataclass(frozen=True, repr=False)
class Run(Result):
    """Logged signals of one run: ``time_s`` (n,) and ``data`` by column name, each (n,).

    The logged output of a controller at time t is the value that was held until the update at t.
    ``settings`` name the solver that ran, also if the run was repeated. All values are finite.
    """

    time_s: Array
    data: dict[str, Array]
    settings: SimulationParameters

    def __getitem__(self, column: str) -> Array:
        """Return the values of the column of ``data`` with this name, (n,)."""
        return self.data[column]

    @property
    def columns(self) -> dict[str, Array]:
        """``time_s`` and ``data`` in one dictionary."""
        return {"time_s": self.time_s, **self.data}

    def to_dataframe(self) -> Any:
        """Return ``data`` as a `pandas.DataFrame` with the index ``time_s``.

        Raises `PackageError` without pandas.
        """
        return data_frame(self.columns, "time_s")
