"""Fits numbers of a scenario to a log in a CSV file, with all results as plain data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Unpack

from kneexo.common.progress import progress_bar
from kneexo.errors import ParameterError
from kneexo.parameters import Scenario
from kneexo.parameters.fields.quantity import Parameters, choice, quantity
from kneexo.sweeps import SweepOptions

if TYPE_CHECKING:
    from kneexo.analysis.identification.fit import FittedScenario


class FitSettings(Parameters):
    """Settings of ``kneexo fit``: the log, what to find in it, and the search."""

    log: str = choice("", "path of the CSV file, the first argument of the command")
    parameters: tuple[str, ...] = choice(("plant.pump.lag_s",), "NAME[=LOW:HIGH] of each number")
    columns: tuple[str, ...] = choice((), "NAME=COLUMN of other names, with a factor of units")
    measured: tuple[str, ...] = choice((), "columns to compare; left out: encoder, motor speed")
    command_holds: Literal["until", "from"] = choice("until", "time of the row until or from which")
    whole_loop: bool = choice(True, "False: no second estimate")
    loss: Literal["linear", "huber", "soft_l1", "cauchy"] = choice("linear", "others: outliers")
    starts: int = quantity(1, "1", "assumption: one search, from the scenario", ge=1, le=1000)


def fit_study(
    scenario: Scenario = Scenario(),
    *,
    settings: FitSettings = FitSettings(),
    **options: Unpack[SweepOptions],
) -> FittedScenario:
    """Fit numbers of a scenario to a log: see `kneexo.analysis.identification.fit.fit`.

    Parameters
    ----------
    scenario
        What is known of the machine.
    settings
        The log, what to find, and the search.
    **options
        Those of `kneexo.sweeps.SweepOptions`. Only ``progress`` has an effect.

    Raises
    ------
    ParameterError, SimulationError
        As `kneexo.analysis.identification.fit.fit`, or without a log.
    """
    from kneexo.analysis.identification.fit import fit  # `kneexo params` does without its SciPy

    chosen = settings.model_dump()
    log = chosen.pop("log")
    if not log:
        raise ParameterError("log: must be the path of a CSV file: kneexo fit LOG.csv MINE.yaml")
    with progress_bar(1.0, "fit" if options.get("progress") else None):
        return fit(scenario, log, **chosen)
