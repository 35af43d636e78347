"""Thresholds of fault detectors from the residuals of healthy runs over an uncertainty set."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from kneexo.common.plotting import SERIES, axes_or_new
from kneexo.common.result import Array, Result
from kneexo.diagrams.signals import columns
from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import UNCERTAINTY, ProtectionParameters, Scenario, UncertaintySet
from kneexo.parameters.device.safety_states import DETECTORS, REASONS
from kneexo.parameters.fields.fields import limits_of
from kneexo.parameters.fields.quantity import Parameters, quantities, quantity
from kneexo.parameters.scenario import require_scenario
from kneexo.parameters.uncertainty import applicable, draw, realize
from kneexo.simulation import needs_runs, simulate
from kneexo.sweeps.parallel import parallel_map

MARGIN = 1.5
"""Proposed threshold divided by the largest level of a healthy run.

The factor is a choice. A larger factor gives fewer false alarms, but a fault is detected later or
not at all. It applies to the proposal that ``print`` shows, and not to the default thresholds.
"""

_SIGNALS = ("residuals", "safety_reason")
_AFTER_START = ("speed", "following")
"""Names of the detectors whose residuals count only after the start of a run."""


@dataclass(frozen=True, repr=False)
class DetectorThresholds(Result):
    """Result of `detector_thresholds`: false alarms, and levels of the residuals in healthy runs.

    A detector detects a fault if its residual exceeds the threshold long enough: see
    ``protection.trip_s``, the trip time. The level of a detector in a run is the largest threshold
    at which the detector would have detected a fault. ``levels`` maps the name of a detector to the
    levels (trip times, runs) in the unit of the detector's threshold, with a row for each trip time
    in ``trips_s``. The first trip time is that of the protection.
    """

    protection: ProtectionParameters
    runs: int
    failed: int
    """Number of runs that ended with an error. These runs have no levels."""
    hours: float
    """Simulated time of all runs that did not fail."""
    alarms: Mapping[str, int]
    """Number of runs that the protection stopped, by the reason of the stop.

    The dictionary is empty without a false alarm.
    """
    trips_s: tuple[float, ...]
    levels: Mapping[str, Array]

    def largest(self, name: str) -> float:
        """Return the largest level of the detector ``name``, with the protection's trip time."""
        return float(np.max(self.levels[name][0]))

    def false_alarms(self, name: str, threshold: float) -> int:
        """Return the number of runs in which the detector ``name`` would detect a fault.

        ``threshold`` is in the unit of the detector's threshold. The trip time is that of the
        protection.
        """
        return int(np.sum(self.levels[name][0] > threshold))

    def __str__(self) -> str:
        """Return a table with a line for each detector: levels, thresholds and false alarms."""
        lines = [
            f"{self.runs} healthy runs, {self.hours:.3g} h, {self.failed} failed, "
            f"{sum(self.alarms.values())} false alarms",
            "detector   largest  proposed  threshold  false alarms",
        ]
        for name, detector in DETECTORS.items():
            threshold = getattr(self.protection, detector.field)
            largest = self.largest(name)
            lines.append(
                f"{name:9} {largest:8.4g} {MARGIN * largest:9.4g} {threshold:10g} "
                f"{self.alarms.get(name, 0):13d}  {detector.unit}"
            )
        if others := {name: n for name, n in self.alarms.items() if name not in DETECTORS}:
            lines.append(", ".join(f"{name}: {count}" for name, count in others.items()))
        return "\n".join(lines)

    def plot(self, ax: Any = None) -> Any:
        """Plot the largest level, divided by the threshold, over the trip time; return the axes."""
        caption = (
            "Largest threshold at which a detector would have stopped a healthy run, divided by "
            "its threshold, over the trip time. Above 1 the detector raises a false alarm."
        )
        ax = axes_or_new(ax, caption=caption)
        for (name, levels), colour in zip(self.levels.items(), SERIES, strict=False):
            threshold = getattr(self.protection, DETECTORS[name].field)
            order = np.argsort(self.trips_s)
            shares = np.max(levels, axis=1)[order] / threshold
            trips_ms = 1e3 * np.array(self.trips_s)[order]
            ax.plot(trips_ms, shares, "o-", color=colour, label=name)
        ax.axhline(1.0, color="0.7", lw=0.8, zorder=0)
        ax.set(xlabel="trip time (ms)", ylabel="largest level / threshold")
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, fontsize="small")
        return ax


class ThresholdArguments(Parameters):
    """Arguments of `detector_thresholds`."""

    uncertainty: UncertaintySet
    runs: int = quantity(1000, "1", "given by the user", ge=1, le=1_000_000)
    seed: int = quantity(1, "1", "given by the user", ge=0)
    trips_s: tuple[float, ...] = quantities((), "s", "given", ge=0, le=1e5, min_length=None)


def detector_thresholds(
    scenario: Scenario,
    uncertainty: UncertaintySet = UNCERTAINTY,
    runs: int = 1000,
    *,
    seed: int = 1,
    trips_s: Sequence[float] = (),
    workers: int | None = 1,
) -> DetectorThresholds:
    """Simulate healthy runs, to choose the thresholds of the fault detectors above their residuals.

    Each run has the protection of the scenario. If the protection stops the motor, which is a false
    alarm, the run is repeated with thresholds out of reach. The levels of the detectors ``speed``
    and ``following`` count from ``protection.overdue_s`` on, when the start has ended.

    Parameters
    ----------
    scenario
        The scenario, with ``protection``. Its faults and its push are left out.
    uncertainty
        Uncertain values, from which each run gets a sample.
    runs
        Number of runs.
    seed
        Seed of the samples.
    trips_s
        Further trip times in s, beside ``protection.trip_s``, for which levels are computed.
    workers
        Number of worker processes, as in `kneexo.sweeps.parallel_map`.

    Raises
    ------
    ParameterError
        The scenario has no protection, ``runs`` is not positive, a run is not longer than
        ``overdue_s`` and all trip times, all runs fail, or the uncertainty set does not suit the
        scenario.
    """
    require_scenario(scenario)
    given = ThresholdArguments.model_validate(
        {"uncertainty": uncertainty, "runs": runs, "seed": seed, "trips_s": trips_s}
    )
    used_uncertainty, _ = applicable(scenario, given.uncertainty)
    protection = scenario.protection
    if protection is None:
        raise ParameterError("protection: is missing; add protection: {}")
    trips = (protection.trip_s, *given.trips_s)
    times = [(f"protection.{name}", getattr(protection, name)) for name in ("overdue_s", "trip_s")]
    for name, time_s in (*times, *(("trips_s", time_s) for time_s in given.trips_s)):
        if not time_s < scenario.duration_s:
            raise ParameterError(
                f"{name} = {time_s:g} s: must be < {scenario.duration_s:g} s, the "
                f"duration of a run; reduce it, or extend simulation.duration_s"
            )
    protected = scenario.changed({"push": None, "faults": ()})
    never_stopped = protected.changed({"protection": _out_of_reach(protected)})
    healthy = partial(_healthy_run, protected, never_stopped, used_uncertainty, trips)
    results = parallel_map(healthy, draw(used_uncertainty, runs, seed), workers=workers)
    succeeded = [result for result in results if result is not None]
    if not succeeded:
        raise ParameterError(f"all {runs} runs fail; simulate one of them to see why")
    levels = np.stack([level for _, level in succeeded], axis=-1)
    alarms = Counter(REASONS[reason] for reason, _ in succeeded if reason)
    return DetectorThresholds(
        protection,
        runs,
        runs - len(succeeded),
        len(succeeded) * scenario.duration_s / 3600.0,
        alarms,
        trips,
        {name: levels[:, index] for index, name in enumerate(DETECTORS)},
    )


def _out_of_reach(scenario: Scenario) -> ProtectionParameters:
    """Return the protection of a scenario with its thresholds at their largest allowed values.

    A run with this protection is not stopped, so it has the residuals of the whole run. Only the
    load cell can reach its threshold, at the end of its range.
    """
    assert scenario.protection is not None
    fields = ProtectionParameters.model_fields
    limits = {d.field: limits_of(fields[d.field])[1] for d in DETECTORS.values()}
    # A scenario must have this threshold below the range of its load cell. 0.999 is a choice: of
    # the readings that the load cell can give, only the last thousandth of the range is above.
    limits["load_cell_n"] = 0.999 * scenario.load_cell.range_n
    return scenario.protection.model_copy(update=limits)


@needs_runs
def _healthy_run(
    protected: Scenario,
    never_stopped: Scenario,
    uncertainty: UncertaintySet,
    trips_s: Sequence[float],
    values: Mapping[str, Any],
) -> tuple[int, Array] | None:
    """Simulate one healthy run, whose uncertain ``values`` are a sample from ``uncertainty``.

    Returns the reason of the false alarm (0: none) and the levels (trip times, detectors). A level
    is the largest threshold at which the detector would have given an alarm with the trip time.
    The result is None if the run fails.
    """
    try:
        run = simulate(realize(protected, uncertainty, values), signals=_SIGNALS)
        reason = int(run["safety_reason"].max())
        # Again, with thresholds out of reach: a run that the protection stops shows no levels after
        # the stop.
        if reason:
            run = simulate(realize(never_stopped, uncertainty, values), signals=_SIGNALS)
    except SimulationError:
        return None
    assert protected.protection is not None
    period_s = protected.controller.sample_time_s
    started = int(protected.protection.overdue_s / period_s)
    levels = np.zeros((len(trips_s), len(DETECTORS)))
    for index, (name, column) in enumerate(zip(DETECTORS, columns(["residuals"]), strict=True)):
        residual = run[column][started if name in _AFTER_START else 0 :] / DETECTORS[name].factor
        for row, trip_s in enumerate(trips_s):
            levels[row, index] = level_of(residual, max(1, round(trip_s / period_s)))
    return reason, levels


def level_of(residual: Array, trip_samples: int) -> float:
    """Return the largest threshold at which a detector would detect a fault in a residual (n,).

    The counter of the detector goes up by one at each sample above the threshold, and down by one
    at each other sample, but not below zero. The detector detects a fault when the counter reaches
    ``trip_samples``. The result is 0 if the residual has fewer samples than ``trip_samples``.
    """
    # A threshold just below values[i] counts all samples >= values[i]. Bisect for the largest such
    # i at which the detector still detects a fault: the indices below `low` do, those from `high`
    # on do not.
    values = np.unique(residual)
    low, high = 0, values.size
    while low < high:
        middle = (low + high) // 2
        # The counter is the sum of all steps, minus the lowest sum so far if this is below zero.
        sums = np.cumsum(np.where(residual >= values[middle], 1, -1))
        counts = sums - np.minimum(np.minimum.accumulate(sums), 0)
        if counts.max() >= trip_samples:
            low = middle + 1
        else:
            high = middle
    return float(values[low - 1]) if low else 0.0
