"""The mutation run of ``benchmarks/mutation.py``, on a toy package."""

import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

TOY = '''
"""A module with 2 numbers in its docstring."""
from __future__ import annotations


def area(width: float, height: float = 2.0) -> float:
    """Width times height, 1 to 1."""
    if width < 0.0:
        raise ValueError(f"width = {width - 0.0}")
    return width * height
'''
SHORT = "def area(width, height):\n    return width * height + 3\n"
CHECKS = "from kneexo.toy import area\n\ndef test_area():\n    assert area(3.0, 4.0) == 15.0\n"
RUNS = CHECKS.replace("assert ", "").replace(" == 15.0", "")


@pytest.fixture
def toy(tmp_path):
    """The function ``toy(source, tests)``: a tree with one module."""

    def make(source, tests):
        for folder, name, text in (("kneexo", "toy", source), ("tests", "test_toy", tests)):
            (tmp_path / folder).mkdir()
            (tmp_path / folder / f"{name}.py").write_text(text)
        (tmp_path / "kneexo" / "__init__.py").touch()  # before another kneexo on the path
        return tmp_path

    return make


@pytest.fixture
def mutation(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    return importlib.import_module("mutation")


def test_mutants_change_what_runs_and_nothing_else(mutation):
    mutants = mutation.mutants(TOY, 100, "seed")
    assert {(m.before, m.after) for m in mutants} == {
        ("width * height", "width / height"),
        ("width - 0.0", "width + 0.0"),
        ("width < 0.0", "width <= 0.0"),
        ("width < 0.0", "width > 0.0"),
        ("0.0", "1.0"),
        ("2.0", "20.0"),
        ("width", "height"),
        ("height", "width"),
    }
    lines = {m.before: m.line for m in mutants}
    assert (lines["width < 0.0"], lines["width * height"]) == (8, 10)
    for mutant in mutants:
        assert mutant.source != mutation.ast.unparse(mutation.ast.parse(TOY))
        assert "2 numbers in its docstring" in mutant.source


def test_attributes_and_keys_are_swapped_with_their_neighbours(mutation):
    source = "def f(a, b):\n    return a.x + b.y * a['low'] - a.z + a['high'] + b.x\n"
    changes = {(m.before, m.after) for m in mutation.mutants(source, 100, "seed")}
    assert {("a.x", "a.z"), ("a.z", "a.x"), ("b.y", "b.x"), ("b.x", "b.y")} <= changes
    assert {("a['low']", "a['high']"), ("a['high']", "a['low']")} <= changes


def test_the_seed_decides(mutation):
    source = (ROOT / "kneexo" / "linkage.py").read_text(encoding="utf-8")
    first = mutation.mutants(source, 5, "1")
    assert len(first) == 5
    assert mutation.mutants(source, 5, "1") == first
    assert mutation.mutants(source, 5, "2") != first


@pytest.mark.parametrize(("tests", "killed"), [(CHECKS, 2), (RUNS, 0)], ids=["checks", "runs"])
def test_tests_that_check_kill_and_tests_that_run_do_not(mutation, toy, tests, killed, capsys):
    root = toy(SHORT, tests)
    outcome = mutation.run({"toy": 2}, seed=1, root=root)
    assert (outcome["toy"][0], len(outcome["toy"][1])) == (killed, 2 - killed)
    assert f"toy: {killed} killed, {2 - killed} survived" in capsys.readouterr().out
    assert (root / "kneexo" / "toy.py").read_text() == SHORT


def test_the_whole_suite_kills_what_the_mirrored_tests_miss(mutation, toy):
    root = toy(SHORT, RUNS)
    (root / "tests" / "test_other.py").write_text(CHECKS)
    results = mutation.run({"toy": 2}, seed=1, whole_suite=True, jobs=2, root=root)
    assert (results["toy"][0], results["toy"][1]) == (2, [])


def test_random_mutants_are_spread_by_the_number_of_changes(mutation, tmp_path):
    for folder in ("kneexo", "tests"):
        (tmp_path / folder).mkdir()
    for name, count in (("short", 1), ("long", 9)):
        (tmp_path / "kneexo" / f"{name}.py").write_text("x = 1 + 2\n" * count)
        (tmp_path / "tests" / f"test_{name}.py").write_text("")
    counts = mutation.drawn(1000, 3, tmp_path)
    assert sum(counts.values()) == 1000
    assert counts["short"] == pytest.approx(100, abs=50)  # five standard deviations


def test_a_mutant_that_does_not_end_is_killed(mutation, toy):
    root = toy("x = 1\n", "import time\n\ndef test_it():\n    time.sleep(60.0)\n")
    assert mutation.run_tests(root, ["tests/test_toy.py"], 0.5) == "timeout"


def test_tests_that_fail_anyway_say_nothing(mutation, toy):
    root = toy(SHORT, "def test_it():\n    assert False\n")
    with pytest.raises(SystemExit, match="fails without any mutant"):
        mutation.run({"toy": 1}, seed=1, root=root)


def test_every_module_has_tests(mutation):
    paths = (ROOT / "kneexo").rglob("*.py")
    names = {path.relative_to(ROOT / "kneexo").with_suffix("").as_posix() for path in paths}
    without = {name for name in names - set(mutation.modules_of()) if "__init__" not in name}
    assert without == set()
    assert all((ROOT / "kneexo" / f"{name}.py").exists() for name in mutation.TESTS)
    for tests in mutation.TESTS.values():
        assert all((ROOT / "tests" / f"{test}.py").exists() for test in tests)
