"""Results of the size study that several test files read."""

from __future__ import annotations

import pytest
from size_cases import SMALL, made_up

from kneexo.studies.size.size import size_study
from kneexo.sweeps.checkpoint import Checkpoint


@pytest.fixture(scope="session")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("sizing") / "checkpoint"
    return size_study(settings=SMALL, checkpoint=Checkpoint(path)), path


@pytest.fixture(scope="session")
def sized():
    return made_up()
