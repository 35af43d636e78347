"""Results of the robustness study that several test files read."""

import math

import pytest
from robustness_cases import (
    FEW,
    REAL,
    SMALL,
    assessment,
    uncertain,
)

from kneexo.parameters import (
    UNCERTAIN_KNEE,
)
from kneexo.studies.robustness.study import (
    RobustnessResult,
    robustness_study,
)


@pytest.fixture(scope="session")
def real():
    budget = FEW.model_copy(update={"samples": 4, "corners_max": 4, "sensitivity_duration_s": 0.1})
    wide = uncertain(
        plant__cylinder__mass_kg={"low": 1.4, "high": 1.8},
        plant__pump__lag_s={"low": 0.0099, "high": 0.0101, "scale": "log"},
    )
    return robustness_study(REAL, wide, budget)


@pytest.fixture(scope="session")
def by_hand():
    """Visits out of order, one of which fails; its corners have other numbers than its samples."""
    stopped = {"max_error_deg": math.nan, "tracking_failure": "t = 1 s: out of range"}
    return RobustnessResult(
        scenario=UNCERTAIN_KNEE,
        uncertainty=SMALL,
        left_out=("plant.load.knee_torque_n_m",),
        settings=FEW,
        nominal=assessment(1.0, None, None, None),
        one_at_a_time=(
            assessment(1.1, 1.4, None, None),
            assessment(0.8, 1.8, None, None),
            assessment(0.7, None, 0.005, None),
            assessment(1.6, None, 0.02, None),
            assessment(1.0, None, None, 0),
            assessment(1.2, None, None, 1),
            assessment(1.25, None, None, 2),
        ),
        samples=(
            assessment(1.5, 1.50, 0.012, 1),
            assessment(0.9, 1.45, 0.007, 2),
            assessment(1.9, 1.60, 0.019, 0),
            assessment(1.2, 1.75, 0.011, 2, **stopped),
            assessment(1.1, 1.65, 0.009, 1),
        ),
        corners=(
            assessment(2.3, 1.4, 0.005, 0),
            assessment(0.6, 1.8, 0.02, 1),
            assessment(2.1, 1.4, 0.02, 2),
        ),
        corners_possible=12,
        corners_settled=True,
        local={
            "rms_error_deg": {"plant.cylinder.mass_kg": 0.3, "plant.pump.lag_s": 0.05},
            "disk_margin": {"plant.cylinder.mass_kg": -0.2, "plant.pump.lag_s": -0.07},
        },
        local_failures=("tracking: too long",),
    )
