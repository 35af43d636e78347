"""Results of the reproduce study that several test files read."""

import pytest
from reproduce_cases import made_up


@pytest.fixture(scope="session")
def known():
    return made_up()
