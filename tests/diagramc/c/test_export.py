"""Folders of exported models: vectors, harness, build files, refusals."""

import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from pydrake.symbolic import Variable
from pydrake.systems.primitives import LinearSystem, Sine, SymbolicVectorSystem

from diagramc import Interface, export_c, read_diagram, source_of
from diagramc.c import build as c_build
from diagramc.c.build import CodeSize, Replay
from diagramc.c.export import Measurement, _measured, exported
from diagramc.c.source import CSource
from diagramc.c.vectors import Vectors, recorded_vectors
from diagramc.equations.equations import Equations
from diagramc.equations.graph import Graph
from diagramc.errors import CompilationError, OutputError, SimulationError
from diagramc.run_data import State

needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs the C compiler gcc")
FILES = {
    *("filter.c", "filter.h", "filter_params.c", "filter_vectors.c", "filter_vectors.h"),
    *("filter_test.c", "Makefile", "CMakeLists.txt", "README.md", "manifest.json"),
    "traceability.md",
}


def low_pass(feedthrough=0.0):
    """Y = x + d u, x⁺ = 0.5 x + u every 10 ms."""
    system = LinearSystem(A=[[0.5]], B=[[1.0]], C=[[1.0]], D=[[feedthrough]], time_period=0.01)
    system.set_name("low_pass")
    return system


SAMPLES = np.arange(1.0, 21.0)[:, None]


@pytest.fixture(scope="module")
def low_pass_export(tmp_path_factory):
    path = tmp_path_factory.mktemp("low_pass") / "out"
    export_c(low_pass(), path, name="filter", inputs=["u0"], samples=SAMPLES)
    return path


@pytest.fixture
def folder(low_pass_export, tmp_path):
    return shutil.copytree(low_pass_export, tmp_path / "out")


@needs_compiler
@pytest.mark.parametrize("precision", ["double", "float"])
def test_the_harness_reports_differences(precision, no_targets):
    source = source_of(read_diagram(low_pass(), inputs=["u0"]), "filter", precision=precision)
    vectors = recorded_vectors(low_pass(), source, SAMPLES)
    files, measurement = exported(source, vectors)
    assert set(files) == FILES
    (difference,) = measurement.replay.difference.values()
    assert measurement.replay.passed
    assert difference <= 1e-5
    assert measurement.replay.largest["y0"] == pytest.approx(vectors.outputs.max(), rel=1e-5)
    # A vector that is wrong by 1 % is found, and by how much.
    right = vectors.outputs[4, 0]
    vectors.outputs[4, 0] *= 1.01
    wrong = exported(source, vectors)[1].replay
    assert not wrong.passed
    assert wrong.difference["y0"] == pytest.approx(0.01 * right, rel=1e-3)  # three digits


@pytest.mark.slow
@needs_compiler
def test_make_and_cmake_build_the_folder(folder, no_targets):
    made = subprocess.run(["make", "test"], cwd=folder, capture_output=True, text=True, check=True)
    assert "20 steps, 0 failures" in made.stdout
    assert {path.name for path in folder.iterdir()} == FILES | {"build"}
    # Another compiler or other flags make the objects anew, the same ones do not.
    for flags, objects in (("-O1", 2), ("-O1", 0), ("-O0 -DQUOTED='a b'", 2)):
        command = ["make", f"CFLAGS={flags}"]
        made = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
        assert made.stdout.count(f"{flags} -c -o build/cc/") == objects
    made = subprocess.run(["make", "CC=true"], cwd=folder, capture_output=True, text=True)
    assert made.stdout.count("true ") == 2
    # Each compiler has its own folder, so gcc leaves the objects of cc alone.
    for compiler in ("gcc", shutil.which("gcc")):
        command = ["make", "test", f"CC={compiler}"]
        made = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
        assert "20 steps, 0 failures" in made.stdout
    assert {path.name for path in (folder / "build").iterdir()} == {"cc", "gcc", "true"}
    subprocess.run(["make", "clean"], cwd=folder, capture_output=True, check=True)
    if shutil.which("cmake"):
        build = "build/cmake"
        for command in (["cmake", "-B", build], ["cmake", "--build", build]):
            subprocess.run(command, cwd=folder, capture_output=True, check=True)
        subprocess.run(["ctest", "--test-dir", build], cwd=folder, capture_output=True, check=True)
    # A build does not stand in the way of the next export.
    export_c(low_pass(), folder, name="filter", inputs=["u0"], samples=SAMPLES)


@pytest.mark.slow
@pytest.mark.skipif(
    not (shutil.which("make") and shutil.which("cmake")), reason="needs make and cmake"
)
def test_make_and_cmake_use_the_same_flags(folder):
    """The flags of each source as the tools print them."""

    def flags_of(command):
        return [word for word in command.split() if re.match("-(?![IDco]$)[^ID]", word)]

    lines = subprocess.run(["make", "-n", "test"], cwd=folder, capture_output=True, text=True)
    made = [flags_of(line) for line in lines.stdout.splitlines() if " -c " in line]
    option = "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON"
    subprocess.run(["cmake", "-B", "build/cmake", option], cwd=folder, check=True)
    commands = json.loads((folder / "build/cmake/compile_commands.json").read_text())
    assert made == [flags_of(entry["command"]) for entry in commands]
    assert len(made) == 4
    assert set(c_build.FLAGS) <= set(made[0])


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize(
    ("precision", "flag", "compiles"),
    [
        ("double", "-ffast-math", False),
        ("double", "-Ofast", False),
        ("double", "-ffinite-math-only", False),
        ("double", "-O2", True),
        ("float", "-ffast-math", False),
    ],
)
def test_fast_math_does_not_compile(tmp_path, compiler, precision, flag, compiles):
    if shutil.which(compiler) is None:
        pytest.skip(f"needs the C compiler {compiler}")
    source = source_of(read_diagram(low_pass(), inputs=["u0"]), "filter", precision=precision)
    for name, text in source.files().items():
        (tmp_path / name).write_text(text)
    command = [compiler, "-std=c99", flag, "-fsyntax-only", "filter.c"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode == 0) is compiles
    assert ('"compile filter.c without -f' in done.stderr) is not compiles


def test_the_readme_tells_what_was_measured(folder):
    text = (folder / "README.md").read_text()
    source = source_of(read_diagram(low_pass(), inputs=["u0"]), "filter")
    assert "call it from a timer interrupt at 100 Hz" in text
    assert "| `u0` | double | finite |" in text
    assert "    inputs.u0 = ...;\n" in text
    assert f"| operations in a step | {source.operations.total()}: 1 *, 1 + |" in text
    assert f"| RAM of `filter_state_t` | {source.state_bytes} bytes |" in text
    assert "20 recorded steps" in text
    assert not re.search(r"@\w|\bNAME\b|\bUPPER\b", text)


STIFF_PER_S = 5e4


def stiff():
    """A lag of 20 µs, which RK4 cannot take with steps of 0.2 ms."""
    system = LinearSystem(A=[[-STIFF_PER_S]], B=[[STIFF_PER_S]], C=[[1.0]], D=[[0.0]])
    system.set_name("stiff")
    return system


@pytest.mark.slow
def test_steps_follow_the_fastest_mode_of_any_diagram(tmp_path):
    options = {"name": "stiff", "inputs": ["u0"], "tick_s": 2e-3, "samples": np.full((5, 1), 2.0)}
    with pytest.raises(SimulationError, match=r"cannot follow model\.x\[0\], which moves in"):
        export_c(
            stiff(), tmp_path / "unstable", step_s=2e-4, **options | {"samples": 100 * [[2.0]]}
        )
    measurement = export_c(stiff(), tmp_path / "out", **options)
    source = source_of(read_diagram(stiff(), inputs=["u0"]), "stiff", tick_s=2e-3)
    assert source.plan.schedule.largest_step_s == pytest.approx(0.2 / STIFF_PER_S, rel=1e-12)
    assert source.plan.schedule.steps == 500
    text = (tmp_path / "out" / "stiff.c").read_text()
    assert "step < 500U" in text
    vectors = recorded_vectors(stiff(), source, np.array(options["samples"]))
    np.testing.assert_allclose(vectors.outputs, 2.0, rtol=1e-12)  # after 100 time constants
    if measurement.replay is not None:
        assert measurement.replay.passed
    export_c(stiff(), tmp_path / "chosen", step_s=1e-5, **options)
    assert "step < 200U" in (tmp_path / "chosen" / "stiff.c").read_text()


def test_the_fastest_mode_is_that_of_the_context(tmp_path):
    """Dx/dt = −x³, whose eigenvalue is −3 x²."""
    x = Variable("x")
    system = SymbolicVectorSystem(state=[x], dynamics=[-(x**3)], output=[x])
    context = system.CreateDefaultContext()
    context.SetContinuousState([100.0])
    export_c(system, tmp_path / "out", name="cubic", tick_s=1e-3, steps=5, context=context)
    assert "step < 150U" in (tmp_path / "out" / "cubic.c").read_text()  # 1 ms / (0.2 / 3e4 s)
    export_c(system, tmp_path / "out", name="cubic", tick_s=1e-3, steps=5)
    assert "step < 5U" in (tmp_path / "out" / "cubic.c").read_text()


def test_without_compilers_the_readme_says_so(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    measurement = export_c(low_pass(), tmp_path / "out", name="filter", inputs=["u0"], steps=5)
    assert measurement.replay is None
    assert measurement.code_sizes == {}
    text = (tmp_path / "out" / "README.md").read_text()
    assert "| differences | not measured: this machine has no C compiler" in text
    assert "| flash and stack | not measured: this machine has no arm-none-eabi-gcc |" in text


def test_the_rows_of_the_readme_tell_each_number_with_its_unit():
    replayed = Replay({"y0": 1.25e-12}, {"y0": 34.5}, passed=True)
    sizes = {"Cortex-M4F": CodeSize(1120, 48), "Cortex-M7": CodeSize(2040, 96)}
    measurement = Measurement({"*": 3, "sqrt": 1}, 24, replayed, sizes, {"power": "no | meter"})
    assert list(_measured("m", measurement)) == [
        ("operations in a step", "4: 3 *, 1 sqrt"),
        ("RAM of `m_state_t`", "24 bytes"),
        ("difference of `y0`", "1.25e-12, where it goes up to 34.5"),
        ("Cortex-M4F: flash, code and parameters, without the C library, -O2", "1120 bytes"),
        ("Cortex-M4F: stack of a step, without the C library, -O2", "48 bytes"),
        ("Cortex-M7: flash, code and parameters, without the C library, -O2", "2040 bytes"),
        ("Cortex-M7: stack of a step, without the C library, -O2", "96 bytes"),
        ("power", "not measured: no / meter"),
    ]


def test_a_broken_compiler_does_not_stop_an_export(tmp_path, monkeypatch, script):
    bin_ = tmp_path / "bin"
    bin_.mkdir()
    for name in ("cc", "arm-none-eabi-gcc", "arm-none-eabi-size"):
        script(bin_ / name, f"echo '{name} error: no licence' >&2; exit 1")
    monkeypatch.setenv("PATH", f"{bin_}:/usr/bin:/bin")
    out = tmp_path / "out"
    measurement = export_c(low_pass(), out, name="filter", inputs=["u0"], steps=5)
    assert {path.name for path in out.iterdir()} == FILES
    assert (measurement.replay, measurement.code_sizes) == (None, {})
    assert measurement.not_measured == {
        "differences": "cc: cc error: no licence",
        "flash and stack": "arm-none-eabi-gcc: arm-none-eabi-gcc error: no licence",
    }
    text = (out / "README.md").read_text()
    for what, reason in measurement.not_measured.items():
        assert f"| {what} | not measured: {reason} |" in text


@needs_compiler
def test_the_readme_lists_the_functions_of_all_that_is_printed(tmp_path):
    """A step multiplies by a constant alone; the start computes it, by exp."""
    g = Graph()
    factor = g.node("exp", g.source("parameter", 0))
    y = g.multiply(factor, g.source("input", 0))
    equations = Equations(graph=g, parameters=["m.a"], inputs={"u": 1}, outputs={"y": [y]})
    state = State(np.zeros(0), np.zeros(0))
    options = {"precision": "float", "tick_s": 0.1, "subject": "a ---> b"}
    source = CSource(equations, "m", np.ones(1), state, **options)
    assert source.operations == {"*": 1}
    text = exported(source, Vectors(np.ones((1, 1)), np.full((1, 1), np.e)))[0]["README.md"]
    assert text.count("-->") == 1
    assert text.splitlines()[0].endswith("a --- > b -->")
    assert "The code needs `math.h` of the C library (`expf`)." in text
    if shutil.which("arm-none-eabi-gcc"):
        assert "| Cortex-M7: flash, code and parameters, without the C library, -O2 |" in text
        assert "| Cortex-M7: stack of a step, without the C library, -O2 |" in text
    assert "| output | port |\n|---|---|\n| `y` | y |" in text


# ------------------------------------------------------------------------------- folders


def test_foreign_files_are_not_touched(tmp_path):
    (tmp_path / "main.c").write_text("int main(void) { return 0; }\n")
    with pytest.raises(OutputError, match="has other files and no export; choose another"):
        export_c(low_pass(), tmp_path, name="filter", inputs=["u0"], steps=5)
    assert [path.name for path in tmp_path.iterdir()] == ["main.c"]


SOURCE = {"outputs": ["y0"], "tick_s": 0.1, "steps": 3}


def test_a_new_export_replaces_the_last_one_and_no_other_file(folder, no_targets):
    (folder / "main.c").write_text("mine")
    before = (folder / "filter.c").read_text()
    export_c(Sine(1.0, 2.0, 0.0, 1), folder, name="filter", **SOURCE)
    assert {path.name for path in folder.iterdir()} == FILES | {"main.c"}
    assert (folder / "main.c").read_text() == "mine"
    assert (folder / "filter.c").read_text() != before


def test_an_export_of_another_name_is_not_replaced(folder, no_targets):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    line = "out: has the export of 'filter'; choose another directory for 'source'"
    with pytest.raises(OutputError, match=line) as error:
        export_c(Sine(1.0, 2.0, 0.0, 1), folder, name="source", **SOURCE)
    assert "\n" not in str(error.value)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_the_file_that_a_model_was_made_from_is_beside_it(tmp_path, no_targets):
    origin = ("model.toml", "gain = 2.0\n")
    export_c(low_pass(), tmp_path, name="filter", inputs=["u0"], steps=3, origin=origin)
    text = (tmp_path / "model.toml").read_text()
    assert text.partition("\n")[2] == origin[1]
    assert text.startswith("# Made by diagramc")
    assert (
        "| `model.toml` | what the diagram was made from |" in (tmp_path / "README.md").read_text()
    )


INTEGER = Interface(integers=frozenset(["u0"]), ranges={"u0": (-5.0, 5.0)})
ANY_INTEGER = Interface(integers=frozenset(["u0"]))


@pytest.mark.parametrize(
    ("options", "line"),
    [
        *(({"samples": samples}, r"must be \(steps, 1\)") for samples in ([[1.0, 2.0]], [1.0], [])),
        ({"samples": [[0.0], [np.nan]]}, "samples: u0 = nan in step 1: must be finite$"),
        (
            {"samples": [[0.5]], "interface": INTEGER},
            "samples: u0 = 0.5 in step 0: must be a whole number in -5 … 5",
        ),
        ({"samples": [[0.0], [6.0]], "interface": INTEGER}, "u0 = 6 in step 1"),
        ({"samples": [[1e12]], "interface": ANY_INTEGER}, r"u0 = 1e\+12 in step 0"),
        ({"interface": Interface(ranges={"u0": (1, 2)})}, "u0 = 0 in step 0: must be finite in 1"),
        ({"samples": "a"}, r"must be an array of numbers of the shape \(steps, 1\)"),
        ({"samples": [[0.0], [0.0, 1.0]]}, "must be an array of numbers"),
        ({"inputs": 3}, r"^inputs = .*: must be names, such as \['u', 'v'\]"),
        *(
            ({"steps": steps}, r"^steps = .*: must be a whole number")
            for steps in (1.5, None, "5", 1e30, True)
        ),
        *(
            ({"steps": steps}, "must be at least 1, for test vectors, and at most 1000000")
            for steps in (0, -3, 10**30)
        ),
        ({"outputs": []}, "filter: test vectors need an output; export an output port"),
        ({"name": "a" * 5000}, "^name = 'a.* … .*: must be a C identifier"),
        ({"tick_s": np.nan}, "tick_s = nan s: must be finite and > 0 s"),
        ({"directory": 3}, "directory = 3: must be a path"),
    ],
)
def test_wrong_arguments_are_refused(tmp_path, options, line):
    place = {"name": "filter", "inputs": ["u0"], "directory": tmp_path}
    with pytest.raises(CompilationError, match=line) as error:
        export_c(low_pass(), **place | options)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500
    assert not list(tmp_path.iterdir())
