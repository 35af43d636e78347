"""What a newcomer meets: signatures, one-line errors, short texts, news of a long compilation."""

import ast
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.primitives import Integrator, LinearSystem

from kneexo.compiler import compile_diagram
from kneexo.compiler.errors import CompilationError
from kneexo.compiler.native import machine_code


def imported_names(path):
    """Public names of the imports in a file, by the module that they come from."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    imports = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.level)
    return {alias.asname: node.module for node in imports for alias in node.names}


def test_the_names_for_the_type_checker_are_those_of_the_package():
    compiler = sys.modules[compile_diagram.__module__.rpartition(".")[0]]
    assert imported_names(Path(compiler.__file__)) == compiler._MODULE_OF
    for name in compiler.__all__:
        assert getattr(compiler, name) is not None
    with pytest.raises(AttributeError, match=r"has no attribute 'absent'$"):
        _ = compiler.absent


def lag():
    one = np.eye(1)
    return LinearSystem(-one, one, one, np.zeros((1, 1)), 0.0)


@pytest.mark.parametrize(
    ("system", "line"),
    [
        (42, "int 42: cannot be compiled; must be a Diagram or leaf system of floats"),
        (None, "NoneType None: cannot be compiled; must be a Diagram"),
    ],
)
def test_what_is_no_system_is_one_line(system, line):
    with pytest.raises(CompilationError) as caught:
        compile_diagram(system)
    assert str(caught.value).startswith(line)


def test_a_system_of_another_scalar_type_is_refused():
    from pydrake.autodiffutils import AutoDiffXd

    with pytest.raises(CompilationError, match=r"leaf system of floats$"):
        compile_diagram(lag().ToScalarType[AutoDiffXd]())


def test_a_single_system_is_named_where_it_cannot_be_compiled():
    system = lag()
    with pytest.raises(CompilationError, match=r"^LinearSystem: .*name the diagram's port in inp"):
        compile_diagram(system)
    system.set_name("lag")
    with pytest.raises(CompilationError, match=r"^lag: time derivatives"):
        compile_diagram(system)


def test_unknown_inputs_are_named_with_the_known_ones():
    with pytest.raises(CompilationError, match=r"^LinearSystem: has no input port 'u'; it has u0$"):
        compile_diagram(lag(), inputs=["u"])


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


@pytest.mark.parametrize(("body_s", "told"), [(0.0, False), (0.3, True)])
def test_a_long_compilation_is_told_on_stderr(monkeypatch, capfd, body_s, told):
    monkeypatch.setattr(machine_code, "ANNOUNCED_AFTER_S", 0.1)
    with machine_code._announced():
        time.sleep(body_s)
    time.sleep(0.15)
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == told
    if told:
        assert lines[0].startswith("compiling equations; machine code is kept in ")
        assert Path(lines[0].rpartition(" in ")[2]).is_absolute()


def test_worker_processes_are_silent(monkeypatch, capfd):
    monkeypatch.setattr(machine_code, "ANNOUNCED_AFTER_S", 0.0)
    monkeypatch.setattr(machine_code, "parent_process", lambda: "parent")
    with machine_code._announced():
        time.sleep(0.05)
    assert capfd.readouterr().err == ""
