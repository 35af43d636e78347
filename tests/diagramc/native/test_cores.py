import os
from concurrent.futures import ThreadPoolExecutor

import pytest

from diagramc.native.cores import available_cores


def test_cores_are_not_those_of_another_process():
    def on_one_core():
        os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])  # this thread alone
        return available_cores()

    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(on_one_core).result() == 1


@pytest.mark.parametrize(("count", "cores"), [(5, 5), (None, 1)])
def test_cores_without_affinity_are_those_of_the_machine(monkeypatch, count, cores):
    """As on macOS."""
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: count)
    assert available_cores() == cores
