"""What the gate runs of the slow tests, and a skip for a missing tool, which fails in CI."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TESTS = """
import pytest

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("number", range(3))
def test_first(number):
    pass


@pytest.mark.cases_in_gate(2)
@pytest.mark.parametrize("number", range(5))
def test_two(number):
    pass


@pytest.mark.cases_in_gate(0)
def test_dear():
    pass


@pytest.mark.parametrize("number", range(2))
def test_page(number, browser):
    pass


@pytest.mark.cases_in_gate(0)
def test_dear_page(browser):
    pass


def test_tool():
    pytest.skip("needs a wrench")


@pytest.mark.skipif(True, reason="needs a lathe")
def test_mark():
    pass


def test_allowed():
    pytest.skip("root may write everywhere")


@pytest.mark.xfail
def test_expected():
    assert False
"""


def run(folder, selection, ci):
    """The results of tests by their name and the lines that explain them."""
    shutil.copy(ROOT / "tests/conftest.py", folder)
    (folder / "test_some.py").write_text(TESTS)
    (folder / "test_module.py").write_text("import pytest\n\npytest.importorskip('a_hammer')\n")
    options = ["-c", str(ROOT / "pyproject.toml"), "-n", "0", "-m", selection]
    options += ["-vrsf", "--continue-on-collection-errors"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, str(folder)],
        env=os.environ | {"KNEEXO_CI": ci},
        capture_output=True,
        text=True,
    )
    return dict(re.findall(r"::test_(\S+) ([A-Z]+)", done.stdout)), done.stdout


@pytest.mark.slow
def test_the_gate_has_cases_of_each_slow_test_and_fails_without_a_tool(tmp_path):
    results, text = run(tmp_path, "gate", ci="1")
    passed = dict.fromkeys(["first[0]", "two[0]", "two[2]"], "PASSED")
    missing = {"tool": "FAILED", "mark": "ERROR"}
    assert results == passed | missing | {"allowed": "SKIPPED", "expected": "XFAIL"}
    for tool in ("needs a wrench", "needs a lathe", "could not import 'a_hammer'"):
        assert text.count(f"\nmissing in CI: {tool}") == 1


@pytest.mark.slow
def test_elsewhere_a_missing_tool_skips(tmp_path):
    results, text = run(tmp_path, "gate and not browser", ci="")
    assert {results[name] for name in ("tool", "mark", "allowed")} == {"SKIPPED"}
    assert "missing in CI" not in text


@pytest.mark.slow
def test_pages_are_selected_alone(tmp_path):
    results, _ = run(tmp_path, "browser", ci="")
    assert set(results) == {"page[0]", "page[1]"}
