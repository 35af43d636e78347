"""Waiting for other processes, as long as they work: a loaded machine makes nobody fail."""

import os
import time
from contextlib import suppress
from pathlib import Path

IDLE_S = 30.0
"""Time in s without work in any process that this one has started, after which a wait fails."""

LOOK_S = 0.5


def wait_for(condition):
    """The value of a condition as soon as it is true. Raises `TimeoutError` where nobody works."""
    idle_s, looked_s = 0.0, time.monotonic()
    while not (value := condition()):
        time.sleep(0.01)
        if time.monotonic() - looked_s > LOOK_S:
            idle_s += 0.0 if _is_working(os.getpid()) else LOOK_S
            looked_s = time.monotonic()
            if idle_s > IDLE_S:
                raise TimeoutError(f"nothing works for {IDLE_S:g} s")
    return value


def _is_working(ancestor):
    """Whether a thread of a process below another one runs, waits for a core or for a disk."""
    parents = {}
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # a process that has ended
            parents[int(process.name)] = int(_status(process)[1])
    below = {ancestor}
    while more := {child for child, parent in parents.items() if parent in below} - below:
        below |= more
    for child in below - {ancestor}:
        with suppress(OSError):
            if any(_status(thread)[0] in "RD" for thread in Path(f"/proc/{child}/task").iterdir()):
                return True
    return False


def _status(place):
    """State, parent and more of a process or thread, behind its name in parentheses."""
    return (place / "stat").read_text().rpartition(")")[2].split()
