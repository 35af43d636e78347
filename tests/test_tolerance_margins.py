"""``benchmarks/tolerance_margins.py``: shares of tolerances, and what they mean."""

import ast
import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).parents[1] / "benchmarks" / "tolerance_margins.py"


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("tolerance_margins", TOOL)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def recorded(tool, source, **values):
    """What the asserts of a test file record: kind and share by line."""
    recorder = tool.Recorder(Path())
    tree = ast.parse(source)
    tool.Inequalities("/x/tests/test_a.py").visit(tree)
    ast.fix_missing_locations(tree)
    exec(compile(tree, "test_a.py", "exec"), values | {"__compare__": recorder.compare})
    return {line: (kind, share) for (_, line, kind), (share, _) in recorder.shares.items()}


def test_a_magnitude_below_a_bound_has_a_share_of_it(tool):
    source = "assert abs(x) < 4.0\nassert 1e-9 >= x * 1e-9\nassert margin > 2.0\nassert a < b < c"
    shares = recorded(tool, source, x=0.5, margin=8.0, a=1.0, b=2.0, c=3.0)
    assert shares == {
        "test_a.py:1": ("inequality", 0.125),
        "test_a.py:2": ("inequality", 0.5),
        "test_a.py:3": ("claim", 0.25),
    }


@pytest.mark.slow  # starts pytest
def test_a_comparison_with_nan_has_no_tolerance(tmp_path):
    source = "import pytest\ndef test_x():\n    assert 1.1 == pytest.approx(1.0, rel=0.4)\n"
    source += "    assert float('nan') == pytest.approx(float('nan'), nan_ok=True)\n"
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_a.py").write_text(source)
    (tmp_path / "tests" / "conftest.py").write_text("import sys\nsys.dont_write_bytecode = False\n")
    command = [sys.executable, TOOL, "run", "records", "-q", "tests"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert "1 passed" in result.stdout
    assert not list(tmp_path.rglob("*.pyc"))  # a later pytest would find these asserts
    shown = subprocess.run(
        [sys.executable, TOOL, "show", "records"], cwd=tmp_path, capture_output=True, text=True
    )
    assert shown.stdout.startswith("1 tolerances in 1 tests")


def test_an_inequality_that_fails_still_fails(tool):
    with pytest.raises(AssertionError):
        recorded(tool, "assert abs(x) < 4.0", x=5.0)


@pytest.mark.parametrize(
    ("shares", "relative", "kind", "margin"),
    [
        ((0.0, 0.0), 0.0, "exact", float("inf")),
        ((0.25, 0.125), 1e-6, "rounding", 4.0),  # the deviation halves with another kernel
        ((0.25, 0.25), 1e-15, "rounding", 4.0),  # as small as rounding
        ((0.5, 0.5 - 2.0**-20), 1e-6, "deterministic", 2.0**19),  # changes by rounding only
    ],
)
def test_kinds_of_tolerances(tool, tmp_path, capsys, shares, relative, kind, margin):
    folders = [tmp_path / "here", tmp_path / "there"]
    for folder, share in zip(folders, shares, strict=True):
        folder.mkdir()
        record = ["test_a.py::test_x", "test_a.py:1", "approx", share, relative]
        (folder / "1.json").write_text(json.dumps([record]))
    (result,) = tool.margins(folders)
    assert (result.kind, result.margin) == (kind, margin)
    assert tool.show(folders, worst=0) == (margin < 10.0)
    assert ("test_x" in capsys.readouterr().out) == (margin < 10.0)
