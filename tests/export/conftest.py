"""Shared: the helper of the benchmarks that compiles exported C, the example of a controller."""

import importlib
import shutil
from pathlib import Path

import pytest
from elsewhere import module_of

from diagramc.c import build as c_build

ROOT = Path(__file__).parents[2]


fmus = module_of("fmus_elsewhere", ROOT / "tests/diagramc/fmu/conftest.py")
fmu_instance, run_elsewhere = fmus.fmu_instance, fmus.run_elsewhere
wasm = module_of("wasm_runs", ROOT / "tests/diagramc/c/conftest.py")
web_run = wasm.web_run


@pytest.fixture
def exported(monkeypatch):
    """``benchmarks/exported.py``; skips where there is no C compiler."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    hand_written = importlib.import_module("hand_written")
    try:
        hand_written.c_compiler()
    except hand_written.NoCompilerError as error:
        pytest.skip(str(error))
    return importlib.import_module("exported")


@pytest.fixture(scope="session")
def backstepping():
    """The scenario of ``examples/backstepping.py``, with its own controller."""
    return module_of("backstepping", ROOT / "examples" / "backstepping.py").BACKSTEPPING


@pytest.fixture
def no_targets(monkeypatch):
    """Flash and stack are not measured."""
    monkeypatch.setattr(c_build, "TARGETS", {})


@pytest.fixture
def no_compiler(monkeypatch, no_targets):
    """What is written is not built."""
    monkeypatch.setattr(c_build, "COMPILERS", ())


@pytest.fixture
def tool():
    """The function ``tool(name)``: the path of a program; skips where it is missing."""

    def find(name):
        path = shutil.which(name)
        if path is None:
            pytest.skip(f"{name} is not installed")
        return path

    return find
