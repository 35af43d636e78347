"""Change the package at random places, one at a time, and show those that its own tests miss.

    python benchmarks/mutants.py [--count 60] [--seed TEXT] [--most N]

A mutant is one changed operator, comparison, number or truth value. The places are drawn with the
seed, spread over the folders of the package by their numbers of places. Each mutant runs in a copy
of the tree, with an empty cache, until a test fails: the fast tests of the file that mirrors the
module and of the files that import the module, then the slow tests of the mirror that the gate
runs, then its other slow tests. The exit code is 1 if more than ``--most`` mutants survive. A
survivor is a gap in these tests, which other tests may fill, or a change that changes nothing.
`benchmarks/mutation.py` makes every change of one module.
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("diagramc", "kneexo")
PAIRS = (
    *((ast.Lt, ast.LtE), (ast.Gt, ast.GtE), (ast.Eq, ast.NotEq), (ast.Is, ast.IsNot)),
    *((ast.In, ast.NotIn), (ast.And, ast.Or), (ast.Add, ast.Sub), (ast.Mult, ast.Div)),
)
OTHERS = dict(PAIRS) | {b: a for a, b in PAIRS} | {ast.Pow: ast.Mult, ast.FloorDiv: ast.Div}
"""What takes the place of an operator."""

STEPS = (
    ("fast", ["-m", "not slow"]),
    ("gate", ["-m", "gate"]),
    ("slow", ["-m", "slow"]),
)
"""Where a mutant can be found, in this order, with the options of pytest."""

CPU_S = 900
"""Processor time in s after which the tests of a mutant count as failed: an endless loop."""


@dataclass(frozen=True)
class Mutant:
    """The text ``new`` in place of the characters ``start`` to ``end`` (in bytes) of a file."""

    file: Path
    line: int
    start: int
    end: int
    old: str
    new: str


def changed(node: ast.AST) -> ast.AST | None:
    """Return a changed copy of an expression, or None where there is nothing to change."""
    other = copy.deepcopy(node)
    match other:
        case ast.Constant(value=bool()):
            other.value = not other.value
        case ast.Constant(value=int()):
            other.value += 1
        case ast.Constant(value=float()):
            other.value = 1.1 * other.value or 1.0
        case ast.UnaryOp(op=ast.USub() | ast.Not()):
            return other.operand
        case ast.Compare() if type(other.ops[0]) in OTHERS:
            other.ops[0] = OTHERS[type(other.ops[0])]()
        case ast.BinOp() | ast.BoolOp() if type(other.op) in OTHERS:
            other.op = OTHERS[type(other.op)]()
        case _:
            return None
    return other


def expressions(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the expressions below a node, but those of annotations and formatted texts."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns") or isinstance(node, ast.JoinedStr):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield child
                yield from expressions(child)


def mutants_of(file: Path) -> list[Mutant]:
    """Return every mutant of a file of the package."""
    text = (ROOT / file).read_bytes()
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found = []
    for node in expressions(ast.parse(text)):
        other = changed(node) if isinstance(node, ast.expr) else None
        if other is not None:
            start = starts[node.lineno - 1] + node.col_offset
            end = starts[node.end_lineno - 1] + node.end_col_offset
            old, new = text[start:end].decode(), f"({ast.unparse(other)})"
            found.append(Mutant(file, node.lineno, start, end, old, new))
    return found


def drawn(count: int, seed: str) -> list[Mutant]:
    """Draw ``count`` mutants, in each folder a share by its number of places, but one at least."""
    folders = defaultdict(list)
    files = [path for root in PACKAGES for path in sorted((ROOT / root).rglob("*.py"))]
    for file in files:
        path = file.relative_to(ROOT)
        folders[path.parts[:-1][:2]] += mutants_of(path)
    generator = random.Random(seed)
    total = sum(len(places) for places in folders.values())
    picked = []
    for places in folders.values():
        share = max(1, round(count * len(places) / total))
        picked += generator.sample(places, min(share, len(places)))
    return picked


def mirror_of(file: Path) -> Path:
    """Return the path of the test file that mirrors a module, which need not exist."""
    folders = file.parts[file.parts[0] == "kneexo" : -1]
    return Path("tests", *folders, f"test_{file.name}")


def importers() -> dict[str, list[Path]]:
    """Return a dictionary from the name of each imported module to the test files."""
    found = defaultdict(list)
    for test in sorted((ROOT / "tests").rglob("test_*.py")):
        for node in ast.walk(ast.parse(test.read_bytes())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            for name in names:
                if test not in found[name]:
                    found[name].append(test)
    return {name: [test.relative_to(ROOT) for test in tests] for name, tests in found.items()}


def run(mutant: Mutant, tests: dict[str, list[Path]], folder: Path) -> str:
    """Return the step whose tests fail for a mutant, or "survives"."""
    tree = Path(tempfile.mkdtemp(dir=folder))
    ignored = shutil.ignore_patterns(".*", "__pycache__", "build", "*.egg-info")
    shutil.copytree(ROOT, tree, ignore=ignored, dirs_exist_ok=True)
    text = (tree / mutant.file).read_bytes()
    changed_text = text[: mutant.start] + mutant.new.encode() + text[mutant.end :]
    (tree / mutant.file).write_bytes(changed_text)
    mirror = mirror_of(mutant.file)
    own = [mirror] if (tree / mirror).exists() else []
    module = ".".join(mutant.file.with_suffix("").parts).removesuffix(".__init__")
    environment = os.environ | {"DIAGRAMC_CACHE_DIR": str(tree / "cache"), "PYTHONPATH": str(tree)}
    outcome = "survives"
    for name, options in STEPS:
        files = [*own, *(t for t in tests.get(module, []) if t not in own)]
        files = files if name == "fast" else own
        if not files:
            continue
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "--capture=fd"]
        done = subprocess.run(
            [*command, "-p", "no:cacheprovider", *options, *map(str, files)],
            cwd=tree,
            env=environment,
            capture_output=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S)),
        )
        if done.returncode not in (0, 5):  # 5: no test has this mark
            outcome = name
            break
    shutil.rmtree(tree)
    return outcome


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", default="1")
    parser.add_argument("--most", type=int, default=sys.maxsize, help="survivors that may be")
    options = parser.parse_args()
    mutants, tests = drawn(options.count, options.seed), importers()
    outcomes = []
    with (
        tempfile.TemporaryDirectory(prefix="kneexo-mutants-") as folder,
        ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool,
    ):
        runs = pool.map(lambda mutant: run(mutant, tests, Path(folder)), mutants)
        for mutant, outcome in zip(mutants, runs, strict=True):
            outcomes.append(outcome)
            change = f"{mutant.old}  →  {mutant.new}".replace("\n", " ")
            print(f"{outcome:9} {mutant.file}:{mutant.line}  {change[:120]}", flush=True)
    print(f"seed {options.seed}: {len(mutants)} mutants, {dict(Counter(outcomes))}")
    return int(outcomes.count("survives") > options.most)


if __name__ == "__main__":
    sys.exit(main())
