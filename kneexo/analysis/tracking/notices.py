"""What the model of a scenario leaves out, and notices about values that may surprise its user."""

from __future__ import annotations

import contextlib
import math
import textwrap
from collections.abc import Iterable, Iterator

import numpy as np

from kneexo.analysis.signals import period_s, settled_s
from kneexo.analysis.wearer.coupling import coupled_loop, stiffness_interval
from kneexo.common.progress import line_width
from kneexo.diagrams.plant import moving_masses_kg
from kneexo.errors import LinearizationError
from kneexo.geometry.rod_polynomial import controller_polynomial, largest_error_mm
from kneexo.parameters import (
    TABLE_1_LINKAGES,
    CylinderParameters,
    PlantParameters,
    RampReference,
    SampledReference,
    Scenario,
    SlidingModeParameters,
    StepReference,
)
from kneexo.parameters.fields.fields import unit_of
from kneexo.parameters.fields.replaced import believed
from kneexo.parameters.labels import value_text
from kneexo.simulation.compiled import why_not_compiled
from kneexo.systems.knee_reference import run_middle_deg, run_range_deg

LONGEST_HOLD = 0.1
"""Largest share of a run before the first or after the last sample without a notice.

Assumption: an error of 0 in a tenth of the run lowers the root mean square by 5 %.
"""

LARGEST_IN_RAD_DEG = 2.6
"""Assumption: samples within this angle may be in rad, since 150° are 2.6 rad."""

SLOWEST_DEG_S, LONGEST_TRIAL_S = 0.5, 100.0
"""Assumption: a longer reference that is always slower may have its times in ms."""

LARGEST_MISFIT_MM = 0.3
"""Largest error in mm of a given polynomial over 0…90° without a notice.

Table 1 differs by at most 0.22 mm from the linkages that are identified from Table 1.
"""


def omissions(scenario: Scenario) -> tuple[str, ...]:
    """Return the effects that kneexo can compute and that the model of ``scenario`` leaves out.

    The effects of the plant come first. The tuple is empty if the model leaves out no such effect.
    """
    own, controller, bus = scenario.parts.chosen(), scenario.controller, scenario.bus
    plant = believed(scenario.plant)
    load, full = plant.load, plant.full_order
    knee = load if load.kind == "knee" else None
    friction = full is not None and full.coulomb_friction_n + full.stribeck_friction_n > 0.0
    left_out = {
        "load on the knee": knee is None,
        "weight of the shank": knee is not None and knee.segment_mass_kg * knee.gravity_m_s2 == 0.0,
        "torque of the wearer": (
            knee is not None and knee.knee_torque_n_m == 0.0 and scenario.wearer.kind == "none"
        ),
        "full order of the cylinder (valves, friction, air)": full is None,
        "friction of the seals": full is not None and not friction,
        "air in the oil": full is not None and full.entrained_air == 0.0,
        "leakage": plant.leakage_m3_per_s_pa == 0.0,
        "lag and limits of the motor": plant.ideal_motor,
        "torque of the motor": plant.motor is None,
        "heat of the motor": plant.motor is not None and plant.thermal is None,
        "error of the polynomial": plant.rod_map == "polynomial",
        "counts of the encoder": not scenario.encoder.quantized,
        "estimation of the rod's state": scenario.estimator.kind == "exact",
        "sampling": controller.kind == "smc" and controller.continuous,
        "bus": bus.velocity_unit_rad_s == 0.0 and bus.latency_samples == 0,
    }
    # Of what a part of the user computes or leaves out, kneexo knows nothing.
    unknown = {name for place in own for name in _EFFECTS_OF[place]}
    return tuple(name for name, is_out in left_out.items() if is_out and name not in unknown)


_EFFECTS_OF = {
    "cylinder": (
        "full order of the cylinder (valves, friction, air)",
        *("friction of the seals", "air in the oil", "leakage"),
    ),
    "motor": ("leakage", "lag and limits of the motor", "torque of the motor", "heat of the motor"),
    "load": ("load on the knee", "weight of the shank", "torque of the wearer"),
    "estimator": ("estimation of the rod's state",),
}
"""For each place of a part of the user, the effects that the part may compute."""


def model_lines(scenario: Scenario, notes: Iterable[str]) -> list[str]:
    """Return one line that names the `omissions` of a scenario, and a line for each of ``notes``.

    A line of more than `line_width` characters is broken, and its further lines are indented.
    """
    left_out = ", ".join(omissions(scenario)) or "nothing that kneexo can compute"
    return [wrapped(line) for line in (f"Left out: {left_out}.", *(f"Note: {n}." for n in notes))]


def wrapped(line: str) -> str:
    """Return ``line`` in lines of at most `line_width` characters, indented from the second on.

    A longer word, such as a path, stays whole.
    """
    return textwrap.fill(
        line, line_width(), subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )


def notices(scenario: Scenario) -> Iterator[str]:
    """Yield a line for each surprise: what a user of ``scenario`` may not expect of its run.

    1. a contradiction in the model: see `model_notices`,
    2. torque control without a wearer, so that nothing moves the knee,
    3. an unstable virtual stiffness, with both ends of the stable interval,
    4. torque control that is unstable at an end of the reference's range,
    5. missing readings of the load cell, and when they stop the motor,
    6. a part of the reference that is not run as it stands: see ``_reference_notices``.

    Raises `LinkageError` when the linkage cannot be assembled.
    """
    yield from model_notices(scenario)
    if scenario.controller.kind == "torque" and scenario.wearer.kind == "none":
        yield (
            "no wearer moves the knee, and controller.kind = torque does not follow the reference; "
            "add wearer: leg and plant: {load: knee}"
        )
    yield from _stiffness_notice(scenario)
    yield from _torque_control_notice(scenario)
    yield from _load_cell_notice(scenario)
    yield from _reference_notices(scenario)


def _reference_notices(scenario: Scenario) -> Iterator[str]:
    """Yield a line for each part of the reference that is not run as its user may expect.

    1. The run has less than two periods of a sine, so that the transient counts.
    2. The run ends before the step or ramp.
    3. Samples of a file were shifted, or clipped at the stops.
    4. Samples seem to be in rad, or their times in ms.
    5. Samples before 0 s are not run.
    6. The run holds the first or the last sample for more than `LONGEST_HOLD` of its duration.
    """
    reference, duration_s = scenario.reference, scenario.duration_s
    if (period := period_s(scenario)) > settled_s(scenario):
        yield (
            f"the run of {duration_s:g} s has less than two periods of the reference, {period:g} s "
            f"each, so its error and verdict include the start; set simulation.duration_s to some "
            f"periods"
        )
    if isinstance(reference, StepReference | RampReference) and reference.time_s >= duration_s:
        yield (
            f"the {reference.kind} at {reference.time_s:g} s is not run, because the run ends at "
            f"{duration_s:g} s; reduce reference.time_s, or set a longer simulation.duration_s"
        )
    if isinstance(reference, SampledReference):
        start_s, end_s = reference.times_s[0], reference.times_s[-1]
        if reference.shift_s > 0.0:
            yield f"the run begins at {reference.shift_s:g} s of the files of reference and moment"
        if reference.clipped_deg > 0.0:
            yield f"samples up to {reference.clipped_deg:.3g}° beyond the stops are clipped"
        yield from _unit_notices(reference)
        if start_s < 0.0:
            yield (
                f"the samples before 0 s, from {start_s:g} s on, are not run; add {-start_s:g} s "
                f"to all times"
            )
        if start_s > LONGEST_HOLD * duration_s:
            yield (
                f"the reference begins at {start_s:g} s, and the run holds its first sample until "
                f"then; subtract {start_s:g} s from its times to begin at once"
            )
        if duration_s - end_s > LONGEST_HOLD * duration_s:
            yield (
                f"the reference ends at {end_s:g} s, and the run holds its last sample until "
                f"simulation.duration_s = {duration_s:g} s; leave simulation.duration_s out to "
                f"stop at the last sample"
            )


def _unit_notices(reference: SampledReference) -> Iterator[str]:
    """Yield a line if the samples of a reference seem to be in rad, or their times in ms."""
    changes = np.abs(np.diff(reference.angles_deg))
    if changes.any() and (largest := np.max(np.abs(reference.angles_deg))) < LARGEST_IN_RAD_DEG:
        yield f"the reference stays within {largest:.3g}°; if it is in rad, multiply it by 57.3"
    rate = np.max(changes / np.diff(reference.times_s))
    if 0.0 < rate < SLOWEST_DEG_S and reference.times_s[-1] > LONGEST_TRIAL_S:
        yield f"the reference moves at most {rate:.2g} deg/s; divide its times by 1000 if in ms"


def _stiffness_notice(scenario: Scenario) -> Iterator[str]:
    """Yield a line if knee and wearer are unstable with the virtual stiffness of the controller.

    The line has both ends of the interval of stable stiffnesses.
    """
    law, angle = scenario.controller, run_middle_deg(scenario)
    if not (law.kind == "torque" and law.mode in ("impedance", "assist_as_needed")):
        return
    path, given = "controller.stiffness_n_m_per_rad", law.stiffness_n_m_per_rad
    try:
        ends = stiffness_interval(scenario, knee_angle_deg=angle)
    except LinearizationError:  # the verdict on stability has the reason
        return
    low, high = ends.low_n_m_per_rad, ends.high_n_m_per_rad
    if low <= given <= high:
        return
    where = f"{angle:.3g}°"
    if law.mode == "assist_as_needed":  # within the band there is no spring
        where += ", outside the band"
    line = f"{path} = {given:g} N·m/rad is unstable at {where}: "
    if math.isnan(low):
        yield f"{line}no stiffness is stable; reduce the controller's gains and damping"
    else:
        remedy = "increase" if given < low else "reduce"
        interval = f"{value_text(path, low)} … {value_text(path, high)}"
        yield f"{line}must be {interval} N·m/rad; {remedy} it"


def _torque_control_notice(scenario: Scenario) -> Iterator[str]:
    """Yield a line if knee and wearer are unstable at an end of the reference's range.

    The verdict has the stability in the middle of the range alone. The moment arm, the oil and an
    inertia at the rod change with the knee angle, and so does stability.
    """
    if scenario.controller.kind != "torque" or scenario.wearer.kind == "none":
        return
    growth = {}
    # Both ends, because with an inertia at the knee the loop is unstable near extension, and the
    # verdict looks at the middle.
    for angle in set(run_range_deg(scenario)) - {run_middle_deg(scenario)}:
        with contextlib.suppress(LinearizationError):
            growth[angle] = float(abs(coupled_loop(scenario, angle).eigenvalues[0]))
    if growth and growth[worst := max(growth, key=lambda angle: growth[angle])] >= 1.0:
        yield (
            f"knee and wearer are unstable at {worst:.3g}°: the largest eigenvalue of the sampled "
            f"loop is {growth[worst]:.3g}, and must be below 1; reduce the controller's gains"
        )


def _load_cell_notice(scenario: Scenario) -> Iterator[str]:
    """Yield a line if readings of the load cell are missing until the torque control stops."""
    law, cell = scenario.controller, scenario.load_cell
    stop_s = cell.dropout_start_s + law.timeout_s if law.kind == "torque" else math.inf
    end_s = min(cell.dropout_start_s + cell.dropout_s, scenario.duration_s)
    if stop_s < end_s:
        yield (
            f"load_cell.dropout_s = {cell.dropout_s:g} s: without readings the motor stops from "
            f"{stop_s:.4g} s to {end_s:.4g} s, which margins and impedance leave out"
        )


def model_notices(scenario: Scenario) -> Iterator[str]:
    """Yield a line for each contradiction in the model of ``scenario``.

    The lines have this order. If a part of the user replaces cylinder or load, kneexo knows nothing
    of the masses, and lines 2 to 5 are left out.

    1. A part of the user replaces a part of kneexo, but the controller believes kneexo's numbers.
       A second line says if the part has no symbolic equations.
    2. The mass that moves with the rod is beyond the bounds of the sliding-mode controller.
    3. The mass of the rod is so large that it stands for a load of the knee, but it has no weight.
    4. The mass of the rod has no effect, because the load has an inertia.
    5. The nominal plant differs from the plant.
    6. The controller's polynomial misses the linkage by more than `LARGEST_MISFIT_MM`, or is fitted
       to the linkage.

    Raises `LinkageError` when the linkage cannot be assembled.
    """
    plant, controller = scenario.plant, scenario.controller
    if own := scenario.parts.chosen():
        names = ", ".join(f"{place} = {part.make.short_name}" for place, part in own.items())
        yield f"a part of yours replaces {names}; the controller believes kneexo's numbers"
        if reason := why_not_compiled(scenario):
            yield f"Drake's Simulator makes the runs, about a thousand times slower: {reason}"
    if {"cylinder", "load"} & own.keys():  # of whose masses kneexo knows nothing
        yield from polynomial_notices(scenario)
        return
    mass_kg, inertia = plant.cylinder.mass_kg, plant.knee_inertia_kg_m2
    if controller.kind == "smc":
        low, high = controller.mass_min_kg, controller.mass_max_kg
        least, largest = moving_masses_kg(plant)
        text = f"plant.cylinder.mass_kg = {mass_kg:g} kg"
        if inertia is not None:
            text = f"plant.load.inertia_kg_m2 = {inertia:g} kg·m² acts as "
            text += f"{least:.3g} … {largest:.3g} kg at the rod, which"
        if not low <= least <= largest <= high:
            yield (f"{text} is outside controller.mass_min_kg … mass_max_kg, {low:g} … {high:g} kg")
    if inertia is None and mass_kg > SlidingModeParameters().mass_max_kg:
        if plant.load.kind == "none":
            yield (
                f"plant.cylinder.mass_kg = {mass_kg:g} kg has inertia but no weight; "
                f"plant.load: knee adds weight"
            )
        elif plant.load.segment_mass_kg < mass_kg:
            yield (
                f"plant.cylinder.mass_kg = {mass_kg:g} kg has inertia but no weight; gravity acts "
                f"on plant.load.segment_mass_kg = {plant.load.segment_mass_kg:g} kg"
            )
    if inertia is not None and mass_kg != CylinderParameters().mass_kg:
        yield (
            f"plant.cylinder.mass_kg = {mass_kg:g} kg has no effect; "
            f"plant.load.inertia_kg_m2 = {inertia:g} kg·m² replaces it"
        )
    if scenario.nominal is not None:
        yield from _nominal_notice(plant, scenario.nominal)
    yield from polynomial_notices(scenario)


def _nominal_notice(plant: PlantParameters, nominal: PlantParameters) -> Iterator[str]:
    """Yield a line about the first number in which the plant differs from the nominal plant.

    The line also says how many further numbers differ.
    """
    differing = []
    for part in ("cylinder", "pump", "linkage"):
        believed, true = getattr(nominal, part), getattr(plant, part)
        for name, field in type(true).model_fields.items():
            values = getattr(believed, name), getattr(true, name)
            if values[0] != values[1]:
                unit = unit_of(field)
                differing.append(
                    f"nominal.{part}.{name} is {values[0]:.4g} {unit}, that of the plant "
                    f"{values[1]:.4g} {unit}"
                )
    if differing:
        others = f"; {len(differing) - 1} more differences" if len(differing) > 1 else ""
        yield f"{differing[0]}{others}"


def polynomial_notices(scenario: Scenario) -> Iterator[str]:
    """Yield the lines of `model_notices` about the controller's polynomial.

    Raises `LinkageError` when the linkage cannot be assembled.
    """
    polynomial, link = controller_polynomial(scenario), scenario.believed_plant.linkage
    error = largest_error_mm(link, polynomial)
    if scenario.polynomial is None:
        if link not in TABLE_1_LINKAGES.values():
            yield (
                f"the controller's polynomial is fitted to this linkage: off by at most "
                f"{error:.2g} mm of rod over 0…90 deg"
            )
    elif error > LARGEST_MISFIT_MM:
        yield (
            f"polynomial is off the linkage by up to {error:.2g} mm of rod over 0…90 deg, must be "
            f"at most {LARGEST_MISFIT_MM:g} mm; leave polynomial out, so that kneexo fits it"
        )
