"""Machine code of a model: loaded once, found again after pickling, announced if slow."""

import pickle
import threading
import time
from pathlib import Path

import pytest
from pydrake.symbolic import Variable
from pydrake.systems.primitives import SymbolicVectorSystem

from diagramc import State, compile_diagram
from diagramc.native import cache, machine_code
from diagramc.root import variable


@pytest.mark.parametrize(("body_s", "announced"), [(0.0, False), (0.3, True)])
def test_a_long_compilation_is_announced_on_stderr(monkeypatch, capfd, body_s, announced):
    monkeypatch.setattr(machine_code, "ANNOUNCED_AFTER_S", 0.1)
    monkeypatch.setattr(machine_code, "_announcement", threading.Event())
    for _ in range(2):  # one line is enough
        with machine_code._announced():
            time.sleep(body_s)
    time.sleep(0.15)
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == announced
    if announced:
        assert lines[0].startswith("compiling equations; machine code is kept in ")
        assert Path(lines[0].rpartition(" in ")[2]).is_absolute()


def test_worker_processes_are_silent(monkeypatch, capfd):
    monkeypatch.setattr(machine_code, "ANNOUNCED_AFTER_S", 0.0)
    monkeypatch.setattr(machine_code, "_announcement", threading.Event())
    monkeypatch.setattr(machine_code, "parent_process", lambda: "parent")
    with machine_code._announced():
        time.sleep(0.05)
    assert capfd.readouterr().err == ""


def test_code_for_one_run_and_for_lanes_are_two_entries_and_loaded_once(monkeypatch, tmp_path):
    monkeypatch.setenv(variable("CACHE_DIR"), str(tmp_path / "cache"))
    x = Variable("x")

    def simulate(count):
        system = SymbolicVectorSystem(state=[x], dynamics=[-1.2345 * x], output=[x])
        model = compile_diagram(system)
        parameters, states = [model.parameters()] * count, State([1.0], [])
        model.simulate_batch(parameters, states, 0.1, record_period_s=0.1)
        return len(cache.cache_entries())

    alone = simulate(1)
    assert simulate(8) == alone + 1
    cache.clear_cache()
    assert simulate(1) == simulate(8) == 0  # this process has them


def test_a_pickled_model_has_the_same_code():
    x = Variable("x")
    model = compile_diagram(SymbolicVectorSystem(state=[x], dynamics=[-x], output=[x]))
    code = pickle.loads(pickle.dumps(model.code))
    assert code.key == model.code.key
    assert code.layout == model.code.layout
    assert code.start_function("constants") is model.code.start_function("constants")


def test_unknown_functions_are_refused():
    x = Variable("x")
    model = compile_diagram(SymbolicVectorSystem(state=[x], dynamics=[-x], output=[x]))
    with pytest.raises(KeyError, match="finish"):
        model.code.start_function("finish")
