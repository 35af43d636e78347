import csv
import fcntl
import inspect
import io
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
import warnings
from contextlib import contextmanager, suppress
from dataclasses import fields
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from pydantic_core import SchemaError, SchemaValidator, core_schema

import kneexo
import kneexo.__main__ as command_line
from kneexo.analysis import TrackingMetrics, track
from kneexo.analysis.frequency_response import SinestreamSettings
from kneexo.command_line import commands, main as cli
from kneexo.command_line.main import main
from kneexo.command_line.parameter_list import parameter_rows
from kneexo.compiler.native import cache
from kneexo.errors import WorkerError
from kneexo.interruption import Terminated
from kneexo.parameters import PlantParameters, Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.scenario_file import load_scenario
from kneexo.studies.bandwidth import study as bandwidth
from kneexo.studies.catalogue import STUDIES, Study
from kneexo.studies.contest.study import ContestSettings
from kneexo.sweeps import SweepOptions

SHORT = """
reference: {frequency_hz: 1.0, amplitude_deg: 2.0}
simulation: {duration_s: 1.2}
"""


@pytest.fixture
def scenario_file(tmp_path):
    def write(text):
        path = tmp_path / "scenario.yaml"
        path.write_text(text)
        return str(path)

    return write


@pytest.fixture
def undrawn(monkeypatch):
    """Figures that take longer than the rest, of which another test looks at the files."""
    monkeypatch.setattr("kneexo.studies.bandwidth.figures.figures", lambda _: {})
    monkeypatch.setattr("kneexo.command_line.output.save_figure", lambda *_: None)


def run_command(*arguments, **options):
    return subprocess.run(
        [sys.executable, "-m", "kneexo", *arguments], stderr=subprocess.PIPE, text=True, **options
    )


def test_a_stream_without_greek_letters_gets_escapes(scenario_file, monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    assert main(["params", scenario_file(SHORT), "--json"]) == 0
    stream.flush()
    rows = json.loads(stream.buffer.getvalue())["parameters"]
    assert any(row["unit"] == "m/s²" for row in rows)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        pytest.param(["params", "SCENARIO"], marks=pytest.mark.slow),
        ["params", "--yaml"],
    ],
)
def test_a_full_device_is_a_line(arguments, scenario_file):
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
    words = [scenario_file(SHORT) if word == "SCENARIO" else word for word in arguments]
    with open("/dev/full", "w") as full:
        done = run_command(*words, stdout=full, env=environment)
    assert (done.returncode, done.stderr) == (2, "kneexo: No space left on device\n")


def test_a_closed_output_is_no_failure():
    line = ["sh", "-c", 'exec "$0" -m kneexo cache >&-', sys.executable]
    done = subprocess.run(line, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_an_unknown_matplotlib_backend_does_not_matter(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "bogus")
    assert main(["cache"]) == 0
    assert os.environ["MPLBACKEND"] == "Agg"  # before Matplotlib is imported


def test_no_home_directory_is_a_line(tmp_path):
    code = (
        "import sys, pathlib\n"
        "def nowhere(): raise RuntimeError('Could not determine home directory.')\n"
        "pathlib.Path.home = nowhere\n"
        "from kneexo.command_line import main as cli\n"
        "sys.exit(cli.main(['cache']))\n"
    )
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("KNEEXO", "XDG"))}
    line = [sys.executable, "-c", code]
    done = subprocess.run(line, env=environment, capture_output=True, text=True)
    assert done.returncode == 0
    (told,) = done.stderr.splitlines()
    assert told.startswith("kneexo: cache directory: cannot be determined")


def test_too_little_memory_is_a_line(capsys, monkeypatch, tmp_path):
    def refuse(options):
        raise MemoryError

    monkeypatch.setattr(commands, "simulate", refuse)
    assert main(["simulate", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == "kneexo: out of memory; reduce simulation.duration_s\n"


def test_a_run_that_would_not_fit_into_memory_is_refused(capsys, scenario_file, tmp_path):
    path = scenario_file("simulation: {duration_s: 86400}")
    assert main(["simulate", path, "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "simulation.duration_s = 86400 s" in line
    assert "43200000 samples" in line
    assert "at most 2 GiB" in line
    assert not (tmp_path / "out").exists()


LIGHT = """
import sys, kneexo.command_line.main
def runs_without(arguments, *modules):
    try:
        assert kneexo.command_line.main.main(arguments) == 0
    except SystemExit as end:  # of the help
        assert not end.code
    assert not set(modules) & set(sys.modules), arguments
runs_without(["cache"], "numpy", "pydrake", "matplotlib", "numba", "llvmlite", "pydantic")
runs_without(["--help"], "numpy", "pydrake", "matplotlib")
for arguments in (["--yaml"], ["--schema"], [sys.argv[1]]):
    runs_without(["params", *arguments], "pydrake", "scipy", "matplotlib", "llvmlite")
runs_without(["params"], "scipy.optimize", "scipy.linalg", "matplotlib")
"""
"""In an order in which no command may import what the next one must not."""


def test_commands_import_no_more_than_they_need(scenario_file):
    line = [sys.executable, "-c", LIGHT, scenario_file(SHORT)]
    out = subprocess.run(line, capture_output=True, text=True, check=True).stdout
    for command in ("reproduce", "simulate", "params", "diagram", "cache"):
        assert command in out.partition("plant:")[0]


def test_params_lists_every_number_with_unit_and_provenance(capsys):
    assert main(["params", "--json"]) == 0
    rows = {row["parameter"]: row for row in json.loads(capsys.readouterr().out)["parameters"]}
    mass = rows["plant.cylinder.mass_kg"]
    assert (mass["value"], mass["unit"]) == (1.6, "kg")
    assert "Table" in mass["provenance"]
    assert all(row["provenance"] for row in rows.values())
    assert main(["params"]) == 0
    assert "plant.pump.lag_s = 0.01 s" in capsys.readouterr().out


def test_params_prints_a_scenario_file_that_loads(capsys, tmp_path):
    assert main(["params", "--yaml"]) == 0
    path = tmp_path / "full.yaml"
    path.write_text(capsys.readouterr().out)
    assert load_scenario(path) == Scenario()


def test_params_of_a_scenario_have_no_alternatives_and_no_studies(capsys, scenario_file):
    listed = []
    for arguments in ([], [scenario_file("controller: {kind: pid}")]):
        assert main(["params", *arguments, "--json"]) == 0
        rows = json.loads(capsys.readouterr().out)["parameters"]
        listed.append({row["parameter"] for row in rows})
    everything, own = listed
    assert "controller(pid).integral_per_s2" in everything
    assert "bandwidth: amplitudes_deg" in everything
    assert "reproduce, Fig. 13: trials" in everything
    assert "controller.integral_per_s2" in own
    assert not any("(" in name or ":" in name for name in own)


def test_params_prints_a_json_schema(capsys):
    assert main(["params", "--schema"]) == 0
    assert "plant" in json.loads(capsys.readouterr().out)["properties"]


def test_simulate_writes_signals_metrics_scenario_and_plot(capsys, scenario_file, tmp_path):
    out = tmp_path / "out"
    assert main(["simulate", scenario_file(SHORT), "--out", str(out), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert {file.name for file in out.iterdir()} == {
        "signals.csv",
        "metrics.json",
        "scenario.yaml",
        "tracking.png",
        "tracking.pdf",
    }
    assert json.loads((out / "metrics.json").read_text()) == printed
    assert printed["max_error_deg"] < 0.5
    assert load_scenario(out / "scenario.yaml").reference.frequency_hz == 1.0
    with (out / "signals.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0][:2] == ["time_s", "knee_reference_rad"]
    assert "load_pressure_pa" in rows[0]
    assert len(rows) == 1 + 601


def test_a_run_shorter_than_a_period_has_dashes(capsys, scenario_file, tmp_path, undrawn):
    path = scenario_file("simulation: {duration_s: 0.1}")
    assert main(["simulate", path, "--out", str(tmp_path / "out")]) == 0
    text = capsys.readouterr().out
    assert "nan" not in text
    assert f"{'max_error_deg':28s} –" in text
    assert "nan" not in (tmp_path / "out" / "signals.csv").read_text()


def test_diagram_always_writes_the_dot_file(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))  # no Graphviz here
    assert main(["diagram", "--out", str(tmp_path / "out")]) == 0
    text = (tmp_path / "out" / "closed_loop.dot").read_text()
    assert "digraph" in text
    assert "controller" in text
    captured = capsys.readouterr()
    assert f"closed_loop.dot is in {tmp_path / 'out'}\n" in captured.out
    assert "install Graphviz" in captured.err
    assert len(captured.err.splitlines()) == 1


def test_diagram_draws_with_graphviz(capsys, tmp_path, monkeypatch):
    fake = tmp_path / "dot"
    fake.write_text('#!/bin/sh\nfor last; do :; done\necho "$1" > "$last"\n')
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    assert main(["diagram", "--out", str(tmp_path / "out"), "--json"]) == 0
    names = json.loads(capsys.readouterr().out)["files"]
    assert names == ["closed_loop.dot", "closed_loop.png", "closed_loop.svg"]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("plant: {cylinder: {mass_kg: -1}}", "plant.cylinder.mass_kg = -1 kg is out of range"),
        ("plant: {cylinder: {mass_kg: .nan}}", "mass_kg = nan kg is out of range"),
        ("plant: {cylinder: {mas_kg: 1.0}}", "plant.cylinder.mas_kg: unknown name"),
        ("reference: {mean_deg: 70.0}", "leaves the range of motion 0 … 90 deg"),
        ("plant: {linkage: {a_2_m: 0.2}}", "cannot be assembled"),
        ("controller: {kind: lqr}", "controller.kind = 'lqr'"),
        (
            "reference: {frequency_hz: 1.0, amplitude_deg: 2.0}\n"
            "simulation: {duration_s: 1.2, integrator: runge_kutta3}",
            "left the stroke 0 … 0.15 m; reduce the motion, the load or the step",
        ),
        ("initial_offset_m: -0.15", "outside the stroke 0 … 0.15 m; change the offset"),
        ("controller: {kind: pid, anti_windup_s: 1e-3}", "must be at least sample_time_s"),
        (
            "reference: {kind: samples, times_s: [0, 1, 1e300], angles_deg: [1, 2, 3]}",
            "times_s must lie within ±100000 s",
        ),
        (
            "reference: {kind: samples, times_s: [0, 1e-9, 1], angles_deg: [1, 2, 3]}",
            "times_s must increase by at least 1e-6 s",
        ),
        (
            "reference: {kind: samples, times_s: [0, 1, 2, 3], angles_deg: [5, 89, 89, 5]}\n"
            "simulation: {duration_s: 1.0}",
            "interpolation cubic passes the range of motion",
        ),
        ("reference: {kind: samples, times_s: [0, 1], angles_deg: [1, 2]}", "must have at least 3"),
    ],
)
def test_bad_scenarios_are_one_line_exit_2_and_leave_nothing(
    capsys, scenario_file, tmp_path, text, told
):
    out = tmp_path / "out"
    assert main(["simulate", scenario_file(text), "--out", str(out)]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("kneexo:")]
    assert len(lines) == 1
    assert told in lines[0]
    assert "scenario.yaml" in lines[0]
    assert not out.exists()


def wait_for(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not (value := condition()):
        if time.monotonic() > end:
            raise TimeoutError(condition)
        time.sleep(0.01)
    return value


def alive(session):
    """Processes of a session that still work."""
    found = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, of = file.read_text().rpartition(")")[2].split()[:4]
        except OSError:  # it has just ended
            continue
        if int(of) == session and state != "Z":
            found.append(int(file.parent.name))
    return found


@contextmanager
def started(*arguments, **options):
    """A command in a session of its own, which is killed at the end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "kneexo", *map(str, arguments)],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **options,
    )
    try:
        yield process
    finally:
        for number in alive(process.pid):
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        process.communicate()


SWEEP = ["bandwidth", "--workers", "2"]


@pytest.mark.parametrize(
    ("number", "told", "code"),
    [
        pytest.param(signal.SIGINT, "interrupted", 130, marks=pytest.mark.slow),
        (signal.SIGTERM, "terminated", 143),
    ],
)
def test_an_interrupt_is_one_line_and_leaves_nothing(tmp_path, number, told, code):
    out = tmp_path / "deep" / "out"
    with started(*SWEEP, "--out", out) as process:
        wait_for(lambda: len(alive(process.pid)) >= 3)  # workers are there, or are starting
        assert any(out.glob(".kneexo-*"))
        os.killpg(process.pid, number) if number == signal.SIGINT else process.send_signal(number)
        error = process.communicate(timeout=20)[1]
        assert process.returncode == code
        assert "Traceback" not in error
        assert error.splitlines()[-1] == f"kneexo: {told}; nothing was written"
        assert not (tmp_path / "deep").exists()
        wait_for(lambda: not alive(process.pid), 5.0)


@pytest.mark.slow
def test_a_killed_sweep_leaves_no_process_and_its_pieces(tmp_path):
    path = tmp_path / "bandwidth.checkpoint.jsonl"
    with started(*SWEEP, "--out", tmp_path) as process:
        wait_for(lambda: path.exists() and path.read_bytes().count(b"\n") > 1)
        process.kill()
        process.wait()
        wait_for(lambda: not alive(process.pid), 5.0)
    kept = path.read_bytes()
    assert [file.name for file in tmp_path.glob(".*")] == [next(tmp_path.glob(".kneexo-*")).name]
    with started("bandwidth", "--workers", "1", "--out", tmp_path) as process:
        wait_for(lambda: path.stat().st_size > len(kept))  # it has gone on
        process.terminate()
        error = process.communicate(timeout=20)[1]
        assert process.returncode == 143
    last = error.splitlines()[-1]
    assert re.fullmatch(
        rf"kneexo: terminated; [0-9]+ finished pieces are kept in {re.escape(str(path))}; "
        rf"the same command goes on from them",
        last,
    )
    assert path.read_bytes().startswith(kept)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


EARLY = """
import os, signal, sys
MODULE = sys.argv.pop(1)
class Interrupt:
    def find_spec(self, name, path, target=None):
        if name == MODULE:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupt())
import runpy
runpy.run_module("kneexo", run_name="__main__", alter_sys=True)
"""


@pytest.mark.parametrize(
    ("module", "told"),
    [
        ("kneexo.command_line.main", "interrupted"),
        ("argparse", "interrupted"),
        pytest.param("kneexo.parameters", "interrupted; KEPT", marks=pytest.mark.slow),
        ("pydrake", "interrupted; KEPT"),
        pytest.param("matplotlib", "interrupted; KEPT", marks=pytest.mark.slow),
    ],
)
def test_an_interrupt_of_an_import_is_one_true_line(tmp_path, module, told):
    kept = tmp_path / "bandwidth.checkpoint.jsonl"
    kept.write_text("")
    done = subprocess.run(
        [sys.executable, "-c", EARLY, module, "bandwidth", "--out", str(tmp_path)],
        capture_output=True,
        text=True,
    )
    line = f"finished pieces are kept in {kept}; the same command goes on from them"
    assert done.stderr == f"kneexo: {told.replace('KEPT', line)}\n"
    assert done.returncode == 130


@pytest.mark.parametrize(
    ("interrupt", "code", "told"),
    [(KeyboardInterrupt(), 130, "interrupted"), (Terminated(), 143, "terminated")],
)
def test_an_interrupt_behind_import_errors_is_one_line(
    capsys, monkeypatch, tmp_path, interrupt, code, told
):
    """Extension modules that import each other make an ImportError of an ImportError."""
    inner, middle, outer = ImportError("common"), ImportError("trees"), ImportError("framework")
    inner.__cause__, middle.__context__, outer.__cause__ = interrupt, inner, middle

    def imports(options):
        raise outer

    monkeypatch.setattr(commands, "simulate", imports)
    assert main(["simulate", "--out", str(tmp_path)]) == code
    assert capsys.readouterr().err == f"kneexo: {told}; nothing was written\n"
    inner.__cause__ = ModuleNotFoundError("trees")
    with pytest.raises(ImportError, match="framework"):
        main(["simulate", "--out", str(tmp_path)])


class _Interrupting:
    def __index__(self):
        raise KeyboardInterrupt


def test_an_interrupt_in_the_text_of_an_error_is_one_line(capsys, monkeypatch, tmp_path):
    """Such as of pydantic and pybind11, which keep no more of it."""

    def imports(options):
        SchemaValidator(core_schema.str_schema(max_length=_Interrupting()))

    with pytest.raises(SchemaError) as error:
        imports(None)
    assert error.value.__cause__ is error.value.__context__ is None
    monkeypatch.setattr(commands, "simulate", imports)
    assert main(["simulate", "--out", str(tmp_path)]) == 130
    assert capsys.readouterr().err == "kneexo: interrupted; nothing was written\n"

    def terminated(options):
        raise RuntimeError("cannot import trees: Terminated: <EMPTY MESSAGE>")

    monkeypatch.setattr(commands, "simulate", terminated)
    assert main(["simulate", "--out", str(tmp_path)]) == 143


def test_drake_does_not_see_an_interrupt_of_its_import(tmp_path):
    """It would print its call stack."""
    (tmp_path / "pydrake").mkdir()
    (tmp_path / "pydrake/__init__.py").write_text(
        "import signal\n"
        "try:\n"
        "    signal.raise_signal(signal.SIGINT)\n"
        "except KeyboardInterrupt:\n"
        "    print('Could not initialize pydrake')\n"
        "    raise\n"
    )
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); from kneexo.command_line import main as cli\n"
    )
    code += "sys.exit(cli.main(['simulate', '--out', sys.argv[1]]))"
    line = [sys.executable, "-c", code, str(tmp_path)]
    done = subprocess.run(line, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "kneexo: interrupted; nothing was written\n"


def test_an_interrupt_after_the_command_ends_python_at_once(monkeypatch):
    monkeypatch.setattr(cli, "main", lambda: 7)
    before = signal.getsignal(signal.SIGINT)
    try:
        assert command_line.main() == 7
        assert signal.getsignal(signal.SIGINT) == signal.SIG_DFL
    finally:
        signal.signal(signal.SIGINT, before)


def test_modules_of_the_working_directory_are_found_after_all_others(monkeypatch, tmp_path):
    (tmp_path / "my_law_of_control.py").write_text("GAIN = 7\n")
    (tmp_path / "json.py").write_text("raise AssertionError\n")
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p not in ("", os.getcwd())])
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.delitem(sys.modules, "json")
    monkeypatch.chdir(tmp_path)

    def command():
        import_module("json")
        return import_module("my_law_of_control").GAIN

    monkeypatch.setattr(cli, "main", command)
    assert command_line.main() == 7
    monkeypatch.delitem(sys.modules, "my_law_of_control")


def test_a_missing_scenario_and_an_unwritable_directory_are_one_line(capsys, tmp_path):
    assert main(["simulate", str(tmp_path / "no.yaml"), "--out", str(tmp_path / "o")]) == 2
    assert "no.yaml" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    for command in ("reproduce", "simulate", "diagram"):
        assert main([command, "--out", str(tmp_path / "file")]) == 2
        error = capsys.readouterr().err
        assert "cannot write there" in error
        assert len(error.splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ["simulate", "a\nb\x1b", "--out", "o"],
            "kneexo: a\\nb\\x1b: cannot be read: No such file",
        ),
        (["simulate", "x" * 5000, "--out", "o"], "kneexo: " + "x" * 150 + " … xxx"),
        (["simulate", "--out", "o/" + "x" * 5000], "kneexo: --out o/" + "x" * 148 + " … xxx"),
        (["simulate", "--set", "a\nb", "--out", "o"], "kneexo: --set a\\nb: must be NAME=VALUE"),
        (["simulate", "--set", "x" * 5000 + "=1", "--out", "o"], "kneexo: Scenario: xxx"),
        (["view", "--out", "k", "loop"], "kneexo: loop: cannot be read: Too many levels of symb"),
    ],
)
def test_names_are_short_and_on_one_line(capsys, tmp_path, monkeypatch, arguments, told):
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    assert main(arguments) == 2
    line = capsys.readouterr().err
    assert line.startswith(told)
    assert line.count("\n") == 1
    assert len(line) < 1000
    assert os.listdir() == ["loop"]


@pytest.mark.parametrize("number", ["1_0", "٣", "nan", "inf", "1e999", "0x1", ""])
@pytest.mark.parametrize("option", ["--knee-angle", "--workers"])
def test_numbers_of_options_have_the_digits_0_to_9(capsys, option, number):
    command = "linearize" if option == "--knee-angle" else "bandwidth"
    with pytest.raises(SystemExit) as caught:
        main([command, option, number, "--out", "o"])
    assert caught.value.code == 2
    assert f"argument {option}: {number!r} must be a" in capsys.readouterr().err


def test_unknown_arguments_are_short_and_on_one_line(capsys):
    with pytest.raises(SystemExit):
        main(["params", "a", "b\n" + "x" * 5000])
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith("kneexo: error: unrecognized arguments: b\\nxxx")
    assert len(line) < 1300


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (SystemExit(5), "kneexo: SystemExit: 5 ("),
        (ZeroDivisionError("mine"), "kneexo: ZeroDivisionError: mine ("),
    ],
)
def test_an_error_of_the_users_code_is_one_line_with_its_place(capsys, monkeypatch, error, told):
    def fail(options):
        raise error

    monkeypatch.setattr(commands, "params", fail)
    assert main(["params", "--schema"]) == 2
    line = capsys.readouterr().err
    assert line.startswith(told)
    assert line.endswith("; correct that code\n")
    assert "test_main.py, line " in line


def test_a_mistake_of_ours_has_its_traceback(monkeypatch):
    monkeypatch.setattr(commands, "params", partial(commands._checkpoint_path))
    with pytest.raises(AttributeError):
        main(["params", "--schema"])


def test_workers_below_one_are_refused(capsys, tmp_path):
    assert main(["reproduce", "--out", str(tmp_path / "o"), "--workers", "0"]) == 2
    assert "--workers = 0" in capsys.readouterr().err


def test_python_m_kneexo_is_the_same_command():
    out = subprocess.run(
        [sys.executable, "-m", "kneexo", "--version"], capture_output=True, text=True, check=True
    )
    assert out.stdout.startswith("kneexo ")


def test_linearize_writes_what_it_finds_and_refuses_a_posture_out_of_range(capsys, tmp_path):
    from kneexo.analysis import linearize_loop

    posture = ["--knee-angle", "30"]
    assert main(["linearize", *posture, "--out", str(tmp_path / "out"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert json.loads((tmp_path / "out" / "linearization.json").read_text()) == printed
    assert {file.name for file in (tmp_path / "out").iterdir()} == {
        "linearization.json",
        *(f"{name}.{kind}" for name in ("loop", "nyquist", "poles") for kind in ("png", "pdf")),
    }
    # The plant of Eq. 13, 15 and 16: (s + 1/τ_m) s (s² + 2ζω s + ω²).
    oil, pump = PlantParameters().cylinder, PlantParameters().pump
    leak = pump.leakage_m3_per_s_pa + oil.leakage_m3_per_s_pa
    softness = 4.0 * oil.bulk_modulus_pa / oil.total_volume_m3
    omega = math.sqrt(softness * (oil.mean_area_m2**2 + oil.damping_n_s_per_m * leak) / oil.mass_kg)
    zeta = (oil.damping_n_s_per_m / oil.mass_kg + softness * leak) / (2.0 * omega)
    pair = omega * complex(-zeta, math.sqrt(1.0 - zeta**2))
    poles = [0.0, -1.0 / pump.lag_s, pair, pair.conjugate()]
    found = [complex(*pole) for pole in printed["plant_poles_per_s"]]
    by_imaginary_part = {"key": lambda pole: (pole.imag, pole.real)}
    assert sorted(found, **by_imaginary_part) == pytest.approx(
        sorted(map(complex, poles), **by_imaginary_part), rel=1e-9, abs=1e-6
    )
    assert printed["plant_frequencies_rad_s"] == pytest.approx(
        [0.0, 1.0 / pump.lag_s, omega, omega], rel=1e-9, abs=1e-6
    )
    assert printed["plant_damping_ratios"][1:] == pytest.approx([1.0, zeta, zeta], rel=1e-6)
    # dθ/dt per motor speed: flow over area, over the moment arm dx/dθ (Eq. 10 at 30°, in mm/deg).
    arm = np.polyval(np.polyder([1.571e-8, -4.164e-6, 0.0004789, -0.03192, -0.6195, 148.0]), 30.0)
    arm *= 1e-3 * 180.0 / math.pi
    flow = pump.displacement_m3_per_rad / pump.gear_ratio
    gain = flow / (oil.mean_area_m2 + oil.damping_n_s_per_m * leak / oil.mean_area_m2) / arm
    assert printed["plant_velocity_gain"] == pytest.approx(gain, rel=5e-3)  # G1 is not Table 1
    point = printed["operating_point"]
    assert point["knee_angle_rad"] == pytest.approx(math.radians(30.0), abs=1e-9)
    for name in ("motor_speed_rad_s", "load_pressure_pa", "rod_force_n"):
        assert point[name] == pytest.approx(0.0, abs=1e-6)
    loop = linearize_loop(Scenario(), 30.0)
    assert printed["loop_eigenvalues"] == [[z.real, z.imag] for z in loop.eigenvalues]
    assert abs(complex(*printed["loop_eigenvalues"][0])) == max(
        abs(complex(*z)) for z in printed["loop_eigenvalues"]
    )
    margins = loop.margins()
    assert printed["margins"] == {
        name: None if value != value or math.isinf(value) else value
        for name, value in vars(margins).items()
    }
    assert printed["bandwidth_hz"] == loop.bandwidth_hz()
    feedback = loop.complementary_sensitivity_bandwidth_hz()
    assert printed["complementary_sensitivity_bandwidth_hz"] == feedback
    assert main(["linearize", "--knee-angle", "200", "--out", str(tmp_path / "no")]) == 2
    assert "knee angle = 200 deg" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


def test_the_margins_and_bandwidths_of_an_unstable_loop_are_null(capsys, tmp_path, undrawn):
    # Exact states at k/Φ = 1.3e4 1/s: docs/eq27_at_2ms.md.
    command = ["linearize", "--set", "estimator={kind: exact}", "--set", "controller.phi_m_s2=24.4"]
    assert main([*command, "--out", str(tmp_path / "out"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["margins"].pop("stable") is False
    assert set(printed["margins"].values()) == {None}
    assert printed["bandwidth_hz"] is None
    assert printed["complementary_sensitivity_bandwidth_hz"] is None


def test_cache_shows_and_clears_what_is_kept(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("KNEEXO_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("KNEEXO_CACHE_SIZE_MB", "7")
    assert main(["cache"]) == 0
    assert "entries    0\n" in capsys.readouterr().out
    assert not (tmp_path / "cache").exists()
    for age_s in range(6):
        cache.store(str(age_s), bytes(2**20))
        used_last = cache.entries()[0].path
        os.utime(used_last, (1e9 - age_s, 1e9 - age_s))
    newest, *_, oldest = cache.entries()
    assert main(["cache", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["directory"] == str(tmp_path / "cache")
    assert printed["limit_bytes"] == 7 * 2**20
    assert printed["size_bytes"] == sum(entry["size_bytes"] for entry in printed["entries"])
    assert [entry["last_use_s"] for entry in printed["entries"]] == [1e9 - age for age in range(6)]
    assert printed["entries"][0]["name"] == newest.path.name
    assert main(["cache"]) == 0
    text = capsys.readouterr().out
    assert f"directory  {tmp_path / 'cache'}\nentries    6\n" in text
    assert "size       6.0 of at most 7 MiB" in text
    assert "2001-09-0" in text
    assert "1024.0 KiB" in text
    assert newest.path.name in text
    assert oldest.path.name not in text
    assert main(["cache", "--clear"]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'cache'}: 6 entries deleted\n"
    assert list((tmp_path / "cache").iterdir()) == []
    cache.store("key", b"code")
    assert main(["cache", "--clear", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == {
        "kneexo": kneexo.__version__,
        "directory": str(tmp_path / "cache"),
        "deleted": 1,
    }


# -------------------------------------------------------------------------------- studies

SMALL_MAP = ["--set", "amplitudes_deg=[1.0]", "--set", "frequencies_hz=[2, 3, 5]"]


def test_bandwidth_measures_writes_and_leaves_no_checkpoint(capsys, tmp_path):
    out = tmp_path / "out"
    assert main(["bandwidth", *SMALL_MAP, "--workers", "1", "--out", str(out), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert json.loads((out / "bandwidth.json").read_text()) == printed
    names = {file.name for file in out.iterdir()}
    assert {"bandwidth.md", "amplitude_map.png", "amplitude_map.pdf"} <= names
    assert not any("checkpoint" in name for name in names)


def test_an_interrupted_study_goes_on_with_identical_results(
    capsys, tmp_path, monkeypatch, undrawn
):
    whole, torn = tmp_path / "whole", tmp_path / "torn"
    command = ["bandwidth", *SMALL_MAP, "--workers", "1", "--out"]
    assert main([*command, str(whole)]) == 0
    measure, calls = bandwidth._measure, []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return measure(*arguments)

    interrupted.__module__, interrupted.__qualname__ = measure.__module__, measure.__qualname__
    monkeypatch.setattr(bandwidth, "_measure", interrupted)
    capsys.readouterr()
    assert main([*command, str(torn)]) == 130
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("kneexo: interrupted; 3 finished pieces are kept in ")
    assert [file.name for file in torn.iterdir()] == ["bandwidth.checkpoint.jsonl"]
    assert main([*command, str(torn)]) == 0
    pieces = len(calls) - 4
    assert pieces > 0
    for name in ("bandwidth.json", "bandwidth.md"):
        assert (torn / name).read_bytes() == (whole / name).read_bytes()
    assert not (torn / "bandwidth.checkpoint.jsonl").exists()


class FakeStudy:
    def __init__(self, settings):
        self.settings = settings

    def results(self):
        return {"settings": type(self.settings).__name__}


def replace_study(monkeypatch, name, compute):
    """Put ``compute`` in the place of a study; its result is a `FakeStudy`."""
    monkeypatch.setattr(f"kneexo.studies.{name}.study.{name}_study", compute)
    monkeypatch.setattr(Study, "report", lambda study, result: "# found\n")
    monkeypatch.setattr(Study, "figures", lambda study, result: {})
    monkeypatch.setattr(Study, "motions", lambda study, result: {})


def stand_in(monkeypatch, compute):
    """A bandwidth study that takes no time."""

    def study(scenario=Scenario(), *, settings, workers, executor, checkpoint, progress):
        compute(checkpoint)
        return FakeStudy(settings)

    replace_study(monkeypatch, "bandwidth", study)


@pytest.mark.parametrize("pieces", [0, 2])
@pytest.mark.parametrize(
    ("interrupt", "told", "code"),
    [(KeyboardInterrupt, "interrupted", 130), (Terminated, "terminated", 143)],
)
def test_an_interrupt_tells_how_many_pieces_are_kept(
    capsys, tmp_path, monkeypatch, interrupt, told, code, pieces
):
    def interrupted(checkpoint):
        for n in range(pieces):
            checkpoint.keep(f"piece {n}", n)
        raise interrupt

    stand_in(monkeypatch, interrupted)
    out = tmp_path / "deep" / "out"
    path = out / "bandwidth.checkpoint.jsonl"
    assert main(["bandwidth", "--out", str(out)]) == code
    fate = (
        f"{pieces} finished pieces are kept in {path}; the same command goes on from them"
        if pieces
        else "nothing was written"
    )
    assert capsys.readouterr().err.splitlines() == [f"kneexo: {told}; {fate}"]
    assert list((tmp_path / "deep").rglob("*.*")) == ([path] if pieces else [])
    assert (tmp_path / "deep").exists() == bool(pieces)


def test_finished_pieces_go_only_when_asked(capsys, tmp_path, monkeypatch):
    path = tmp_path / "bandwidth.checkpoint.jsonl"
    command = ["bandwidth", "--out", str(tmp_path)]

    def interrupted(checkpoint):
        checkpoint.keep("a", 1)
        raise KeyboardInterrupt

    stand_in(monkeypatch, interrupted)
    assert main(command) == 130
    seen = []
    stand_in(monkeypatch, lambda checkpoint: seen.append(len(checkpoint)))
    for option in ([], ["--resume"]):
        assert main([*command, *option]) == 0
        told = f"kneexo: 1 finished pieces of other settings stay in {path}; --restart deletes them"
        assert capsys.readouterr().err.splitlines()[-1] == told
    assert main([*command, "--restart"]) == 0
    assert not path.exists()
    assert seen == [1, 1, 0]


@pytest.mark.parametrize("option", [[], ["--resume"], ["--restart"]])
def test_a_file_that_is_no_checkpoint_is_refused(capsys, tmp_path, monkeypatch, option):
    stand_in(monkeypatch, lambda checkpoint: pytest.fail("the study began"))
    path = tmp_path / "bandwidth.checkpoint.jsonl"
    path.write_text("my notes\n")
    assert main(["bandwidth", "--out", str(tmp_path), *option]) == 2
    assert capsys.readouterr().err == (
        f"kneexo: checkpoint {path}: this is not a checkpoint of kneexo; move it away or choose "
        f"another directory\n"
    )
    assert path.read_text() == "my notes\n"
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_a_second_process_is_refused(capsys, tmp_path, monkeypatch):
    stand_in(monkeypatch, lambda checkpoint: pytest.fail("the study began"))
    path = tmp_path / "bandwidth.checkpoint.jsonl"
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert main(["bandwidth", "--out", str(tmp_path), "--restart"]) == 2
    assert capsys.readouterr().err == (
        f"kneexo: checkpoint {path}: another process is at work on it; wait until it has ended, or "
        f"choose another directory\n"
    )


def test_damaged_lines_are_one_line_on_stderr(capsys, tmp_path, monkeypatch):
    def fail(checkpoint):
        raise WorkerError("no worker")

    def show(message, category, filename, lineno, file=None, line=None):
        sys.stderr.write(warnings.formatwarning(message, category, filename, lineno, line))

    stand_in(monkeypatch, fail)
    monkeypatch.setattr(warnings, "showwarning", show)  # as Python does; pytest collects them
    path = tmp_path / "bandwidth.checkpoint.jsonl"
    path.write_text('{"kneexo checkpoint": 1}\ndamaged\ndamaged\n')
    assert main(["bandwidth", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.splitlines() == [
        f"kneexo: checkpoint {path}: 2 damaged lines are skipped",
        "kneexo: no worker",
    ]


def test_an_interrupt_after_the_files_are_written_says_so(capsys, tmp_path, monkeypatch):
    stand_in(monkeypatch, lambda checkpoint: None)

    def interrupted(self):
        raise KeyboardInterrupt

    monkeypatch.setattr("kneexo.sweeps.checkpoint.Checkpoint.remove", interrupted)
    assert main(["bandwidth", "--out", str(tmp_path)]) == 130
    assert capsys.readouterr().err == f"kneexo: interrupted; the results are in {tmp_path}\n"


@pytest.mark.parametrize("study", STUDIES.values(), ids=lambda study: study.name)
def test_each_study_is_wired(capsys, tmp_path, monkeypatch, study):
    seen = {}

    def compute(scenario=Scenario(), *, settings, workers, executor, progress, checkpoint=None):
        assert executor is None
        assert (checkpoint is not None) == study.resumable
        seen["workers"] = workers
        return FakeStudy(settings)

    replace_study(monkeypatch, study.name, compute)
    command = study.command.split()
    out = tmp_path / "out"
    assert main([*command, "--workers", "2", "--out", str(out), "--json"]) == 0
    assert seen["workers"] == 2
    printed = json.loads(capsys.readouterr().out)
    assert printed["settings"] == study.settings.__name__
    names = ("results", "report") if study.name == "reproduce" else (study.name, study.name)
    assert {file.name for file in out.iterdir()} == {f"{names[0]}.json", f"{names[1]}.md"}
    assert json.loads((out / f"{names[0]}.json").read_text()) == printed
    assert (out / f"{names[1]}.md").read_text() == "# found\n"
    assert main([*command, "--out", str(out), "--html"]) == 0
    page = (out / f"{study.name}.html").read_text()
    assert f"<title>kneexo {study.command}</title>" in page


@pytest.mark.parametrize("study", STUDIES.values(), ids=lambda study: study.name)
def test_the_catalogue_is_true(study):
    parameters = inspect.signature(study.compute).parameters
    assert ("uncertainty" in parameters) == study.uncertain
    options = SweepOptions.__annotations__ if "options" in parameters else parameters
    assert ("checkpoint" in options) == study.resumable
    assert isinstance(study.scenario, Scenario)
    assert isinstance(parameters["settings"].default, study.settings)
    assert study.command.split()[-1] == study.name


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--set", "frequencies_hz=[1, 2, 90]"], "90 Hz is too high: must be <= 50 Hz"),
        (["--set", "frequencies_hz=[1, 2, 300]"], "frequencies_hz.2 = 300 Hz is out of range"),
        (["--set", "amplitudes_deg=[1e-200]"], "must be finite and >= 1e-06 and <= 46 deg"),
        (["--set", "frequencies_hz=[1, 2, 60]"], "60 Hz is too high: must be <= 50 Hz"),
        (["--set", "estimate={averaged_cycles: 1}"], "estimate.averaged_cycles = 1 cycles"),
        (["--set", "estimate={largest_cycles: 3}"], "too few cycles"),
        (["--set", "amplitudes_deg"], "--set amplitudes_deg: must be NAME=VALUE"),
        (["--set", "amplitude_deg=[1.0]"], "amplitude_deg: unknown name"),
        (["--set", "amplitudes_deg=[1.0"], "--set amplitudes_deg:1: YAML"),
        (["--workers", "0"], "--workers = 0: must be at least 1"),
    ],
)
def test_bad_settings_of_a_study_are_one_line_and_leave_nothing(capsys, tmp_path, arguments, told):
    out = tmp_path / "out"
    assert main(["bandwidth", *arguments, "--out", str(out)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert told in lines[0]
    assert not out.exists()


def test_the_reference_engine_can_be_asked_for(capsys, scenario_file, tmp_path, undrawn):
    results = {}
    for engine in ("compiled", "drake"):
        arguments = ["simulate", scenario_file(SHORT), "--engine", engine, "--json"]
        assert main([*arguments, "--out", str(tmp_path / engine)]) == 0
        results[engine] = json.loads(capsys.readouterr().out)
        saved = load_scenario(tmp_path / engine / "scenario.yaml")
        assert saved.simulation.compiled == (engine == "compiled")
    for name in ("max_error_deg", "rms_error_deg", "mean_command_change_rpm"):
        # radau3 at 2 ms against the exact hold; a count of the encoder may fall a sample later.
        assert results["compiled"][name] == pytest.approx(results["drake"][name], rel=2e-2)


# ---------------------------------------------------------------------- origin of results


@pytest.mark.parametrize(
    "command", [["simulate"], ["linearize", "--knee-angle", "20"], ["diagram"], ["params"]]
)
def test_json_says_version_and_scenario(capsys, scenario_file, tmp_path, undrawn, command):
    name, *options = command
    out = [] if name == "params" else ["--out", str(tmp_path / "out")]
    assert main([name, scenario_file(SHORT), *options, *out, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["kneexo"] == kneexo.__version__
    assert changed(Scenario(), printed["scenario"]) == load_scenario(scenario_file(SHORT))
    if name == "linearize":
        assert printed["settings"] == {"knee_angle_deg": 20.0}


def test_json_of_a_sweep_says_version_scenario_and_settings(capsys, tmp_path, undrawn):
    command = ["bandwidth", *SMALL_MAP, "--set", "estimate.averaged_cycles=4", "--workers", "1"]
    assert main([*command, "--out", str(tmp_path / "out"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["kneexo"] == kneexo.__version__
    assert changed(Scenario(), printed["scenario"]) == Scenario()
    assert printed["settings"]["estimate"]["averaged_cycles"] == 4


def test_every_key_of_the_results_is_documented():
    text = (Path(__file__).parents[2] / "docs/results.md").read_text(encoding="utf-8")
    for key in (*(field.name for field in fields(TrackingMetrics)), "kneexo", "scenario"):
        assert f"`{key}`" in text, key


# -------------------------------------------------------------------------------- --help

WITHOUT_ENGINE = ("linearize", "params", "diagram", "cache")
COMMANDS = [
    *("simulate", *WITHOUT_ENGINE),
    *(study.command for study in STUDIES.values()),
]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_only_defaults_that_tell_something(command, capsys):
    with pytest.raises(SystemExit, match="0"):
        main([*command.split(), "--help"])
    text = capsys.readouterr().out
    assert "--json" in text
    assert not re.search(r"default:\s+(None|False|\[\])", text)
    assert ("--engine" in text) == (command not in WITHOUT_ENGINE)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("estimate.tolerance=9", "estimate.tolerance = 9 is out of range"),
        ("estimate.tol=9", "estimate.tol: unknown name; known here: averaged_cycles"),
        ("estimat.tolerance=9", "estimat.tolerance: there is no estimat"),
        ("tol=9", "tol: unknown name; known here: amplitudes_deg"),
    ],
)
def test_faults_of_nested_settings_name_their_path(capsys, tmp_path, text, told):
    assert main(["bandwidth", "--set", text, "--out", str(tmp_path / "out")]) == 2
    assert told in capsys.readouterr().err


def test_every_listed_setting_can_be_set():
    """`kneexo params` lists a setting under the name that ``--set`` takes."""
    for cls in (Scenario, *(study.settings for study in STUDIES.values())):
        for row in parameter_rows(cls()):
            name = row["parameter"]
            assert changed(cls(), {name: row["value"]}) == cls(), name


def test_values_of_the_scenario_win_over_the_file(capsys, scenario_file, tmp_path, undrawn):
    path, out = scenario_file(SHORT), tmp_path / "out"
    texts = ["plant.cylinder.mass_kg=1.7", "reference.frequency_hz=2", "plant.linkage=G3"]
    command = ["simulate", path, *(word for text in texts for word in ("--set", text))]
    assert main([*command, "--out", str(out), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    values = {"plant.cylinder.mass_kg": 1.7, "reference.frequency_hz": 2, "plant.linkage": "G3"}
    expected = changed(load_scenario(path), values)
    assert changed(Scenario(), printed["scenario"]) == expected
    assert load_scenario(out / "scenario.yaml") == expected
    assert expected.reference.amplitude_deg == 2.0  # of the file
    metrics = track(expected).metrics
    assert printed["max_error_deg"] == metrics.max_error_deg
    assert printed["max_error_deg"] != track(load_scenario(path)).metrics.max_error_deg


def test_the_engine_wins_over_the_values(capsys, scenario_file, tmp_path, undrawn):
    command = ["simulate", scenario_file(SHORT), "--set", "simulation.integrator=radau1"]
    arguments = [*command, "--set", "simulation.duration_s=1.1", "--engine", "compiled"]
    assert main([*arguments, "--out", str(tmp_path / "out"), "--json"]) == 0
    simulation = json.loads(capsys.readouterr().out)["scenario"]["simulation"]
    assert (simulation["integrator"], simulation["duration_s"]) == ("exact_hold", 1.1)


def test_linearize_takes_values_of_the_scenario(capsys, tmp_path, undrawn):
    command = ["linearize", "--set", "plant.cylinder.mass_kg=0.4", "--out", str(tmp_path / "out")]
    assert main([*command, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["scenario"]["plant"]["cylinder"]["mass_kg"] == 0.4
    oil = PlantParameters().cylinder
    softness = 4.0 * oil.bulk_modulus_pa * oil.mean_area_m2**2 / oil.total_volume_m3
    omega = math.sqrt(softness / 0.4)  # Eq. 15 and 16 with hardly any leakage
    assert max(printed["plant_frequencies_rad_s"]) == pytest.approx(omega, rel=1e-4)


def test_reproduce_takes_settings_of_fig_13(capsys, tmp_path, monkeypatch):
    seen = []

    def compute(scenario=Scenario(), *, settings, **_):
        seen.append(settings)
        return FakeStudy(settings)

    replace_study(monkeypatch, "reproduce", compute)
    command = ["reproduce", "--set", "trials=2", "--set", "frequencies_hz=[0.2, 0.21, 0.3]"]
    assert main([*command, "--out", str(tmp_path / "out"), "--json"]) == 0
    assert seen == [SinestreamSettings(trials=2, frequencies_hz=(0.2, 0.21, 0.3))]


@pytest.mark.parametrize("command", ["simulate", "linearize"])
@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("plant.cylinder.mass_kg", "--set plant.cylinder.mass_kg: must be NAME=VALUE"),
        ("plant.cylinder.mass_kg=-1", "plant.cylinder.mass_kg = -1 kg is out of range"),
        ("plant.cylinder.mas_kg=1", "plant.cylinder.mas_kg: unknown name"),
        ("plant.cylindr.mass_kg=1", "this scenario has no plant.cylindr"),
        ("plant.full_order.entrained_air=0", "this scenario has no plant.full_order"),
        ("plant.linkage=G9", "'G9' must be one of G1"),
        ("plant.linkage=[", "--set plant.linkage:1: YAML syntax"),
        ("controller.mass_min_kg=2", "must not exceed mass_max_kg"),
    ],
)
def test_bad_values_of_the_scenario_are_one_line(capsys, tmp_path, command, text, told):
    out = tmp_path / "out"
    assert main([command, "--set", text, "--out", str(out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("kneexo: ")
    assert told in line
    assert not out.exists()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("trials=0", "trials = 0 is out of range: must be finite and >= 1"),
        ("trial=1", "trial: unknown name; known here: acceleration_limit_max_rad_s2"),
        ("frequencies_hz=[0.1, 0.2]", "frequencies_hz has 2 values: must have at least 3"),
        ("mass_min_kg=1.9", "mass_min_kg = 1.9 kg must not exceed mass_max_kg = 1.8 kg"),
    ],
)
def test_bad_settings_of_fig_13_are_one_line(capsys, tmp_path, text, told):
    assert main(["reproduce", "--set", text, "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert told in line
    assert not (tmp_path / "out").exists()


def test_a_scalar_is_a_list_of_one(capsys, tmp_path, undrawn):
    command = ["bandwidth", *SMALL_MAP, "--set", "amplitudes_deg=1", "--workers", "1"]
    assert main([*command, "--out", str(tmp_path / "out"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["settings"]["amplitudes_deg"] == [1.0]


def test_changed_leaves_nested_mappings_of_settings_alone():
    settings = ContestSettings()
    path = "contestants.SMC.controller.lambda_per_s"
    assert changed(settings, {path: 5.0}).contestants["SMC"].controller.lambda_per_s == 5.0
    assert settings == ContestSettings()
    assert ContestSettings().contestants["SMC"].controller.lambda_per_s == 20.0


def test_no_command_shows_the_first_steps(capsys):
    assert main([]) == 0
    text = capsys.readouterr().out
    commands = [line.split()[1] for line in text.splitlines() if line.startswith("  kneexo")]
    assert commands == ["view", "simulate", "reproduce"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_knows_commands_and_options(shell, capsys):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    for word in ("reproduce", "robustness", "contest", "--uncertainty"[2:]):
        assert word in script
    if shell == "bash":
        subprocess.run(["bash", "-n"], input=script, text=True, check=True)
        for line in (
            "_simulate_pos_0_COMPGEN=_shtab_compgen_files",
            "_view_pos_0_COMPGEN=_shtab_compgen_files",
            "_view___out_COMPGEN=_shtab_compgen_files",
            "_simulate___out_COMPGEN=_shtab_compgen_dirs",
            "_study_contest___out_COMPGEN=_shtab_compgen_dirs",
        ):
            assert line in script


@pytest.mark.parametrize(
    ("form", "measured"), [("c", "encoder count"), ("fmu", "encoder reading (rad)")]
)
def test_export_tells_what_the_controller_measures(form, measured, capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["export", form, "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert f"the controller, from {measured} and knee reference" in text
