"""Adds wearer and load cell to the closed loop: leg, cuff, biological moment and measured force."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from pydrake.systems.primitives import PassThrough, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from kneexo import systems
from kneexo.diagrams.part import Part, by_name, leaf_part
from kneexo.diagrams.plant import scenario_plant_parts, start_rod_force
from kneexo.geometry.rod_polynomial import controller_polynomial
from kneexo.parameters import LegParameters, MomentTable, NoLoad, Scenario
from kneexo.systems import cuff, knee_reference, load_cell, wearer_knee

MOMENT_INPUT = "biological_moment_input"
"""Signal of the biological moment that comes from outside the loop."""


def wearer_parts(scenario: Scenario) -> list[Part]:
    """Return the parts that a wearer and a load cell add to the loop: leg, cuff and load cell.

    The list is empty if the scenario has neither a wearer nor a torque controller.
    """
    parts = []
    leg, load = scenario.wearer, scenario.plant.load
    if isinstance(leg, LegParameters) and not isinstance(load, NoLoad):
        start = knee_reference.start_motion(scenario.reference)
        parts = [
            Part(
                "wearer",
                lambda **fault: systems.WearerKnee(leg, load, *start, **fault),
                lambda: wearer_knee.context_values(leg, load),
                wearer_knee.state_variables(leg.motion),
                lambda: wearer_knee.start_state(leg, *start),
                offers=by_name("wearer_motion"),
            ),
            leaf_part(
                *("cuff", systems.Cuff, cuff, leg.cuff),
                states=cuff.state_variables(leg.cuff),
                offers=by_name("interaction_torque", "interaction_power", "cuff_slip")
                | {"knee_torque": "interaction_torque"},
            ),
        ]
    if scenario.has_load_cell:
        cell, sample_time_s = scenario.load_cell, scenario.controller.sample_time_s
        parts.append(
            Part(
                "load_cell",
                lambda **fault: systems.LoadCell(
                    cell, sample_time_s, _start_force(scenario), **fault
                ),
                lambda: load_cell.context_values(cell),
                load_cell.STATE_VARIABLES,
                lambda: [_start_force(scenario)],
                offers=by_name("measured_force"),
            )
        )
    return [part._replace(reads={"fault": f"faults_of_{part.name}"}) for part in parts]


def parts_with_states(scenario: Scenario) -> Iterator[tuple[str, Part]]:
    """Yield path and part of each leaf system of plant, wearer and load cell.

    The continuous states of the closed loop are theirs, and a fault can change their parameters.
    """
    yield from ((f"plant/{part.name}", part) for part in scenario_plant_parts(scenario))
    yield from ((part.name, part) for part in wearer_parts(scenario))


def _start_force(scenario: Scenario) -> float:
    """Return the force in N that the rod exerts at the start."""
    return start_rod_force(
        scenario.plant,
        knee_reference.start_angle_rad(scenario.reference),
        scenario.initial_offset_m,
        controller_polynomial(scenario),
    )


@lru_cache(maxsize=64)
def moment_spline(moment: MomentTable) -> Any:
    """Return M(t) as Drake's piecewise polynomial through the samples, in N·m over s."""
    # Straight lines: nothing reads a derivative of the moment, and no curve overshoots the samples.
    return PiecewisePolynomial.FirstOrderHold(
        np.array(moment.times_s), np.array([moment.moments_n_m])
    )


def moment_of(scenario: Scenario) -> MomentTable | None:
    """Return the table of the wearer's biological moment, or None if the wearer has none."""
    return scenario.wearer.moment if isinstance(scenario.wearer, LegParameters) else None


def moment_parts(scenario: Scenario, external: bool = False) -> Iterator[Part]:
    """Yield the part that supplies the biological moment of the wearer.

    The part is a source of M(t). If the moment is ``external``, it is an open input port of the
    loop. Nothing is yielded if the wearer has no biological moment.
    """
    moment = moment_of(scenario)
    if moment is None:
        return
    if external:
        reads, offers = {"u": MOMENT_INPUT}, {"biological_moment": "y"}
        yield Part("biological_moment", lambda: PassThrough(1), reads=reads, offers=offers)
    else:
        offers = {"biological_moment": "y0"}
        yield Part("moment", lambda: TrajectorySource(moment_spline(moment)), offers=offers)
