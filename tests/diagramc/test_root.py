"""Names of diagramc in files and in the environment."""

import re

import pytest

import diagramc
from diagramc import compile_diagram
from diagramc.root import ROOT, TOOL, variable


def test_the_name_is_that_of_the_package_and_the_tool_has_its_version():
    assert compile_diagram.__module__.split(".")[0] == ROOT
    assert re.fullmatch(rf"{ROOT} \d+\.\d+\.\d+", TOOL)
    assert f"{ROOT} {diagramc.__version__}" == TOOL


def test_a_variable_of_before_is_accepted_with_a_line(monkeypatch):
    for name in ("DIAGRAMC_CPU", "KNEEXO_CPU"):
        monkeypatch.delenv(name, raising=False)
    assert variable("CPU") == "DIAGRAMC_CPU"
    monkeypatch.setenv("KNEEXO_CPU", "x86-64-v3")
    with pytest.warns(UserWarning, match="^KNEEXO_CPU: .* set DIAGRAMC_CPU instead$"):
        assert variable("CPU") == "KNEEXO_CPU"
    monkeypatch.setenv("DIAGRAMC_CPU", "")
    assert variable("CPU") == "DIAGRAMC_CPU"
