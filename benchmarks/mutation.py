"""Change one module at many places with mutmut, and show the changes that its tests do not notice.

    python benchmarks/mutation.py MODULE TEST [TEST ...] [--only FUNCTION]
    python benchmarks/mutation.py kneexo/sweeps/sweep.py tests/sweeps/test_sweep.py

Each mutant is one changed operator, number, text, argument or assignment. mutmut runs for it the
fast tests among ``TEST`` that call the changed function. ``--only`` is a pattern such as
``*step_metrics*``. The mutants live in a copy of the tree. A survivor is a gap in the tests, or a
change that changes nothing. mutmut changes no decorated function and nothing outside of functions.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
CONFIGURATION = """
[tool.mutmut]
source_paths = ["diagramc", "kneexo"]
only_mutate = [{module}]
also_copy = ["benchmarks", "docs", "examples"]
pytest_add_cli_args = ["-n", "0", "-p", "no:cacheprovider"]
pytest_add_cli_args_test_selection = {tests}
"""


def mutmut(tree: Path, *words: str) -> str:
    """Run a command of mutmut in a copy of the tree; return what it prints."""
    command = [sys.executable, "-m", "mutmut", *words]
    done = subprocess.run(command, cwd=tree, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{done.stdout[-2000:]}{done.stderr}")
    return done.stdout


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("module", help="such as kneexo/analysis/tracking/tracking.py")
    parser.add_argument("tests", nargs="+", help="such as tests/analysis/tracking/test_tracking.py")
    parser.add_argument("--only", default="*", help="pattern of the functions to change")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="kneexo-mutation-") as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".*", "__pycache__", "build"))
        module, tests = json.dumps(options.module), json.dumps(options.tests)
        with (tree / "pyproject.toml").open("a", encoding="utf-8") as file:
            file.write(CONFIGURATION.format(module=module, tests=tests))
        mutmut(tree, "run", options.only)
        lines = mutmut(tree, "results", "--all", "true").split("\n")
        outcomes = dict(line.strip().split(": ") for line in lines if line)
        for name, outcome in outcomes.items():
            if outcome not in ("killed", "not checked"):
                print(mutmut(tree, "show", name))
        print(Counter(outcomes.values()))


if __name__ == "__main__":
    main()
