"""What a newcomer meets: signatures, one-line errors, short texts, news of a long compilation."""

import ast
import sys
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.primitives import Integrator

from diagramc import compile_diagram


def imported_names(path):
    """Public names of the imports in a file, by the module that they come from."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    imports = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.level)
    return {alias.asname: node.module for node in imports for alias in node.names}


def test_the_names_for_the_type_checker_are_those_of_the_package():
    compiler = sys.modules[compile_diagram.__module__.rpartition(".")[0]]
    names = compiler._MODULE_OF | {"__version__": "version"}
    assert imported_names(Path(compiler.__file__)) == names
    for name in compiler.__all__:
        assert getattr(compiler, name) is not None
    with pytest.raises(AttributeError, match=r"has no attribute 'absent'$"):
        _ = compiler.absent


def test_a_model_without_sample_time_needs_a_tick():
    model = compile_diagram(Integrator(1), inputs=["u0"])
    arguments = (model.parameters(), model.state())
    with pytest.raises(ValueError, match=r"^tick_s is needed: the model has no sample time$"):
        model.as_system(*arguments)
    for tick_s in (0.0, -1.0, np.inf):
        with pytest.raises(ValueError, match=r"^tick_s = .*: must be finite and > 0$"):
            model.as_system(*arguments, tick_s=tick_s)
    assert model.as_system(*arguments, tick_s=0.01).num_input_ports() == 1


def test_models_and_runs_have_short_texts():
    model = compile_diagram(Integrator(1), inputs=["u0"])
    assert repr(model) == (
        "DiagramModel(0 parameters, 1 continuous and 0 discrete states, inputs: u0, outputs: y0)"
    )
    run = model.simulate(model.parameters(), model.state(), 0.1, record_period_s=0.05)
    assert repr(run) == "Simulation(3 records of y0)"
