"""Compare the processor time of the studies in two trees, in alternation.

    python benchmarks/studies.py OLD NEW [--only NAME ...] [--repeats N] [--workers N]

``OLD`` and ``NEW`` are checkouts of kneexo. Each study runs with reduced settings, and with the
numbers of plants that decide its cost. A row has the smallest processor time of the repeats in each
tree, with all worker processes, their ratio, and the memory of the largest process. Run it once
before, so that both trees find their machine code in the cache.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

STUDIES = {
    "contest": ("generations=12", "optimizer_seeds=[1]", "test_samples=4"),
    "robustness": ("samples=60", "corners_max=60"),
}


def cost(tree: Path, study: str, workers: int) -> tuple[float, float]:
    """Run a study of a tree; return its processor time in s and its memory in MiB."""
    settings = [word for value in STUDIES[study] for word in ("--set", value)]
    with tempfile.TemporaryDirectory() as folder:
        words = ["study", study, *settings, "--workers", str(workers), "--out", folder]
        process = subprocess.Popen(
            [sys.executable, "-m", "kneexo", *words],
            env=os.environ | {"PYTHONPATH": str(tree.resolve())},
            stdout=subprocess.DEVNULL,
            cwd=folder,
        )
        _, status, usage = os.wait4(process.pid, 0)  # with the processes that it has waited for
    if status:
        raise SystemExit(f"{tree}: study {study} fails")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024.0


def main() -> None:
    """Run the studies and print a row for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("trees", nargs=2, type=Path, metavar="TREE")
    parser.add_argument("--only", nargs="*", choices=STUDIES, default=list(STUDIES))
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    for study in options.only:
        rounds = [
            [cost(tree, study, options.workers) for tree in options.trees]
            for _ in range(options.repeats)
        ]
        (old_s, old_mib), (new_s, new_mib) = (min(costs) for costs in zip(*rounds, strict=True))
        print(
            f"{study}: {old_s:.1f} s -> {new_s:.1f} s ({old_s / new_s:.2f} times as fast), "
            f"{old_mib:.0f} MiB -> {new_mib:.0f} MiB",
            flush=True,
        )


if __name__ == "__main__":
    main()
