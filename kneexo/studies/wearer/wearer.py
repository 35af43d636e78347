"""Torque between wearer and knee in walking and sit-to-stand, with other pumps, gains and modes.

The leg of the first table follows its path whatever torque it feels, and the desired torque is
zero. So the torque that remains is the error of the actuator. The legs of the second table are weak
and yield. The modes of the torque controller help these legs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Unpack

import numpy as np
from pydantic import TypeAdapter

from kneexo.analysis.signals import saturated_share
from kneexo.analysis.tracking.interaction import INTERACTION_SIGNALS, interaction_metrics
from kneexo.analysis.wearer.coupling import coupled_stability, stiffness_interval
from kneexo.common.result import Result
from kneexo.diagrams import SIGNALS
from kneexo.errors import LinearizationError, ParameterError, failure_noted
from kneexo.parameters import (
    BODIES,
    MOMENT_MASS_KG,
    UNCERTAIN_KNEE,
    WEARERS,
    Scenario,
    gait_moment,
    gait_reference,
    leg_of_body,
    sit_to_stand_reference,
)
from kneexo.parameters.fields.quantity import Parameters, quantities, quantity
from kneexo.parameters.paths import changed, value_at
from kneexo.simulation import Run, needs_runs, simulate
from kneexo.studies.hardware import DISPLACEMENT, scaled
from kneexo.sweeps import SweepOptions, open_sweep


class WearerSettings(Parameters):
    """Settings of the study `wearer`: motions, pumps, gains, modes and weak legs."""

    cadences_hz: tuple[float, ...] = quantities(
        (0.3, 0.5, 0.7, 1.0), "Hz", "assumption: strides per second", ge=0.01, le=10
    )
    rise_times_s: tuple[float, ...] = quantities(
        (1.5, 2.0, 3.0), "s", "assumption: time to stand up, and to sit down", ge=0.1, le=100
    )
    cycles: int = quantity(3, "1", "assumption: cycles; the first is discarded", ge=2, le=1000)
    flow_factor: float = quantity(
        10.0, "1", "assumption: a larger pump, ten times the flow per revolution", ge=1, le=100
    )
    sized_flow_factor: float = quantity(
        16.3, "1", "kneexo size: 1.1 times the least flow for walking at 1 Hz", ge=1, le=100
    )
    unlimited_flow_factor: float = quantity(
        50.0, "1", "assumption: flow at which the motor stays off its limits", ge=1, le=100
    )
    gain_factor: float = quantity(
        4.0, "1", "assumption: higher gains, with a disk margin above 0.6", ge=0.01, le=100
    )
    inertia_gain_factor: float = quantity(
        0.5,
        "1",
        "assumption: gains with the inertia of the shank; higher ones lose their margins",
        ge=0.01,
        le=100,
    )
    inertia_filter_s: float = quantity(
        0.005, "s", "assumption: low-pass of the load cell with this inertia", ge=1e-5, le=1
    )
    postures_deg: tuple[float, ...] = quantities(
        (10.0, 45.0, 85.0), "deg", "assumption: knee angles of the margins", ge=0, le=90
    )
    help_cadences_hz: tuple[float, ...] = quantities(
        (0.5, 1.0), "Hz", "assumption: strides per second of weak legs", ge=0.01, le=10
    )
    help_rise_times_s: tuple[float, ...] = quantities(
        (2.0,), "s", "assumption: time to stand up, and to sit down, of weak legs", ge=0.1, le=100
    )
    shares: tuple[float, ...] = quantities(
        (0.2, 0.5), "1", "assumption: shares of the biological moment", ge=-1, le=1
    )
    effort: float = quantity(
        0.8, "1", "assumption: share of the biological moment that weak muscles give", ge=0, le=2
    )
    crouch_deg: float = quantity(
        5.0,
        "deg",
        "assumption: flexion added to the gait of a weak leg, so that it yields before the stop",
        ge=0,
        le=20,
    )
    virtual_stiffness_n_m_per_rad: float = quantity(
        200.0, "N·m/rad", "assumption: virtual spring as stiff as the leg", ge=0, le=1e4
    )
    band_deg: float = quantity(2.0, "deg", "assumption: half the band without torque", ge=0, le=90)
    torque_limit_n_m: float = quantity(
        60.0, "N·m", "assumption: above half the moment of the heavy wearer", ge=0, le=500
    )


WEARER_KNEE = changed(
    UNCERTAIN_KNEE, {"plant.full_order": {}, "wearer": "leg", "controller": "torque"}
)
"""Default scenario: the full order of the cylinder under the weight of the shank, and a wearer."""

DEVICES = (
    ("miniHydrA, electro-hydraulic ankle", "0.03…2.26", "mean, 0…5 Hz", "Actuators 14(9), 443"),
    ("quasi-direct drive knee", "0.34", "rms of torque tracking", "T-RO 38(3), 2022"),
    ("knee device, unpowered", "1.03, 0.31", "reported, not checked", "RA-L 2018, 2019"),
    ("knee device, backdriven", "1.5, 0.5", "reported, not checked", "RA-L 2018, 2019"),
)
"""Name, torque in N·m, quantity and source of the torque between wearer and other devices."""

HELD, PAPER, LARGER, SIZED, UNLIMITED = (
    "motor held",
    "paper's pump",
    "larger pump",
    "sized pump",
    "motor without limits",
)
"""Names of the pumps."""
HIGHER = ", higher gains"
"""End of a design's name, if the design has the higher gains."""
INERTIA = f"{SIZED}, inertia of the shank"
"""Name of a design with the inertia m l² of the shank about the knee, and with lower gains."""
LOOPS = (PAPER, PAPER + HIGHER, INERTIA)
"""Names of the designs whose margins are computed. Other pumps have the same margins."""
HELPING = (PAPER, SIZED + HIGHER)
"""Names of the designs that help weak legs."""
Motion = tuple[float, float]
"""Cadence of walking in Hz and time to stand up in s. The number of the other motion is nan."""
ANY = "any"
"""Name of a wearer whose leg follows its path. Its mass and stiffness have no effect."""
ZERO = "zero torque"
"""Name of the mode without desired torque."""
_TRACE_POINTS = 600
_STANCE = ("stiffness_n_m_per_rad", "loss_modulus_n_m_per_rad", "damping_n_m_s_per_rad")
_SIGNALS = (*INTERACTION_SIGNALS, "knee_reference", "knee_angle", "motor_speed_command")
_METRICS = (
    *("rms_torque_n_m", "mean_torque_n_m", "peak_torque_n_m"),
    *("assistance_ratio", "power_from_wearer_w", "power_to_wearer_w"),
)


@dataclass(frozen=True)
class WearerTrace:
    """The last cycle of a run, as columns (n,). The columns are empty if the run failed."""

    time_s: tuple[float, ...] = ()
    leg_deg: tuple[float, ...] = ()
    knee_deg: tuple[float, ...] = ()
    torque_n_m: tuple[float, ...] = ()
    """Interaction torque τ_i of the wearer on the exoskeleton, positive in flexion."""


@dataclass(frozen=True)
class WearerRow:
    """One run. If the run failed, its numbers are nan, and ``failure`` has the reason.

    ``cadence_hz`` is nan for sit-to-stand, and ``rise_time_s`` is nan for walking.
    """

    design: str
    wearer: str
    mode: str
    cadence_hz: float
    rise_time_s: float
    rms_torque_n_m: float = math.nan
    mean_torque_n_m: float = math.nan
    peak_torque_n_m: float = math.nan
    assistance_ratio: float = math.nan
    power_from_wearer_w: float = math.nan
    power_to_wearer_w: float = math.nan
    deviation_deg: float = math.nan
    """Largest deviation of the leg from its path."""
    saturated_share: float = math.nan
    lowest_pressure_pa: float = math.nan
    """Lowest pressure of both chambers relative to the atmosphere; nan in reduced order."""
    failure: str = ""
    trace: WearerTrace = WearerTrace()

    @property
    def motion(self) -> str:
        """The motion in words."""
        if math.isnan(self.rise_time_s):
            return f"walking, {self.cadence_hz:g} Hz"
        return f"rising in {self.rise_time_s:g} s"


@dataclass(frozen=True)
class MarginRow:
    """Least margins of a design in reduced order, over the legs `WEARERS` and the knee angles.

    `kneexo.analysis.StiffnessInterval` describes the stiffnesses. Numbers are nan if a loop is
    unstable or does not rest.
    """

    design: str
    disk_margin: float = math.nan
    gain_margin: float = math.nan
    low_n_m_per_rad: float = math.nan
    high_n_m_per_rad: float = math.nan
    felt_n_m_per_rad: float = math.nan


@dataclass(frozen=True, repr=False)
class WearerResult(Result):
    """Rows of the legs that follow their path, of the weak legs, and of the margins."""

    transparency: tuple[WearerRow, ...]
    help: tuple[WearerRow, ...]
    margins: tuple[MarginRow, ...]
    scenario: Scenario
    settings: WearerSettings

    def results(self) -> dict[str, Any]:
        """Return all rows, without the traces, as plain data with units in the names."""
        parts = ("transparency", "help", "margins")
        return {
            part: [
                {name: value for name, value in asdict(row).items() if name != "trace"}
                for row in getattr(self, part)
            ]
            for part in parts
        }


def with_flow(scenario: Scenario, factor: float, gain: float = 1.0) -> Scenario:
    """Return a scenario with ``factor`` times the pump's displacement and ``gain`` times the gains.

    The gains apply to the flow, so K_p and K_i in (rad/s)/N shrink in inverse proportion to the
    displacement. The valves stay as they are, because larger make-up valves pass slow motions of
    the rod without load on a chamber, and so hide what the pump does.
    """
    gains = ("proportional_rad_s_per_n", "integral_rad_s2_per_n")
    scaling = {f"controller.{name}": gain / factor for name in gains}
    return changed(
        scaled(scenario, {DISPLACEMENT: factor}),
        {path: value_at(scenario, path) * number for path, number in scaling.items()},
    )


def designs(scenario: Scenario, settings: WearerSettings) -> dict[str, Scenario]:
    """Return a dictionary from the name of a design to a scenario with zero desired torque."""
    scenario = changed(scenario, {"controller.mode": "zero_torque", "wearer.motion": "prescribed"})
    flows = {
        PAPER: 1.0,
        LARGER: settings.flow_factor,
        SIZED: settings.sized_flow_factor,
        UNLIMITED: settings.unlimited_flow_factor,
    }
    load: Any = scenario.plant.load  # a scenario with a wearer has a load
    shank = {
        "plant.load.inertia_kg_m2": load.segment_mass_kg * load.centre_of_mass_m**2,
        "load_cell.filter_s": settings.inertia_filter_s,
    }
    return {
        HELD: changed(scenario, {"controller.command_limit_rad_s": 1e-3}),
        **{
            name + end: with_flow(scenario, flow, gain)
            for end, gain in (("", 1.0), (HIGHER, settings.gain_factor))
            for name, flow in flows.items()
        },
        INERTIA: with_flow(
            changed(scenario, shank), settings.sized_flow_factor, settings.inertia_gain_factor
        ),
    }


def modes(settings: WearerSettings, assisting: bool) -> dict[str, dict[str, Any]]:
    """Return a dictionary from the name of a mode to values of a scenario.

    The shares of the biological moment are among the modes only if ``assisting``.
    """
    law = {
        "controller.stiffness_n_m_per_rad": settings.virtual_stiffness_n_m_per_rad,
        "controller.band_rad": math.radians(settings.band_deg),
        "controller.torque_limit_n_m": settings.torque_limit_n_m,
    }
    assist = law | {"controller.mode": "assist"}
    return {
        ZERO: {},
        **{
            f"assist {share:g}": assist | {"controller.assistance": share}
            for share in settings.shares
            if assisting
        },
        "virtual spring": law | {"controller.mode": "impedance"},
        "spring outside band": law | {"controller.mode": "assist_as_needed"},
    }


def in_motion(
    scenario: Scenario, settings: WearerSettings, motion: Motion, body: str = ""
) -> Scenario:
    """Return the scenario with walking or sit-to-stand.

    In sit-to-stand the shank stays upright, so its weight has no moment. With one of the `BODIES`,
    the leg is active. The leg then has the stiffness and damping of stance, in proportion to the
    mass. In walking the path of this leg is more flexed, and the muscles give the share ``effort``
    of the biological moment.
    """
    cycles = settings.cycles
    values: dict[str, Any] = {"wearer.moment": None, "wearer.effort": 1.0}
    cadence_hz, rise_time_s = motion
    walks = math.isnan(rise_time_s)
    if walks:
        reference = gait_reference(cadence_hz, cycles)
    else:
        reference = sit_to_stand_reference(rise_time_s, cycles)
        values["plant.load.segment_mass_kg"] = 0.0
    path = dict(reference)
    if body:
        mass, height = BODIES[body]
        stance = WEARERS["stance"]
        values |= {f"wearer.{name}": value for name, value in leg_of_body(mass, height).items()}
        values |= {
            f"wearer.{name}": getattr(stance, name) * mass / MOMENT_MASS_KG for name in _STANCE
        }
        values["wearer.motion"] = "active"
        if walks:
            moment = gait_moment(cadence_hz, cycles, body_mass_kg=mass)
            values |= {"wearer.moment": dict(moment), "wearer.effort": settings.effort}
            path["angles_deg"] = [angle + settings.crouch_deg for angle in reference.angles_deg]
    return changed(
        scenario, values | {"simulation.duration_s": reference.times_s[-1], "reference": path}
    )


# --------------------------------------------------------- pieces of work: plain data in, out


@needs_runs
def measured(cycles: int, scenario: Scenario) -> dict[str, Any]:
    """Simulate a scenario; return the fields of a `WearerRow` over all cycles after the first."""
    has_moment = scenario.wearer.kind == "leg" and scenario.wearer.moment is not None
    has_chambers = scenario.plant.full_order is not None
    signals = list(_SIGNALS)
    if has_moment:
        signals.append("biological_moment")
    if has_chambers:
        signals.append("chamber_pressures")
    period_s = scenario.duration_s / cycles
    row: dict[str, Any] = {}
    with failure_noted(row):
        run = simulate(scenario, signals=tuple(signals))
        metrics = asdict(interaction_metrics(run, period_s=period_s))
        counts = run.time_s >= metrics["start_s"] - 1e-9
        deviation_rad = (run["wearer_angle_rad"] - run["knee_reference_rad"])[counts]
        command_rad_s = run["motor_speed_command_rad_s"][counts]
        columns = SIGNALS["chamber_pressures"] if has_chambers else ()
        pressures_pa = [run[name][counts] for name in columns] or [math.nan]
        row |= {name: metrics[name] for name in _METRICS}
        row["deviation_deg"] = math.degrees(float(np.max(np.abs(deviation_rad))))
        row["saturated_share"] = saturated_share(command_rad_s, scenario.command_limit_rad_s)
        row["lowest_pressure_pa"] = float(np.min(pressures_pa))
        row["trace"] = _trace(run, period_s)
    return row


def _trace(run: Run, period_s: float) -> dict[str, list[float]]:
    """Return the last cycle of a run as data of a `WearerTrace`."""
    time_in_cycle = np.linspace(0.0, period_s, _TRACE_POINTS + 1)
    time_in_run = run.time_s[-1] - period_s + time_in_cycle
    columns = {
        "leg_deg": np.degrees(run["wearer_angle_rad"]),
        "knee_deg": np.degrees(run["knee_angle_rad"]),
        "torque_n_m": run["interaction_torque_n_m"],
    }
    trace = {"time_s": time_in_cycle.tolist()}
    for name, values in columns.items():
        trace[name] = np.interp(time_in_run, run.time_s, values).tolist()
    return trace


def margins(postures_deg: tuple[float, ...], scenario: Scenario) -> dict[str, float]:
    """Return margins and stiffnesses of a design: the fields of `MarginRow` except ``design``."""
    reduced = changed(scenario, {"plant.full_order": None, "plant.bypass": None})
    with suppress(LinearizationError):
        loops = coupled_stability(reduced, knee_angles_deg=postures_deg)
        springs = stiffness_interval(reduced)
        return {
            "disk_margin": float(loops.disk_margin.min()),
            "gain_margin": float(loops.gain_margin.min()),
            "low_n_m_per_rad": springs.low_n_m_per_rad,
            "high_n_m_per_rad": springs.high_n_m_per_rad,
            "felt_n_m_per_rad": springs.felt_n_m_per_rad,
        }
    return {}


# ---------------------------------------------------------------------------------- study


def wearer_study(
    scenario: Scenario = WEARER_KNEE,
    settings: WearerSettings = WearerSettings(),
    **options: Unpack[SweepOptions],
) -> WearerResult:
    """Measure the torque that a wearer feels, and the help that a weak wearer gets.

    1. The leg follows walking or sit-to-stand exactly, and the desired torque is zero. The
       designs have other pumps and gains. The study also computes their margins.
    2. Weak legs of light, average and heavy wearers yield to the torque of the cuff. The modes of
       the controller help these wearers.

    The row of a run that fails has nan.

    Parameters
    ----------
    scenario
        A scenario with a wearer and a torque controller. The study replaces the reference, the
        motion of the leg and the mode of the controller.
    settings
        Frequencies, designs and wearers.
    options
        Workers, checkpoint and progress: see `kneexo.sweeps.SweepOptions`.

    Raises
    ------
    ParameterError
        The scenario has no wearer, or another controller.
    """
    if scenario.wearer.kind != "leg" or scenario.controller.kind != "torque":
        raise ParameterError(
            f"wearer.kind = {scenario.wearer.kind}, controller.kind = {scenario.controller.kind}: "
            f"must be leg and torque; add wearer: leg, controller: torque"
        )
    scenario = scenario.undisturbed()
    by_design = designs(scenario, settings)
    cases = list(_cases(by_design, settings))
    with open_sweep(**options) as sweep:
        numbers = sweep.map(
            partial(measured, settings.cycles), [case for _, case in cases], "torque of wearers"
        )
        stability = sweep.map(
            partial(margins, settings.postures_deg), [by_design[name] for name in LOOPS], "margins"
        )
    rows = [
        TypeAdapter(WearerRow).validate_python(labels | row)
        for (labels, _), row in zip(cases, numbers, strict=True)
    ]
    return WearerResult(
        transparency=tuple(row for row in rows if row.wearer == ANY),
        help=tuple(row for row in rows if row.wearer != ANY),
        margins=tuple(
            MarginRow(name, **numbers) for name, numbers in zip(LOOPS, stability, strict=True)
        ),
        scenario=scenario,
        settings=settings,
    )


def _cases(
    by_design: Mapping[str, Scenario], settings: WearerSettings
) -> Iterator[tuple[dict[str, Any], Scenario]]:
    """Yield the labels of each `WearerRow`, and its scenario. Only the average wearer stands up."""
    for design, case in by_design.items():
        for motion in _motions(settings.cadences_hz, settings.rise_times_s):
            yield _labels(design, ANY, ZERO, motion), in_motion(case, settings, motion)
    for design in HELPING:
        for motion in _motions(settings.help_cadences_hz, settings.help_rise_times_s):
            walks = math.isnan(motion[1])
            for body in BODIES if walks else ("average",):
                case = in_motion(by_design[design], settings, motion, body)
                for mode, values in modes(settings, assisting=walks).items():
                    yield _labels(design, body, mode, motion), changed(case, values)


def _motions(cadences_hz: tuple[float, ...], rise_times_s: tuple[float, ...]) -> list[Motion]:
    """Return walking at each cadence, then sit-to-stand with each rise time."""
    walking = [(cadence, math.nan) for cadence in cadences_hz]
    return walking + [(math.nan, time) for time in rise_times_s]


def _labels(design: str, wearer: str, mode: str, motion: Motion) -> dict[str, Any]:
    labels = {"design": design, "wearer": wearer, "mode": mode}
    return labels | dict(zip(("cadence_hz", "rise_time_s"), motion, strict=True))
