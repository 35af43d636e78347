"""Makes the legs that a page shows, from scenarios or from files of earlier runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from kneexo.common.files.table import read_table
from kneexo.common.result import Array
from kneexo.errors import ScenarioError, SimulationError, shown
from kneexo.parameters import CylinderParameters, LinkageParameters, PlantParameters, Scenario
from kneexo.parameters.fields.replaced import believed
from kneexo.parameters.task.reference import LONGEST_TIME_S
from kneexo.simulation import simulate

Motion = tuple[PlantParameters, Mapping[str, Array]]
"""A plant, and a run of this plant: columns (n,) by name. ``time_s`` starts at 0."""

SIGNALS = ("knee_angle", "knee_reference", "load_pressure")
"""The signals of a run that a page shows."""

COLUMNS = ("time_s", "knee_angle_rad", "knee_reference_rad", "load_pressure_pa")
"""The names of time and `SIGNALS` as columns of a run and of signals.csv."""

WEARER_SIGNALS = ("wearer_motion", "interaction_torque")
"""Names of the additional signals that a page shows of a run with a wearer."""

WEARER_COLUMNS = ("wearer_angle_rad", "interaction_torque_n_m")
"""Names of the columns of `WEARER_SIGNALS` that a page shows."""

_SHORTEST_STEP_S = 1e-9  # the times in signals.csv have ten digits
_HIGHEST_PRESSURE_PA = 1e12
_HIGHEST_TORQUE_N_M = 1e6
_SLACK_RAD = 1e-6


@dataclass(frozen=True)
class Leg:
    """The part of a run that a view shows. ``time_s`` and the three signals are (n,) each."""

    name: str
    linkage: LinkageParameters
    time_s: Array
    knee_angle_rad: Array
    reference_rad: Array
    pressure_pa: Array
    pressure_rating_pa: float = CylinderParameters().pressure_rating_pa
    """Load pressure in Pa at which the cylinder has its full colour."""
    wearer_rad: Array | None = None
    """Angle of the wearer's knee (n,). None without a wearer."""
    torque_n_m: Array | None = None
    """Torque of the wearer on the exoskeleton (n,), positive flexes. None without a wearer."""

    @classmethod
    def of_plant(cls, name: str, plant: PlantParameters, signals: Mapping[str, ArrayLike]) -> Leg:
        """Return a leg with the linkage and the pressure rating of a plant.

        ``signals`` maps each name in `COLUMNS` to its values (n,). The names in `WEARER_COLUMNS`
        are optional.
        """
        time, angle, reference, pressure = (np.asarray(signals[column]) for column in COLUMNS)
        wearer = (np.asarray(signals[c]) if c in signals else None for c in WEARER_COLUMNS)
        rating_pa = believed(plant.cylinder).pressure_rating_pa
        return cls(name, plant.linkage, time, angle, reference, pressure, rating_pa, *wearer)


def leg_of_scenario(name: str, scenario: Scenario) -> tuple[Leg, str]:
    """Run a scenario. Return the leg and an error message, which is empty for a complete run.

    If the run fails, the leg ends with the last sample before the failure. Raises `SimulationError`
    if there is no such sample.
    """
    signals = SIGNALS + WEARER_SIGNALS * (scenario.wearer.kind != "none")
    try:
        return Leg.of_plant(name, scenario.plant, simulate(scenario, signals=signals).columns), ""
    except SimulationError as error:
        failure = error
    sample = scenario.controller.sample_time_s
    # A failed run has no samples. So bisection finds the longest run that ends before the failure.
    passing, failing = 0, int(scenario.duration_s / sample) + 1  # numbers of samples
    run = None
    while failing - passing > 1:
        middle = (passing + failing) // 2
        simulation = scenario.simulation.model_copy(update={"duration_s": middle * sample})
        try:
            shorter = scenario.model_copy(update={"simulation": simulation})
            run, passing = simulate(shorter, signals=signals), middle
        except SimulationError:
            failing = middle
    if run is None:
        raise failure
    return Leg.of_plant(name, scenario.plant, run.columns), str(failure)


def leg_of_results(name: str, directory: Path, scenario: Scenario) -> Leg:
    """Return the moving leg, for the 3D view, of a run that ``kneexo simulate`` has written.

    The motion is read from signals.csv in ``directory``; ``name`` is the title of the leg.

    Raises `ScenarioError` if signals.csv cannot be read, a column is missing, the time does not
    increase, or a value is out of range. Knee angle and reference must lie within the scenario's
    range of motion, extended by the allowed overshoot. The columns of `WEARER_COLUMNS` are
    required if the scenario has a wearer.
    """
    path = directory / "signals.csv"
    has_wearer = scenario.wearer.kind != "none"
    table = read_table(path, COLUMNS + WEARER_COLUMNS * has_wearer)
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
    if has_wearer:
        wearer, torque = WEARER_COLUMNS
        table.require(wearer, -math.tau, math.tau, "rad")
        table.require(torque, -_HIGHEST_TORQUE_N_M, _HIGHEST_TORQUE_N_M, "N·m")
    return Leg.of_plant(name, scenario.plant, table.columns)
