"""The verdict on a run in a few lines about tracking, torques, saturation and stability."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from html import escape
from typing import Any

import numpy as np

from kneexo.analysis.linear.margins import Margins
from kneexo.analysis.linear.sampled_loop import SampledLoop, linearize_loop
from kneexo.analysis.signals import (
    period_s,
    rms,
    saturated_share,
    settled_s,
    share_above,
    to_rpm,
)
from kneexo.analysis.tracking.clauses import said
from kneexo.analysis.tracking.interaction import (
    INTERACTION_SIGNALS,
    TORQUE_SIGNALS,
    InteractionMetrics,
    interaction_metrics,
    torque_error,
    whole_periods,
)
from kneexo.analysis.tracking.limit_cycle import LimitCycle, limit_cycle
from kneexo.analysis.tracking.notices import model_lines, notices, omissions, wrapped
from kneexo.analysis.tracking.stop import Stop, first_stop, peak_motor_current_a
from kneexo.common.result import Result
from kneexo.diagrams.signals import columns
from kneexo.errors import KneexoError
from kneexo.geometry.linkage import pose
from kneexo.parameters import Scenario
from kneexo.parameters.device.plant import LOWEST_PRESSURE_PA
from kneexo.simulation import Run
from kneexo.systems.knee_reference import run_middle_deg, run_range_deg

ERROR_SHARE = 2.0 / 30.0
"""A run tracks if its largest error is at most this share of the reference's amplitude.

Section 5 of the paper: the error with the sliding-mode controller was less than 2° at an amplitude
of 30°.
"""

LARGEST_COUNT_DEG = ERROR_SHARE * 30.0
"""Largest error in deg of a run that tracks because of the encoder's counts.

A run with a small motion may have an error of one count of the encoder. With a coarser encoder the
bound stays at the paper's error for the paper's amplitude of 30°.
"""

_VALUES = ("tracks", "max_error_deg", "max_error_time_s", "error_bound_deg", "saturated_share",
    "pressure_over_rating_share", "relief_share", "power_over_rating_share", "torque_error_rms_n_m",
    "peak_motor_current_a",
)  # fmt: skip
"""Names of the fields of `Verdict` that its plain data contain as they are."""

LARGEST_INTERVAL = 10.0
"""Smallest interval between two samples of a reference, in medians of all, that is a gap."""

_UNLIMITED_RPM = 1e6
"""Motors are slower, so a higher limit of the command means no limit."""


MODE_SWITCHING_HZ = 20.0
"""Least frequency in Hz at which the load pressure changes its sign in mode switching.

Assumption: the oscillation of the default cylinder has 130…200 Hz, and no knee moves at 20 Hz.
"""

_OBSERVED_S = 0.5
"""Time in s within which mode switching is counted."""


@dataclass(frozen=True, repr=False)
class Stability(Result):
    """Stability of the sampled loop at a constant knee angle.

    Without a linear loop ``stable`` is None, and ``failure`` is the reason. ``margins`` is None
    unless the loop is stable.
    """

    knee_angle_deg: float
    stable: bool | None
    largest_eigenvalue: float = math.nan
    margins: Margins | None = None
    sample_time_s: float = math.nan
    failure: str = ""

    @classmethod
    def of_loop(cls, loop: SampledLoop) -> Stability:
        """Return the largest eigenvalue of a linear loop, and the margins if the loop is stable."""
        return cls(
            math.degrees(loop.knee_angle_rad),
            loop.stable,
            float(abs(loop.eigenvalues[0])),
            loop.margins() if loop.stable else None,
            loop.sample_time_s,
        )

    @classmethod
    def of_scenario(cls, scenario: Scenario) -> Stability:
        """Return the stability of a scenario's loop in the middle of its `run_range_deg`."""
        angle = run_middle_deg(scenario)
        try:
            return cls.of_loop(linearize_loop(scenario, knee_angle_deg=angle))
        except KneexoError as error:
            return cls(angle, None, failure=str(error))

    @property
    def line(self) -> str:
        """One line with the margins, or with the reason why there are none."""
        at = f"at {self.knee_angle_deg:.3g}°"
        if self.stable is None:
            return f"No margins {at}: {self.failure}"
        if self.margins is None:
            return (
                f"Not stable {at}: the largest eigenvalue of the sampled loop is "
                f"{self.largest_eigenvalue:.6g}, and must be below 1."
            )
        m = self.margins
        gain = "infinite"
        if math.isfinite(m.gain_margin):
            gain = f"{m.gain_margin:.3g} ({_two_digits(20.0 * math.log10(m.gain_margin))} dB)"
        if m.lower_gain_margin > 0.0:
            gain += f" and {m.lower_gain_margin:.3g}"
        phase, delay = "infinite", "infinite"
        if math.isfinite(m.phase_margin_deg):
            samples = math.floor(m.delay_margin_s / self.sample_time_s)
            phase = f"{m.phase_margin_deg:.3g}°"
            delay = f"{1e3 * m.delay_margin_s:.3g} ms ({samples} samples)"
        return f"Stable {at}: gain margin {gain}, phase margin {phase}, delay margin {delay}."


def loop_lines(loop: SampledLoop) -> tuple[str, ...]:
    """Return lines with the stability, margins and bandwidths of a linear loop.

    An unstable loop has one line, because it has neither margins nor bandwidth. A torque controller
    does not follow the knee reference, so it has only the bandwidth of the feedback.
    """
    stability = Stability.of_loop(loop)
    m = stability.margins
    if m is None:
        return (stability.line,)
    none = f"none below {0.5 / loop.sample_time_s:g} Hz"
    crossings, bandwidths = (
        ["none" if math.isnan(f) else f"{f:.3g} Hz" for f in frequencies]
        for frequencies in (
            (m.phase_margin_frequency_hz, m.gain_margin_frequency_hz),
            (loop.bandwidth_hz(), loop.complementary_sensitivity_bandwidth_hz()),
        )
    )
    with_feedforward, feedback = (none if text == "none" else text for text in bandwidths)
    bandwidth = f" (−3 dB, small signals): {with_feedforward}; of the feedback alone: {feedback}."
    if loop.scenario.controller.kind == "torque":
        bandwidth = f" of the feedback (−3 dB, small signals): {feedback}."
    return (
        stability.line,
        f"Crossover: gain {crossings[0]}, phase {crossings[1]}. Disk margin {m.disk_margin:.3g}: "
        f"gain {m.disk_gain_margin:.3g}, phase {m.disk_phase_margin_deg:.3g}°.",
        f"Bandwidth{bandwidth}",
    )


@dataclass(frozen=True, repr=False)
class Verdict(Result):
    """The verdict on a run. ``print`` shows the verdict in a few lines.

    A run tracks if its largest error after the first period of a sinusoidal reference is at most
    ``error_bound_deg``. This bound is `ERROR_SHARE` of the amplitude, but at least the largest knee
    angle of one count of the encoder, or `LARGEST_COUNT_DEG` if a count is larger. The amplitude is
    half the range of the reference within the run (`run_range_deg`). For another reference, and for
    a run of less than two periods, the error of the whole run counts. A run with a step tracks if
    its knee angle settles (`StepMetrics`). A torque controller does not control the knee angle, so
    ``tracks`` is None.

    Shares are shares of all samples of the run.
    """

    tracks: bool | None
    max_error_deg: float
    max_error_time_s: float
    """Time of the largest error."""
    error_bound_deg: float
    saturated_share: float
    """Share of the run with the command at its limit."""
    pressure_over_rating_share: float
    """Share of the run with a load pressure above the cylinder's rating."""
    relief_share: float
    """Share of the run in which a chamber has the relief pressure; nan in the reduced order."""
    power_over_rating_share: float
    """Share of the run with a shaft power above the motor's rating."""
    stability: Stability
    omissions: tuple[str, ...]
    notices: tuple[str, ...]
    lines: tuple[str, ...]
    """Lines on a stop, tracking, a limit cycle, torques, saturation and the margins of the loop.

    A run without wearer and torque controller has no line on torques. A run with torque controller
    has no line on tracking. A run that the protection stops has neither errors of angle or torque
    nor a line that nothing saturates, because they describe the knee at rest.
    """
    model_lines: tuple[str, ...]
    """What the model leaves out, and the notices, as text for a terminal."""
    interaction: InteractionMetrics | None = None
    """Metrics of the interaction with a wearer; None without wearer."""
    torque_error_rms_n_m: float = math.nan
    """Root mean square of desired minus actual torque of the actuator on the knee.

    The mean is over the same samples as the metrics of the interaction (`whole_periods`). The value
    is nan without a torque controller.
    """
    limit_cycle: LimitCycle | None = None
    """Oscillation of the knee while the reference rests at the end of the run, or None."""
    stop: Stop | None = None
    """The first stop of the protection, or None."""
    peak_motor_current_a: float = math.nan
    """Largest current of the motor, also just after a brake engages; nan without its limits."""

    @property
    def text(self) -> str:
        """The ``lines`` wrapped to the width of the terminal, and the `model_lines`."""
        return "\n".join((*map(wrapped, self.lines), *self.model_lines))

    def results(self) -> dict[str, Any]:
        """Return the verdict as plain data for JSON: ``lines``, and their values by name."""
        margins, stability = self.stability.margins, self.stability
        names = ("gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin")
        return {
            "lines": list(self.lines),
            **{name: getattr(self, name) for name in _VALUES},
            "knee_angle_deg": stability.knee_angle_deg,
            "stable": stability.stable,
            **{name: getattr(margins, name, math.nan) for name in names},
            "margins_failure": stability.failure,
            "interaction": None if self.interaction is None else asdict(self.interaction),
            "limit_cycle": None if self.limit_cycle is None else asdict(self.limit_cycle),
            "stop": None if self.stop is None else asdict(self.stop),
            "omissions": list(self.omissions),
            "notices": list(self.notices),
        }

    def __repr__(self) -> str:
        """Return `text`."""
        return self.text

    def _repr_html_(self) -> str:
        """Return `text` as HTML with a line break after each line."""
        return escape(self.text).replace("\n", "<br>")


def verdict_of(scenario: Scenario, run: Run, *, step: tuple[bool, str] | None) -> Verdict:
    """Return the `Verdict` on a run. Linearizes the loop of its scenario.

    ``step`` says whether the response to a step settles, and describes it in one line. ``step`` is
    None if the reference has no step.
    """
    stop = first_stop(scenario, run)
    tracking, tracking_lines = _tracking(scenario, run, step)
    if stop is not None:
        tracking_lines = [stop.line]
    torques, torque_lines = _torques(scenario, run, stop)
    cycle, limits = limit_cycle(run), _limits(scenario, run)
    saturation = _saturation(limits, stop)
    peak_a, logged_a = peak_motor_current_a(scenario, run)
    cycle_lines = [] if cycle is None else [cycle.line]
    stability = Stability.of_scenario(scenario)
    notes = (
        *notices(scenario),
        *_gap_notices(scenario, run),
        *_pressure_notices(scenario, run),
        *_fault_notices(scenario, run),
        *_current_notices(peak_a, logged_a),
    )
    return Verdict(
        **tracking,
        **torques,
        saturated_share=limits["command"].share,
        pressure_over_rating_share=limits["pressure"].share,
        relief_share=limits["relief"].share,
        power_over_rating_share=limits["power"].share,
        stability=stability,
        omissions=omissions(scenario),
        notices=notes,
        lines=(*tracking_lines, *cycle_lines, *torque_lines, *saturation, stability.line),
        model_lines=tuple(model_lines(scenario, notes)),
        limit_cycle=cycle,
        stop=stop,
        peak_motor_current_a=peak_a,
    )


def _tracking(
    scenario: Scenario, run: Run, step: tuple[bool, str] | None
) -> tuple[dict[str, Any], list[str]]:
    """Return the fields of the `Verdict` that describe tracking, and the line on tracking.

    With torque control there is no line. `verdict_of` describes ``step``.
    """
    error_deg = np.degrees(np.abs(run["knee_reference_rad"] - run["knee_angle_rad"]))
    first = int(np.searchsorted(run.time_s, settled_s(scenario) - 1e-9))
    worst = first + int(np.argmax(error_deg[first:]))
    max_error_deg, time_s = float(error_deg[worst]), float(run.time_s[worst])
    bound_deg, reason = _error_bound(scenario)
    tracks: bool | None = max_error_deg <= bound_deg
    fields = {
        "max_error_deg": max_error_deg,
        "max_error_time_s": time_s,
        "error_bound_deg": bound_deg,
    }
    lines = [f"{said('tracks' if tracks else 'does not track', **fields)} ({reason})."]
    if scenario.controller.kind == "torque":
        tracks, lines = None, []
    elif step is not None:
        tracks, lines = step[0], [step[1]]
    return {"tracks": tracks, **fields}, lines


def _torques(scenario: Scenario, run: Run, stop: Stop | None) -> tuple[dict[str, Any], list[str]]:
    """Return the fields of the `Verdict` that describe torques, and the lines on torques.

    If the run has the signals, one line describes the interaction with a wearer, and one line
    describes the error of the torque, unless the protection stops the run.
    """
    fields, lines = dict[str, Any](), []
    if set(columns(INTERACTION_SIGNALS)) <= set(run.data):
        interaction = interaction_metrics(run, period_s=period_s(scenario))
        fields["interaction"] = interaction
        law, line, ratio = scenario.controller, interaction.line, interaction.assistance_ratio
        if law.kind == "torque" and law.mode == "assist" and not math.isnan(ratio):
            line = f"{line.removesuffix('.')} (requested {law.assistance:.3g})."
        lines.append(line)
    if set(columns(TORQUE_SIGNALS)) <= set(run.data):
        window = whole_periods(run.time_s, period_s(scenario))
        error, time_s = torque_error(run)[window], run.time_s[window]
        worst = int(np.argmax(np.abs(error)))
        desired = np.max(np.abs(run["desired_torque_n_m"][window]))
        fields["torque_error_rms_n_m"] = rms(error)
        line = (
            f"Torque error {rms(error):.3g} N·m rms, peak {abs(error[worst]):.3g} N·m at "
            f"{time_s[worst]:.4g} s; the desired torque reaches {desired:.3g} N·m."
        )
        lines += [] if stop else [line]
    return fields, lines


def _fault_notices(scenario: Scenario, run: Run) -> Iterator[str]:
    """Yield a line that says when faults were active, or that none was."""
    if not scenario.faults:
        return
    active = run["active_faults"]
    samples = np.flatnonzero(active)
    if later := [f.begin_s for f in scenario.faults if f.begin_s > scenario.duration_s]:
        yield f"a fault begins after the run by its mttf_s: at {min(later):.4g} s"
    elif not samples.size:
        yield "no fault was active, because no signal passed its threshold; change above or below"
    if not samples.size:
        return
    first, last = run.time_s[samples[[0, -1]]]
    count = len(scenario.faults)
    faults = "1 fault" if count == 1 else f"{count} faults"
    yield (
        f"{faults}: at most {active.max():.0f} at once, the first from {first:.4g} s, the last "
        f"until {last:.4g} s; margins are those without faults"
    )


def _current_notices(peak_a: float, logged_a: float) -> Iterator[str]:
    """Yield a line if a dynamic brake has a larger current than the log of the run."""
    if peak_a > logged_a:
        yield (
            f"the current of the brake reaches {peak_a:.3g} A as it engages; signals.csv shows at "
            f"most {logged_a:.3g} A, because its rows are before the updates of the controller"
        )


def _gap_notices(scenario: Scenario, run: Run) -> Iterator[str]:
    """Yield a line if samples of the reference are missing, with the errors there and elsewhere."""
    if scenario.reference.kind != "samples":
        return
    times = np.array(scenario.reference.times_s)
    steps, after = np.diff(times), np.searchsorted(times, run.time_s)
    step = np.pad(steps, 1)[after]  # 0 before the first and after the last sample
    is_gap = step >= LARGEST_INTERVAL * np.median(steps)
    if not is_gap.any() or is_gap.all():
        return
    end = after[np.argmax(step)]
    error_deg = np.degrees(np.abs(run["knee_reference_rad"] - run["knee_angle_rad"]))
    yield (
        f"the reference has gaps, the longest from {times[end - 1]:.6g} to {times[end]:.6g} s, in "
        f"which its curve is a guess: largest error {error_deg[is_gap].max():.3g}° there, "
        f"{error_deg[~is_gap].max():.3g}° elsewhere"
    )


def _pressure_notices(scenario: Scenario, run: Run) -> Iterator[str]:
    """Yield lines on pressures of a run that a user should know of.

    In the reduced order, which has no relief valves, a wearer can exceed the rated pressure. In the
    full order the load can change between the chambers again and again, which is mode switching
    (`kneexo.systems.FullCylinder`), and a chamber can fall below `LOWEST_PRESSURE_PA`.
    """
    peak = np.max(np.abs(run["load_pressure_pa"]))
    reduced_order = scenario.plant.full_order is None and scenario.wearer.kind != "none"
    if reduced_order and peak > scenario.pressure_rating_pa:
        yield (
            f"the load pressure reaches {1e-6 * peak:.3g} MPa, because the reduced order has no "
            f"relief valves, so torques are too large; add plant: {{full_order: true}}"
        )
    chambers = {
        name: run[column]
        for name, column in (("cap", "cap_pressure_pa"), ("rod side", "rod_side_pressure_pa"))
        if column in run.data
    }
    if not chambers:
        return
    # After a change of sign, the number of changes within a time.
    changes_s = run.time_s[1:][np.diff(np.signbit(run["load_pressure_pa"]))]
    counts = np.searchsorted(changes_s, changes_s + _OBSERVED_S) - np.arange(changes_s.size)
    often = np.flatnonzero(counts >= 2.0 * MODE_SWITCHING_HZ * _OBSERVED_S)
    if often.size:
        yield (
            f"mode switching: from {changes_s[often[0]]:.4g} s on the load changes the chamber "
            f"{counts[often[0]]} times within {_OBSERVED_S:g} s, and the speed of the rod swings; "
            f"friction of the seals damps this: raise plant.full_order.coulomb_friction_n"
        )
    name, pressure = min(chambers.items(), key=lambda item: float(item[1].min()))
    index = int(np.argmin(pressure))
    if pressure[index] < LOWEST_PRESSURE_PA:
        yield (
            f"the pressure of the {name} falls to {1e-6 * pressure[index]:.3g} MPa at "
            f"{run.time_s[index]:.4g} s and {math.degrees(run['knee_angle_rad'][index]):.3g}°, "
            f"below {1e-6 * LOWEST_PRESSURE_PA:g} MPa, where oil evaporates; enlarge "
            f"plant.full_order.makeup_conductance_m3_per_s_pa or the flow of the pump"
        )


def _error_bound(scenario: Scenario) -> tuple[float, str]:
    """Return the largest error in deg of a run that tracks, and the reason in words."""
    low_deg, high_deg = run_range_deg(scenario)
    amplitude_deg = 0.5 * (high_deg - low_deg)
    angles = np.radians(np.linspace(low_deg, high_deg, 91))
    sensitivity = np.max(np.abs(pose(scenario.plant.linkage, angles).encoder_sensitivity))
    count_deg = 360.0 / scenario.encoder.counts_per_revolution * float(sensitivity)
    if min(count_deg, LARGEST_COUNT_DEG) > ERROR_SHARE * amplitude_deg:
        if count_deg > LARGEST_COUNT_DEG:
            return LARGEST_COUNT_DEG, f"one count of the encoder is {count_deg:.3g}°"
        return count_deg, "one count of the encoder"
    share = f"1/{1.0 / ERROR_SHARE:.3g}"
    return ERROR_SHARE * amplitude_deg, f"{share} of the amplitude of {amplitude_deg:.3g}°"


@dataclass(frozen=True)
class _Limit:
    """A limit of the hardware, with the share of the run in which the knee reaches the limit."""

    share: float
    reached: str
    """What happens at the limit."""
    largest: str
    """The largest value of the run beside the limit."""


def _limits(scenario: Scenario, run: Run) -> dict[str, _Limit]:
    """Return the limits of the command, the load pressure, the chambers and the power by name."""
    full = scenario.plant.full_order if scenario.parts.cylinder is None else None
    command, limit = run["motor_speed_command_rad_s"], scenario.command_limit_rad_s
    pressure, rating = run["load_pressure_pa"], scenario.pressure_rating_pa
    power, rated_w = run["shaft_power_w"], scenario.power_rating_w
    relief_share = math.nan
    if full is not None and "cap_pressure_pa" in run.data:
        chambers = np.maximum(run["cap_pressure_pa"], run["rod_side_pressure_pa"])
        relief_share = share_above(chambers, full.relief_pressure_pa)
    rpm, limit_rpm = to_rpm(np.max(np.abs(command))), to_rpm(limit)
    of_limit = f" of {limit_rpm:.4g}" if limit_rpm < _UNLIMITED_RPM else ""
    of_rating = f" of {1e-6 * rating:.3g}" if rating < math.inf else ""
    of_power = f" of {rated_w:.3g}" if rated_w < math.inf else ""
    return {
        "command": _Limit(
            saturated_share(command, limit),
            f"command at its limit of {limit_rpm:.4g} rpm",
            f"command {rpm:.4g}{of_limit} rpm",
        ),
        "pressure": _Limit(
            share_above(pressure, rating),
            f"pressure above {1e-6 * rating:.3g} MPa",
            f"pressure {1e-6 * np.max(np.abs(pressure)):.2g}{of_rating} MPa",
        ),
        "relief": _Limit(relief_share, "relief valves open", ""),
        "power": _Limit(
            share_above(power, rated_w),
            f"power above {rated_w:.3g} W",
            f"power {np.max(np.abs(power)):.2g}{of_power} W",
        ),
        **_torque_limits(scenario, run),
    }


def _torque_limits(scenario: Scenario, run: Run) -> dict[str, _Limit]:
    """Return the limits of the desired torque and of the load cell, of a torque controller."""
    law, cell = scenario.controller, scenario.load_cell
    if law.kind != "torque" or not set(columns(TORQUE_SIGNALS)) <= set(run.data):
        return {}
    limit, force = law.torque_limit_n_m, run["rod_force_n"] + cell.offset_n
    return {
        "desired torque": _Limit(
            saturated_share(run["desired_torque_n_m"], limit),
            f"desired torque at its limit of {limit:.4g} N·m",
            "",
        ),
        "load cell": _Limit(
            share_above(force, cell.range_n),
            f"load cell beyond its range of {cell.range_n:.4g} N",
            "",
        ),
    }


def _saturation(limits: Mapping[str, _Limit], stop: Stop | None) -> list[str]:
    """Return one line that says which limits the run reaches, and for which share of its time.

    A run that the protection stops has no line that nothing saturates.
    """
    reached = [
        f"{limit.reached} for {_two_digits(100.0 * limit.share)} % of the run"
        for limit in limits.values()
        if limit.share > 0.0
    ]
    if limits["command"].share > 0.5:
        return [f"Saturated most of the time, which the margins leave out: {', '.join(reached)}."]
    if reached or stop:
        return [f"Saturates: {', '.join(reached)}."] if reached else []
    largest = [limit.largest for limit in limits.values() if limit.largest]
    return [f"Nothing saturates: {', '.join(largest)}."]


def _two_digits(value: float) -> str:
    """Return ``value``, rounded to two digits, as text. A number from 100 on has no exponent."""
    return f"{float(f'{value:.2g}'):g}"
