"""Designs the motion that tells most about numbers of a scenario, before the machine moves."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from diagramc import InputTable, Log, State, Unknown, sensitivities, write_files
from kneexo.analysis.identification.fit import unknown_of
from kneexo.analysis.identification.machine_log import (
    AT_LIMIT,
    COMMAND,
    ELEMENT_OF,
    OFFSET,
    START_M,
)
from kneexo.common.result import Array, Result
from kneexo.errors import (
    KneexoError,
    ParameterError,
    failure_noted,
    shown,
)
from kneexo.parameters import SampledReference, Scenario, SineReference
from kneexo.parameters.paths import value_at
from kneexo.parameters.scenario_file import as_scenario
from kneexo.simulation.compiled import compile_open_loop, scenario_run, simulate_together

STEP_S = 0.01
"""Time in s between the angles of a candidate."""
SEGMENT_S = 10.0
"""Duration in s of each of the `standard_candidates`."""
_TAPER_S = 1.0  # over which a multisine grows and fades, so that segments join at rest
_MOVING = 0.75  # share of the time in which a staircase moves
_RATES_DEG_S = (4.0, 8.0, 15.0)
_TREADS = (1, 3)
_BANDS_HZ = (1.0, 3.0, 10.0)
_SHARES = (1 / 16, 1 / 64)  # of the amplitude of a multisine in half the range
_PRESSURE = "load_pressure_pa"
_PRIOR = 12.0  # 1/variance of a place that may be anywhere from 0 to 1
_TWO_SIDED = 1.96


@dataclass(frozen=True, repr=False)
class Experiment(Result):
    """A motion that tells much about numbers of a scenario; ``print`` shows a table."""

    reference: SampledReference
    """The chosen segments one after the other, as a reference of a scenario."""
    chosen: tuple[str, ...]
    """Names of the segments, in their order. The first tells most."""
    refused: dict[str, str]
    """Why a candidate was not considered, by name."""
    unknowns: tuple[Unknown, ...]
    half_width: dict[str, float]
    """Half of the 95 % interval of each number that a fit to the whole motion can reach at best."""
    half_width_of_sine: dict[str, float]
    """The same for the sine of Fig. 12, as long as the motion."""

    @property
    def words(self) -> dict[str, str]:
        """Whether the interval of each number lies inside its range: ``bounded`` or not."""
        words = {}
        for u in self.unknowns:
            room = min(u.begin, 1.0 - u.begin) * u.slope(u.value(u.begin))
            both = (widths[u.name] < room for widths in (self.half_width, self.half_width_of_sine))
            word, by_sine = ("bounded" if inside else "not bounded" for inside in both)
            words[u.name] = word if word == by_sine else f"{word}, by the sine {by_sine}"
        return words

    def write_csv(self, path: str | PathLike[str]) -> None:
        """Write the motion to a CSV file with the columns ``time_s`` and ``knee_angle_deg``.

        A scenario file takes it as ``reference: FILE.csv``. Raises `OutputError` if the file cannot
        be written.
        """
        rows = zip(self.reference.times_s, self.reference.angles_deg, strict=True)
        lines = ["time_s,knee_angle_deg", *(f"{time:.2f},{angle:.6f}" for time, angle in rows)]
        file = Path(path)
        write_files(file.parent, {file.name: "\n".join(lines) + "\n"}, f"file {shown(file)}")

    def __str__(self) -> str:
        """Return the half-widths beside those of the sine, the segments, and a refusal."""
        rows = [("number", "value", "± (95 %)", "± by the sine", "")]
        for u in self.unknowns:
            widths = f"{self.half_width[u.name]:.2g}", f"{self.half_width_of_sine[u.name]:.2g}"
            value = f"{u.value(u.begin):.5g}"
            rows.append((u.name, value, *widths, self.words[u.name]))
        columns = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, columns)).rstrip() for row in rows]
        lines.append(f"{len(self.chosen)} segments:")
        lines += [f"  {count} of {name}" for name, count in Counter(self.chosen).items()]
        for name, reason in [*self.refused.items()][:1]:
            lines.append(f"{len(self.refused)} candidates refused, the first is {name}: {reason}")
        return "\n".join(lines)


def design_experiment(
    scenario: Scenario | str | PathLike[str],
    ranges: Mapping[str, tuple[float, float]],
    noise: Mapping[str, float],
    *,
    duration_s: float = 60.0,
    candidates: Mapping[str, ArrayLike] | None = None,
) -> Experiment:
    """Choose the motion that tells most about numbers of a scenario, within the machine's limits.

    Each candidate is a motion of the knee that the whole loop follows once, without quantizers. A
    run that fails, a command at the speed limit, or a pressure above the rating refuses the
    candidate. From the run comes the command, and the plant alone gets this command. The Jacobian J
    of what the sensors then show, by the places of the numbers in their ranges, gives the
    information Σ JᵀJ/σ². The controller adds none, because the log has the command: given all
    earlier rows, a row of the log depends on the numbers through the plant only (Ljung, System
    Identification, 1999, 13.5). The position of the rod at the start of a segment is unknown too,
    and takes its part of the information.

    The choice is greedy and D-optimal: the next segment is the one that raises log det of the sum
    of all information most (Fedorov, Theory of Optimal Experiments, 1972). The sum begins with that
    of a number that may be anywhere in its range, so that the determinant is not zero. A segment
    may come again.

    The half-widths are 1.96 standard deviations by Cramér and Rao, of the whole motion at once, to
    first order. They begin with the ranges too: a number of which the log tells nothing has 0.57 of
    its range. They hold for white noise and the structure of the scenario.

    Parameters
    ----------
    scenario
        What is known of the machine, or the path of a scenario file.
    ranges
        Lower and upper end of each number to be found, by dotted path. In a range above zero the
        place of a number is logarithmic.
    noise
        Standard deviation of the noise of each sensor, by column of a run, such as
        ``encoder_reading_rad`` (an encoder has its resolution divided by √12) or
        ``motor_speed_rad_s``.
    duration_s
        Longest duration of the motion in s.
    candidates
        Knee angles (n,) in deg at steps of `STEP_S`, by name. All begin and end with the knee at
        rest at one angle. None: `standard_candidates`.

    Raises
    ------
    ParameterError
        A path or column is not of the scenario, a range is not within the declared one, a noise is
        not above zero, all candidates are refused, or none is as short as ``duration_s``.
    SimulationError
        The scenario cannot follow the sine of Fig. 12.

    Examples
    --------
    >>> import kneexo as kx
    >>> experiment = kx.design_experiment(
    ...     kx.Scenario(),
    ...     {"plant.pump.lag_s": (1e-3, 0.1), "plant.pump.acceleration_limit_rad_s2": (1e3, 1e5)},
    ...     {"encoder_reading_rad": 4.4e-4, "motor_speed_rad_s": 1.0},
    ...     duration_s=10.0,
    ... )
    >>> experiment.words["plant.pump.acceleration_limit_rad_s2"]
    'bounded, by the sine not bounded'
    """
    scenario = as_scenario(scenario)
    if scenario.wearer.kind != "none":
        raise ParameterError("design: a wearer moves the knee too; leave the wearer out")
    smooth = scenario.without_quantizers()
    if not ranges or not noise or not STEP_S <= duration_s < math.inf:
        raise ParameterError(
            f"design: needs a range, a noise and duration_s of {STEP_S:g} s or more; has "
            f"{len(ranges)}, {len(noise)} and {duration_s:g} s"
        )
    # The derivatives are at the numbers of the scenario: `replace` refuses one outside its range.
    unknowns = [
        replace(unknown_of(scenario, path, ends), start=value_at(scenario, path))
        for path, ends in ranges.items()
    ]
    for column, sigma in noise.items():
        if not 0.0 < sigma < math.inf:
            raise ParameterError(f"noise: {shown(column)} = {sigma:g}: must be finite and above 0")
    for column in set(noise) - set(ELEMENT_OF):
        raise ParameterError(f"noise: {shown(column)} is no column of a run")
    limits = {COMMAND: scenario.command_limit_rad_s, _PRESSURE: scenario.pressure_rating_pa}
    candidates = standard_candidates(scenario) if candidates is None else candidates
    variants, told, refused = {}, {}, dict[str, str]()
    for name, angles in candidates.items():
        with failure_noted(refused, name):
            variants[name] = _following(smooth, angles)
    for name, run in zip(variants, _runs(variants.values()), strict=True):
        with failure_noted(refused, name):
            told[name] = _information(variants[name], run, unknowns, noise, limits)
    refused = {name: reason for name, reason in refused.items() if reason}
    steps = {name: np.size(candidates[name]) - 1 for name in told}
    chosen: list[str] = []
    prior = total = _PRIOR * np.eye(len(unknowns))
    left = round(duration_s / STEP_S)
    while fitting := [name for name in told if steps[name] <= left]:
        before = np.linalg.slogdet(total)[1]
        gains = [(np.linalg.slogdet(total + told[n])[1] - before) / steps[n] for n in fitting]
        chosen.append(fitting[int(np.argmax(gains))])
        total, left = total + told[chosen[-1]], left - steps[chosen[-1]]
    if not chosen:
        first = next((f"; {name}: {reason}" for name, reason in refused.items()), "")
        raise ParameterError(f"design: no candidate is allowed in {duration_s:g} s{first}")
    pieces = [np.asarray(candidates[name], dtype=float) for name in chosen]
    angles = np.concatenate([pieces[0][:1], *(piece[1:] for piece in pieces)])
    fig_12 = SineReference()
    turns = fig_12.frequency_hz * STEP_S * np.arange(angles.size)
    sine = fig_12.mean_deg - fig_12.amplitude_deg * np.cos(2.0 * np.pi * turns)
    motions = [_following(smooth, motion) for motion in (angles, sine)]
    widths = []
    slopes = [unknown.slope(unknown.value(unknown.begin)) for unknown in unknowns]
    for motion, run in zip(motions, _runs(motions), strict=True):
        whole = prior + _information(motion, run, unknowns, noise)
        halves = _TWO_SIDED * np.sqrt(np.diag(np.linalg.inv(whole))) * slopes
        widths.append(dict(zip(ranges, halves.tolist(), strict=True)))
    reference = motions[0].reference
    assert isinstance(reference, SampledReference)
    return Experiment(reference, tuple(chosen), refused, tuple(unknowns), *widths)


def standard_candidates(scenario: Scenario) -> dict[str, Array]:
    """Return staircases, multisines and their sums, of 10 s in the range of a scenario's reference.

    A staircase begins in the middle of the range, rises, falls twice as far, and returns. A
    multisine has all frequencies k/10 s up to the last of a band, with the phases of Schroeder
    (1970), which keep its largest value small.
    """
    low, high = scenario.reference.range_deg
    middle, reach = 0.5 * (low + high), 0.5 * (high - low)
    time = np.arange(round(SEGMENT_S / STEP_S) + 1) * STEP_S
    stairs = {"": np.zeros(time.size)}
    for rate, treads in product(_RATES_DEG_S, _TREADS):
        height = min(reach, 0.25 * _MOVING * rate * SEGMENT_S)
        tread_s, move_s = 0.25 * SEGMENT_S / treads, height / treads / rate
        starts = 0.5 * (tread_s - move_s) + tread_s * np.arange(4 * treads)
        ways = np.repeat([1.0, -1.0, -1.0, 1.0], treads) * height / treads
        name = f"staircase of {treads} x {height / treads:.2g} deg at {rate:g} deg/s"
        stairs[name] = ways @ np.clip((time - starts[:, None]) / move_s, 0.0, 1.0)
    waves = {"": np.zeros(time.size)}
    fade = np.sin(0.5 * np.pi * np.clip(np.minimum(time, time[-1] - time) / _TAPER_S, 0, 1)) ** 2
    for band, share in product(_BANDS_HZ, _SHARES):
        k = np.arange(1, round(band * SEGMENT_S) + 1)[:, None]
        phase = 2.0 * np.pi * k * time / SEGMENT_S - np.pi * k * (k - 1) / k.size
        wave = fade * np.sum(np.cos(phase), axis=0)
        name = f"multisine of {share * reach:.2g} deg to {band:g} Hz"
        waves[name] = share * reach / np.max(np.abs(wave)) * wave
    return {
        " + ".join(filter(None, names)): middle + stairs[names[0]] + waves[names[1]]
        for names in product(stairs, waves)
        if any(names)
    }


def _following(smooth: Scenario, angles_deg: ArrayLike) -> Scenario:
    """Return the scenario with a motion as its reference, until its end."""
    angles = np.asarray(angles_deg, dtype=float).tolist()
    times_s = np.round(np.arange(len(angles)) * STEP_S, 9).tolist()
    reference = SampledReference(times_s=times_s, angles_deg=angles)
    return smooth.changed({"reference": reference, "simulation.duration_s": times_s[-1]})


def _runs(scenarios: Iterable[Scenario]) -> list[Any]:
    """Return the run of each whole loop, or its error."""
    return simulate_together([*scenarios], ("motor_speed_command", "load_pressure"))


def _information(
    scenario: Scenario,
    run: Any,
    unknowns: Sequence[Unknown],
    noise: Mapping[str, float],
    limits: Mapping[str, float] = MappingProxyType({}),
) -> Array:
    """Return what the sensors tell of the places of the unknowns, (n, n).

    Raises the error of a failed run, and `ParameterError` where a column reaches a limit.
    """
    if isinstance(run, KneexoError):
        raise run
    for column, limit in limits.items():
        if np.max(np.abs(run[column])) >= AT_LIMIT * limit:
            raise ParameterError(f"{column}: reaches its limit, {limit:.4g}")
    model, start = compile_open_loop(scenario), scenario.initial_offset_m
    offset = Unknown(OFFSET, start - START_M, start + START_M)
    command = np.append(run[COMMAND][1:], run[COMMAND][-1])  # a row has the command until it
    measured = {ELEMENT_OF[column]: run.time_s for column in noise}  # any values
    period_s = scenario.controller.sample_time_s
    log = Log(run.time_s, measured, period_s, {"motor_speed_command": command})
    table = log.table({"motor_speed_command": 1})

    def at(values: Mapping[str, float], log: Log) -> tuple[Array, State, InputTable]:
        return scenario_run(scenario.changed(values), model, table)

    (jacobian,) = sensitivities(model, log, [*unknowns, offset], at=at)
    weighted = jacobian / np.reshape(list(noise.values()), (-1, 1))
    whole = np.einsum("rej,rek->jk", weighted, weighted, optimize=True)
    taken = np.outer(whole[:-1, -1], whole[-1, :-1]) / (whole[-1, -1] or 1.0)
    return np.asarray(whole[:-1, :-1] - taken)
