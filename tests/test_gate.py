"""What the gate runs of the slow tests, and a skip for a missing tool, which fails in CI."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEST = """
@pytest.mark.slow({gate})
@pytest.mark.parametrize("number", range({cases}))
def test_{name}(number{fixture}):
    {body}
"""
TESTS = [
    {"name": "first", "cases": 3},
    {"name": "two", "cases": 5, "gate": "gate=2"},
    {"name": "dear", "gate": "gate=0"},
    {"name": "page", "cases": 2, "fixture": ", browser"},
    {"name": "dear_page", "fixture": ", browser", "gate": "gate=0"},
    {"name": "tool", "body": "pytest.skip('needs a wrench')"},
    {"name": "allowed", "body": "pytest.skip('root may write everywhere')"},
    {"name": "expected", "body": "pytest.xfail()"},
]


@pytest.mark.slow(gate=3)
@pytest.mark.parametrize(
    ("selection", "ci", "expected"),
    [
        ("gate", "1", "first[0] two[0] two[2] tool[0]-FAILED allowed[0]-SKIPPED expected[0]-XFAIL"),
        ("gate", "", "first[0] two[0] two[2] tool[0]-SKIPPED allowed[0]-SKIPPED expected[0]-XFAIL"),
        ("browser", "", "page[0] page[1]"),
    ],
)
def test_some_cases_are_in_the_gate_and_a_missing_tool_fails_in_ci(
    tmp_path, selection, ci, expected
):
    shutil.copy(ROOT / "tests/conftest.py", tmp_path)
    defaults = {"gate": "", "cases": 1, "fixture": "", "body": "pass"}
    text = "".join(TEST.format_map(defaults | test) for test in TESTS)
    (tmp_path / "test_some.py").write_text(f"import pytest\n{text}")
    (tmp_path / "test_module.py").write_text("import pytest\n\npytest.importorskip('a_hammer')\n")
    options = ["-c", ROOT / "pyproject.toml", "-n", "0", "-m", selection, "-v"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, "--continue-on-collection-errors", tmp_path],
        env=os.environ | {"KNEEXO_CI": ci},
        capture_output=True,
        text=True,
    )
    results = re.findall(r"::test_(\S+) ([A-Z]+)", done.stdout)
    assert " ".join("-".join(pair) for pair in results).replace("-PASSED", "") == expected
    for tool in ("needs a wrench", "could not import 'a_hammer'"):
        assert done.stdout.count(f"\nmissing in CI: {tool}") == (ci == "1")
