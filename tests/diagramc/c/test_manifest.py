"""The manifest of an export: checksums of files, equations and parameters, on disk and in C."""

import ctypes
import hashlib
import json

import numpy as np
import pytest
from pydrake.systems.primitives import LinearSystem

from diagramc import export_c, read_diagram, source_of
from diagramc.c import build as c_build
from diagramc.c.manifest import exported_name, manifest_in_c
from diagramc.c.source import CSource
from diagramc.equations.equations import Equations, Update
from diagramc.run_data import State


def lag(gain=2.0):
    """A continuous lag with an input."""
    system = LinearSystem(A=[[-gain]], B=[[1.0]], C=[[1.0]], D=[[0.0]])
    system.set_name("lag")
    return system


def scaled(values=(2.0, 1e-3), constant=3.0):
    """Y = 3 p₀ p₁ x, x⁺ = x, with parameters that a float rounds."""
    equations = Equations(parameters=["law.a", "law.b"], discrete=["law.0[0]"])
    g = equations.graph
    x = g.source("discrete", 0)
    factors = [g.constant(constant), g.source("parameter", 0), g.source("parameter", 1), x]
    equations.outputs = {"y": [g.multiply(*factors)]}
    equations.initial_discrete = [x]
    equations.states, equations.derivatives = ["law.x[0]"], [g.negate(g.source("state", 0))]
    equations.updates = [Update(0.1, 0.0, ((0, x),))]
    return equations, "m", np.array(values), State(np.array([0.7]), np.array([0.1]))


def test_the_manifest_has_the_checksum_of_each_file(tmp_path, no_targets):
    origin = ("lag.yaml", "gain: 2.0\n")
    options = {"name": "lag", "inputs": ["u0"], "tick_s": 0.1, "step_s": 0.05, "steps": 4}
    for folder in ("a", "b"):
        export_c(lag(), tmp_path / folder, origin=origin, **options)
    text = (tmp_path / "a" / "manifest.json").read_text()
    assert text == (tmp_path / "b" / "manifest.json").read_text()
    manifest = json.loads(text)
    files = {path.name: path.read_bytes() for path in (tmp_path / "a").iterdir()}
    del files["manifest.json"]
    assert manifest["files"] == {
        name: hashlib.sha256(content).hexdigest() for name, content in files.items()
    }
    assert manifest["origin"] == "lag.yaml"
    assert manifest["sha256"]["origin"] == manifest["files"]["lag.yaml"]
    assert (manifest["name"], manifest["precision"]) == ("lag", "double")
    assert (manifest["tick_s"], manifest["rk4_steps_per_tick"]) == (0.1, 2)
    assert set(manifest["compiler_flags"]["required"]) < set(c_build.FLAGS)
    assert exported_name(tmp_path / "a") == "lag"


@pytest.mark.parametrize("precision", ["double", "float"])
def test_the_code_has_the_numbers_of_the_manifest(built, precision):
    tool = "tool 3.14.15.dev7, other 9.8.7"
    options = {"precision": precision, "tick_s": 0.1, "tool": tool}
    source = CSource(*scaled(), **options, origin=("a.yaml", "a: 1\n"))
    library = built(source).library
    words = list((ctypes.c_uint32 * 27).in_dll(library, "m_manifest"))
    assert words[:3] == [3, 14, 15]
    sums = ["".join(f"{word:08x}" for word in words[i : i + 8]) for i in (3, 11, 19)]
    assert dict(zip(("equations", "parameters", "origin"), sums, strict=True)) == source.checksums
    real = {"double": ctypes.c_double, "float": ctypes.c_float}[precision]
    in_memory = bytes((real * 4).in_dll(library, "m_params"))
    assert sums[1] == hashlib.sha256(in_memory).hexdigest()
    assert sums[2] == hashlib.sha256(f"# {source.first_line}\na: 1\n".encode()).hexdigest()


def test_each_checksum_follows_what_it_belongs_to():
    first = CSource(*scaled(), tick_s=0.1).checksums
    other_values = CSource(*scaled(values=(2.0, 1.1e-3)), tick_s=0.1).checksums
    other_equations = CSource(*scaled(constant=3.5), tick_s=0.1).checksums
    named = CSource(*scaled(), tick_s=0.1, origin=("a.yaml", "")).checksums
    assert first["equations"] == other_values["equations"] != other_equations["equations"]
    assert first["parameters"] == other_equations["parameters"] != other_values["parameters"]
    assert set(first["origin"]) == {"0"} != set(named["origin"])


def test_the_checksum_of_the_equations_is_that_of_the_diagram():
    """The C printer adds nodes to its own copy of the equations."""
    read = read_diagram(lag(), inputs=["u0"])
    source = source_of(read, "lag", tick_s=0.1)
    assert len(source.plan.equations.graph.nodes) > len(read.equations.graph.nodes)
    assert source.checksums["equations"] == read.key


def test_a_model_without_parameters_has_a_manifest(built):
    system = LinearSystem(A=[], B=[], C=[], D=[[2.0]])
    system.set_name("gain")
    source = source_of(read_diagram(system, inputs=["u0"]), "m", tick_s=0.1)
    words = list((ctypes.c_uint32 * 27).in_dll(built(source).library, "m_manifest"))
    zero = hashlib.sha256(bytes(8)).hexdigest()
    assert "".join(f"{word:08x}" for word in words[11:19]) == zero


def test_a_tool_without_version_has_zeros():
    assert manifest_in_c({}, "copy") == {"version": ["0U", "0U", "0U"]}


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"name": "My web page"}', "\xff"])
def test_a_folder_without_a_readable_manifest_has_no_name(tmp_path, text):
    assert exported_name(tmp_path) is None
    (tmp_path / "manifest.json").write_text(text, encoding="latin-1")
    assert exported_name(tmp_path) is None
