"""Adds input guard, fault detectors and safety supervisor to the controller of a scenario."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from kneexo import systems
from kneexo.diagrams.part import Part
from kneexo.geometry import linkage
from kneexo.parameters import LinkageParameters, ProtectionParameters, Scenario
from kneexo.systems import fault_detectors, input_guard, safety_supervisor


def protection_parts(scenario: Scenario, protection: ProtectionParameters) -> Iterator[Part]:
    """Yield input guard, fault detectors and safety supervisor.

    The guard and the detectors offer good values of the signals that they read as `raw`. The guard
    refuses nothing. A controller that refused a bad input did not step: while the encoder was dead,
    no detector counted and no emergency stop acted.
    """
    believed, sample_time_s = scenario.believed_plant, scenario.controller.sample_time_s
    span = reading_range_rad(scenario)
    follows, has_load_cell = scenario.controller.kind != "torque", scenario.has_load_cell
    law, reference_range = scenario.controller, reference_range_rad(scenario)
    names = ("knee_reference", *["measured_force"] * has_load_cell)
    if law.kind == "torque" and law.mode == "assist":
        names += ("biological_moment",)
    names += ("motor_speed",)
    yield Part(
        "guard",
        lambda: systems.InputGuard(reference_range, sample_time_s, names),
        lambda: input_guard.context_values(reference_range),
        reads=raw(*names),
    )
    yield Part(
        "detectors",
        lambda: systems.FaultDetectors(
            protection, believed, span, sample_time_s, follows, has_load_cell
        ),
        lambda: fault_detectors.context_values(protection, believed, span, sample_time_s),
        reads=raw(*fault_detectors.PLAUSIBLE),
    )
    yield Part(
        "supervisor",
        lambda: systems.SafetySupervisor(protection, sample_time_s),
        lambda: safety_supervisor.context_values(protection),
        reads=raw("motor_speed"),  # a bad speed as it is: that is no standstill
        through="motor_speed_command",
    )


def raw(*names: str) -> dict[str, str]:
    """Return a dictionary from names of signals to the names of their values before the guard."""
    return {name: f"raw_{name}" for name in names}


def reference_range_rad(scenario: Scenario) -> tuple[float, float]:
    """Return the lowest and highest reference of the knee angle that the controller accepts.

    The range is the range of motion, extended by the allowed overshoot, as in
    `require_reference_in_range`. A reference far outside would wind up the integral of a PID.
    """
    knee = scenario.plant.knee
    return (
        math.radians(knee.flexion_min_deg - knee.overshoot_deg),
        math.radians(knee.flexion_max_deg + knee.overshoot_deg),
    )


def reading_range_rad(scenario: Scenario) -> tuple[float, float]:
    """Return the least and largest reading of the encoder in rad within the range of motion.

    The detector ``range`` tolerates ``range_deg`` beyond it. The knee angle can exceed the range of
    motion by the allowed overshoot. θ_4 at both ends (Eq. 3–7), less the phase of the encoder,
    gives the readings. One count and the mounting error extend the range at each end.
    """
    encoder, plant = scenario.encoder, scenario.believed_plant
    knee = plant.knee
    ends_deg = knee.flexion_min_deg - knee.overshoot_deg, knee.flexion_max_deg + knee.overshoot_deg
    angles = _encoder_angles(plant.linkage, ends_deg)  # one-to-one, so the ends are enough
    phase = encoder.phase_rad if encoder.quantized else 0.0
    slack = encoder.resolution_rad + abs(encoder.mounting_error_rad)
    return min(angles) - phase - slack, max(angles) - phase + slack


@lru_cache(maxsize=64)
def _encoder_angles(link: LinkageParameters, angles_deg: tuple[float, float]) -> tuple[float, ...]:
    return tuple(linkage.encoder_angle(link, np.radians(angles_deg)).tolist())
