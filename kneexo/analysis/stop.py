"""The first stop of the protection in a run: cause, turn of the knee, torque, current of the brake.

A logged signal of the supervisor is that before the update at its time. So a stop is decided one
row before the first row that shows the stop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kneexo.diagrams.signals import columns
from kneexo.parameters import Scenario
from kneexo.parameters.plant import RPM
from kneexo.parameters.safety_states import (
    DETECTORS,
    LAW_ACTS,
    REASONS,
    SAFE_STATES,
    STATES,
    SafeState,
)
from kneexo.result import Array, Result
from kneexo.simulation import Run

_STOPPED, _RELEASED = (list(STATES).index(state) for state in ("stopped", "released"))


@dataclass(frozen=True, repr=False)
class Stop(Result):
    """How the protection stopped the motor for the first time in a run."""

    time_s: float
    """Time at which the supervisor stops the law."""
    reason: str
    """One of `REASONS`."""
    residual: float
    """Residual of the detector at the sample that made it trip; nan for another reason."""
    threshold: float
    """Threshold of the detector in the same unit; nan for another reason."""
    fault_s: float
    """Time from which on faults were active before the stop; nan without a fault."""
    safe_state: SafeState
    safe_s: float
    """Time at which the motor is safe, as in `safe_sample`; nan if it never is."""
    turn_deg: float
    """Largest turn of the knee from the fault on, or from the stop on, until the motor is safe."""
    safe_turn_deg: float
    """Largest turn of the knee from the safe motor on, until a reset or the end of the run."""
    safe_torque_n_m: float
    """Largest torque in the same time; see `knee_torque`."""
    reset_s: float
    """Time at which a reset lets the law act again; nan without a reset."""
    end_state: str
    """One of `STATES`, in which the run ends."""
    is_worn: bool
    """Whether the torque is that of a wearer."""

    @property
    def line(self) -> str:
        """One sentence: when and why, the turn since the fault, turn and torque after the stop."""
        cause = {"start": "a start that is overdue"}.get(self.reason, f"the {self.reason}")
        if self.reason in DETECTORS:
            unit = DETECTORS[self.reason].unit
            cause = f"the detector {self.reason}"
            if math.isfinite(self.residual):
                cause += f" ({self.residual:.4g} > {self.threshold:g} {unit})"
        is_earlier = self.fault_s < self.time_s
        since = f"since the fault at {self.fault_s:.4g} s" if is_earlier else "since then"
        line = f"Stopped at {self.time_s:.4g} s by {cause}; the knee turns {self.turn_deg:.3g}° "
        state = f"{self.safe_state}: {SAFE_STATES[self.safe_state]}"
        if math.isnan(self.safe_s):
            line += f"{since}, and the motor does not become safe ({state})"
        else:
            line += (
                f"{since} until the motor is safe at {self.safe_s:.4g} s ({state}), then "
                f"{self.safe_turn_deg:.3g}° with at most {self.safe_torque_n_m:.3g} N·m of the "
                f"{'wearer' if self.is_worn else 'actuator'}"
            )
        if not math.isnan(self.reset_s):
            line += f"; a reset follows at {self.reset_s:.4g} s, and the run ends {self.end_state}"
        return f"{line}."


def first_stop(scenario: Scenario, run: Run) -> Stop | None:
    """Return the first `Stop` in a run, or None if the protection does not stop the motor."""
    protection = scenario.protection
    if protection is None or not run["safety_reason"].any():
        return None
    first = int(np.argmax(run["safety_reason"] > 0.0))
    reason = REASONS[int(run["safety_reason"][first])]
    residual = threshold = math.nan
    if detector := DETECTORS.get(reason):
        # The residual changes a counter, the counter the state, and the record shows it after that.
        column = columns(["residuals"])[list(DETECTORS).index(reason)]
        residual = float(run[column][max(first - 2, 0)]) / detector.factor
        threshold = getattr(protection, detector.field)
    begin, fault_s = first - 1, math.nan
    active = run.columns.get("active_faults", np.zeros(first))[:first] > 0.0
    if (begins := np.flatnonzero(active & np.diff(active, prepend=False))).size:
        begin = int(begins[-1])
        # The row at the start of a faulty command or parameter is before the fault.
        begin -= any(abs(run.time_s[begin - 1] - f.begin_s) < 1e-9 for f in scenario.faults)
        fault_s = float(run.time_s[begin])
    law_acts = np.isin(run["safety_state"], [list(STATES).index(state) for state in LAW_ACTS])
    acts = first + np.flatnonzero(law_acts[first:])
    end = int(acts[0]) if acts.size else run.time_s.size
    safe = safe_sample(scenario, run, first)
    safe = None if safe is None or safe >= end else safe
    turn_deg, _ = turn_and_torque(run, slice(begin, end if safe is None else safe + 1))
    safe_turn_deg = safe_torque_n_m = math.nan
    if safe is not None:
        safe_turn_deg, safe_torque_n_m = turn_and_torque(run, slice(safe, end))
    return Stop(
        time_s=float(run.time_s[first - 1]),
        reason=reason,
        residual=residual,
        threshold=threshold,
        fault_s=fault_s,
        safe_state=protection.safe_state,
        safe_s=math.nan if safe is None else float(run.time_s[safe - 1]),
        turn_deg=turn_deg,
        safe_turn_deg=safe_turn_deg,
        safe_torque_n_m=safe_torque_n_m,
        reset_s=float(run.time_s[end - 1]) if acts.size else math.nan,
        end_state=list(STATES)[int(run["safety_state"][-1])],
        is_worn="interaction_torque_n_m" in run.columns,
    )


def safe_sample(protected: Scenario, run: Run, first: int) -> int | None:
    """Return the first safe sample from the sample ``first`` on, or None.

    At a safe sample the release is on, or the motor has stopped and stands. A motor that does not
    obey keeps turning in the state ``stopped``, which it reaches when the stop is overdue.
    """
    assert protected.protection is not None
    stands = np.abs(run["motor_speed_rad_s"]) < protected.protection.standstill_rpm * RPM
    state = run["safety_state"]
    safe = np.flatnonzero(((state == _RELEASED) | ((state == _STOPPED) & stands))[first:])
    return first + int(safe[0]) if safe.size else None


def turn_and_torque(run: Run, part: slice) -> tuple[float, float]:
    """Return the largest turn in deg from the start of a part of a run, and the largest torque."""
    angle = np.degrees(run["knee_angle_rad"][part])
    torque = knee_torque(run)[part]
    return float(np.max(np.abs(angle - angle[0]))), float(np.max(np.abs(torque)))


def knee_torque(run: Run) -> Array:
    """Return the torque of the wearer, or without a wearer that of the actuator, in N·m, (n,)."""
    if "interaction_torque_n_m" in run.columns:
        return run["interaction_torque_n_m"]
    return run["rod_force_n"] * run["moment_arm_m"]


def peak_motor_current_a(scenario: Scenario, run: Run) -> tuple[float, float]:
    """Return the largest current of the motor and the largest logged one; nan without currents.

    The current of a dynamic brake is largest just after the brake engages. The log has the current
    of the drive before the update that engages the brake, and then that of a slower motor.
    """
    if "motor_current_a" not in run.columns:
        return math.nan, math.nan
    current = np.abs(run["motor_current_a"])
    logged = peak = float(np.max(current))
    protection = scenario.protection
    if protection is not None and protection.safe_state == "dynamic_brake":
        speed = np.abs(run["motor_speed_rad_s"])
        braked = run["safety_state"] == _RELEASED
        for index in np.flatnonzero(braked & np.diff(braked, prepend=False)):
            # i = k_t ω/R. The next row has k_t/R, also of a motor that is hot or faulty.
            if speed[index] > 0.0:
                peak = max(peak, float(current[index] / speed[index] * speed[index - 1]))
    return peak, logged
