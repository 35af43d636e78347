"""Monte Carlo over uncertain plants: 30 s of closed loop each, on all cores of this machine.

``python benchmarks/monte_carlo.py [runs ...]`` (1000 and 10000 by default; ``--workers N``,
``--mixed-runs N``). Each line is a run of Python of its own, so that peak memory is its own; its
wall time has all in it: start of the processes, samples, runs, metrics. The equations are compiled
before.

*unloaded*: the default scenario, whose knee carries nothing, with the values of the default
uncertainty set that it has. *reduced*: that set, whose knee carries the shank, without the choice
of the cylinder's order; 9 structures.
*mixed*: the whole set, two thirds of it in full order with make-up valves and seal friction, where
the exact hold takes many more steps, or RK4 at 20 µs its place; 27 structures.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from functools import partial

import numpy as np

from diagramc.native.cores import available_cores
from kneexo.parameters import UNCERTAIN_KNEE, UNCERTAINTY, Scenario, UncertaintySet
from kneexo.parameters.uncertainty import draw, options_of
from kneexo.studies.assessment import assess
from kneexo.studies.robustness import assess_plant
from kneexo.sweeps import parallel_map

REDUCED = {path: one for path, one in UNCERTAINTY.values.items() if path != "plant.full_order"}
UNLOADED = {path: one for path, one in REDUCED.items() if not path.startswith("plant.load")}
SETS = {
    "unloaded": (Scenario(), UncertaintySet(values=UNLOADED)),
    "reduced": (UNCERTAIN_KNEE, UncertaintySet(values=REDUCED)),
    "mixed": (UNCERTAIN_KNEE, UNCERTAINTY),
}
SEED = 2020


def measure(which: str, runs: int, workers: int) -> dict[str, float]:
    """Assess random plants; return time, memory and a summary of the errors."""
    start = time.perf_counter()
    scenario, uncertainty = SETS[which]
    judge = partial(assess_plant, scenario, uncertainty, partial(assess, margins=False))
    samples = draw(uncertainty, runs, SEED)
    assessments = parallel_map(judge, samples, workers=workers, group=options_of)
    wall = time.perf_counter() - start
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    errors = np.array([metrics["max_error_deg"] for metrics in assessments])
    return {
        "wall_s": wall,
        "cpu_s": sum(one.ru_utime + one.ru_stime for one in usage),
        "parent_mb": usage[0].ru_maxrss / 1024.0,
        "worker_mb": usage[1].ru_maxrss / 1024.0,
        "failed": int(np.isnan(errors).sum()),
        "median_deg": float(np.nanmedian(errors)),
        "worst_deg": float(np.nanmax(errors)),
    }


def measured(which: str, runs: int, workers: int) -> dict[str, float]:
    """Return the result of `measure` from a process of its own."""
    command = [sys.executable, __file__, "--one", which, str(runs), str(workers)]
    return json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)


def row(which: str, runs: int, workers: int) -> float:
    """Measure and print a line; return the wall time in s."""
    cost = measured(which, runs, workers)
    wall = cost["wall_s"]
    print(
        f"{which:8s} {runs:6d} {workers:8d} {wall:8.1f} {1e3 * wall * workers / runs:12.2f} "
        f"{1e3 * cost['cpu_s'] / runs:11.2f} {cost['parent_mb']:10.0f} "
        + (f"{cost['worker_mb']:10.0f}" if workers > 1 else f"{'':10s}")
        + f" {cost['failed']:7d} {cost['median_deg']:8.3f} {cost['worst_deg']:8.3f}",
        flush=True,
    )
    return wall


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="*", type=int, default=[1000, 10000])
    parser.add_argument("--workers", type=int, default=available_cores())
    parser.add_argument("--mixed-runs", type=int, default=500, help="0 leaves the mixed set out")
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        which, runs, workers = options.one
        print(json.dumps(measure(which, int(runs), int(workers))))
        return
    jobs = dict.fromkeys(("unloaded", "reduced"), options.runs)
    jobs["mixed"] = [options.mixed_runs] if options.mixed_runs else []
    for which, counts in jobs.items():
        if counts:
            measured(which, 100, 1)  # compiles what no earlier run has left in the cache
    print(
        "set        runs  workers   wall s  ms/run/core  CPU ms/run  parent MB  worker MB  failed"
        "  median°   worst°"
    )
    for which, counts in jobs.items():
        for runs in counts:
            alone = row(which, runs, 1)
            if options.workers > 1:
                together = row(which, runs, options.workers)
                print(f"{'':8s} scaling from 1 to {options.workers}: {alone / together:.2f}")


if __name__ == "__main__":
    main()
