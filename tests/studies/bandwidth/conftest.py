"""Results of the bandwidth study that several test files read."""

import pytest
from bandwidth_cases import SMALL_MAP, made_up

from kneexo.parameters import Scenario
from kneexo.studies.bandwidth import bandwidth_study
from kneexo.sweeps.checkpoint import Checkpoint


@pytest.fixture(scope="session")
def mapped(tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "checkpoint.jsonl"
    return bandwidth_study(Scenario(), SMALL_MAP, checkpoint=Checkpoint(path)), path


@pytest.fixture(scope="session")
def by_hand():
    return made_up()
