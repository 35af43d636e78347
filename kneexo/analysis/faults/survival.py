"""Critical durations: how long a fault may last before the knee moves too far.

A detector and its reaction must end the fault within this time, the fault-tolerant time interval. A
permanent fault and a shorter one give the same run until the shorter one ends. So the critical
duration is shorter than the time from the start of the fault until the permanent fault exceeds the
bound, or until the run with the permanent fault fails. A bisection between zero and this time finds
the critical duration. The bisection assumes that a longer fault moves the knee farther. A permanent
fault that stays within the bound says only that the critical duration is not shorter than the
observed time: the critical duration is censored.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import cycle, product
from typing import Any

import numpy as np

from kneexo.common.plotting import SERIES, axes_or_new
from kneexo.common.result import Array, Result, data_frame
from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import FaultParameters, Scenario
from kneexo.parameters.criteria import OBSERVED_S, TOLERATED_DEVIATION_DEG
from kneexo.parameters.fields.quantity import Parameters, quantities
from kneexo.parameters.scenario import require_scenario
from kneexo.simulation import Run, needs_runs, simulate
from kneexo.sweeps.parallel import parallel_map


@dataclass(frozen=True, repr=False)
class FaultCase(Result):
    """Effect of one fault that begins at ``start_s``, or later when a signal triggers the fault.

    The deviations are differences of the knee angle from the run without the fault.
    """

    name: str
    """Place, kind and size of the fault."""
    start_s: float
    largest_deviation_deg: float
    """Largest deviation of the knee with the permanent fault; inf if the run fails."""
    critical_duration_s: float
    """Longest duration of the fault with which the knee stays within the bound.

    The critical duration is 0 if a fault of one sample is too long, and nan if no signal starts the
    fault. If ``censored`` is True, the critical duration is the time for which the fault was
    observed.
    """
    censored: bool
    """Whether the knee stays within the bound as long as the permanent fault is observed."""
    failing_duration_s: float
    """Critical duration plus one sample; nan if the critical duration is censored or nan."""


@dataclass(frozen=True, repr=False)
class FaultSurvival(Result):
    """Result of `fault_survival`: critical durations of faults that begin at several times."""

    bound_deg: float
    cases: tuple[FaultCase, ...]

    @property
    def worst(self) -> FaultCase:
        """The case with the shortest critical duration."""
        return _worst(self.cases)

    def __str__(self) -> str:
        """Return a line for each fault, with its shortest critical duration."""
        lines = []
        for name, cases in _by_name(self.cases):
            case = _worst(cases)
            text = f"at most {1e3 * case.critical_duration_s:g} ms, at {case.start_s:g} s"
            if case.censored:
                text = f"a larger deviation is not seen within {case.critical_duration_s:g} s"
            elif math.isnan(case.critical_duration_s):
                text = "never active"
            lines.append(f"{name}: {text}")
        return "\n".join([f"Within {self.bound_deg:g}° of the run without the fault:", *lines])

    def to_dataframe(self) -> Any:
        """Return a `pandas.DataFrame` with a line for each case and the index ``name``.

        Raises `PackageError` without pandas.
        """
        return data_frame(
            {name: [getattr(case, name) for case in self.cases] for name in vars(self.cases[0])},
            "name",
        )

    def plot(self, ax: Any = None) -> Any:
        """Plot the critical duration of each fault over its start; return the axes."""
        caption = (
            "Longest duration of a fault with which the knee stays within "
            f"{self.bound_deg:g}° of the run without the fault. There is no mark where the "
            "permanent fault stays within this bound as long as it is observed, or no signal "
            "starts the fault."
        )
        ax = axes_or_new(ax, caption=caption)
        for (name, cases), colour in zip(_by_name(self.cases), cycle(SERIES), strict=False):
            durations = [
                math.nan if case.censored else 1e3 * case.critical_duration_s for case in cases
            ]
            ax.plot([case.start_s for case in cases], durations, "o-", color=colour, label=name)
        ax.set(xlabel="start of the fault (s)", ylabel="critical duration (ms)")
        ax.set_ylim(bottom=0.0)
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize="small")
        return ax


def _by_name(cases: Sequence[FaultCase]) -> Iterator[tuple[str, list[FaultCase]]]:
    for name in dict.fromkeys(case.name for case in cases):
        yield name, [case for case in cases if case.name == name]


def _worst(cases: Sequence[FaultCase]) -> FaultCase:
    """Return the case with the shortest critical duration.

    A case whose critical duration is nan is returned only if all cases are of this kind.
    """
    return min(cases, key=lambda c: (math.isnan(c.critical_duration_s), c.critical_duration_s))


class SurvivalArguments(Parameters):
    """Two arguments of `fault_survival`."""

    faults: tuple[FaultParameters, ...] = ()
    starts_s: tuple[float, ...] = quantities((), "s", "given", ge=0, le=1e5, min_length=None)


def fault_survival(
    scenario: Scenario,
    faults: Sequence[FaultParameters],
    starts_s: Sequence[float],
    *,
    bound_deg: float = TOLERATED_DEVIATION_DEG,
    observed_s: float = OBSERVED_S,
    workers: int | None = 1,
) -> FaultSurvival:
    """Return, for each fault and start, the longest duration that the loop survives.

    The loop survives if the knee stays within ``bound_deg`` of the run without the fault, until
    ``observed_s`` after the start. A run that fails does not survive.

    >>> from kneexo import Scenario
    >>> from kneexo.analysis import fault_survival
    >>> from kneexo.parameters import FaultParameters
    >>> dead = FaultParameters(place="command", kind="scale", size=0.0)
    >>> print(fault_survival(Scenario(), [dead], [2.5], bound_deg=2.0))
    Within 2° of the run without the fault:
    command scale 0: at most 106 ms, at 2.5 s

    Parameters
    ----------
    scenario
        The scenario. Its own faults are in all runs. Its duration is replaced.
    faults
        Faults whose start and duration are replaced.
    starts_s
        Times in s at which the faults begin.
    bound_deg
        Largest tolerated deviation of the knee in deg.
    observed_s
        Time in s that the runs last after each start.
    workers
        Number of worker processes, as in `kneexo.sweeps.parallel_map`.

    Raises
    ------
    ParameterError
        There is no fault or no start, ``bound_deg`` is not within 0 … 180°, ``observed_s`` is not
        positive, or the scenario refuses a fault or the duration.
    SimulationError
        The run without the fault fails.
    """
    require_scenario(scenario)
    given = SurvivalArguments.model_validate({"faults": faults, "starts_s": starts_s})
    faults, starts_s = given.faults, given.starts_s
    if not faults or not len(starts_s):
        raise ParameterError("faults, starts_s: must have at least one fault and one start")
    if not 0.0 < bound_deg <= 180.0:
        raise ParameterError(f"bound_deg = {bound_deg:g} deg: must be > 0 and <= 180 deg")
    if not 0.0 < observed_s < math.inf:
        raise ParameterError(f"observed_s = {observed_s:g} s: must be > 0 and finite")
    items = []
    for fault, start_s in product(faults, map(float, starts_s)):
        begun = fault.permanent(start_s)
        observed = scenario.changed({"simulation.duration_s": start_s + observed_s})
        _faulty(observed, begun, 1)  # an error here, not in a worker
        items.append((observed, begun))
    case = partial(_observed_case, bound_deg)
    return FaultSurvival(bound_deg, tuple(parallel_map(case, items, workers=workers)))


@needs_runs
def _observed_case(bound_deg: float, item: tuple[Scenario, FaultParameters]) -> FaultCase:
    scenario, fault = item
    healthy = simulate(scenario, signals=_signals(scenario))
    return fault_case(scenario, healthy, bound_deg, fault, _run_with(scenario, fault, None))


def _run_with(scenario: Scenario, fault: FaultParameters, samples: int | None) -> Run | None:
    """Return the run with the fault for ``samples`` samples, or for ever if None.

    The result is None if the run fails.
    """
    faulty = _faulty(scenario, fault, samples)
    try:
        return simulate(faulty, signals=_signals(faulty))
    except SimulationError:
        return None


@needs_runs
def fault_case(
    scenario: Scenario,
    healthy: Run,
    bound_deg: float,
    fault: FaultParameters,
    permanent: Run | None,
) -> FaultCase:
    """Return the effect of a permanent fault, and its critical duration by bisection.

    Parameters
    ----------
    scenario
        The scenario. Its own faults are in all runs, and its duration ends the observation.
    healthy
        The run of the scenario.
    bound_deg
        Largest tolerated deviation of the knee in deg.
    fault
        The fault. Its duration is replaced.
    permanent
        The run with the permanent fault, with the signals ``knee_angle`` and ``active_faults``;
        None if the run fails.

    Raises
    ------
    ParameterError
        The scenario refuses the fault.
    """

    def deviation_deg(run: Run | None) -> Array:
        """Return the deviation of the knee at each sample; a single inf for a run that fails."""
        if run is None:
            return np.array([math.inf])
        return np.degrees(np.abs(run["knee_angle_rad"] - healthy["knee_angle_rad"]))

    period = scenario.controller.sample_time_s
    deviation = deviation_deg(permanent)
    name, largest = fault_name(fault), float(np.max(deviation))
    if largest <= bound_deg:
        assert permanent is not None  # a run that fails has an infinite deviation
        others = healthy["active_faults"] if scenario.faults else 0.0
        active = np.flatnonzero(permanent["active_faults"] > others)
        observed_s = math.nan
        if active.size:  # a signal may start the fault later
            since_s = period * float(deviation.size - active[0])
            observed_s = min(scenario.duration_s - fault.start_s, since_s)
        return FaultCase(name, fault.start_s, largest, observed_s, bool(active.size), math.nan)
    fails = healthy.time_s.size - round(fault.start_s / period)
    if permanent is not None:
        fails = int(np.argmax(deviation > bound_deg)) - round(fault.start_s / period)
    survives = 0
    while fails - survives > 1:
        middle = (survives + fails) // 2
        if np.max(deviation_deg(_run_with(scenario, fault, middle))) <= bound_deg:
            survives = middle
        else:
            fails = middle
    return FaultCase(name, fault.start_s, largest, survives * period, False, fails * period)


def _signals(scenario: Scenario) -> tuple[str, ...]:
    return ("knee_angle", "active_faults") if scenario.faults else ("knee_angle",)


def fault_name(fault: FaultParameters) -> str:
    """Return the name of a fault in reports: its place and kind, and its size, seed and trigger.

    A part that the fault does not have is left out.
    """
    parts = [fault.place, fault.kind]
    if fault.kind != "frozen":
        parts.append(f"{fault.size:g} {fault.size_unit}".rstrip())
    if fault.seed:
        parts.append(f"seed {fault.seed}")
    for sign, threshold in ((">", fault.above), ("<", fault.below)):
        if threshold is not None:
            parts.append(f"if {fault.signal} {sign} {threshold:g}")
    return " ".join(parts)


def _faulty(scenario: Scenario, fault: FaultParameters, samples: int | None) -> Scenario:
    """Return the scenario with one more fault for ``samples`` samples, or for ever if None."""
    period = scenario.controller.sample_time_s
    duration_s = None if samples is None else samples * period
    faults = (*scenario.faults, fault.changed({"duration_s": duration_s}))
    return scenario.changed({"faults": faults})
