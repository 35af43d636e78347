"""Effects of faults at several times of a motion, with and without the protection.

The protection acts in time if the knee stays near the run without the fault until the motor is in
its safe state. The critical duration of a fault is that without protection, the fault-tolerant time
interval.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from itertools import product
from typing import Any, Literal, Unpack

import numpy as np
from pydantic import TypeAdapter

from kneexo.analysis.faults.survival import fault_case, fault_name
from kneexo.analysis.signals import period_s
from kneexo.analysis.tracking.stop import knee_torque, safe_sample, turn_and_torque
from kneexo.common.result import Array, Result, data_frame
from kneexo.diagrams import available_signals
from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import (
    UNCERTAINTY,
    Scenario,
    UncertaintySet,
)
from kneexo.parameters.criteria import OBSERVED_S, TOLERATED_DEVIATION_DEG
from kneexo.parameters.device.safety_states import REASONS, SAFE_STATES, SafeState
from kneexo.parameters.fields.quantity import Parameters, choice, quantity
from kneexo.parameters.task.fault import OPERATOR_INPUTS, FaultParameters
from kneexo.parameters.uncertainty import applicable, draw, options_of, realize
from kneexo.simulation import Run, needs_runs, simulate
from kneexo.simulation.compiled import users_code_key
from kneexo.studies.faults.typical_faults import typical_faults
from kneexo.sweeps import SweepOptions, open_sweep


class FaultsSettings(Parameters):
    """Settings of ``kneexo study faults``: faults, times, bound, and healthy runs."""

    faults: tuple[FaultParameters, ...] = choice(
        (), "left out: typical faults; start_s is replaced, and duration_s and mttf_s are left out"
    )
    controllers: tuple[Literal["smc", "pid"], ...] = choice(
        ("smc", "pid"),
        "controllers in place of the scenario's, unless it is torque or law; one of the same kind "
        "has its gains",
    )
    safe_states: tuple[SafeState, ...] = choice(
        (), "left out: that of the scenario first, then the others that its plant can have"
    )
    onsets: int = quantity(
        4, "1", "assumption: number of starts, evenly spaced over a period", ge=1, le=1000
    )
    observed_s: float = quantity(
        OBSERVED_S,
        "s",
        "assumption: time that a run lasts after the start of its fault, as in fault_survival",
        ge=0.1,
        le=1e4,
    )
    bound_deg: float = quantity(
        TOLERATED_DEVIATION_DEG, "deg", "assumption: as in fault_survival", gt=0, le=180
    )
    samples: int = quantity(
        200, "1", "assumption: healthy runs that count false alarms", ge=1, le=1_000_000
    )
    seed: int = quantity(2020, "1", "assumption: any number", ge=0, le=2**31 - 1)


def not_seen(observed_s: float) -> str:
    """Return the verdict on a fault that no detector finds, and that the knee tolerates."""
    return f"not seen within {observed_s:g} s"


FAILED = ("made worse", "missed", "late")
"""The verdicts of faults on which the protection does not act in time, the worst first."""


@dataclass(frozen=True)
class Peaks:
    """Largest values in the part of a run that begins with a fault."""

    deviation_deg: float
    """Deviation of the knee from the run without the fault."""
    torque_n_m: float
    """Torque of the wearer; without a wearer the torque of the actuator on the knee."""
    pressure_mpa: float
    """Pressure of a chamber; in reduced order the magnitude of the load pressure."""
    complete: bool
    """False if the run ends early, usually because the knee leaves its range of motion."""


@dataclass(frozen=True)
class Rest:
    """Largest values from the time when the motor is safe until the end of the observation.

    The observation ends ``observed_s`` after the start of the fault. All values are nan if the
    motor does not become safe before the end.
    """

    turn_deg: float
    """Turn of the knee since the motor became safe."""
    torque_n_m: float
    """Torque of the wearer or of the actuator, as in `Peaks`."""
    complete: bool
    """False if the run ends before the end of the observation."""


@dataclass(frozen=True)
class FaultRow:
    """Effect of a permanent fault that begins at ``start_s``, if the protection has a safe state.

    ``safe_state`` is this safe state, ``cause`` is the usual cause of the fault, and ``controller``
    is the kind of the controller.
    """

    controller: str
    safe_state: str
    cause: str
    fault: str
    """Place, kind and size of the fault."""
    start_s: float
    alone: Peaks
    """Largest values without protection."""
    flexes: bool
    """Whether the largest deviation without protection is a flexion."""
    critical_duration_s: float
    """Longest duration without protection; see `kneexo.analysis.FaultCase`."""
    censored: bool
    """Whether the critical duration is the observed time, so that the true one may be longer."""
    detector: str
    """Name of the detector that stopped the motor, or an empty text."""
    detected_after_s: float
    safe_after_s: float
    """Time from the start of the fault until the motor stands or its release is on; else inf."""
    protected: Peaks
    """Largest values before the motor reaches the safe state."""
    rest: Rest

    bound_deg: float
    """Largest tolerated deviation."""
    observed_s: float
    """Time from ``start_s`` to the end of the run."""

    @property
    def margin_s(self) -> float:
        """Time that the protection has left: critical duration minus time to the safe state, in s.

        If the critical duration is censored, the true margin is at least as large. The margin is
        nan if the trigger of the fault never occurs, and if the critical duration is censored and
        the motor never becomes safe.
        """
        if self.censored and math.isinf(self.safe_after_s):
            return math.nan
        return self.critical_duration_s - self.safe_after_s

    @property
    def verdict(self) -> str:
        """One of ``never active, not seen within … s, in time, late, missed, made worse``.

        - The trigger of the fault never occurs: never active.
        - No detector detects the fault: the harm is not seen within ``observed_s`` if the knee
          stays within the bound, else the fault is missed.
        - A detector detects the fault: the protection is in time if the deviation stays within the
          bound until the motor is safe. Otherwise the protection makes the fault worse if the
          deviation is larger than without protection, and is late if not. The protection is late
          too if the motor never becomes safe.
        """
        if math.isnan(self.critical_duration_s) and not self.detector:
            return "never active"
        deviation_deg = self.protected.deviation_deg
        is_within = self.protected.complete and deviation_deg <= self.bound_deg
        if not self.detector:
            return not_seen(self.observed_s) if self.censored else "missed"
        if is_within and math.isfinite(self.safe_after_s):
            return "in time"
        is_worse = deviation_deg > max(self.alone.deviation_deg, self.bound_deg)
        return "made worse" if is_worse and self.alone.complete else "late"

    @property
    def has_failed(self) -> bool:
        """Whether the verdict is one of `FAILED`."""
        return self.verdict in FAILED


@dataclass(frozen=True)
class EmergencyStop:
    """Effect of a press of ``emergency_stop`` at ``start_s``, in a run without a fault."""

    controller: str
    safe_state: str
    start_s: float
    knee_deg: float
    """Knee angle at the press."""
    safe_after_s: float
    """Time from the press until the motor stands or its release is on; inf without such a time."""
    turn_deg: float
    """Largest turn of the knee from the press on, before the motor reaches the safe state."""
    torque_n_m: float
    """Largest torque in this time, as in `Peaks`."""
    rest: Rest


_ROW, _STOP = TypeAdapter(FaultRow), TypeAdapter(EmergencyStop)  # from the data of a worker


@dataclass(frozen=True, repr=False)
class FaultsResult(Result):
    """Result of ``kneexo study faults``: rows of all faults, emergency stops and false alarms.

    The worst row also has the curves of its runs, ``traces``.
    """

    scenario: Scenario
    settings: FaultsSettings
    safe_states: tuple[str, ...]
    """The safe states that are compared; the first one is assessed in detail."""
    all_rows: tuple[FaultRow, ...]
    """A row for each controller, safe state, cause, size and start of a fault, in this order."""
    stops: tuple[EmergencyStop, ...]
    """Emergency stops at the times of the faults, for each controller and safe state."""
    alarms: dict[str, int]
    """Number of healthy runs that each detector stopped."""
    healthy_runs: int
    healthy_hours: float
    traces: dict[str, dict[str, Array]]
    """Columns of the runs ``healthy``, ``alone`` and ``protected`` of the `worst` row."""

    @property
    def rows(self) -> tuple[FaultRow, ...]:
        """The rows with the first of the `safe_states`."""
        return tuple(row for row in self.all_rows if row.safe_state == self.safe_states[0])

    @property
    def worst(self) -> FaultRow:
        """The row of `rows` with the largest deviation in spite of the protection.

        If the protection acts in time on each fault, the worst row is the row with the least
        margin.
        """
        return min(self.rows, key=urgency)

    @property
    def undetected(self) -> FaultRow | None:
        """The row without detector that has the largest deviation, or None if all are detected."""
        rows = [row for row in self.rows if not row.detector]
        return max(rows, key=lambda row: row.alone.deviation_deg) if rows else None

    def to_dataframe(self) -> Any:
        """Return a `pandas.DataFrame` with a line for each row.

        Raises `PackageError` without pandas.
        """
        lines = [_flat(row) for row in self.all_rows]
        return data_frame({name: [line[name] for line in lines] for name in lines[0]})

    def results(self) -> dict[str, Any]:
        """Return plain data: all rows, the emergency stops and the false alarms."""
        return {
            "rows": [_flat(row) for row in self.all_rows],
            "emergency_stops": [_flat(stop) for stop in self.stops],
            "healthy": {
                "runs": self.healthy_runs,
                "hours": self.healthy_hours,
                "false_alarms": self.alarms,
            },
        }


def _flat(row: FaultRow | EmergencyStop) -> dict[str, Any]:
    """Return the values of a row by name, for a table.

    The name of a value of `Peaks` or `Rest` begins with the name of their field, such as
    ``alone_deviation_deg``.
    """
    flat: dict[str, Any] = {}
    for name, value in asdict(row).items():
        if isinstance(value, dict):
            flat |= {f"{name}_{key}": number for key, number in value.items()}
        else:
            flat[name] = value
    if isinstance(row, FaultRow):
        flat |= {"margin_s": row.margin_s, "verdict": row.verdict}
    return flat


_SIGNALS = (
    *("knee_reference", "knee_angle", "motor_speed", "load_pressure", "rod_force", "moment_arm"),
    *("interaction_torque", "chamber_pressures", "safety_state", "safety_reason", "active_faults"),
)
"""Signals of the runs, as far as the scenario has them."""


def faults_study(
    scenario: Scenario = Scenario.preset("protected"),
    settings: FaultsSettings = FaultsSettings(),
    uncertainty: UncertaintySet = UNCERTAINTY,
    **options: Unpack[SweepOptions],
) -> FaultsResult:
    """Run each fault at several times, for each controller, with and without protection.

    The protection is that of the scenario, or the default one. Its safe state is replaced by each
    of those that the plant can have.

    Parameters
    ----------
    scenario
        The scenario without faults of its own.
    settings
        Faults, controllers, safe states, times, and the number of healthy runs.
    uncertainty
        Values that vary in the healthy runs.
    options
        Workers, checkpoint and progress: see `kneexo.sweeps.SweepOptions`.

    Raises
    ------
    ParameterError
        The scenario has faults or a push, refuses one of the faults, or is not longer than
        ``observed_s``. Or the protection stops a run without a fault.
    SimulationError
        The run without faults fails.
    """
    if scenario.faults or scenario.push:
        raise ParameterError("faults, push: must be left out; the study sets the faults")
    if pressed := next((f.place for f in settings.faults if f.place in OPERATOR_INPUTS), ""):
        raise ParameterError(
            f"faults: place = {pressed}: must be left out; the study presses the emergency stop"
        )
    if scenario.protection is None:
        scenario = scenario.changed({"protection": {}})
    scenario, starts_s = _starts(scenario, settings)
    safe_states = _safe_states(scenario, settings)
    kept, _ = applicable(scenario, uncertainty)
    faults = typical_faults(scenario)
    if settings.faults:
        faults = {fault_name(fault): (fault,) for fault in settings.faults}
    given = [(cause, fault) for cause, sizes in faults.items() for fault in sizes]
    items = [
        (cause, fault.permanent(start_s)) for (cause, fault), start_s in product(given, starts_s)
    ]
    own = scenario.controller.kind
    kinds = settings.controllers if own in ("smc", "pid") else ()
    cases: list[tuple[FaultRow, Scenario, FaultParameters]] = []
    stops: list[EmergencyStop] = []
    with open_sweep(**options) as sweep:
        for kind in dict.fromkeys(kinds or [own]):
            loop = _controlled(scenario, kind)
            _require_quiet(loop)
            assess = partial(_assess, loop, settings, safe_states)
            assessed = sweep.map(assess, items, "faults", group=_structure)
            for rows in zip(*assessed, strict=True):  # with one safe state
                of_faults = zip(map(_ROW.validate_python, rows), items, strict=True)
                cases += [(row, loop, fault) for row, (_, fault) in of_faults]
            presses = list(product(safe_states, starts_s))
            stopped = sweep.map(partial(_stop, loop, settings), presses, "emergency stops")
            stops += [_STOP.validate_python(values) for values in stopped]
        points = draw(kept, settings.samples, settings.seed)
        alarm = partial(_alarm, scenario, kept)
        alarms = sweep.map(alarm, points, "healthy runs", group=options_of)
    with_first = [case for case in cases if case[0].safe_state == safe_states[0]]
    worst, loop, fault = min(with_first, key=lambda case: urgency(case[0]))
    return FaultsResult(
        scenario=scenario,
        settings=settings,
        safe_states=safe_states,
        all_rows=tuple(row for row, *_ in cases),
        stops=tuple(stops),
        alarms=dict(Counter(filter(None, alarms))),
        healthy_runs=settings.samples,
        healthy_hours=settings.samples * scenario.duration_s / 3600.0,
        traces=_traces(_ending(_observed(loop, settings, worst.start_s), worst.safe_state), fault),
    )


def _controlled(scenario: Scenario, kind: str) -> Scenario:
    """Return the scenario with a controller of the kind ``kind``.

    If the controller of the scenario is of this kind, it is kept with its numbers.
    """
    same = scenario.controller.kind == kind
    return scenario if same else scenario.changed({"controller": kind})


def urgency(row: FaultRow) -> tuple[float, float, float]:
    """Return a key by which ``min`` and ``sorted`` put the worst row first.

    The worst row is the failure with the largest deviation. Rows without failure are compared by
    their margins, and then by the deviation without protection.
    """
    deviation_deg = row.protected.deviation_deg if row.has_failed else 0.0
    margin_s = math.inf if math.isnan(row.margin_s) else row.margin_s
    return -deviation_deg, margin_s, -row.alone.deviation_deg


def _safe_states(scenario: Scenario, settings: FaultsSettings) -> tuple[SafeState, ...]:
    """Return the safe states to compare, by default all that the plant allows.

    The first one is then the safe state of the scenario. Raises `ParameterError` if a safe state of
    ``settings`` does not suit the plant.
    """
    if settings.safe_states:
        for safe_state in settings.safe_states:
            _ending(scenario, safe_state)
        return tuple(dict.fromkeys(settings.safe_states))
    assert scenario.protection is not None
    found = [scenario.protection.safe_state]
    for safe_state in SAFE_STATES:
        with suppress(ParameterError):
            _ending(scenario, safe_state)
            found.append(safe_state)
    return tuple(dict.fromkeys(found))


def _ending(scenario: Scenario, safe_state: str) -> Scenario:
    """Return the scenario whose protection ends a stop in ``safe_state``."""
    return scenario.changed({"protection.safe_state": safe_state})


def _observed(scenario: Scenario, settings: FaultsSettings, start_s: float) -> Scenario:
    """Return the scenario whose run ends ``observed_s`` after the start of a fault."""
    return scenario.changed({"simulation.duration_s": start_s + settings.observed_s})


def _starts(scenario: Scenario, settings: FaultsSettings) -> tuple[Scenario, list[float]]:
    """Return the scenario with the duration of healthy runs, and the times at which faults begin.

    The faults begin in the second period of a sine. With another reference the last ``observed_s``
    of the run stay free, and the faults begin in the last three quarters of the time before.
    """
    period, shares = period_s(scenario), np.arange(settings.onsets) / settings.onsets
    if period:
        starts_s = period * (1.0 + shares)
        end_s = float(starts_s[-1]) + settings.observed_s
        return scenario.changed({"simulation.duration_s": end_s}), starts_s.tolist()
    latest_s = scenario.duration_s - settings.observed_s
    if latest_s <= 0.0:
        raise ParameterError(
            f"observed_s = {settings.observed_s:g} s: must be < {scenario.duration_s:g} s, the "
            f"duration of the run; reduce observed_s, or extend simulation.duration_s"
        )
    return scenario, (latest_s * (0.25 + 0.75 * shares)).tolist()


def _require_quiet(scenario: Scenario) -> None:
    """Raise `ParameterError` if the protection stops the run although there is no fault."""
    run = simulate(scenario, signals=("safety_reason",))
    stopped = np.flatnonzero(run["safety_reason"])
    if stopped.size:
        reason = REASONS[int(run["safety_reason"][stopped[0]])]
        raise ParameterError(
            f"protection: the detector {reason} stops the run without a fault at t = "
            f"{run.time_s[stopped[0]]:g} s with controller.kind = {scenario.controller.kind}; must "
            f"stop nothing; raise its threshold"
        )


def _structure(item: tuple[str, FaultParameters]) -> tuple[str, str]:
    """Return place and kind of a fault, on which the equations of a run with the fault depend.

    Runs of equal equations can share a batch.
    """
    _, fault = item
    return fault.place, fault.kind


@needs_runs
def _assess(
    scenario: Scenario,
    settings: FaultsSettings,
    safe_states: Sequence[str],
    item: tuple[str, FaultParameters],
) -> list[dict[str, Any]]:
    """Return a `FaultRow` for each safe state as plain data; runs in a worker process."""
    cause, fault = item
    scenario = _observed(scenario, settings, fault.start_s)
    alone = _without(scenario)
    healthy = _healthy(alone, users_code_key(alone))
    run, complete = _run(alone, fault)
    case = fault_case(alone, healthy, settings.bound_deg, fault, run if complete else None)
    start = _index(healthy, fault.start_s)
    deviation = _deviation_deg(run, healthy)
    shared = {
        "controller": scenario.controller.kind,
        "cause": cause,
        "bound_deg": settings.bound_deg,
        "observed_s": settings.observed_s,
        "fault": fault_name(fault),
        "start_s": fault.start_s,
        "critical_duration_s": case.critical_duration_s,
        "censored": case.censored,
        "flexes": bool(deviation[np.argmax(np.abs(deviation))] > 0.0),
        "alone": _peaks(run, healthy, slice(start, None)) | {"complete": complete},
    }
    return [
        shared | _protected(_ending(scenario, safe_state), settings, healthy, fault)
        for safe_state in safe_states
    ]


@lru_cache(maxsize=16)
def _healthy(scenario: Scenario, code: str | None) -> Run:
    """Return the run without faults, which each process makes once for each start of the faults.

    ``code``: the `users_code_key` of the scenario, because a law of the user can change.
    """
    return simulate(scenario, signals=_signals(scenario))


def _protected(
    scenario: Scenario, settings: FaultsSettings, healthy: Run, fault: FaultParameters
) -> dict[str, Any]:
    """Return the fields of a `FaultRow` that depend on the protection, as plain data.

    ``healthy`` is the run without fault, from which the deviation is measured.
    """
    assert scenario.protection is not None
    run, complete = _run(scenario, fault)
    found: dict[str, Any] = {"safe_state": scenario.protection.safe_state}
    found |= {"detector": "", "detected_after_s": math.inf}
    after = run.time_s - fault.start_s
    detected = np.flatnonzero((after >= 0.0) & (run["safety_reason"] > 0.0))
    if detected.size:
        found["detector"] = REASONS[int(run["safety_reason"][detected[0]])]
        found["detected_after_s"] = float(after[detected[0]])
    found["safe_after_s"], end = _safe_after(run, scenario, fault.start_s)
    peaks = _peaks(run, healthy, slice(_index(healthy, fault.start_s), end))
    found["protected"] = peaks | {"complete": complete or end is not None}
    found["rest"] = _rest(run, end, fault.start_s + settings.observed_s)
    return found


@needs_runs
def _stop(scenario: Scenario, settings: FaultsSettings, item: tuple[str, float]) -> dict[str, Any]:
    """Return the fields of an `EmergencyStop` as plain data; runs in a worker process."""
    safe_state, start_s = item
    protected = _ending(_observed(scenario, settings, start_s), safe_state)
    press = FaultParameters(place="emergency_stop", kind="value", size=1.0, start_s=start_s)
    run, _ = _run(protected, press)
    safe_after_s, end = _safe_after(run, protected, start_s)
    start = _index(run, start_s)
    return {
        "controller": scenario.controller.kind,
        "safe_state": safe_state,
        "start_s": start_s,
        "knee_deg": math.degrees(run["knee_angle_rad"][start]),
        "safe_after_s": safe_after_s,
        **turn_and_torque(run, slice(start, end)),
        "rest": _rest(run, end, start_s + settings.observed_s),
    }


def _rest(run: Run, end: int | None, end_s: float) -> dict[str, Any]:
    """Return the values of `Rest` from the sample before the index ``end`` until ``end_s``."""
    last = _index(run, end_s)
    if end is None or end >= last:
        return {"turn_deg": math.nan, "torque_n_m": math.nan, "complete": False}
    is_complete = bool(run.time_s[-1] > end_s - 1e-9)
    return turn_and_torque(run, slice(end - 1, last)) | {"complete": is_complete}


def _index(run: Run, time_s: float) -> int:
    """Return the index of the sample at ``time_s``, which rounding may have changed a little."""
    return int(np.searchsorted(run.time_s, time_s - 1e-9))


def _without(scenario: Scenario) -> Scenario:
    return scenario.changed({"protection": None})


def _signals(scenario: Scenario) -> tuple[str, ...]:
    available = available_signals(scenario)
    return tuple(name for name in _SIGNALS if name in available)


def _run(scenario: Scenario, fault: FaultParameters) -> tuple[Run, bool]:
    """Return the run with a fault, and whether the run is complete.

    A run that fails is repeated up to the sample before the failure.
    """
    faulty = scenario.changed({"faults": (fault,)})
    try:
        return simulate(faulty, signals=_signals(faulty)), True
    except SimulationError as error:
        if not error.time_s > fault.start_s:
            raise
        # A run checks the range of motion at each sample and at its last time, so the repeated run
        # ends one sample earlier than the failure.
        samples = math.ceil(error.time_s / scenario.controller.sample_time_s) - 2
    end_s = max(samples * scenario.controller.sample_time_s, fault.start_s)
    faulty = faulty.changed({"faults": (), "simulation.duration_s": end_s}).changed(
        {"faults": (fault,)}
    )
    return simulate(faulty, signals=_signals(faulty)), False


def _deviation_deg(run: Run, healthy: Run) -> Array:
    """Return the deviation of the knee at each sample of a run, positive in flexion."""
    angle, other = run["knee_angle_rad"], healthy["knee_angle_rad"]
    return np.degrees(angle - other[: angle.size])


def _safe_after(run: Run, protected: Scenario, start_s: float) -> tuple[float, int | None]:
    """Return the time from ``start_s`` to the first safe sample, and the index behind this sample.

    Without a `safe_sample` the result is inf and None.
    """
    safe = safe_sample(protected, run, slice(_index(run, start_s), None))
    return (math.inf, None) if safe is None else (float(run.time_s[safe]) - start_s, safe + 1)


def _peaks(run: Run, healthy: Run, part: slice) -> dict[str, Any]:
    """Return the largest values in a part of the samples."""
    values = {
        "deviation_deg": _deviation_deg(run, healthy),
        "torque_n_m": knee_torque(run),
        "pressure_mpa": 1e-6 * _pressure(run),
    }
    return {name: float(np.max(np.abs(value[part]))) for name, value in values.items()}


def _pressure(run: Run) -> Array:
    """Return the larger of both chambers' pressures; in reduced order the load pressure, in Pa."""
    if "cap_pressure_pa" in run.columns:
        return np.maximum(run["cap_pressure_pa"], run["rod_side_pressure_pa"])
    return run["load_pressure_pa"]


def _traces(scenario: Scenario, fault: FaultParameters) -> dict[str, dict[str, Array]]:
    """Return time in s, and knee and reference in deg, of three runs."""
    alone = _without(scenario)
    runs = {
        "healthy": simulate(alone, signals=_signals(alone)),
        "alone": _run(alone, fault)[0],
        "protected": _run(scenario, fault)[0],
    }
    return {
        name: {
            "time_s": run.time_s,
            "knee_deg": np.degrees(run["knee_angle_rad"]),
            "reference_deg": np.degrees(run["knee_reference_rad"]),
        }
        for name, run in runs.items()
    }


@needs_runs
def _alarm(scenario: Scenario, uncertainty: UncertaintySet, values: Mapping[str, Any]) -> str:
    """Return the detector that stops a healthy run with uncertain values, or an empty text."""
    run = simulate(realize(scenario, uncertainty, values), signals=("safety_reason",))
    return REASONS[int(run["safety_reason"][-1])] if run["safety_reason"][-1] else ""
