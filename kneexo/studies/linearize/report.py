"""Markdown report on a `PlantLinearization` and a `SampledLoop` of `kneexo.analysis`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from kneexo.analysis import PlantLinearization, SampledLoop
from kneexo.analysis.linear.margins import Margins
from kneexo.analysis.signals import to_rpm
from kneexo.parameters.criteria import SOUND_DISK_MARGIN
from kneexo.studies.markdown import number
from kneexo.studies.template import filled

Row = tuple[str, ...]
"""The cells of a row of a table."""


def report(
    plant: PlantLinearization, loop: SampledLoop, lines: Iterable[str], model: Iterable[str]
) -> str:
    """Return the report on a linearized plant and sampled loop in Markdown.

    ``lines`` are the lines of `kneexo.analysis.tracking.verdict.loop_lines`. The report shows the
    last of these lines for a stable loop, because a table has the margins, and the only line of an
    unstable loop. ``model`` are the lines of `kneexo.analysis.tracking.notices.model_lines`.
    """
    return filled(
        "linearize/report.md",
        plant=plant,
        loop=loop,
        lines=list(lines),
        model=model,
        point=plant.operating_point,
        motor_rpm=to_rpm(plant.operating_point.motor_speed_rad_s),
        degrees=math.degrees,
        poles=list(_poles(plant)),
        margins=list(_margins(loop.margins(), loop.sample_time_s)) if loop.stable else [],
        sound_disk_margin=SOUND_DISK_MARGIN,
    )


def _poles(plant: PlantLinearization) -> Iterator[Row]:
    """Yield a row for each real pole and for each pair of complex poles."""
    scale = float(np.max(np.abs(plant.poles)))
    for pole, frequency, ratio in zip(plant.poles, *plant.damping, strict=True):
        if pole.imag < 0.0:
            continue
        text = number(pole.real) + (f" ± {number(pole.imag)}j" if pole.imag > 0.0 else "")
        # The rounding error of a pole at zero is relative to the fastest pole.
        marginal = abs(pole.real) <= 1e-9 * scale
        verdict = "integrates" if marginal else "decays" if pole.real < 0.0 else "grows"
        yield (text, number(frequency / (2.0 * math.pi)), number(ratio), verdict)


def _margins(m: Margins, sample_time_s: float) -> Iterator[Row]:
    """Yield a row for each margin of a stable loop, with its criterion and verdict."""
    # A disk margin α guarantees the gain (1 + α/2)/(1 − α/2) and the phase 2 atan(α/2).
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
