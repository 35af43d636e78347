"""WebAssembly modules: their layout, refusals, and runs under wasmtime against the C's vectors."""

import hashlib
import math
import re
from importlib.util import find_spec

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LinearSystem, Sine

from diagramc import CompilationError, Interface, read_diagram, source_of
from diagramc.c import cross, wasm
from diagramc.c.wasm import wasm_files, wasm_module, wasm_table


@pytest.fixture
def real_zig():
    """Skips where Zig is not installed."""
    if find_spec("ziglang") is None:
        pytest.skip("needs Zig: pip install ziglang")


def plant_with_counter():
    """An oscillator with an input, a sampled sum of the input, a sine of time, two constants."""
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem(
        "plant",
        LinearSystem(A=[[0.0, 1.0], [-400.0, -4.0]], B=[[0.0], [400.0]], C=[[1.0, 0.0]], D=[[0.0]]),
    )
    count = builder.AddNamedSystem(
        "count", LinearSystem(A=[[1.0]], B=[[1.0]], C=[[2.0]], D=[[0.0]], time_period=0.01)
    )
    wave = builder.AddNamedSystem("wave", Sine(2.0, 3.0, 0.5, 1))
    level = builder.AddNamedSystem("level", ConstantVectorSource([1.5, -2.5]))
    builder.ExportInput(plant.get_input_port(), "u")
    builder.ConnectInput("u", count.get_input_port())
    builder.ExportOutput(plant.get_output_port(), "x")
    builder.ExportOutput(count.get_output_port(), "sum")
    builder.ExportOutput(wave.get_output_port(0), "wave")
    builder.ExportOutput(level.get_output_port(), "level")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    context.SetContinuousState([0.25, -1.0])
    context.SetDiscreteState(0, [3.0])
    return diagram, context


def source(**options):
    diagram, context = plant_with_counter()
    options = {"step_s": 0.002} | options
    return source_of(read_diagram(diagram, inputs=["u"]), "model", context, **options)


def expected_outputs(inputs):
    """The outputs of ``source()``: five steps of RK4 a tick as a matrix, the sum, the sine."""
    rates = np.array([[0.0, 1.0, 0.0], [-400.0, -4.0, 400.0], [0.0, 0.0, 0.0]])
    terms = [np.linalg.matrix_power(0.002 * rates, n) / math.factorial(n) for n in range(5)]
    tick = np.linalg.matrix_power(sum(terms), 5)
    x = [np.array([0.25, -1.0])]
    for u in inputs[:, 0]:
        x.append((tick @ [*x[-1], u])[:2])
    total = 2.0 * (3.0 + np.append(0.0, np.cumsum(inputs[:, 0])))
    wave = 2.0 * np.sin(3.0 * 0.01 * np.arange(len(x)) + 0.5)
    ones = np.ones(len(x))
    return np.column_stack([np.array(x)[:, 0], total, wave, 1.5 * ones, -2.5 * ones])


def test_the_table_names_the_numbers_in_the_order_of_the_memory():
    made = source()
    table = wasm_table(made)
    assert table["sample_time_s"] == 0.01
    assert (table["rk4_steps_per_tick"], table["rosenbrock_tolerance"]) == (5, None)
    stiff = wasm_table(source(integrator="rosenbrock", step_s=None))
    assert (stiff["rk4_steps_per_tick"], stiff["rosenbrock_tolerance"]) == (0, 1e-7)
    assert table["inputs"] == ["u"]
    assert table["outputs"] == ["x", "sum", "wave", "level_0", "level_1"]
    assert table["states"] == ["plant.x[0]", "plant.x[1]"]
    assert table["discrete"] == ["count.0[0]"]
    values = dict(zip(table["params"], table["defaults"], strict=True))
    assert values == {
        "level.group_0[0]": 1.5,
        "level.group_0[1]": -2.5,
        "initial_x[0]": 0.25,
        "initial_x[1]": -1.0,
        "initial_d[0]": 3.0,
    }
    header = wasm_files(made)["model.h"]
    members = re.findall(r"model_real_t (\w+)\[(\d)\];", header.partition("} model_params_t")[0])
    assert members == [("group_0", "2"), ("initial_x", "2"), ("initial_d", "1")]


def test_a_module_is_compiled_for_webassembly_alone(zig):
    zig()
    module = wasm_module(source())
    arguments = module.code.decode().split(" ")
    assert arguments[:3] == ["cc", "-target", "wasm32-wasi"]
    assert {"-O3", "-s", "-ffp-contract=off", "model_wasm.c", "model.c"} < {*arguments}
    assert module.table["sha256"] == hashlib.sha256(module.code).hexdigest()


def test_a_module_is_compiled_once(zig, monkeypatch):
    zig()
    first = wasm_module(source())
    monkeypatch.setattr(wasm, "linked", None)
    assert wasm_module(source()) == first
    with pytest.raises(TypeError):  # other C is compiled
        wasm_module(source(step_s=0.001))


def test_without_zig_the_remedy_is_said(monkeypatch):
    monkeypatch.setattr(cross, "find_spec", lambda name: None)
    message = "^WebAssembly: the compiler Zig is not installed; pip install ziglang$"
    with pytest.raises(CompilationError, match=message):
        wasm_module(source())


def test_single_precision_is_refused():
    with pytest.raises(CompilationError, match="precision = 'float': must be double"):
        wasm_module(source(precision="float"))


@pytest.mark.slow(gate=0)
def test_a_module_runs_as_the_compiled_diagram(real_zig, web_run):
    made = source()
    module = wasm_module(made)
    inputs = np.sin(np.arange(300.0))[:, None]
    run = web_run(module.code)
    assert run.imports == 0
    outputs = run.run(module.table, inputs)
    # Rounding of each step, in the 250 steps of 2 ms that the decay of 2/s remembers.
    np.testing.assert_allclose(outputs, expected_outputs(inputs), rtol=0, atol=2500 * 2.2e-16)
    # Row 0 is the start: x and 2·sum as set, 2·sin(0.5), the constants.
    np.testing.assert_allclose(outputs[0], [0.25, 6.0, 2.0 * np.sin(0.5), 1.5, -2.5], rtol=1e-15)
    # States after the run, the continuous ones first.
    states = run.vector("states", 3)
    np.testing.assert_allclose(states[[0, 2]], outputs[-1, :2] / [1.0, 2.0], rtol=1e-15)
    # In pieces the same.
    assert run("start") == 0
    assert [run("advance", 0, 100), run("advance", 100, 200)] == [100, 200]
    np.testing.assert_array_equal(run.vector("outputs", 5, 301).T, outputs)
    # Parameters act, and `defaults` takes them back.
    params = np.array(module.table["defaults"])
    params[module.table["params"].index("level.group_0[1]")] = 7.0
    params[module.table["params"].index("initial_d[0]")] = 5.0
    other = run.run(module.table, inputs, params=params)
    np.testing.assert_array_equal(other[:, 3:], np.tile([1.5, 7.0], (301, 1)))
    np.testing.assert_allclose(other[:, 1] - outputs[:, 1], 4.0, rtol=1e-12)
    np.testing.assert_array_equal(run.run(module.table, inputs), outputs)


@pytest.mark.slow
def test_a_module_runs_by_the_rosenbrock_method(real_zig, web_run):
    made = source(integrator="rosenbrock", step_s=None, tolerance=1e-8)
    module = wasm_module(made)
    inputs = np.sin(np.arange(50.0))[:, None]
    outputs = web_run(module.code).run(module.table, inputs)
    finer = wasm_module(source(step_s=1e-4))
    expected = web_run(finer.code).run(finer.table, inputs)
    np.testing.assert_allclose(outputs, expected, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_a_module_stops_at_the_end_of_its_memory_and_at_a_failure(real_zig, web_run):
    made = source(interface=Interface(ranges={"u": (-1.0, 1.0)}))
    module = wasm_module(made)
    run = web_run(module.code)
    run("defaults")
    assert run("start") == 8  # no memory yet
    assert run("advance", 0, 3) == 0
    assert run("reserve", 2**31) == 0  # more than 4 GiB
    assert run("reserve", 2**32 - 1) == 0
    assert run("start") == 8
    assert run("reserve", 10) == 1
    assert run("start") == 0
    assert run("advance", 0, 11) == 10  # row 10 is the last
    run.vector("inputs", 1, 11)[0, 4] = 2.0
    assert run("start") == 0
    assert run("advance", 0, 10) == 4
    assert run("status") == 1
    assert run("advance", 4, 1) == 0  # until the next start
    # Memory grows, and the inputs are zero again.
    assert run("reserve", 200_000) == 1
    assert not run.vector("inputs", 1, 200_001).any()
    assert run("start") == 0
    assert run("advance", 0, 200_000) == 200_000
    assert run.vector("outputs", 5, 200_001)[1, -1] == 6.0


@pytest.mark.slow
def test_the_bytes_of_a_module_are_repeatable(real_zig, tmp_path, monkeypatch):
    first = wasm_module(source()).code
    folder = tmp_path / "another folder"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setenv("DIAGRAMC_CACHE_DIR", str(folder))
    # Without what Zig has stored of the model. Its own library would take minutes.
    monkeypatch.setenv("ZIG_LOCAL_CACHE_DIR", str(folder))
    assert wasm_module(source()).code == first
    assert str(tmp_path).encode() not in first


@pytest.mark.slow
def test_a_model_without_inputs_and_states_runs(real_zig, web_run):
    wave = Sine(2.0, 3.0, 0.5, 1)
    made = source_of(read_diagram(wave), "wave", tick_s=0.1, outputs=["y0"])
    module = wasm_module(made)
    assert module.table["rk4_steps_per_tick"] == 0
    outputs = web_run(module.code).run(module.table, ticks=50)
    expected = 2.0 * np.sin(3.0 * 0.1 * np.arange(51) + 0.5)
    np.testing.assert_allclose(outputs[:, 0], expected, rtol=0, atol=1e-14)
