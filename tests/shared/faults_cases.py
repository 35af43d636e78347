"""A result of the study `faults` that is made up, with a row of each verdict."""

import math
from dataclasses import replace

import numpy as np

from kneexo.parameters import UNCERTAIN_KNEE, FaultParameters
from kneexo.parameters.criteria import OBSERVED_S
from kneexo.studies.faults import FaultsResult, FaultsSettings
from kneexo.studies.faults.faults import EmergencyStop, FaultRow, Peaks, Rest


def row(
    cause,
    fault,
    critical_s,
    detector,
    safe_s,
    *,
    start_s=10.0,
    flexes=True,
    complete=True,
    moved_deg=4.567,
    safe_state="zero_speed",
    turn_deg=0.876,
):
    return FaultRow(
        controller="smc",
        safe_state=safe_state,
        cause=cause,
        fault=fault,
        start_s=start_s,
        alone=Peaks(23.45, 12.34, 2.345, complete),
        flexes=flexes,
        critical_duration_s=critical_s,
        censored=critical_s == OBSERVED_S,
        detector=detector,
        detected_after_s=0.5 * safe_s,
        safe_after_s=safe_s,
        protected=Peaks(moved_deg, 6.789, 1.234, complete),
        rest=Rest(turn_deg, 3.45, True)
        if math.isfinite(safe_s)
        else Rest(math.nan, math.nan, False),
        bound_deg=5.0,
        observed_s=OBSERVED_S,
    )


def _without_torque(zero_speed):
    """The row with the safe state torque_off, which is quicker if the command is lost."""
    if zero_speed.cause != "command lost":
        return replace(zero_speed, safe_state="torque_off")
    return replace(
        zero_speed,
        safe_state="torque_off",
        safe_after_s=0.0234,
        protected=Peaks(3.456, 4.321, 0.987, True),
        rest=Rest(12.34, 3.21, True),
    )


def made_up():
    time_s = np.linspace(0.0, 15.0, 31)
    curves = {"healthy": 0.0, "alone": 2.0, "protected": 1.0}
    rows = (
        row("magnet slipped", "encoder offset 1 deg", OBSERVED_S, "", math.inf),
        row("magnet slipped", "encoder offset 5 deg", 0.876, "flow", 0.0543),
        row(
            "command lost",
            "command scale 0",
            0.321,
            "following",
            0.432,
            flexes=False,
            moved_deg=5.678,
        ),
        row(
            "command lost",
            "command scale 0",
            0.654,
            "following",
            0.567,
            start_s=12.5,
            moved_deg=5.432,
        ),
        row("wear", "leakage", 0.987, "", math.inf, complete=False, moved_deg=9.876),
    )
    return FaultsResult(
        scenario=UNCERTAIN_KNEE,
        settings=FaultsSettings(),
        safe_states=("zero_speed", "torque_off"),
        all_rows=(*rows, *(_without_torque(row) for row in rows)),
        stops=(
            EmergencyStop(
                "pid", "zero_speed", 10.0, 34.5, 0.0765, 1.1, 22.3, Rest(0.3, 5.43, True)
            ),
            EmergencyStop(
                "smc", "zero_speed", 10.0, 34.5, 0.0876, 1.23, 23.4, Rest(0.456, 4.56, True)
            ),
            EmergencyStop(
                "smc", "zero_speed", 12.5, 45.6, 0.0543, 2.34, 12.3, Rest(0.567, 5.67, True)
            ),
            EmergencyStop(
                "smc", "torque_off", 10.0, 34.5, 0.0321, 3.21, 32.1, Rest(6.78, 7.89, True)
            ),
            EmergencyStop(
                "smc", "torque_off", 12.5, 45.6, 0.0432, 4.32, 21.0, Rest(8.91, 9.12, True)
            ),
        ),
        alarms={"rate": 2, "speed": 1},
        healthy_runs=200,
        healthy_hours=1.19,
        traces={
            name: {
                "time_s": time_s,
                "knee_deg": 40.0 + rate * time_s,
                "reference_deg": np.full(31, 41.0),
            }
            for name, rate in curves.items()
        },
    )


DEAD = FaultParameters(place="command", kind="scale", size=0.0)
SWAPPED = FaultParameters(place="command", kind="scale", size=-1.0)
QUICK = FaultsSettings(
    faults=(DEAD, SWAPPED), controllers=("smc",), onsets=2, observed_s=2.0, samples=3
)
FAST = UNCERTAIN_KNEE.changed({"reference.frequency_hz": 0.2, "reference.amplitude_deg": 15.0})
SMALL_STUDY = {"scenario": FAST, "settings": QUICK}
"""Arguments of a study that takes about a second."""
