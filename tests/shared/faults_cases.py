"""A result of the study `faults` that is made up, with a row of each verdict."""

import math

import numpy as np

from kneexo.parameters import UNCERTAIN_KNEE
from kneexo.studies.faults import FaultsResult, FaultsSettings
from kneexo.studies.faults.study import EmergencyStop, FaultRow, Peaks


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
):
    return FaultRow(
        controller="smc",
        cause=cause,
        fault=fault,
        start_s=start_s,
        alone=Peaks(23.45, 12.34, 2.345, complete),
        flexes=flexes,
        critical_duration_s=critical_s,
        detector=detector,
        detected_after_s=0.5 * safe_s,
        safe_after_s=safe_s,
        protected=Peaks(moved_deg, 6.789, 1.234, complete),
        bound_deg=5.0,
    )


def made_up():
    time_s = np.linspace(0.0, 15.0, 31)
    curves = {"healthy": 0.0, "alone": 2.0, "protected": 1.0}
    return FaultsResult(
        scenario=UNCERTAIN_KNEE,
        settings=FaultsSettings(),
        rows=(
            row("magnet slipped", "encoder offset 1 deg", math.inf, "", math.inf),
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
        ),
        stops=(
            EmergencyStop("smc", 10.0, 0.0876, 1.23, 23.4),
            EmergencyStop("smc", 12.5, 0.0543, 2.34, 12.3),
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
