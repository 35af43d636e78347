"""Shared by the tests of C: a false Zig, and WebAssembly modules that run under wasmtime."""

import ctypes

import numpy as np
import pytest

from diagramc.c import build

FAKE_ZIG = """
import sys

arguments = sys.argv[1:]
if "x86_64-windows-gnu" in arguments and FAILS:
    sys.exit("m.c:1:1: error: odd")
with open(arguments[arguments.index("-o") + 1], "w") as file:
    file.write(" ".join(arguments))
"""


@pytest.fixture
def zig(tmp_path, monkeypatch):
    """``zig(fails)``: in the place of Zig a program that writes its arguments as library."""

    def install(fails=False):
        package = tmp_path / "ziglang"
        package.mkdir()
        (package / "__init__.py").touch()
        (package / "__main__.py").write_text(FAKE_ZIG.replace("FAILS", str(fails)))
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))
        monkeypatch.setenv(
            "DIAGRAMC_CACHE_DIR", str(tmp_path / "cache")
        )  # it makes no real modules

    return install


@pytest.fixture
def no_targets(monkeypatch):
    """Flash and stack are not measured."""
    monkeypatch.setattr(build, "TARGETS", {})


@pytest.fixture
def script():
    """``script(path, text)``: a program of the shell."""

    def write(path, text):
        path.write_text(f"#!/bin/sh\n{text}\n")
        path.chmod(0o755)

    return write


class WebRun:
    """A module in wasmtime; its exports are methods, its vectors are NumPy arrays."""

    def __init__(self, code):
        wasmtime = pytest.importorskip("wasmtime", reason="needs wasmtime: pip install wasmtime")
        self.store = wasmtime.Store()
        module = wasmtime.Module(self.store.engine, code)
        self.imports = len(module.imports)
        self.exports = wasmtime.Instance(self.store, module, []).exports(self.store)
        self("_initialize")

    def __call__(self, name, *arguments):
        return self.exports[name](self.store, *arguments)

    def vector(self, name, *shape):
        """The doubles at the address that the export ``name`` returns; a view."""
        start = self.exports["memory"].data_ptr(self.store)
        start = ctypes.addressof(start.contents) + self(name)
        buffer = (ctypes.c_double * int(np.prod(shape))).from_address(start)
        return np.frombuffer(buffer).reshape(shape)

    def run(self, table, inputs=None, ticks=None, params=None):
        """The outputs (ticks + 1, n) of a run; the inputs have a row for each tick."""
        ticks = len(inputs) if ticks is None else ticks
        self("defaults")
        if params is not None:
            self.vector("params", len(params))[:] = params
        assert self("reserve", ticks) == 1
        if inputs is not None:
            self.vector("inputs", len(table["inputs"]), ticks + 1)[:, :-1] = np.transpose(inputs)
        assert self("start") == 0
        assert self("advance", 0, ticks) == ticks
        return self.vector("outputs", len(table["outputs"]), ticks + 1).T.copy()


@pytest.fixture
def web_run():
    """The class `WebRun`."""
    return WebRun
