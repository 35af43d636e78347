"""Results of the controller study that several test files read."""

import pytest
from controller_cases import BASE, SMALL, made_up

from kneexo.studies.controller.controller import (
    controller_study,
)
from kneexo.sweeps.checkpoint import Checkpoint


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    checkpoint = Checkpoint(tmp_path_factory.mktemp("study") / "checkpoint.jsonl")
    return controller_study(BASE, SMALL, checkpoint=checkpoint), checkpoint


@pytest.fixture(scope="session")
def by_hand():
    return made_up()
