"""Reports of the commands ``simulate`` and ``linearize`` in Markdown, for their HTML pages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from kneexo.analysis.signals import settled_s, to_rpm
from kneexo.analysis.tracking.tracking import SETTLING_BAND
from kneexo.parameters.criteria import SOUND_DISK_MARGIN
from kneexo.studies.markdown import document, markdown_table, number

if TYPE_CHECKING:
    from kneexo.analysis import PlantLinearization, SampledLoop, TrackingResult
    from kneexo.analysis.linear.margins import Margins

Row = tuple[str, ...]
"""The cells of a row of a table."""


def tracking_report(result: TrackingResult) -> str:
    """Return the report on a run in Markdown: findings, values with limits, other values."""
    verdict = result.verdict
    return document(
        "# A run under torque control"
        if verdict.tracks is None
        else "# A run beside its reference",
        _bullets(*verdict.lines, *verdict.model_lines),
        "## Limits",
        markdown_table(("quantity", "largest value", "limit", "verdict"), _limits(result)),
        "## More numbers",
        markdown_table(("quantity", "value"), _numbers(result)),
    )


def _limits(result: TrackingResult) -> Iterator[Row]:
    """Yield a row for each limit of a run, with the verdict on the run's largest value."""
    scenario, metrics, verdict = result.scenario, result.metrics, result.verdict
    plant, run, step = scenario.plant, result.run, result.step
    if step is not None and verdict.stop is None:
        band_deg = SETTLING_BAND * abs(step.step_deg)
        yield (
            "error after the step",
            f"{number(step.final_error_deg)}° at the end",
            f"{number(band_deg)}° ({100.0 * SETTLING_BAND:g} % of the step)",
            "settles" if step.settles else "does not settle",
        )
    elif verdict.tracks is not None and verdict.stop is None:
        yield (
            "tracking error",
            f"{number(verdict.max_error_deg)}° at {verdict.max_error_time_s:.4g} s",
            f"{number(verdict.error_bound_deg)}°",
            "tracks" if verdict.tracks else "does not track",
        )
    command_rpm = f"{number(metrics.peak_command_rpm)} rpm"
    limit_rpm = to_rpm(scenario.command_limit_rad_s)
    share = verdict.saturated_share
    yield ("motor speed command", command_rpm, f"{number(limit_rpm)} rpm", _over(share, "at"))
    rated = verdict.pressure_over_rating_share
    pressure, rating = metrics.peak_pressure_mpa, 1e-6 * plant.cylinder.pressure_rating_pa
    yield ("load pressure", f"{number(pressure)} MPa", f"{number(rating)} MPa", _over(rated))
    if plant.full_order is not None and "cap_pressure_pa" in run.data:
        chambers = np.maximum(run["cap_pressure_pa"], run["rod_side_pressure_pa"])
        value, relief = 1e-6 * float(np.max(chambers)), 1e-6 * plant.full_order.relief_pressure_pa
        opened = _over(verdict.relief_share, "at")
        yield ("pressure of a chamber", f"{number(value)} MPa", f"{number(relief)} MPa", opened)
    power, rated_w = metrics.peak_shaft_power_w, plant.pump.rated_power_w
    over = _over(verdict.power_over_rating_share)
    yield ("motor power", f"{number(power)} W", f"{number(rated_w)} W", over)
    stability = verdict.stability
    name = f"eigenvalue of the sampled loop at {number(stability.knee_angle_deg)}°"
    if stability.stable is None:
        yield (name, "–", "1", "no linear loop")
    else:
        word = "stable" if stability.stable else "not stable"
        yield (name, f"{stability.largest_eigenvalue:.6g}", "1", word)


def _over(share: float, where: str = "above") -> str:
    """Return the verdict on a limit that a run reaches for a ``share`` of its time."""
    return f"{where} the limit for {number(100.0 * share)} %" if share > 0.0 else "below the limit"


def _numbers(result: TrackingResult) -> Iterator[Row]:
    """Yield the metrics of a run that have no limit."""
    m, verdict, step = result.metrics, result.verdict, result.step
    if step is not None:
        yield ("rise time, 10 … 90 %", _with_unit(step.rise_time_s, "s"))
        yield ("overshoot", _with_unit(step.overshoot_percent, "%"))
        yield ("settling time", _with_unit(step.settling_time_s, "s"))
        yield ("final error", _with_unit(step.final_error_deg, "°"))
    if not math.isnan(verdict.peak_motor_current_a):
        yield ("motor current, largest", _with_unit(verdict.peak_motor_current_a, "A"))
    if (cycle := verdict.limit_cycle) is not None:
        low, high = cycle.lowest_pressure_mpa, cycle.highest_pressure_mpa
        yield ("limit cycle at rest, amplitude", f"{number(cycle.amplitude_deg)}° of the knee")
        yield ("limit cycle at rest, period", _with_unit(cycle.period_s, "s"))
        yield ("limit cycle at rest, load pressure", f"{number(low)} … {number(high)} MPa")
    first = " after the first period" if settled_s(result.scenario) > 0.0 else ""
    if (torques := verdict.interaction) is not None:
        yield (f"interaction torque, root mean square{first}", _torque(torques.rms_torque_n_m))
        yield (f"interaction torque, mean magnitude{first}", _torque(torques.mean_torque_n_m))
        yield (f"interaction torque, largest{first}", _torque(torques.peak_torque_n_m))
        yield (
            f"mean power that the wearer gives{first}",
            _with_unit(torques.power_from_wearer_w, "W"),
        )
        yield (
            f"mean power that the wearer gets{first}",
            _with_unit(torques.power_to_wearer_w, "W"),
        )
        if not math.isnan(torques.assistance_ratio):
            yield (f"assistance ratio{first}", _percent(torques.assistance_ratio))
    if verdict.tracks is None:
        error = _torque(verdict.torque_error_rms_n_m)
        yield (f"torque error, root mean square{first}", error)
    error = "error" if verdict.tracks is not None else "distance from the reference"
    yield (f"{error}, root mean square{first}", _with_unit(m.rms_error_deg, "°"))
    if first and verdict.tracks is not None:
        yield ("largest error of the whole run", _with_unit(m.max_error_overall_deg, "°"))
        overall = _with_unit(m.rms_error_overall_deg, "°")
        yield ("error of the whole run, root mean square", overall)
    yield ("mean change of the command", _with_unit(m.mean_command_change_rpm, "rpm per sample"))
    yield ("share of samples with a saturated command", _percent(m.saturated_share))
    yield ("work of the motor on the pump", _with_unit(m.shaft_energy_delivered_j, "J"))
    back_j = m.shaft_energy_delivered_j - m.shaft_energy_j
    yield ("work that flows back to the motor", _with_unit(back_j, "J"))
    yield ("work of the pump on the cylinder", _with_unit(m.hydraulic_energy_j, "J"))


def _with_unit(value: float, unit: str) -> str:
    """Return a number of three digits with its unit; a dash for nan."""
    return "–" if math.isnan(value) else f"{number(value)}{'' if unit == '°' else ' '}{unit}"


def _torque(value: float) -> str:
    return _with_unit(value, "N·m")


def _percent(share: float) -> str:
    return _with_unit(100.0 * share, "%")


def linear_report(
    plant: PlantLinearization, loop: SampledLoop, lines: Iterable[str], model: Iterable[str]
) -> str:
    """Return the report on a linearized plant and sampled loop in Markdown.

    ``lines`` are the lines of `kneexo.analysis.tracking.verdict.loop_lines`. A table replaces the
    lines with margins. ``model`` has the lines on the omissions of the model.
    """
    margins, table = loop.margins(), list[Row]()
    findings = [next(iter(lines))]
    if loop.stable:
        table = list(_margins(margins, loop.sample_time_s))
        small = [name for name, *_, verdict in table if verdict != "sound"]
        judged = f"too small: {', '.join(small)}" if small else "all margins are sound"
        angle = number(math.degrees(loop.knee_angle_rad))
        findings = [f"Stable at {angle}°; {judged}.", list(lines)[-1]]
    point = plant.operating_point
    eigenvalue = f"{abs(loop.eigenvalues[0]):.6g}"
    return document(
        "# Poles and margins",
        _bullets(*findings, *model),
        "## Plant",
        f"In equilibrium at {number(math.degrees(point.knee_angle_rad))}° the motor turns at "
        f"{number(round(to_rpm(point.motor_speed_rad_s), 9))} rpm, the load pressure is "
        f"{number(round(1e-6 * point.load_pressure_pa, 9))} MPa, and the rod force is "
        f"{number(round(point.rod_force_n, 9))} N. At low frequency the knee turns by "
        f"{number(plant.velocity_gain)} rad for each rad of the motor.",
        markdown_table(("pole (1/s)", "frequency (Hz)", "damping ratio", "verdict"), _poles(plant)),
        "## Sampled loop",
        f"The largest eigenvalue is {eigenvalue}, and must be below 1: "
        f"{'stable' if loop.stable else 'not stable, so there are no margins'}.",
        markdown_table(("change of the loop", "margin", "at (Hz)", "criterion", "verdict"), table)
        if table
        else "",
        "A margin of gain or phase is sound if it is at least the one that a disk margin of "
        f"{SOUND_DISK_MARGIN:g} guarantees. The delay margin must be at least one sample."
        if table
        else "",
    )


def _poles(plant: PlantLinearization) -> Iterator[Row]:
    """Yield a row for each real pole and for each pair of complex poles."""
    scale = float(np.max(np.abs(plant.poles)))
    for pole, frequency, ratio in zip(plant.poles, *plant.damping, strict=True):
        if pole.imag < 0.0:
            continue
        text = number(pole.real) + (f" ± {number(pole.imag)}j" if pole.imag > 0.0 else "")
        marginal = abs(pole.real) <= 1e-9 * scale
        verdict = "integrates" if marginal else "decays" if pole.real < 0.0 else "grows"
        yield (text, number(frequency / (2.0 * math.pi)), number(ratio), verdict)


def _margins(m: Margins, sample_time_s: float) -> Iterator[Row]:
    """Yield a row for each margin of a stable loop, with its criterion and verdict."""
    half = 0.5 * SOUND_DISK_MARGIN
    gain, phase_deg = (1.0 + half) / (1.0 - half), math.degrees(2.0 * math.atan(half))
    decibels = f" ({20.0 * math.log10(m.gain_margin):.3g} dB)" if m.gain_margin < math.inf else ""
    samples = ""
    if m.delay_margin_s < math.inf:
        samples = f" ({math.floor(m.delay_margin_s / sample_time_s)} samples)"
    for name, value, text, frequency_hz, least, limit in (
        ("more gain", m.gain_margin, f"factor {number(m.gain_margin)}{decibels}",
         m.gain_margin_frequency_hz, gain, f"factor {number(gain)}"),
        ("phase lag", m.phase_margin_deg, f"{number(m.phase_margin_deg)}°",
         m.phase_margin_frequency_hz, phase_deg, f"{number(phase_deg)}°"),
        ("phase lead", m.phase_lead_margin_deg, f"{number(m.phase_lead_margin_deg)}°",
         m.phase_lead_margin_frequency_hz, phase_deg, f"{number(phase_deg)}°"),
        ("delay", m.delay_margin_s, f"{number(1e3 * m.delay_margin_s)} ms{samples}",
         m.delay_margin_frequency_hz, sample_time_s, f"{number(1e3 * sample_time_s)} ms"),
        ("gain and phase together (disk margin)", m.disk_margin, number(m.disk_margin),
         m.disk_margin_frequency_hz, SOUND_DISK_MARGIN, number(SOUND_DISK_MARGIN)),
    ):  # fmt: skip
        verdict = "sound" if value >= least else "too small"
        yield (name, text, number(frequency_hz), f"at least {limit}", verdict)
    lower, most = m.lower_gain_margin, 1.0 / gain
    text = f"factor {number(lower)}" if lower > 0.0 else "any factor"
    verdict = "sound" if lower <= most else "too small"
    yield ("less gain", text, "–", f"at most factor {number(most)}", verdict)


def _bullets(*lines: str) -> list[str]:
    """Return a list in Markdown."""
    return [f"- {line}" for line in lines]
