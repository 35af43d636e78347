import io
import json
import os
import re
import signal
import subprocess
import sys
from contextlib import contextmanager, suppress
from pathlib import Path
from unittest.mock import Mock

import pytest
from pydantic_core import SchemaError, SchemaValidator, core_schema
from waiting import wait_for

from kneexo.command_line import single_runs, utilities
from kneexo.command_line.main import main
from kneexo.common.interruption import Terminated


def test_a_stream_without_greek_letters_gets_escapes(short, monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    assert main(["params", short, "--json"]) == 0
    stream.flush()
    rows = json.loads(stream.buffer.getvalue())["parameters"]
    assert any(row["unit"] == "m/s²" for row in rows)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        pytest.param(["params", "SCENARIO"], marks=pytest.mark.slow),
    ],
)
def test_a_full_device_is_a_line(arguments, short, run_command):
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
    words = [short if word == "SCENARIO" else word for word in arguments]
    with open("/dev/full", "w") as full:
        process = run_command(*words, stdout=full, env=environment)
    assert (process.returncode, process.stderr) == (2, "kneexo: No space left on device\n")


@pytest.mark.slow
def test_a_closed_output_is_no_failure():
    line = ["sh", "-c", 'exec "$0" -m kneexo setup cache >&-', sys.executable]
    process = subprocess.run(line, capture_output=True, text=True)
    assert (process.returncode, process.stderr) == (0, "")


@pytest.mark.slow
def test_an_unknown_matplotlib_backend_does_not_matter(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "bogus")
    assert main(["setup", "cache"]) == 0
    assert os.environ["MPLBACKEND"] == "Agg"  # before Matplotlib is imported


def test_no_home_directory_is_a_line(tmp_path):
    code = (
        "import sys, pathlib\n"
        "def nowhere(): raise RuntimeError('Could not determine home directory.')\n"
        "pathlib.Path.home = nowhere\n"
        "from kneexo.command_line import main as cli\n"
        "sys.exit(cli.main(['setup', 'cache']))\n"
    )
    environment = {k: v for k, v in os.environ.items() if k[:4] not in ("DIAG", "XDG_")}
    line = [sys.executable, "-c", code]
    process = subprocess.run(line, env=environment, capture_output=True, text=True)
    assert process.returncode == 0
    (message,) = process.stderr.splitlines()
    assert message.startswith("kneexo: cache directory: cannot be determined")


def test_too_little_memory_is_a_line(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(single_runs, "simulate", Mock(side_effect=MemoryError))
    assert main(["simulate", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == "kneexo: out of memory; reduce simulation.duration_s\n"


LIGHT = """
import sys, kneexo.command_line.main
def runs_without(arguments, *modules):
    try:
        assert kneexo.command_line.main.main(arguments) == 0
    except SystemExit as end:  # of the help
        assert not end.code
    assert not set(modules) & set(sys.modules), arguments
runs_without(["setup", "cache"], "numpy", "pydrake", "matplotlib", "numba", "llvmlite", "pydantic")
runs_without(["--help"], "numpy", "pydrake", "matplotlib")
for arguments in (["--yaml"], ["--schema"], ["--preset", "leg"], [sys.argv[1]]):
    runs_without(["params", *arguments], "pydrake", "scipy", "matplotlib", "llvmlite")
runs_without(["params"], "scipy.optimize", "scipy.linalg", "matplotlib")
"""
"""In an order in which no command may import what the next one must not."""


@pytest.mark.slow
def test_commands_import_no_more_than_they_need(short):
    line = [sys.executable, "-c", LIGHT, short]
    out = subprocess.run(line, capture_output=True, text=True, check=True).stdout
    for command in ("reproduce", "simulate", "params", "diagram", "setup"):
        assert command in out.partition("plant:")[0]


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (SystemExit(5), "kneexo: SystemExit: 5 ("),
        (ZeroDivisionError("mine"), "kneexo: ZeroDivisionError: mine ("),
    ],
)
def test_an_error_of_the_users_code_is_one_line_with_its_place(capsys, monkeypatch, error, message):
    def fail(*_):
        raise error

    monkeypatch.setattr(utilities, "params", fail)
    assert main(["params", "--schema"]) == 2
    line = capsys.readouterr().err
    assert line.startswith(message)
    assert line.endswith("; correct that code\n")
    assert "test_main.py, line " in line


def test_a_mistake_of_ours_has_its_traceback(monkeypatch):
    monkeypatch.setattr(utilities, "params", utilities.cache)
    with pytest.raises(AttributeError):
        main(["params", "--schema"])


# ---------------------------------------------------------------------------- interrupts


def alive(session):
    """Processes of a session that still work."""
    processes = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, its_session = file.read_text().rpartition(")")[2].split()[:4]
        except OSError:  # it has just ended
            continue
        if int(its_session) == session and state != "Z":
            processes.append(int(file.parent.name))
    return processes


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
        process.wait()
        process.stderr.close()


SWEEP = ["study", "bandwidth", "--workers", "2"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "word", "code"),
    [
        (signal.SIGINT, "interrupted", 130),
        (signal.SIGTERM, "terminated", 143),
    ],
)
def test_an_interrupt_is_one_line_and_leaves_nothing(tmp_path, number, word, code):
    out = tmp_path / "deep" / "out"
    with started(*SWEEP, "--out", out) as process:
        wait_for(lambda: len(alive(process.pid)) >= 3)  # workers are there, or are starting
        assert any(out.glob(".diagramc-*"))
        os.killpg(process.pid, number) if number == signal.SIGINT else process.send_signal(number)
        error = process.communicate()[1]
        assert process.returncode == code
        assert "Traceback" not in error
        assert error.splitlines()[-1] == f"kneexo: {word}; nothing was written"
        assert not (tmp_path / "deep").exists()
        wait_for(lambda: not alive(process.pid))


@pytest.mark.slow
def test_a_killed_sweep_leaves_no_process_and_its_pieces(tmp_path):
    path = tmp_path / "bandwidth.checkpoint.jsonl"
    with started(*SWEEP, "--out", tmp_path) as process:
        wait_for(lambda: path.exists() and path.read_bytes().count(b"\n") > 1)
        process.kill()
        process.wait()
        wait_for(lambda: not alive(process.pid))
    pieces = path.read_bytes()
    assert [file.name for file in tmp_path.glob(".*")] == [next(tmp_path.glob(".diagramc-*")).name]
    with started("study", "bandwidth", "--workers", "1", "--out", tmp_path) as process:
        wait_for(lambda: path.stat().st_size > len(pieces))  # it has gone on
        process.terminate()
        error = process.communicate()[1]
        assert process.returncode == 143
    last = error.splitlines()[-1]
    assert re.fullmatch(
        rf"kneexo: terminated; [0-9]+ finished pieces are kept in {re.escape(str(path))}; "
        rf"the same command goes on from them",
        last,
    )
    assert path.read_bytes().startswith(pieces)
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
    ("module", "message"),
    [
        ("kneexo.command_line.main", "interrupted"),
        ("argparse", "interrupted"),
        pytest.param("kneexo.parameters", "interrupted; KEPT", marks=pytest.mark.slow),
        ("pydrake", "interrupted; KEPT"),
        # An empty checkpoint is deleted when a command ends that has opened it.
        pytest.param("matplotlib", "interrupted; nothing was written", marks=pytest.mark.slow),
    ],
)
def test_an_interrupt_of_an_import_is_one_true_line(tmp_path, module, message):
    checkpoint = tmp_path / "bandwidth.checkpoint.jsonl"
    checkpoint.write_text("")
    process = subprocess.run(
        [sys.executable, "-c", EARLY, module, "study", "bandwidth", "--out", str(tmp_path)],
        capture_output=True,
        text=True,
    )
    line = f"finished pieces are kept in {checkpoint}; the same command goes on from them"
    assert process.stderr == f"kneexo: {message.replace('KEPT', line)}\n"
    assert process.returncode == 130


class _Interrupting:
    def __index__(self):
        raise KeyboardInterrupt


def _of_imports(interrupt):
    """Extension modules that import each other make an ImportError of an ImportError."""
    inner, middle, outer = ImportError("common"), ImportError("trees"), ImportError("framework")
    inner.__cause__, middle.__context__, outer.__cause__ = interrupt, inner, middle
    return outer


def _of_pydantic():
    """Its text alone names the interrupt."""
    with pytest.raises(SchemaError) as error:
        SchemaValidator(core_schema.str_schema(max_length=_Interrupting()))
    assert error.value.__cause__ is error.value.__context__ is None
    return error.value


@pytest.mark.parametrize(
    ("error", "code", "word"),
    [
        (_of_imports(KeyboardInterrupt()), 130, "interrupted"),
        (_of_imports(Terminated()), 143, "terminated"),
        (_of_pydantic(), 130, "interrupted"),
        # of pybind11
        (RuntimeError("cannot import trees: Terminated: <EMPTY MESSAGE>"), 143, "terminated"),
    ],
)
def test_an_interrupt_behind_an_error_is_one_line(capsys, monkeypatch, tmp_path, error, code, word):
    monkeypatch.setattr(single_runs, "simulate", Mock(side_effect=error))
    assert main(["simulate", "--out", str(tmp_path)]) == code
    assert capsys.readouterr().err == f"kneexo: {word}; nothing was written\n"


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
    process = subprocess.run(line, capture_output=True, text=True)
    assert (process.returncode, process.stdout) == (130, "")
    assert process.stderr == "kneexo: interrupted; nothing was written\n"
