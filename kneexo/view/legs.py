"""What a page shows of a scenario, or of the files of an earlier run."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from kneexo.errors import ScenarioError, SimulationError
from kneexo.parameters import Scenario
from kneexo.simulation import Run, simulate
from kneexo.view.page import COLUMNS, Leg

SIGNALS = ("knee_angle", "knee_reference", "load_pressure")
"""Signals of a run that a page shows."""


def leg_of_scenario(name: str, scenario: Scenario) -> tuple[Leg, str]:
    """The run of a scenario, and why it ends early, empty where it does not.

    A run that fails is shown up to its last whole sample before the failure; one that fails at once
    raises its `SimulationError`.
    """
    try:
        return _leg(name, scenario, simulate(scenario, signals=SIGNALS)), ""
    except SimulationError as error:
        failure = error
    sample = scenario.controller.sample_time_s
    good, bad = 0, int(scenario.simulation.duration_s / sample) + 1
    run = None
    while bad - good > 1:
        middle = (good + bad) // 2
        simulation = scenario.simulation.model_copy(update={"duration_s": middle * sample})
        try:
            shorter = scenario.model_copy(update={"simulation": simulation})
            run, good = simulate(shorter, signals=SIGNALS), middle
        except SimulationError:
            bad = middle
    if run is None:
        raise failure
    return _leg(name, scenario, run), str(failure)


def _leg(name: str, scenario: Scenario, run: Run) -> Leg:
    return Leg.of_signals(name, scenario.plant.linkage, run.columns)


def leg_of_results(name: str, directory: Path, scenario: Scenario) -> Leg:
    """The run in a directory that ``kneexo simulate`` wrote: signals.csv of the scenario.

    Raises `ScenarioError` where it is missing or not of such a run.
    """
    path = directory / "signals.csv"
    try:
        with path.open(encoding="utf-8") as file:
            names = file.readline().strip().split(",")
            missing = [column for column in COLUMNS if column not in names]
            if missing:
                raise ScenarioError(f"{path}: has no column {missing[0]}")
            places = [names.index(column) for column in COLUMNS]
            with warnings.catch_warnings(action="ignore"):  # no rows: told below
                table = np.loadtxt(file, delimiter=",", usecols=places, ndmin=2)
    except ScenarioError:
        raise
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError as error:
        reason = str(error).partition("\n")[0]
        raise ScenarioError(f"{path}: is not a table of numbers ({reason})") from None
    if not (table.size and np.isfinite(table).all()):
        raise ScenarioError(f"{path}: has no rows, or numbers that are not finite")
    if table[0, 0] < 0.0 or (np.diff(table[:, 0]) <= 0.0).any():
        raise ScenarioError(f"{path}: time_s must rise from 0 s or later")
    return Leg(name, scenario.plant.linkage, *table.T)
