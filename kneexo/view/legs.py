"""What a page shows of a scenario, or of the files of an earlier run."""

from __future__ import annotations

import math
from pathlib import Path

from kneexo.errors import ScenarioError, SimulationError, shown
from kneexo.files.table import read_table
from kneexo.parameters import Scenario
from kneexo.parameters.reference import LONGEST_TIME_S
from kneexo.simulation import Run, simulate
from kneexo.view.page import COLUMNS, Leg

SIGNALS = ("knee_angle", "knee_reference", "load_pressure")
"""Signals of a run that a page shows."""

_SHORTEST_STEP_S = 1e-9  # the times in signals.csv have ten digits
_HIGHEST_PRESSURE_PA = 1e12
_SLACK_RAD = 1e-6


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

    Raises `ScenarioError` where signals.csv is missing or damaged: a column is missing, the
    time does not rise, or a value is out of range. Knee angle and reference must lie within
    the range of motion and the overshoot that the scenario allows.
    """
    path = directory / "signals.csv"
    table = read_table(path, COLUMNS)
    if not table.lines:
        raise ScenarioError(f"{shown(path)}: has no rows below the names of its columns")
    knee = scenario.plant.knee
    low = math.radians(knee.flexion_min_deg - knee.overshoot_deg) - _SLACK_RAD
    high = math.radians(knee.flexion_max_deg + knee.overshoot_deg) + _SLACK_RAD
    time, angle, reference, pressure = COLUMNS
    table.require(time, 0.0, LONGEST_TIME_S, "s")
    table.require_increase(time, _SHORTEST_STEP_S, "s")
    table.require(angle, low, high, "rad")
    table.require(reference, low, high, "rad")
    table.require(pressure, -_HIGHEST_PRESSURE_PA, _HIGHEST_PRESSURE_PA, "Pa")
    return Leg.of_signals(name, scenario.plant.linkage, table.columns)
