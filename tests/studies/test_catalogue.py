import inspect

import pytest

from kneexo.parameters import Scenario
from kneexo.studies.catalogue import STUDIES
from kneexo.sweeps import SweepOptions


@pytest.mark.parametrize("study", STUDIES.values(), ids=lambda study: study.name)
def test_the_catalogue_is_true(study):
    parameters = inspect.signature(study.compute).parameters
    assert ("uncertainty" in parameters) == study.uncertain
    options = SweepOptions.__annotations__ if "options" in parameters else parameters
    assert ("checkpoint" in options) == study.resumable
    assert isinstance(study.scenario, Scenario)
    assert isinstance(parameters["settings"].default, study.settings)
    assert study.command.split()[-1] == study.name
