"""The command that repeats a failed run, and makes a test of it."""

import json
import re
import subprocess
import sys

import pytest

from kneexo.command_line.main import main
from kneexo.compiler import compile_diagram, record_run
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.sweeps.failure import record_failure

FAILING = changed(
    Scenario(),
    {
        "reference": {"kind": "sine", "mean_deg": 3.0, "amplitude_deg": 2.9, "frequency_hz": 1.0},
        "controller": {"kind": "pid", "integral_per_s2": 1e5},
        "simulation.duration_s": 0.2,
    },
)
LAW = """\
def law(rod_extension, rod_reference, gain=-1e5):
    error = rod_reference[0] - rod_extension
    return gain * error if error > 0.0 else gain * error  # called as Python, as it branches
"""
DIAGRAM = """\
from pydrake.symbolic import Variable
from pydrake.systems.primitives import SymbolicVectorSystem


def make():
    x = Variable("x")
    return SymbolicVectorSystem(state=[x], dynamics=[{rate} * x * x], output=[x])
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working directory, with the file of a failed run, and a folder for tests."""
    monkeypatch.chdir(tmp_path)
    record_failure(FAILING).write(tmp_path / "failure.json")
    (tmp_path / "tests").mkdir()
    return tmp_path


@pytest.fixture
def wrong_sign(folder):
    """The same with the run of a law of the wrong sign, which is in ``my.py``."""
    (folder / "my.py").write_text(LAW, encoding="utf-8")
    scenario = changed(FAILING, {"simulation.duration_s": 1.0}).with_law("my.py:law")
    record_failure(scenario).write(folder / "failure.json")
    return folder


@pytest.fixture
def growth(tmp_path, monkeypatch):
    """The working directory, with dx/dt = 2 x² from x = 1 and the file of its run, in ``out``."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "growth.py").write_text(DIAGRAM.format(rate=2.0), encoding="utf-8")
    for name in ("out", "tests"):
        (tmp_path / name).mkdir(exist_ok=True)
    scope = {}
    exec(DIAGRAM.format(rate=2.0), scope)
    model = compile_diagram(scope["make"]())
    state = model.state()
    state.continuous[:] = 1.0
    options = {"record_period_s": 0.01, "integrator": "rk4", "step_s": 0.001}
    record_run(model, model.parameters(), state, 1.0, **options).write("out/run.json")
    return tmp_path


def pytest_on(path):
    """Exit code and output of pytest, in a process: its plugins are not those of this run."""
    command = [sys.executable, "-m", "pytest", "-q", "-rxX", "-p", "no:cacheprovider", str(path)]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=path.parent)
    return ended.returncode, ended.stdout


def test_a_replay_says_the_error_and_that_it_is_the_same(folder, capsys):
    assert main(["replay", "failure.json"]) == 0
    error, same = capsys.readouterr().out.splitlines()
    assert error.startswith("t = 0.1")
    assert same == "same end, with the same bits of all states"
    assert main(["replay", "failure.json", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["same"] is True
    assert printed["end"] == json.loads((folder / "failure.json").read_text())["end"]
    assert (printed["files"], printed["changes"]) == ([], [])


def test_a_difference_of_one_bit_is_an_error_of_one_line(folder, capsys):
    document = json.loads((folder / "failure.json").read_text())
    document["end"]["state"]["plant/cylinder.x[0]"] *= 1.0 + 2.0**-52
    document["versions"]["drake"] = "0.1"
    (folder / "failure.json").write_text(json.dumps(document))
    assert main(["replay", "failure.json", "--test", "tests/test_sign.py"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("kneexo: failure.json: plant/cylinder.x[0] now ends at 0.14")
    assert "; drake changed since the file was written: 0.1, now 1." in line
    assert list((folder / "tests").iterdir()) == []


@pytest.mark.parametrize("mended", [False, True])
def test_the_test_fails_as_expected_until_the_law_is_mended(wrong_sign, capsys, mended):
    assert main(["replay", "failure.json", "--test", "tests/test_sign.py"]) == 0
    assert "tests/test_sign.py repeats it: pytest tests/test_sign.py" in capsys.readouterr().out
    test = wrong_sign / "tests" / "test_sign.py"
    assert max(map(len, test.read_text(encoding="utf-8").splitlines())) <= 100
    assert sorted(file.name for file in test.parent.iterdir()) == ["test_sign.json", test.name]
    (wrong_sign / "failure.json").unlink()
    if mended:
        (wrong_sign / "my.py").write_text(LAW.replace("gain *", "-gain *"), encoding="utf-8")
    function = load(test, "test_sign")
    if mended:
        function()
    else:
        with pytest.raises(RuntimeError, match=r"has the wrong sign"):
            function()
    (mark,) = function.pytestmark
    assert (mark.name, mark.kwargs["strict"]) == ("xfail", True)
    assert re.match(r"t = 0\.\d+ s: knee: knee_angle", mark.kwargs["reason"])


def load(path, name):
    scope = {"__file__": str(path), "__name__": "a_test"}
    exec(compile(path.read_text(encoding="utf-8"), path, "exec"), scope)
    return scope[name]


@pytest.mark.slow
def test_pytest_runs_both_tests(wrong_sign, growth, capsys):
    assert main(["replay", "failure.json", "--test", "tests/test_sign.py"]) == 0
    diagram = ["--diagram", "growth.py:make"]
    assert main(["replay", "out/run.json", *diagram, "--test", "tests/test_growth.py"]) == 0
    code, text = pytest_on(growth / "tests")
    assert code == 0, text
    assert "2 xfailed" in text
    (growth / "my.py").write_text(LAW.replace("gain *", "-gain *"), encoding="utf-8")
    (growth / "growth.py").write_text(DIAGRAM.format(rate=-2.0), encoding="utf-8")
    code, text = pytest_on(growth / "tests")
    assert code == 1
    assert text.count("[XPASS(strict)]") == 2


def test_a_run_of_a_diagram_needs_its_maker(growth, capsys):
    assert main(["replay", "out/run.json"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(
        "with a failed run of a scenario; a run of a diagram needs --diagram FILE.py:NAME"
    )
    test = growth / "tests" / "test_growth.py"
    command = ["replay", "out/run.json", "--diagram", "growth.py:make"]
    assert main([*command, "--test", str(test)]) == 0
    error, same, _ = capsys.readouterr().out.splitlines()
    assert error.startswith("t = 0.5")  # the pole is at 1/(2 x₀) = 0.5 s
    assert same == "same end, with the same bits of all states"
    with pytest.raises(RuntimeError, match=r"is not finite"):
        load(test, "test_growth")()
    (growth / "growth.py").write_text(DIAGRAM.format(rate=-2.0), encoding="utf-8")
    load(test, "test_growth")()
    assert main(command) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "the run now ends with success, not with SimulationError: t = 0.5" in line
    assert "equations changed since the file was written: " in line


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["absent.json"], "absent.json: cannot be read (is no file)"),
        (["my.py"], "my.py: must be a file of kneexo with a failed run of a scenario; a run of a"),
        (["failure.json", "--test", "tests/sign.py"], "--test tests/sign.py: the name must begin"),
        (["failure.json", "--test", "tests/test-a.py"], "--test tests/test-a.py: the name must be"),
        (["failure.json", "--test", "no/test_a.py"], "no/test_a.py: cannot be written ("),
        (
            ["failure.json", "--diagram", "my.py:law"],
            "failure.json: must be a file of kneexo with a",
        ),
    ],
)
def test_wrong_arguments_are_one_line_and_write_nothing(folder, capsys, arguments, message):
    (folder / "my.py").write_text(LAW, encoding="utf-8")
    before = sorted(folder.rglob("*"))
    assert main(["replay", *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"kneexo: {message}")
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize(
    ("diagram", "message"),
    [
        ("growth.py", "--diagram growth.py: must be FILE.py:NAME"),
        ("no.py:make", "--diagram no.py:make: there is no file no.py"),
        ("growth.py:maker", "--diagram growth.py:maker: has no such function; it has "),
        ("bad.py:make", "--diagram bad.py:make: the file fails: ZeroDivisionError: division by"),
        ("bad2.py:make", "--diagram bad2.py:make: the function fails: ValueError: no"),
    ],
)
def test_a_wrong_maker_is_one_line(growth, capsys, diagram, message):
    (growth / "bad.py").write_text("1 / 0\n", encoding="utf-8")
    (growth / "bad2.py").write_text("def make():\n    raise ValueError('no')\n", encoding="utf-8")
    assert main(["replay", "out/run.json", "--diagram", diagram]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"kneexo: {message}")


def test_a_test_that_exists_stays(folder, capsys):
    test = folder / "tests" / "test_sign.py"
    test.write_text("# mine\n", encoding="utf-8")
    assert main(["replay", "failure.json", "--test", str(test)]) == 2
    assert "exists already; choose another name" in capsys.readouterr().err
    assert [file.read_text() for file in test.parent.iterdir()] == ["# mine\n"]


def test_a_run_that_succeeds_makes_no_test(growth, capsys):
    scope = {}
    exec(DIAGRAM.format(rate=2.0), scope)
    model = compile_diagram(scope["make"]())
    record_run(model, model.parameters(), model.state(), 0.1, record_period_s=0.1).write("ok.json")
    command = ["replay", "ok.json", "--diagram", "growth.py:make"]
    assert main(command) == 0
    assert capsys.readouterr().out.startswith("t = 0.1 s: the run succeeds\nsame end")
    assert main([*command, "--test", "tests/test_ok.py"]) == 2
    assert "does not fail, there is nothing to mend" in capsys.readouterr().err
