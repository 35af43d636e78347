"""The first stop of the protection in a run: its cause, turn of the knee, torque, brake's current.

A logged signal of the supervisor is that before the update at its time. So a stop is decided one
row before the first row that shows the stop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kneexo.analysis.tracking.clauses import CAUSES, said
from kneexo.common.result import Array, Result
from kneexo.diagrams.signals import columns
from kneexo.parameters import Scenario
from kneexo.parameters.device.plant import RPM
from kneexo.parameters.device.safety_states import (
    DETECTORS,
    REASONS,
    SAFE_STATES,
    STATES,
    SafeState,
)
from kneexo.simulation import Run

# The states before the first of these are `kneexo.parameters.device.safety_states.LAW_ACTS`.
_STOPPING, _STOPPED, _RELEASED = map(list(STATES).index, ("stopping", "stopped", "released"))


@dataclass(frozen=True, repr=False)
class Stop(Result):
    """How the protection stopped the motor for the first time in a run."""

    time_s: float
    """Time at which the supervisor stops the law."""
    reason: str
    """One of `REASONS`."""
    residual: float
    """Residual at the sample at which the detector detected the fault; nan for another reason."""
    threshold: float
    """Threshold of the detector in the same unit; nan for another reason."""
    fault_s: float
    """Time from which on faults were active before the stop; ``time_s`` without a fault."""
    turn_deg: float
    """Largest turn of the knee from ``fault_s`` on until the motor is safe."""
    torque_n_m: float
    """Largest torque in the same time; see `knee_torque`."""
    safe_state: SafeState
    safe_s: float
    """Time at which the motor is safe, as in `safe_sample`; nan if the motor never is safe."""
    safe_turn_deg: float
    """Largest turn of the knee from the safe motor on, until a reset or the end of the run."""
    safe_torque_n_m: float
    """Largest torque in the same time; see `knee_torque`."""

    @property
    def line(self) -> str:
        """When and why; time from the fault to the stop and the safe motor; turns and torques."""
        cause = CAUSES[self.reason]
        if detector := DETECTORS.get(self.reason):
            cause += f" ({self.residual:.4g} > {self.threshold:g} {detector.unit})"
        stop_ms, safe_ms = (1e3 * (time_s - self.fault_s) for time_s in (self.time_s, self.safe_s))
        numbers = vars(self) | {"cause": cause, "stop_ms": stop_ms, "safe_ms": safe_ms}
        clauses, end = ["stopped", "safe"], "."
        if stop_ms > 0.0:
            clauses = ["stopped", "after the fault", "safe after the fault"]
        if math.isnan(self.safe_s):
            clauses[-1] = "not safe"
        else:
            end = f", and then {self.safe_turn_deg:.3g}° at up to {self.safe_torque_n_m:.3g} N·m."
        state = f"({self.safe_state}: {SAFE_STATES[self.safe_state]})"
        return f"{said(*clauses, **numbers)} {state}{said('until safe', **numbers)}{end}"


def first_stop(scenario: Scenario, run: Run) -> Stop | None:
    """Return the first `Stop` in a run, or None if the protection does not stop the motor."""
    protection = scenario.protection
    if protection is None or not run["safety_reason"].any():
        return None
    first = int(np.argmax(run["safety_reason"] > 0.0))
    reason, size = REASONS[int(run["safety_reason"][first])], (math.nan, math.nan)
    if detector := DETECTORS.get(reason):
        # The residual changes a counter, the counter the state, and the record shows it after that.
        column = columns(["residuals"])[list(DETECTORS).index(reason)]
        residual = float(run[column][max(first - 2, 0)]) / detector.factor
        size = residual, getattr(protection, detector.field)
    active = run.columns.get("active_faults", np.zeros(first))[:first] > 0.0
    begin = np.append(first - 1, np.flatnonzero(active & np.diff(active, prepend=False)))[-1]
    # The row at the start of a faulty command or parameter is before the fault.
    begin -= any(abs(run.time_s[begin - 1] - fault.begin_s) < 1e-9 for fault in scenario.faults)
    law_acts = np.flatnonzero(run["safety_state"] < _STOPPING)
    end = int(np.append(law_acts[law_acts > first], run.time_s.size)[0])
    safe = safe_sample(scenario, run, slice(first, end))
    rest: tuple[float, ...] = (math.nan, math.nan, math.nan)
    if safe is not None:
        rest = float(run.time_s[safe - 1]), *turn_and_torque(run, slice(safe, end)).values()
    acting = slice(begin, end if safe is None else safe + 1)
    turn_deg, torque_n_m = turn_and_torque(run, acting).values()
    times = float(run.time_s[first - 1]), float(run.time_s[begin])
    peaks = times[1], turn_deg, torque_n_m
    return Stop(times[0], reason, *size, *peaks, protection.safe_state, *rest)


def safe_sample(protected: Scenario, run: Run, part: slice) -> int | None:
    """Return the first safe sample of a part of a run, or None.

    At a safe sample the release is on, or the motor has stopped and stands. A motor that does not
    obey keeps turning in the state ``stopped``, which it reaches when the stop is overdue.
    """
    assert protected.protection is not None
    stands = np.abs(run["motor_speed_rad_s"]) < protected.protection.standstill_rpm * RPM
    state = run["safety_state"]
    safe = np.flatnonzero(((state == _RELEASED) | ((state == _STOPPED) & stands))[part])
    return part.start + int(safe[0]) if safe.size else None


def turn_and_torque(run: Run, part: slice) -> dict[str, float]:
    """Return the largest turn of the knee and the largest `knee_torque` in a part of a run.

    ``turn_deg`` counts from the knee angle at the start of the part. The torque is ``torque_n_m``.
    """
    angle, torque = np.degrees(run["knee_angle_rad"][part]), knee_torque(run)[part]
    values = {"turn_deg": angle - angle[0], "torque_n_m": torque}
    return {name: float(np.max(np.abs(value))) for name, value in values.items()}


def knee_torque(run: Run) -> Array:
    """Return the torque of the wearer, or without a wearer that of the actuator, in N·m, (n,)."""
    worn = run.columns.get("interaction_torque_n_m")
    return run["rod_force_n"] * run["moment_arm_m"] if worn is None else worn


def peak_motor_current_a(scenario: Scenario, run: Run) -> tuple[float, float]:
    """Return the largest current of the motor and the largest logged one; nan without currents.

    The current of a dynamic brake is largest just after the brake engages. The log has the current
    of the drive before the update that engages the brake, and then that of a slower motor.
    """
    current = np.abs(run.columns.get("motor_current_a", np.full(run.time_s.size, math.nan)))
    logged = float(np.max(current))
    if scenario.protection is None or scenario.protection.safe_state != "dynamic_brake":
        return logged, logged
    speed, braked = np.abs(run["motor_speed_rad_s"]), run["safety_state"] == _RELEASED
    on = np.flatnonzero(braked & np.diff(braked, prepend=False) & (speed > 0.0))
    # i = k_t ω/R. The first row with the brake has k_t/R, also of a motor that is hot or faulty.
    return float(np.max(current[on] / speed[on] * speed[on - 1], initial=logged)), logged
