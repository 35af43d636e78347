"""Results of the contest study that several test files read."""

import pytest
from contest_cases import (
    BASE,
    LAG,
    SMALL,
    made_up,
)

from kneexo.parameters.paths import changed
from kneexo.studies.contest.contest import (
    contest_study,
)
from kneexo.studies.paper import PID_PAPER
from kneexo.sweeps.checkpoint import Checkpoint


@pytest.fixture(params=["made up", "run"])
def contest(request):
    """A contest by hand, and one that was held."""
    return made_up() if request.param == "made up" else request.getfixturevalue("small")[0]


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    checkpoint = Checkpoint(tmp_path_factory.mktemp("contest") / "checkpoint.jsonl")
    # The study replaces duration and controller.
    other = changed(BASE, {"simulation.duration_s": 7.0, "controller": PID_PAPER.model_dump()})
    return contest_study(other, LAG, SMALL, checkpoint=checkpoint), checkpoint
