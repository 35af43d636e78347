"""Results of the study `wearer` that several test files read."""

import pytest
from wearer_cases import SMALL, made_up

from kneexo.studies.wearer.wearer import (
    WEARER_KNEE,
    wearer_study,
)


@pytest.fixture(scope="session")
def small():
    return wearer_study(WEARER_KNEE, SMALL)


@pytest.fixture(scope="session")
def by_hand():
    return made_up()
