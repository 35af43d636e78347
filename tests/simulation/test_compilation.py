"""`compile`: scenarios, scenario files and diagrams."""

import pytest
from pydrake.systems.primitives import Integrator

import kneexo
from kneexo.errors import CompilationError, ScenarioError
from kneexo.parameters import Scenario
from kneexo.simulation import compile_scenario


def test_inputs_of_a_scenario_cannot_be_chosen():
    with pytest.raises(CompilationError, match=r"^inputs: must be left out for a scenario"):
        kneexo.compile(Scenario(), inputs=["knee_reference"])


def test_a_scenario_file_compiles(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text("encoder: {quantized: false}\n", encoding="utf-8")
    for name in (path, str(path)):
        assert kneexo.compile(name).state_names == compile_scenario(Scenario()).state_names
    path.write_text("encoder: {quantised: false}\n", encoding="utf-8")
    with pytest.raises(ScenarioError, match="quantised"):
        kneexo.compile(path)


def test_a_diagram_compiles():
    assert kneexo.compile(Integrator(1), inputs=["u0"]).inputs == {"u0": 1}


def test_a_law_that_is_called_as_python_is_no_machine_code():
    scenario = Scenario().with_law(lambda rod_extension: max(0.0, rod_extension))
    with pytest.raises(
        CompilationError, match=r"called as Python: the function branches on a value"
    ):
        kneexo.compile(scenario)
