"""CPU time of the exported closed loop, compared with the C that is written by hand.

``python benchmarks/exported_speed.py`` compiles both with the same flags, for each compiler of the
machine, and lets them take turns. The table has the shortest of the CPU times of 30 s, with and
without the weight of the leg. The program ends with 1 if a ratio exceeds `LIMIT`.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from exported import Replay, exported_source
from hand_written import c_library, parameters_of, run_c

from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed

LIMIT = 1.1
TOLERANCE = 1e-9
"""Largest difference of a signal, divided by its largest magnitude."""
STEP_S = 2e-4
OUTPUTS = ("rod_extension", "load_pressure")
CASES = {
    "without load": Scenario(),
    "with the weight": changed(Scenario(), {"plant.load": {"kind": "knee"}}),
}
COMMANDS = ("gcc -O2", "gcc -O3 -march=native", "clang -O2", "clang -O3 -march=native")


@dataclass(frozen=True)
class Row:
    """CPU times in s of one case, compiled by one command, and the difference of the results."""

    case: str
    command: str
    by_hand_s: float
    exported_s: float
    difference: float

    @property
    def met(self) -> bool:
        """Whether the exported code is fast enough and right."""
        return self.exported_s <= LIMIT * self.by_hand_s and self.difference <= TOLERANCE

    def __str__(self) -> str:
        """The row of the table."""
        times = f"{1e3 * self.by_hand_s:.2f} | {1e3 * self.exported_s:.2f}"
        ratio = f"{self.exported_s / self.by_hand_s:.2f}"
        return f"{self.case} | {self.command} | {times} | {ratio} | {self.difference:.1g}"


def shortest_times(functions: list[Callable[[], Any]], turns: int) -> list[float]:
    """The shortest time in s of each function, called in turns.

    It is wall time: some kernels count processor time in steps of milliseconds, and return zero.
    """
    times = np.full((turns, len(functions)), np.inf)
    for turn in times:
        for place, function in enumerate(functions):
            start = time.perf_counter_ns()
            function()
            turn[place] = 1e-9 * (time.perf_counter_ns() - start)
    return [float(shortest) for shortest in times.min(axis=0)]


def rows(duration_s: float, turns: int) -> Iterator[Row]:
    """Measure each case with each compiler of the machine."""
    for case, scenario in CASES.items():
        parameters = parameters_of(scenario)
        samples = round(duration_s / parameters.sample_time_s)
        _, source = exported_source(scenario, "loop", outputs=OUTPUTS, step_s=STEP_S)
        inputs = np.zeros((samples, len(source.plan.inputs)))
        for command in COMMANDS:
            name, *flags = *command.split(), "-ffp-contract=off"
            compiler = shutil.which(name)
            if compiler is None:
                continue
            options = {
                "pid": False,
                "loaded": scenario.plant.load.kind == "knee",
                "steps": source.plan.schedule.steps,
                "samples": samples,
                "library": c_library(compiler, tuple(flags)),
            }
            replay = Replay(source, flags=flags, compiler=compiler)
            by_hand = partial(run_c, parameters, **options)
            exported = partial(replay.from_start, inputs)
            difference = np.abs(exported() - by_hand()).max(axis=0) / np.abs(by_hand()).max(axis=0)
            yield Row(case, command, *shortest_times([by_hand, exported], turns), difference.max())


def main(arguments: list[str] | None = None) -> int:
    """Print the table; return 1 if a row misses its limit or there is no compiler."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=30.0, help="simulated s (default 30)")
    parser.add_argument("--turns", type=int, default=20, help="runs of each program (default 20)")
    options = parser.parse_args(arguments)
    print("case | compiler | by hand (ms) | exported (ms) | ratio | difference")
    verdicts = []
    for row in rows(options.duration, options.turns):
        print(row, flush=True)
        verdicts.append(row.met)
    return 0 if verdicts and all(verdicts) else 1


if __name__ == "__main__":
    sys.exit(main())
