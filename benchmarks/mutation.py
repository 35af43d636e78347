"""Put mistakes into the package, one at a time, and see whether its tests notice.

    python benchmarks/mutation.py                                   # two in each module
    python benchmarks/mutation.py analysis/tracking --count 20      # many in one
    python benchmarks/mutation.py --seed 7                          # others
    python benchmarks/mutation.py --random 300 --whole-suite --jobs 2

Each mutant is one wrong operator, constant, sign, name, attribute or key. It is killed when a fast
test of the mirrored file (``tests/PATH/test_X.py``, or those of `TESTS`) fails, does not end in
time, or cannot be collected. Mutants of parameters and studies also face
``tests/test_defaults.py``. Mutants
live in a copy of the tree, so that no wrong source is left when the run is killed. The seed and the
module alone decide which mutants are picked. ``--random`` draws them from the whole package, where
every possible change is equally likely. With ``--whole-suite`` a mutant survives only if it passes
every fast test. A survivor is a gap in the tests, or a change that changes nothing.
"""

from __future__ import annotations

import argparse
import ast
import multiprocessing
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]

TESTS: dict[str, tuple[str, ...]] = {
    "command_line/export": (
        "command_line/test_export",
        "export/test_firmware",
        "export/test_fmu",
    ),
    "errors": ("command_line/test_main", "parameters/test_scenario_file"),
    "interruption": ("test_interruption", "command_line/test_main"),
    "analysis/sampled_loop": (
        "analysis/test_sampled_loop",
        "analysis/test_sampled_loop_in_time",
    ),
    "files/table": ("files/test_table", "parameters/test_reference_files"),
    "compiler/model_base": ("compiler/test_model_base", "compiler/test_model"),
    "compiler/equations/contexts": ("compiler/equations/test_contexts", "compiler/test_model"),
    "compiler/equations/events": ("compiler/equations/test_events", "compiler/test_drake_zoo"),
    "compiler/linear/linearize": (
        "compiler/linear/test_linearize",
        "compiler/linear/test_model",
    ),
    "compiler/linear/model": (
        "compiler/linear/test_model",
        "compiler/linear/test_sine_response",
        "compiler/linear/test_linearize",
    ),
    "compiler/equations/names": ("compiler/equations/test_names", "compiler/test_drake_zoo"),
    "compiler/equations/reader": ("compiler/equations/test_reader", "simulation/test_compiled"),
    "compiler/equations/symbolic": ("compiler/equations/test_symbolic", "compiler/test_drake_zoo"),
    "compiler/equations/tree": ("compiler/equations/test_tree", "compiler/test_drake_zoo"),
    "compiler/native/ir": ("compiler/native/test_ir", "compiler/native/test_printer"),
    "compiler/native/exact_hold": (
        "compiler/native/test_exact_hold",
        "compiler/native/test_time_loop",
    ),
    "compiler/native/jacobian_slots": (
        "compiler/native/test_jacobian_slots",
        "compiler/native/test_exact_hold",
    ),
    "compiler/native/integrators": (
        "compiler/native/test_integrators",
        "compiler/native/test_time_loop",
    ),
    "compiler/native/machine_code": ("compiler/native/test_machine_code", "compiler/test_model"),
    "compiler/native/llvm": ("compiler/native/test_llvm", "compiler/native/test_time_loop"),
    "compiler/native/runner": (
        "compiler/native/test_runner",
        "compiler/native/test_time_loop",
        "compiler/test_model",
    ),
    "compiler/c/export": ("compiler/c/test_export", "compiler/c/test_source"),
    "compiler/c/plan": ("compiler/c/test_plan", "compiler/c/test_source", "compiler/c/test_tables"),
    "compiler/c/source": ("compiler/c/test_source", "compiler/c/test_tables"),
    "compiler/c/build": ("compiler/c/test_build", "compiler/fmu/test_fmu"),
    "compiler/equations/partition": (
        "compiler/equations/test_partition",
        "compiler/equations/test_passes",
        "compiler/c/test_tables",
    ),
    "compiler/equations/graph_values": (
        "compiler/equations/test_graph_values",
        "compiler/c/test_tables",
        "compiler/c/test_step_size",
    ),
    "diagrams/part": ("diagrams/test_part", "diagrams/test_plant", "diagrams/test_controller"),
    "diagrams/closed_loop": (
        "diagrams/test_closed_loop",
        "diagrams/test_closed_loop_second_program",
        "diagrams/test_closed_loop_scalars",
    ),
    "diagrams/plant": (
        "diagrams/test_plant",
        "diagrams/test_plant_exact_solution",
        "diagrams/test_full_order_plant",
    ),
    "parameters/control": (
        "parameters/test_control",
        "parameters/test_quantity",
        "systems/test_sliding_mode_controller",
    ),
    "parameters/linkages": (
        "parameters/test_linkages",
        "parameters/test_quantity",
        "test_linkage",
        "test_rod_inverse",
    ),
    "parameters/paths": ("parameters/test_paths", "parameters/test_uncertainty"),
    "parameters/plant": ("parameters/test_plant", "parameters/test_quantity"),
    "parameters/quantity": ("parameters/test_quantity", "parameters/test_scenario_file"),
    "parameters/reference": (
        "parameters/test_reference",
        "parameters/test_reference_files",
        "parameters/test_quantity",
        "test_gait",
        "parameters/test_scenario_file",
    ),
    "parameters/scenario": (
        "systems/test_drive",
        "parameters/test_scenario",
        "parameters/test_quantity",
        "parameters/test_scenario_file",
    ),
    "parameters/uncertainty": ("parameters/test_uncertainty",),
    "simulation/drake": ("simulation/test_engines", "simulation/test_both_engines"),
    "simulation/run": ("simulation/test_run", "simulation/test_engines", "test_result"),
    "parameters/scenario_file": ("parameters/test_scenario_file", "parameters/test_uncertainty"),
    "studies/reproduce/study": ("studies/reproduce/test_study", "test_cluster"),
    "systems/_leaf": ("systems/test_leaf",),
    "systems/state_variable": (
        "systems/test_state_variable",
        "systems/test_bldc_pump",
        "diagrams/test_plant",
    ),
    "systems/cylinder": (
        "systems/test_cylinder",
        "systems/test_reduced_cylinder",
        "systems/test_full_cylinder",
    ),
}
"""Tests of the modules that have no file of their own name."""

_BINARY = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Div,
    ast.Mod: ast.FloorDiv,
    ast.MatMult: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
_COMPARED = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.GtE),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.LtE),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}


@dataclass(frozen=True)
class Mutant:
    """A changed module: its line, the expression before and after, and the whole source."""

    line: int
    before: str
    after: str
    source: str

    def __str__(self) -> str:
        """One line."""
        return f"line {self.line}: {self.before} -> {self.after}"


# --------------------------------------------------------------------------------- mutants


def _code(node: ast.AST) -> Iterator[ast.AST]:
    """What runs below a node: neither annotations, decorators, imports nor bare strings."""
    yield node
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for child in value if isinstance(value, list) else [value]:
            bare = isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant)
            typing = isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test)
            imported = isinstance(child, ast.Import | ast.ImportFrom)
            if isinstance(child, ast.AST) and not (bare or typing or imported):
                yield from _code(child)


def _key(node: ast.Subscript) -> str:
    """The text in brackets; empty for anything else."""
    value = node.slice.value if isinstance(node.slice, ast.Constant) else ""
    return value if isinstance(value, str) else ""


def _others(values: set[str], value: str, chance: random.Random) -> list[str]:
    """One of the values that is another; none where there is none."""
    others = sorted(values - {value})
    return [chance.choice(others)] if others else []


def _changes(tree: ast.Module, chance: random.Random) -> Iterator[tuple[ast.AST, Any, str, Any]]:
    """Each node that may be wrong: where it is, what to set, the attribute and its new value."""
    attributes: dict[str, set[str]] = {}
    keys: set[str] = set()
    for node in _code(tree):
        if isinstance(node, ast.Attribute):
            attributes.setdefault(ast.unparse(node.value), set()).add(node.attr)
        if isinstance(node, ast.Subscript) and _key(node):
            keys.add(_key(node))
    for scope in ast.walk(tree):
        if not isinstance(scope, ast.FunctionDef):
            continue
        arguments = scope.args.posonlyargs + scope.args.args + scope.args.kwonlyargs
        local = {a.arg for a in arguments} - {"self", "cls"}
        inside = [node for node in _code(scope) if isinstance(node, ast.Name)]
        local |= {node.id for node in inside if isinstance(node.ctx, ast.Store)}
        for node in inside:
            if isinstance(node.ctx, ast.Load) and node.id in local:
                for name in _others(local, node.id, chance):
                    yield node, node, "id", name
    for node in _code(tree):
        if isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in _BINARY:
            yield node, node, "op", _BINARY[type(node.op)]()
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            yield node, node, "op", ast.UAdd()
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            yield node, node, "operand", ast.UnaryOp(ast.Not(), node.operand)
        elif isinstance(node, ast.BoolOp):
            yield node, node, "op", ast.Or() if isinstance(node.op, ast.And) else ast.And()
        elif isinstance(node, ast.Compare):
            for other in _COMPARED[type(node.ops[0])]:
                yield node, node, "ops", [other(), *node.ops[1:]]
        elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
            yield node, node, "value", not node.value
        elif isinstance(node, ast.Constant) and isinstance(node.value, int):
            yield node, node, "value", node.value + 1
        elif isinstance(node, ast.Constant) and isinstance(node.value, float):
            yield node, node, "value", 10.0 * node.value or 1.0
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
            for name in _others(attributes[ast.unparse(node.value)], node.attr, chance):
                yield node, node, "attr", name
        elif isinstance(node, ast.Subscript) and _key(node):
            for name in _others(keys, _key(node), chance):
                yield node, node.slice, "value", name


def mutants(source: str, count: int, seed: str) -> list[Mutant]:
    """At most ``count`` mutants of a module, picked by the seed, in the order of their lines."""
    tree, chance = ast.parse(source), random.Random(seed)
    changes = list(_changes(tree, chance))
    picked = []
    for node, holder, name, value in chance.sample(changes, len(changes)):
        if len(picked) == count:
            break
        before, old = ast.unparse(node), getattr(holder, name)
        setattr(holder, name, value)
        try:
            changed = ast.unparse(tree)
            compile(changed, "mutant", "exec")
        except (SyntaxError, ValueError):  # an f-string that cannot hold it
            continue
        else:
            picked.append(Mutant(getattr(node, "lineno", 0), before, ast.unparse(node), changed))
        finally:
            setattr(holder, name, old)
    return sorted(picked, key=lambda mutant: mutant.line)


def drawn(count: int, seed: int, root: Path = ROOT) -> dict[str, int]:
    """Draw ``count`` mutants; return how many of them each module gets.

    Modules are drawn in proportion to the number of their possible changes.
    """
    names = modules_of(root)
    sources = [(root / "kneexo" / f"{name}.py").read_text(encoding="utf-8") for name in names]
    sizes = [sum(1 for _ in _changes(ast.parse(s), random.Random(0))) for s in sources]
    return dict(sorted(Counter(random.Random(seed).choices(names, sizes, k=count)).items()))


# -------------------------------------------------------------------------------- the tests


def mirrored(module: str, root: Path = ROOT) -> list[str]:
    """Paths of the tests of a module such as ``analysis/tracking``, from the root of the tree."""
    folder, _, name = module.rpartition("/")
    names = TESTS.get(module, (f"{folder}/test_{name}".lstrip("/"),))
    if module.startswith(
        ("parameters/", "studies/", "analysis/frequency_response", "analysis/sine_estimate")
    ):
        names = (*names, "test_defaults")
    paths = [f"tests/{test}.py" for test in names]
    return [path for path in paths if (root / path).exists()]


def modules_of(root: Path = ROOT) -> list[str]:
    """All modules that have code of their own and tests."""
    paths = sorted((root / "kneexo").rglob("*.py"))
    names = [path.relative_to(root / "kneexo").with_suffix("").as_posix() for path in paths]
    return [name for name in names if mirrored(name, root)]


_SERVER = multiprocessing.get_context("forkserver")
_SERVER.set_forkserver_preload(
    ["pytest", "hypothesis", "pydrake.all", "matplotlib.pyplot", "scipy"]
)
"""A server process imports these modules once; each run of pytest is a fork of it.

Importing them again would take most of the time of a run."""


def _pytest(tree: Path, tests: Sequence[str]) -> None:
    """Run pytest in a new process group, and exit with its code."""
    os.setsid()
    os.chdir(tree)
    null = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(null, stream)
    os.environ |= {
        "PYTHONPATH": str(tree),
        "OPENBLAS_NUM_THREADS": "1",
        "KNEEXO_CACHE_DIR": str(tree.parent / "cache"),
    }
    sys.path.insert(0, str(tree))
    options = ["-x", "-q", "-n0", "--no-header", "--tb=no", "-p", "no:cacheprovider"]
    os._exit(pytest.main([*options, *tests]))


def run_tests(tree: Path, tests: Sequence[str], limit_s: float) -> str:
    """Run fast tests in a copy of the tree; return ``passed``, ``failed`` or ``timeout``."""
    process = _SERVER.Process(target=_pytest, args=(tree, tests))
    process.start()
    process.join(limit_s)
    if process.exitcode is not None:
        return "failed" if process.exitcode else "passed"
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)  # with its workers
    process.join()
    return "timeout"


def judge(
    tree: Path, module: str, picked: Sequence[Mutant], *, whole_suite: bool, slack_s: float
) -> list[Mutant]:
    """Put the mutants of a module into the tree, one after another; return the survivors.

    A mutant may take three times as long as the tests do without it, and ``slack_s`` more.
    """
    path, tests = tree / "kneexo" / f"{module}.py", mirrored(module, tree)
    source = path.read_text(encoding="utf-8")
    start = time.monotonic()
    if run_tests(tree, tests, 3600.0) != "passed":
        raise SystemExit(f"{module}: {', '.join(tests)} fails without any mutant")
    limit = 3.0 * (time.monotonic() - start) + slack_s
    survivors = []
    for mutant in picked:
        path.write_text(mutant.source, encoding="utf-8")
        outcome = run_tests(tree, tests, limit)
        if outcome == "passed" and whole_suite:
            outcome = run_tests(tree, ["tests"], 3600.0)
        survivors += [mutant] if outcome == "passed" else []
    path.write_text(source, encoding="utf-8")
    return survivors


def run(
    counts: Mapping[str, int],
    *,
    seed: int,
    whole_suite: bool = False,
    jobs: int = 1,
    slack_s: float = 30.0,
    root: Path = ROOT,
) -> dict[str, tuple[int, list[Mutant]]]:
    """Return the number of killed mutants and the survivors of each module; print them too.

    ``counts``: mutants of each module.
    """
    results = {}
    trees: SimpleQueue[Path] = SimpleQueue()

    def work(module: str, picked: list[Mutant]) -> None:
        tree = trees.get()
        try:
            survivors = judge(tree, module, picked, whole_suite=whole_suite, slack_s=slack_s)
        finally:
            trees.put(tree)
        results[module] = len(picked) - len(survivors), survivors
        summary = f"{module}: {results[module][0]} killed, {len(survivors)} survived"
        print("\n    ".join([summary, *map(str, survivors)]), flush=True)

    with tempfile.TemporaryDirectory(prefix="kneexo-mutation-") as folder:
        hidden = shutil.ignore_patterns(".*", "__pycache__", "results", "build")
        for job in range(jobs):
            shutil.copytree(root, Path(folder) / f"tree {job}", ignore=hidden)
            trees.put(Path(folder) / f"tree {job}")
        with ThreadPoolExecutor(jobs) as pool:
            pending = []
            for module, count in counts.items():
                source = (root / "kneexo" / f"{module}.py").read_text(encoding="utf-8")
                if picked := mutants(source, count, f"{seed} {module}"):
                    pending.append(pool.submit(work, module, picked))
            for future in pending:
                future.result()
    return results


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", help="such as analysis/tracking; all by default")
    parser.add_argument("--count", type=int, default=2, help="mutants for each module")
    parser.add_argument("--random", type=int, metavar="N", help="N mutants of the whole package")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--whole-suite", action="store_true", help="survivors face all fast tests")
    parser.add_argument("--jobs", type=int, default=1, help="mutants at the same time")
    options = parser.parse_args()
    known = modules_of()
    for module in options.modules:
        if module not in known:
            parser.error(f"{module}: no such module with tests; known: {', '.join(known)}")
    counts = dict.fromkeys(options.modules or known, options.count)
    if options.random:
        counts = drawn(options.random, options.seed)
    results = run(counts, seed=options.seed, whole_suite=options.whole_suite, jobs=options.jobs)
    groups = {"studies": "studies and reports", "export": "exports", "": "elsewhere"}
    for folder, label in groups.items():
        chosen = [r for m, r in results.items() if group(m) == folder]
        killed, survived = sum(r[0] for r in chosen), sum(len(r[1]) for r in chosen)
        print(f"{label}: {killed} killed, {survived} survived")


def group(module: str) -> str:
    """Folder by which the summary counts a module: ``studies``, ``export`` or none."""
    folder = module.partition("/")[0]
    return folder if folder in ("studies", "export") else ""


if __name__ == "__main__":
    main()
