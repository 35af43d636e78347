"""Record how much of each tolerance the tests use, and how this depends on the processor.

    python benchmarks/tolerance_margins.py run FOLDER [PYTEST ARGUMENT ...]
    python benchmarks/tolerance_margins.py show FOLDER [FOLDER ...] [--worst N]

``run`` runs the tests and writes its records to ``FOLDER``. Do this once as it is and once with
the kernels of another machine (``benchmarks/machine_variants.py --margins`` does both). ``show``
compares the folders, prints the smallest margins, and exits with 1 if any is below 10.

Recorded are ``pytest.approx``, ``numpy.testing.assert_allclose`` and each ``<``, ``<=``, ``>``,
``>=`` in an ``assert``. The share r of a tolerance is the deviation over the tolerance, the largest
over all runs; Δr is how much it differs between folders. Kinds of tolerances:

exact
    No deviation in any folder.
rounding
    The deviation is rounding: another kernel changes it by more than a thousandth of itself, or it
    is below 1e-12 of the expected value. Margin: 1/r.
deterministic
    Truncation, printed digits or a bound of the physics: every machine has the same deviation, but
    for rounding. Margin: the unused share over the change, (1 − r)/Δr.

Inequalities count as tolerances where the smaller side is a magnitude (``abs``, ``hypot``,
``norm``, a name with ``error``, ``deviation``, ``distance``, ``relative`` or ``difference``) or the
bound is a number of at most 1e-6. All others are claims (``margin > 30.0``), to which the rule of
deterministic tolerances applies. ``EXEMPT`` names the tests that may have a smaller margin, with
reasons.
"""

from __future__ import annotations

import argparse
import ast
import json
import math
import os
import sys
from collections.abc import Iterator
from numbers import Number
from pathlib import Path
from typing import Any, NamedTuple

EXEMPT: dict[str, str] = {}
"""Reasons why a margin below 10 is right, by a part of the test's name."""

LEAST = 10.0
ROUNDING = 1e-12
"""Relative deviations below this are rounding."""
CHANGED = 1e-3
"""A deviation that another machine changes by more than this share of itself is rounding."""

MAGNITUDES = ("abs", "hypot", "norm", "ptp", "std")
WORDS = ("error", "deviation", "distance", "relative", "difference", "residual", "worst")
OPERATORS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="}


# ---------------------------------------------------------------------------------- recording


class Recorder:
    """A plugin of pytest that records the shares of tolerances, by test and line."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.test = folder, ""
        self.shares: dict[tuple[str, str, str], list[float]] = {}

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Note which test runs."""
        self.test = nodeid

    def pytest_sessionfinish(self) -> None:
        """Write the records of this process."""
        self.folder.mkdir(parents=True, exist_ok=True)
        records = [[*key, *value] for key, value in self.shares.items()]
        (self.folder / f"{os.getpid()}.json").write_text(json.dumps(records))

    def add(self, kind: str, line: str, share: float, relative: float) -> None:
        """Keep the largest ``share`` and ``relative`` of each line.

        ``share``: deviation over tolerance; ``relative``: deviation over expected value.
        """
        if math.isfinite(share):
            worst = self.shares.setdefault((self.test, line, kind), [0.0, 0.0])
            worst[0] = max(worst[0], float(share))
            worst[1] = max(worst[1], float(relative))

    def compare(self, left: Any, operator: str, right: Any, line: str, tolerance: bool) -> Any:
        """Return ``left operator right``, and record how near it is to its bound."""
        import numpy as np

        results = {
            "<": lambda: left < right,
            "<=": lambda: left <= right,
            ">": lambda: left > right,
            ">=": lambda: left >= right,
        }
        result = results[operator]()
        if not (numeric(left) and numeric(right)) or not np.all(result):
            return result
        small, large = (left, right) if operator[0] == "<" else (right, left)
        small, large = np.broadcast_arrays(small, large)
        with np.errstate(all="ignore"):
            if tolerance:
                share = np.where(small > 0.0, small / large, 0.0)
            else:  # a claim: 1 minus the relative distance to the bound
                share = 1.0 - (large - small) / np.maximum(np.abs(small), np.abs(large))
        if share.size:
            worst = float(np.nanmax(share)) if np.any(np.isfinite(share)) else math.nan
            bound = float(np.max(np.abs(large)))
            relative = bound if tolerance else math.inf
            self.add("inequality" if tolerance else "claim", line, worst, relative)
        return result


def numeric(value: Any) -> bool:
    """Return whether a value is a float, or an array of floats."""
    import numpy as np

    if isinstance(value, bool) or not isinstance(value, Number | np.ndarray):
        return False
    return np.asarray(value).dtype.kind == "f"


def test_line() -> str:
    """Return file and number of the innermost line of a test file on the stack."""
    frame = sys._getframe(1)
    while frame is not None:
        path = frame.f_code.co_filename
        if "/tests/" in path:
            return f"{path.rpartition('/tests/')[2]}:{frame.f_lineno}"
        frame = frame.f_back  # type: ignore[assignment]  # None ends the loop
    return "?"


def patch(recorder: Recorder) -> None:
    """Record in pytest.approx and assert_allclose, and rewrite the inequalities of the tests."""
    import numpy as np
    import pytest
    from _pytest.assertion import rewrite

    scalar: Any = type(pytest.approx(1.0))
    equals = scalar.__eq__

    def approx_equals(self: Any, actual: Any) -> bool:
        result = equals(self, actual)
        if isinstance(actual, Number) and isinstance(self.expected, Number):
            deviation = abs(self.expected - actual)
            # Relative to nan there is no tolerance.
            if math.isfinite(deviation) and math.isfinite(tolerance := self.tolerance):
                relative = deviation / abs(self.expected) if self.expected else deviation
                share = deviation / tolerance if tolerance else float(deviation > 0.0)
                kind = "approx" if share <= 1.0 else "approx, differs"
                recorder.add(kind, test_line(), share if share <= 1.0 else 1.0 / share, relative)
        return result

    scalar.__eq__ = approx_equals
    allclose = np.testing.assert_allclose

    def recorded_allclose(
        actual: Any, desired: Any, rtol: float = 1e-7, atol: float = 0.0, **options: Any
    ) -> None:
        allclose(actual, desired, rtol=rtol, atol=atol, **options)
        a, d = np.broadcast_arrays(np.asarray(actual), np.asarray(desired))
        if a.size and a.dtype.kind in "fc":
            with np.errstate(all="ignore"):
                tolerance, deviation = atol + rtol * np.abs(d), np.abs(a - d)
                share = np.where(deviation > 0.0, deviation / tolerance, 0.0)
                scale = np.max(np.abs(d[np.isfinite(d)]), initial=0.0)
            worst = float(np.max(deviation[np.isfinite(deviation)], initial=0.0))
            relative = worst / scale if scale else worst
            largest = float(np.max(share[np.isfinite(share)], initial=0.0))
            recorder.add("allclose", test_line(), largest, relative)

    np.testing.assert_allclose = recorded_allclose
    rewrite_asserts = rewrite.rewrite_asserts

    def rewrite_all(tree: ast.Module, source: bytes, path: str | None = None, *rest: Any) -> None:
        Inequalities(str(path)).visit(tree)
        ast.fix_missing_locations(tree)
        rewrite_asserts(tree, source, path, *rest)

    rewrite.rewrite_asserts = rewrite_all
    # Neither read asserts that pytest rewrote in an earlier run, nor leave ours to a later one.
    rewrite._read_pyc = lambda *_args, **_options: None
    rewrite._write_pyc = lambda *_args, **_options: False
    import builtins

    builtins.__compare__ = recorder.compare  # type: ignore[attr-defined]  # the rewritten asserts call it


class Inequalities(ast.NodeTransformer):
    """Turns each inequality of an assert into a call of `Recorder.compare`."""

    def __init__(self, path: str) -> None:
        self.path, self.inside = path.rpartition("/tests/")[2], False

    def visit_Assert(self, node: ast.Assert) -> ast.AST:
        """Rewrite the condition alone."""
        self.inside = True
        node.test = self.visit(node.test)
        self.inside = False
        return node

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        """Rewrite inequalities of two sides."""
        self.generic_visit(node)
        if not self.inside or len(node.ops) != 1 or type(node.ops[0]) not in OPERATORS:
            return node
        operator = OPERATORS[type(node.ops[0])]
        sides = (node.left, node.comparators[0])
        small, bound = sides if operator[0] == "<" else sides[::-1]
        text = ast.unparse(small)
        tolerance = any(f"{m}(" in text for m in MAGNITUDES) or any(w in text for w in WORDS)
        if isinstance(bound, ast.Constant) and isinstance(bound.value, float):
            tolerance = tolerance or 0.0 < bound.value <= 1e-6
        if isinstance(small, ast.Constant):
            tolerance = False
        arguments = [node.left, ast.Constant(operator), node.comparators[0]]
        arguments += [ast.Constant(f"{self.path}:{node.lineno}"), ast.Constant(tolerance)]
        call = ast.Call(ast.Name("__compare__", ast.Load()), arguments, [])
        return ast.copy_location(call, node)


def run(folder: Path, arguments: list[str]) -> int:
    """Run pytest in this process, with the same examples of hypothesis each time."""
    import hypothesis
    import pytest

    hypothesis.settings.register_profile("margins", derandomize=True, database=None, deadline=None)
    recorder = Recorder(folder)
    patch(recorder)
    options = ["-n", "0", "-p", "no:cacheprovider", "--hypothesis-profile=margins"]
    return int(pytest.main([*options, *arguments], plugins=[recorder]))


# ------------------------------------------------------------------------------------ showing


class Margin(NamedTuple):
    """The margin of one tolerance, over all folders."""

    margin: float
    kind: str
    share: float
    change: float
    test: str
    line: str
    source: str


def margins(folders: list[Path]) -> Iterator[Margin]:
    """Yield the margin of each tolerance that any folder has."""
    by_folder = []
    for folder in folders:
        shares: dict[tuple[str, ...], list[float]] = {}
        for file in folder.glob("*.json"):
            for test, line, source, share, relative in json.loads(file.read_text()):
                worst = shares.setdefault((test, line, source), [0.0, 0.0])
                worst[:] = max(worst[0], share), max(worst[1], relative)
        by_folder.append(shares)
    for key in set().union(*by_folder):
        test, line, source = key
        records = [shares[key] for shares in by_folder if key in shares]
        values = [share for share, _ in records]
        share, change = max(values), max(values) - min(values)
        relative = max(r for _, r in records)
        if share == 0.0:
            kind, margin = "exact", math.inf
        elif source != "claim" and (change > CHANGED * share or relative < ROUNDING):
            kind, margin = "rounding", 1.0 / share
        else:
            kind = "claim" if source == "claim" else "deterministic"
            margin = (1.0 - share) / change if change else math.inf
        yield Margin(margin, kind, share, change, test, line, source)


def show(folders: list[Path], worst: int) -> int:
    """Print counts by kind and the smallest margins; return 1 if a margin is below 10, else 0."""
    everything = sorted(margins(folders))
    print(f"{len(everything)} tolerances in {len({m.test for m in everything})} tests")
    for kind in ("exact", "rounding", "deterministic", "claim"):
        these = [m for m in everything if m.kind == kind]
        least = min((m.margin for m in these), default=math.inf)
        print(f"  {kind}: {len(these)}, smallest margin {least:.3g}")
    print("margin  kind  share  change  line  test")
    small = 0
    for number, m in enumerate(everything):
        exempt = [reason for part, reason in EXEMPT.items() if part in m.test]
        small += m.margin < LEAST and not exempt
        if number < worst or m.margin < LEAST:
            print(
                f"{m.margin:8.3g}  {m.kind:13} {m.share:9.3g} {m.change:9.3g}  {m.line}  "
                f"{m.test.rpartition('::')[2]}  {' '.join(exempt)}"
            )
    print(f"margins below {LEAST:g}: {small}")
    return int(small > 0)


def main() -> int:
    """Run or show."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    runner = commands.add_parser("run")
    runner.add_argument("folder", type=Path)
    shower = commands.add_parser("show")
    shower.add_argument("folders", type=Path, nargs="+")
    shower.add_argument("--worst", type=int, default=20)
    options, rest = parser.parse_known_args()
    if options.command == "run":
        return run(options.folder.resolve(), rest)
    return show(options.folders, options.worst)


if __name__ == "__main__":
    sys.exit(main())
