"""Logs of the real machine: columns by name and unit, checked against what a scenario allows."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import ArrayLike

from kneexo.common.files.reading import file_error
from kneexo.common.files.table import NUMBER, read_table
from kneexo.common.result import Array
from kneexo.diagrams.signals import SIGNALS
from kneexo.errors import ParameterError, close_names, question, shown
from kneexo.geometry.linkage import encoder_angle
from kneexo.parameters import Scenario

TIME, REFERENCE, COMMAND, ENCODER, SPEED = (
    *("time_s", "knee_reference_rad", "motor_speed_command_rad_s"),
    *("encoder_reading_rad", "motor_speed_rad_s"),
)
"""The columns of a run that a fit knows by name."""
ELEMENT_OF = {
    column: name if len(columns) == 1 else f"{name}[{index}]"
    for name, columns in SIGNALS.items()
    for index, column in enumerate(columns)
}
"""Element of an output of a compiled model, by the column of a run that shows it."""
OFFSET = "initial_offset_m"
"""Path of the position of the rod at the start, which a log never tells."""
START_M = 0.01
"""Search range in m to both sides of where the first reading of the encoder sees the rod."""
AT_LIMIT = 0.999
"""Share of the limit from which a command counts as limited, because a log rounds."""
_HOLE = 10.0  # sample times, as in `diagramc.Log`: the held command bridges a shorter one
_UNEVEN = 0.1  # the median step of the stamps may differ by this share from the sample time
_SATURATED = 0.9  # share of the rows; such a command has no steps that show a lag
_AHEAD = 5  # rows, less than a usual lag
_BEYOND_DEG = 5.0  # of a reading, where noise and the zero of the encoder are no wrong unit
_NEAR = 1.2  # a ratio within this factor of a ratio of units is taken for it
_FOLLOWS, _OPPOSES = 0.8, -0.5  # correlations of what is measured with what is predicted


def read_log(
    log: str | os.PathLike[str] | Mapping[str, ArrayLike],
    columns: Sequence[str],
    measured: Sequence[str],
) -> dict[str, Array]:
    """Return time, command and measured columns (n,) of a log, and the reference if it has one.

    The names are those of a run. ``columns`` has NAME=COLUMN or NAME=COLUMN*FACTOR for others. If
    ``measured`` is empty, encoder and motor speed are read, if the log has them. Raises
    `ParameterError` for a name that no run has and for a missing column, and `ScenarioError` for a
    file that cannot be read.
    """
    known = (TIME, *ELEMENT_OF)
    sources = {name: (name, 1.0) for name in (TIME, COMMAND, *measured)}
    for text in columns:
        name, _, source = text.partition("=")
        source, _, factor = source.partition("*")
        if not source or (factor and not NUMBER.fullmatch(factor)):
            raise ParameterError(f"columns: {shown(text)}: must be NAME=COLUMN or NAME=COLUMN*2.5")
        sources[name] = source, float(factor or 1.0)
    for name in sources:
        if name not in known:
            advice = question(close_names(name, known)) or f"; known: {shown(', '.join(known))}"
            raise ParameterError(f"{shown(name)}: is no column of a run{advice}")
    needed = [source for source, _ in sources.values()]
    for name in (REFERENCE, *(() if measured else (ENCODER, SPEED))):
        sources.setdefault(name, (name, 1.0))
    if isinstance(log, Mapping):
        for source in needed:
            if source not in log:
                raise ParameterError(f"log: has no column {source!r}; it has {', '.join(log)}")
        given = log
    else:
        remedy = "; --columns NAME=COLUMN says what a column of another name is"
        more = [source for source, _ in sources.values()]
        given = read_table(log, list(dict.fromkeys(needed)), remedy, more).columns
    return {
        name: factor * np.asarray(given[source], dtype=float)
        for name, (source, factor) in sources.items()
        if source in given
    }


def check(log: Mapping[str, Array], scenario: Scenario) -> None:
    """Raise `ParameterError` where times and command of a log contradict a scenario."""
    time_s, command, period_s = log[TIME], log[COMMAND], scenario.controller.sample_time_s
    steps_s = np.diff(time_s)
    step_s = float(np.median(steps_s)) if steps_s.size else 0.0
    if not abs(step_s / period_s - 1.0) <= _UNEVEN:
        raise ParameterError(
            f"{TIME}: the median step is {step_s:.4g} s: must be controller.sample_time_s = "
            f"{period_s:g} s, a row for each sample{_unit(step_s / period_s, scenario, TIME)}",
        )
    wrong = (steps_s <= 0.0) | (steps_s > _HOLE * period_s)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise ParameterError(
            f"{TIME} = {time_s[row + 1]:.7g} s in row {row + 2} follows {time_s[row]:.7g} s: must "
            f"be later, by at most {_HOLE:g} samples of {period_s:g} s; cut the log there",
        )
    limit, row = scenario.command_limit_rad_s, int(np.argmax(np.abs(command)))
    if abs(command[row]) > limit * (2.0 - AT_LIMIT):
        ratio = float(np.std(command) / (np.std(log.get(SPEED, command)) or 1.0))
        raise ParameterError(
            f"{COMMAND} = {command[row]:.4g} rad/s in row {row + 1}: must be within ±{limit:.4g} "
            f"rad/s, the limit of the scenario{_unit(ratio, scenario, COMMAND)}",
        )
    if np.mean(np.abs(command) > AT_LIMIT * limit) > _SATURATED:
        raise ParameterError(
            f"{COMMAND}: is at its limit of {limit:.4g} rad/s in more than {_SATURATED:.0%} of the "
            f"rows: must be below it more often; log a slower motion",
        )


@contextmanager
def named_in_errors(path: str) -> Iterator[None]:
    """Context manager: put the path of a log before the message of a `ParameterError`."""
    try:
        yield
    except ParameterError as error:
        raise file_error(path, None, str(error)) from None


def phase_rad(scenario: Scenario) -> float:
    """Return what a reading of the encoder lacks to θ_4: the phase and, rounded down, half a count.

    The machine does not know its mounting error.
    """
    return scenario.encoder.offset_rad + scenario.encoder.mounting_error_rad


def check_range(log: Mapping[str, Array], scenario: Scenario) -> None:
    """Raise `ParameterError` if a reading of the encoder is beyond the range of motion."""
    knee = scenario.plant.knee
    ends_deg = knee.flexion_min_deg - _BEYOND_DEG, knee.flexion_max_deg + _BEYOND_DEG
    ends = encoder_angle(scenario.plant.linkage, np.radians(ends_deg)) - phase_rad(scenario)
    (low, high), readings = sorted(ends), log.get(ENCODER, ends)
    row = int(np.argmax(np.maximum(low - readings, readings - high)))
    if not low <= readings[row] <= high:
        raise ParameterError(
            f"{ENCODER} = {readings[row]:.4g} rad in row {row + 1}: must be within {low:.4g} … "
            f"{high:.4g} rad, the range of motion; if its zero is another, set encoder.phase_rad"
        )


def compare(log: Mapping[str, Array], predicted: Mapping[str, Array], scenario: Scenario) -> None:
    """Raise `ParameterError` where a column opposes its prediction (n,), or has another unit.

    Motor speed and command are swapped if the speed leads the command in time.
    """
    for name, values in predicted.items():
        if not np.ptp(log[name]) * np.ptp(values):
            continue
        if name == SPEED and log[SPEED].size > 20 * _AHEAD:
            early, late = log[SPEED][:-_AHEAD], log[SPEED][_AHEAD:]
            leads = np.corrcoef(early, log[COMMAND][_AHEAD:])[0, 1]
            if 1.0 - leads < 0.5 * (1.0 - np.corrcoef(late, log[COMMAND][:-_AHEAD])[0, 1]):
                raise ParameterError(f"{SPEED}: leads {COMMAND} in time: are the columns swapped?")
        follows = float(np.corrcoef(log[name], values)[0, 1])
        ratio = float(np.std(log[name]) / np.std(values))
        if follows < _OPPOSES:
            raise ParameterError(
                f"{name}: falls where {COMMAND} makes it rise (correlation {follows:.2f}): must "
                f"rise too; turn one of them, as by --columns {name}={name}*-1",
            )
        if follows > _FOLLOWS and (unit := _unit(ratio, scenario, name)):
            raise ParameterError(
                f"{name}: moves {ratio:.4g} times as much as {COMMAND} makes it{unit}"
            )


def _unit(ratio: float, scenario: Scenario, name: str) -> str:
    """Return the end of a message that names the factor between units that is next to a ratio.

    They are turns and rad, deg and rad, milli, counts of the encoder and rad, and but for angles
    minutes and seconds, rpm and rad/s. The text is empty if no factor is near.
    """
    counts = scenario.encoder.counts_per_revolution / math.tau
    factors = [math.tau, math.degrees(1.0), 1000.0, counts]
    factors += [] if name.endswith("_rad") else [60.0, 60.0 / math.tau]
    distance = abs(math.log(ratio or 1.0))
    factor = min(factors, key=lambda f: abs(distance - math.log(f)))
    if abs(distance - math.log(factor)) > math.log(_NEAR):
        return ""
    scale = 1.0 / factor if ratio > 1.0 else factor
    return f": another unit, by {factor:.4g}? Then --columns {name}={name}*{scale:.7g}"
