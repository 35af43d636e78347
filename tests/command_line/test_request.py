import pytest

from kneexo.command_line.request import named_in_errors
from kneexo.errors import (
    OutputError,
    PackageError,
    ParameterError,
    ScenarioError,
    WorkerError,
)


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (ParameterError("the knee stops"), "my.yaml: the knee stops"),
        (ParameterError("my.yaml is empty"), "my.yaml is empty"),
        (ParameterError("--workers = 0"), "--workers = 0"),
        (ScenarioError("set.yaml: is empty"), "set.yaml: is empty"),
        (WorkerError("Dask scheduler 'x'"), "Dask scheduler 'x'"),
        (OutputError("directory x"), "directory x"),
        (PackageError("distributed"), "distributed"),
    ],
)
def test_only_what_a_scenario_can_cause_names_its_file(error, line):
    with pytest.raises(type(error)) as caught, named_in_errors("my.yaml"):
        raise error
    assert str(caught.value) == line
    with pytest.raises(ParameterError, match=r"^wrong$"), named_in_errors(None):
        raise ParameterError("wrong")
