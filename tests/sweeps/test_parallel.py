import math
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given, strategies as st
from waiting import wait_for

from kneexo.errors import ParameterError, WorkerError
from kneexo.simulation.lockstep import ask, needs_runs
from kneexo.sweeps import parallel, parallel_map, process_pool
from kneexo.sweeps.checkpoint import Checkpoint, piece_keys


@pytest.fixture(scope="module")
def pool():
    """Two worker processes, which start with the first work."""
    with process_pool(2) as executor:
        yield executor


def test_results_keep_the_order_of_the_items():
    items = [3.0, 1.0, 2.0]
    assert parallel_map(math.sqrt, items, weight=lambda x: x) == [math.sqrt(x) for x in items]


def test_the_heaviest_item_goes_first():
    seen = []
    parallel_map(seen.append, [1, 3, 2], weight=float)
    assert seen == [3, 2, 1]
    seen.clear()
    with ThreadPoolExecutor(1) as executor:
        parallel_map(seen.append, [1, 3, 2], weight=float, executor=executor)
    assert seen == [3, 2, 1]


def test_a_group_goes_together_behind_heavier_items():
    items, seen = ["b1", "a1", "c9", "b2", "a2", "c1"], []
    options = {"weight": lambda item: item == "c9", "group": lambda item: item[0]}
    with ThreadPoolExecutor(1) as executor:
        parallel_map(seen.append, items, executor=executor, **options)
    parallel_map(seen.append, items, **options)
    assert seen == ["c9", "b1", "b2", "a1", "a2", "c1"] * 2
    assert parallel_map(str.upper, items, **options) == ["B1", "A1", "C9", "B2", "A2", "C1"]


def test_no_items_make_no_results(at_once):
    assert parallel_map(math.sqrt, []) == []
    assert parallel_map(math.sqrt, [], executor=at_once()) == []


def test_processes_give_the_same_as_this_process(pool):
    items = list(range(300))
    assert parallel_map(math.factorial, items, executor=pool) == [math.factorial(n) for n in items]


# A worker imports the module of its function; those of Python take no pytest along.


@pytest.mark.slow
def test_processes_do_not_share_their_cores_with_threads_of_blas(monkeypatch):
    name = "OPENBLAS_NUM_THREADS"
    monkeypatch.delenv(name, raising=False)
    assert parallel_map(os.getenv, [name], workers=2) == ["1"]
    assert name not in os.environ
    monkeypatch.setenv(name, "3")
    assert parallel_map(os.getenv, [name], workers=2) == ["3"]
    assert os.environ[name] == "3"


def test_the_callers_executor_is_used_and_left_running():
    with ThreadPoolExecutor(1) as executor:
        assert parallel_map(math.sqrt, [4.0], executor=executor) == [2.0]
        assert executor.submit(math.sqrt, 9.0).result() == 3.0


# ----------------------------------------------------------------------------------- units


def test_small_pieces_go_together_and_all_are_done(at_once):
    executor = at_once()
    items = [float(n) for n in range(5000)]
    assert parallel_map(math.sqrt, items, executor=executor) == [math.sqrt(x) for x in items]
    assert sum(executor.units) == len(items)
    # 1000 single ones are under way at first; the rest goes in units that double.
    assert executor.units[:1000] == [1] * 1000
    assert len(executor.units) < 2000


def test_pieces_that_take_long_go_one_by_one(monkeypatch, at_once):
    monkeypatch.setattr(parallel, "UNIT_S", 0.0)
    executor = at_once()
    executor._max_workers = 1
    seen = []
    monkeypatch.setattr(threading, "kneexo_seen", seen, raising=False)
    assert parallel_map(note, list(range(50)), executor=executor) == list(range(50))
    assert seen == list(range(50))
    assert executor.units == [1] * 50


def note(item):
    threading.kneexo_seen.append(item)
    return item


@given(
    durations=st.lists(st.sampled_from([0.0, 0.0, 0.0, 1.0]), max_size=200),
    workers=st.integers(1, 5),
)
def test_each_piece_is_computed_once_whatever_fits_into_a_unit(durations, workers, at_once):
    clock = [0.0]
    executor = at_once()
    executor._max_workers = workers
    done = []

    def take(item):
        clock[0] += durations[item]
        done.append(item)
        return -item

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parallel.time, "perf_counter", lambda: clock[0])
        patch.setattr(pickle, "dumps", lambda value: value)  # a local function
        patch.setattr(pickle, "loads", lambda value: value)
        results = parallel_map(take, list(range(len(durations))), executor=executor)
    assert results == [-n for n in range(len(durations))]
    assert sorted(done) == list(range(len(durations)))


class Held(Executor):
    """Keeps what is submitted until it is told to run."""

    def __init__(self, workers):
        self._max_workers = workers
        self.waiting = []
        self.most = 0

    def submit(self, function, *arguments):
        future = Future()
        self.waiting.append((future, function, arguments))
        self.most = max(self.most, len(self.waiting))
        threading.Timer(1e-3, self.run).start()
        return future

    def run(self):
        future, function, arguments = self.waiting.pop(0)
        future.set_result(function(*arguments))


def test_no_worker_is_refused():
    with pytest.raises(ParameterError, match="workers = 0: must be >= 1"):
        parallel_map(abs, [1], workers=0)


def test_no_more_is_submitted_than_the_workers_need():
    executor = Held(workers=3)
    assert parallel_map(abs, list(range(-200, 0)), executor=executor) == list(range(200, 0, -1))
    assert 3 <= executor.most <= 12


# ---------------------------------------------------------------- functions that need runs


def count_requests(requests):
    """Answer each request by itself."""
    BATCHES.append(len(requests))
    yield from requests.items()


BATCHES: list[int] = []


@pytest.fixture
def batches():
    """How many calls went on together, each time."""
    BATCHES.clear()
    return BATCHES


@needs_runs
def square(item):
    """Make as many requests as the last digit says."""
    for _ in range(item % 10):
        ask(count_requests, item)
    return item * item


@needs_runs
def square_below(limit, item):
    if item >= limit:
        raise ValueError(f"{item} is too much")
    return square(item)


def test_calls_go_on_together_with_the_results_of_each_alone(batches, monkeypatch, at_once):
    monkeypatch.setattr(parallel, "LARGEST_LOT", 256)
    items = list(range(700))
    expected = [n * n for n in items]
    assert parallel_map(square, items) == expected
    assert 64 < max(batches) <= 256
    assert parallel_map(square, items, executor=at_once()) == expected


@pytest.mark.slow
def test_processes_go_on_with_calls_together(pool):
    items = list(range(700))
    assert parallel_map(square, items, executor=pool) == [n * n for n in items]


@pytest.mark.parametrize("unit_s", [0.0, 0.5])
def test_units_of_calls_grow_as_others_do(batches, monkeypatch, unit_s, at_once):
    monkeypatch.setattr(parallel, "UNIT_S", unit_s)
    executor = at_once()
    executor._max_workers = 2
    items = list(range(1, 1800, 10))
    assert parallel_map(square, items, executor=executor) == [n * n for n in items]
    # Eight units of eight are under way at first.
    assert executor.units[:8] == [8] * 8
    assert (executor.units[8] == 8) == (unit_s == 0.0)


def test_a_unit_grows_as_far_as_the_time_limit_allows():
    units = parallel._Units(range(10_000), 8)
    sizes = []
    for elapsed_s in (0.001, 0.25, 0.4999, 0.5, 0.05, 2.0, 0.25):
        unit = units.take(10_000)
        sizes.append(len(unit))
        units.give_back([], len(unit), elapsed_s)
    assert sizes == [8, 64, 128, 128, 128, 1024, 1024]
    units.give_back([], 40, 2.0)  # a unit that did not end in time
    assert len(units.take(10_000)) == 40


def test_the_last_units_shrink(batches, monkeypatch, at_once):
    monkeypatch.setattr(parallel.time, "perf_counter", lambda: 0.0)  # all units end in time
    executor = at_once()
    executor._max_workers = 2
    items = list(range(5000))
    assert parallel_map(square, items, executor=executor) == [n * n for n in items]
    sizes = executor.units
    largest = sizes.index(max(sizes))
    assert sizes[largest:-1] == sorted(sizes[largest:-1], reverse=True)
    assert sizes[-2] == parallel._LAST_UNIT


def test_few_calls_are_shared_by_all_workers(batches, at_once):
    executor = at_once()
    executor._max_workers = 8
    parallel_map(square, list(range(27)), executor=executor)
    assert executor.units == [1] * 27


def test_results_before_an_error_are_stored(tmp_path, batches, at_once):
    path = tmp_path / "checkpoint.jsonl"
    items = list(range(40))
    with pytest.raises(ValueError, match="33 is too much"):
        parallel_map(partial(square_below, 33), items, checkpoint=Checkpoint(path))
    keys = piece_keys(partial(square_below, 33), items)
    stored = Checkpoint(path)
    assert [key in stored for key in keys] == [True] * 33 + [False] * 7
    with pytest.raises(ValueError, match="33 is too much"):
        parallel_map(partial(square_below, 33), items, executor=at_once(), checkpoint=stored)


def test_stored_results_are_not_computed_again(tmp_path, batches):
    path = tmp_path / "checkpoint.jsonl"
    items = list(range(40))
    parallel_map(square, items[10:20], checkpoint=Checkpoint(path))
    batches.clear()
    results = parallel_map(square, items, checkpoint=Checkpoint(path))
    assert results == [n * n for n in items]
    assert sum(batches) == 3 * 45  # 0 + 1 + … + 9 for each ten but one


# -------------------------------------------------------------------------- errors, deaths


@pytest.mark.parametrize("processes", [False, True])
def test_an_error_in_the_work_is_raised(processes, pool):
    with pytest.raises(ValueError, match=r"math domain|nonnegative"):
        parallel_map(math.sqrt, [1.0, -1.0], workers=1, executor=pool if processes else None)


def test_an_error_ends_what_has_not_begun():
    begun = []

    def work(item):
        begun.append(item)
        time.sleep(0.02)
        raise ValueError(f"no {item}")

    with ThreadPoolExecutor(1) as executor, pytest.raises(ValueError, match="no 0"):
        parallel_map(work, list(range(100)), executor=executor)
    assert len(begun) <= 3


def square_or_die(item):
    if item == 30 and (path := os.environ.get("KNEEXO_TEST_CHECKPOINT")):
        wait_for(lambda: Path(path).read_bytes().count(b"\n") > 1)  # results of others are kept
        os.kill(os.getpid(), signal.SIGKILL)
    return item * item


@pytest.mark.slow
def test_results_before_the_death_of_a_worker_are_stored(tmp_path, monkeypatch):
    path = tmp_path / "checkpoint.jsonl"
    items = list(range(40))
    monkeypatch.setenv("KNEEXO_TEST_CHECKPOINT", str(path))
    with pytest.raises(WorkerError, match="a worker process died") as caught:
        parallel_map(square_or_die, items, workers=2, checkpoint=Checkpoint(path))
    assert "\n" not in str(caught.value)
    assert "use fewer workers" in str(caught.value)
    assert 'below if __name__ == "__main__":' in str(caught.value)
    stored = Checkpoint(path)
    assert 1 <= len(stored) < len(items)
    monkeypatch.delenv("KNEEXO_TEST_CHECKPOINT")
    results = parallel_map(square_or_die, items, checkpoint=stored)
    assert results == [n * n for n in items]


@pytest.mark.parametrize("most", [0, 1, 7])
def test_an_executor_that_breaks_is_one_line_and_resumes(tmp_path, most, at_once):
    path = tmp_path / "checkpoint.jsonl"
    items = list(range(30))
    executor = at_once(most)
    executor._max_workers = 1
    with pytest.raises(WorkerError) as caught:
        parallel_map(abs, items, executor=executor, checkpoint=Checkpoint(path))
    assert "\n" not in str(caught.value)
    stored = Checkpoint(path)
    assert len(stored) == max(most - 3, 0)  # the results of three units were not yet taken
    assert parallel_map(abs, items, executor=at_once(), checkpoint=stored) == items


def test_an_executor_that_cancels_the_work_is_one_line():
    class Cancelling(Executor):
        def submit(self, function, *arguments):
            future = Future()
            future.cancel()
            return future

    with pytest.raises(WorkerError) as caught:
        parallel_map(abs, [1, 2], executor=Cancelling())
    assert "\n" not in str(caught.value)


ORPHANS = """
import sys
from pathlib import Path
from concurrent.futures import wait
from kneexo.sweeps.parallel import process_pool
from tests_of_parallel import note_and_wait
if __name__ == "__main__":
    with process_pool(2) as pool:
        wait([pool.submit(note_and_wait, sys.argv[1]) for _ in range(2)])
"""
NOTE_AND_WAIT = """
import os, time
from pathlib import Path
def note_and_wait(folder):
    Path(folder, str(os.getpid())).touch()
    time.sleep(600)
"""


def is_alive(process):
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(") ")[2][0] != "Z"
    except OSError:
        return False


@pytest.mark.slow
def test_workers_die_with_their_parent(tmp_path):
    (tmp_path / "tests_of_parallel.py").write_text(NOTE_AND_WAIT)
    (tmp_path / "orphans.py").write_text(ORPHANS)
    notes = tmp_path / "notes"
    notes.mkdir()
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "orphans.py"), str(notes)], stderr=subprocess.DEVNULL
    ) as parent:
        wait_for(lambda: len(list(notes.iterdir())) == 2)
        parent.kill()
    workers = [int(file.name) for file in notes.iterdir()]
    try:
        wait_for(lambda: not any(map(is_alive, workers)))
    finally:
        for worker in filter(is_alive, workers):
            os.kill(worker, signal.SIGKILL)


def test_workers_leave_an_interrupt_to_the_parent(pool):
    held_back = partial(signal.pthread_sigmask, signal.SIG_BLOCK)
    assert all(signal.SIGINT in held for held in parallel_map(held_back, [()] * 3, executor=pool))
    assert signal.SIGINT not in held_back(())


def test_one_core_needs_no_pool_where_the_scheduler_says_nothing(monkeypatch):
    """As on macOS and Windows, which have no ``os.sched_getaffinity``."""
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    with process_pool(None) as pool:
        assert pool is None
