import os

import pytest

from kneexo.compilation.cores import available_cores
from kneexo.compilation.model import _in_threads
from kneexo.sweeps.parallel import process_pool


def test_cores_are_those_of_this_process():
    assert available_cores() == len(os.sched_getaffinity(0))


@pytest.mark.parametrize(("count", "cores"), [(5, 5), (None, 1)])
def test_cores_without_affinity_are_those_of_the_machine(monkeypatch, count, cores):
    """As on macOS."""
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: count)
    assert available_cores() == cores


def test_threads_and_processes_need_no_affinity(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    assert list(_in_threads(sum, [[1, 2], [3]], None)) == [3, 3]
    with process_pool(None) as pool:
        assert pool is None
