"""Adds wearer and load cell to the closed loop: leg, cuff, biological moment and measured force."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from pydrake.systems.primitives import PassThrough, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from kneexo import systems
from kneexo.diagrams.part import Part, add_parts, connect
from kneexo.diagrams.plant import start_rod_force
from kneexo.diagrams.signals import WEARER_OUTPUTS
from kneexo.geometry.rod_polynomial import controller_polynomial
from kneexo.parameters import LegParameters, MomentTable, NoLoad, Scenario
from kneexo.systems import cuff, knee_reference, load_cell, wearer_knee


def wearer_parts(scenario: Scenario) -> list[Part]:
    """Return the leaf systems of wearer and load cell: leg, cuff and load cell.

    The list is empty without a wearer and without a torque controller.
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
            ),
            Part(
                "cuff",
                lambda **fault: systems.Cuff(leg.cuff, **fault),
                lambda: cuff.context_values(leg.cuff),
                cuff.state_variables(leg.cuff),
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
            )
        )
    return parts


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
    """Return the biological moment of a scenario, or None."""
    return scenario.wearer.moment if isinstance(scenario.wearer, LegParameters) else None


def add_wearer(
    builder: Any,
    scenario: Scenario,
    plant: Any,
    reference: Any,
    *,
    external_moment: bool,
    fault_names: Mapping[str, tuple[str, ...]],
) -> dict[str, Any]:
    """Add the `wearer_parts` to a DiagramBuilder; return their output ports by signal.

    ``plant`` is the plant, whose ``knee_torque`` becomes the interaction torque. ``reference`` is
    the output port of the knee reference. The biological moment is a source, or an input port of
    the diagram if ``external_moment`` is True. For ``fault_names`` see `add_parts`.
    """
    part = add_parts(builder, wearer_parts(scenario), fault_names)
    ports = {
        name: part[system].GetOutputPort(name)
        for name, system in WEARER_OUTPUTS.items()
        if system in part
    }
    if "load_cell" in part:
        connect(builder, plant, "rod_force", part["load_cell"], "rod_force")
    if "wearer" not in part:
        return ports
    leg, coupling = part["wearer"], part["cuff"]
    builder.Connect(reference, leg.GetInputPort("knee_reference"))
    for name in ("knee_angle", "rod_velocity", "moment_arm"):
        connect(builder, plant, name, coupling, name)
    connect(builder, leg, "wearer_motion", coupling, "wearer_motion")
    connect(builder, coupling, "interaction_torque", leg, "interaction_torque")
    connect(builder, coupling, "interaction_torque", plant, "knee_torque")
    if (moment := moment_of(scenario)) is not None:
        if external_moment:
            source = builder.AddNamedSystem("biological_moment", PassThrough(1))
            builder.ExportInput(source.get_input_port(), "biological_moment")
        else:
            source = builder.AddNamedSystem("moment", TrajectorySource(moment_spline(moment)))
        builder.Connect(source.get_output_port(), leg.GetInputPort("biological_moment"))
        ports["biological_moment"] = source.get_output_port()
    return ports
