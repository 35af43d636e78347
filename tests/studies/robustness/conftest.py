"""Results of the robustness study that several test files read."""

import pytest
from robustness_cases import FEW, REAL, made_up, uncertain

from kneexo.studies.robustness.robustness import (
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
    return made_up()
