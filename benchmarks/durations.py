"""Prints the duration of each study, and of the stages of its progress bar.

``python benchmarks/durations.py`` for all studies, or with the names of some. Other arguments go to
the commands: with ``--workers 1`` all CPU time is that of this process. The durations of the
catalogue (`kneexo.studies.catalogue`) are wall times on two cores that do nothing else.
"""

from __future__ import annotations

import argparse
import io
import resource
import tempfile
import time
from contextlib import redirect_stdout
from itertools import pairwise
from pathlib import Path
from typing import Any

from kneexo import progress
from kneexo.command_line.main import main
from kneexo.studies.catalogue import STUDIES


def cpu_s() -> float:
    """CPU time in s of this process and of its ended child processes."""
    usages = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


class Recorder:
    """Stands in for the bar of a whole command, and notes when each of its parts begins."""

    def __init__(self) -> None:
        self.begun: list[tuple[str, float, float]] = []
        self.note("start")

    def note(self, name: str) -> None:
        """Note that a part begins."""
        self.begun.append((name, time.perf_counter(), cpu_s()))

    def part(self, total: float, name: str) -> Any:
        """Note the begin of a part; return a bar that shows nothing."""
        self.note(name)
        return progress._Part(self, total, 0.0, 0.0)  # type: ignore[arg-type]  # same methods

    def advance_to(self, position_s: float) -> None:
        """Show nothing."""


def measure(command: list[str]) -> None:
    """Run a command and print its durations."""
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(io.StringIO()):
        recorder = Recorder()
        progress._whole = recorder  # type: ignore[assignment]  # it has the bar's methods only
        assert main([*command, "--out", str(Path(folder) / "out")]) == 0
        progress._whole = None
        recorder.note("end")
    spent = {"all": (0.0, 0.0)}
    for (name, wall, cpu), (_, wall_end, cpu_end) in pairwise(recorder.begun):
        for key in (name, "all"):
            before = spent.get(key, (0.0, 0.0))
            spent[key] = (before[0] + wall_end - wall, before[1] + cpu_end - cpu)
    print(" ".join(command))
    for name, (wall, cpu) in spent.items():
        print(f"  {wall:8.1f} s, CPU {cpu:8.1f} s  {name}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("studies", nargs="*", default=list(STUDIES), metavar="STUDY")
    options, others = parser.parse_known_args()
    for study in options.studies:
        measure([*STUDIES[study].command.split(), *others])
