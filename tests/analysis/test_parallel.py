import math
import os
import signal
from concurrent.futures import ThreadPoolExecutor

import pytest

from kneexo.analysis import parallel_map
from kneexo.errors import WorkerError


def test_results_keep_the_order_of_the_items():
    items = [3.0, 1.0, 2.0]
    assert parallel_map(math.sqrt, items, weight=lambda x: x) == [math.sqrt(x) for x in items]


def test_the_heaviest_item_goes_first():
    seen = []
    parallel_map(seen.append, [1, 3, 2], weight=float)
    assert seen == [3, 2, 1]


def test_no_items_make_no_results():
    assert parallel_map(math.sqrt, []) == []


def test_processes_give_the_same_as_this_process():
    items = list(range(7))
    assert parallel_map(math.factorial, items, workers=2) == [math.factorial(n) for n in items]


def test_the_callers_executor_is_used_and_left_running():
    with ThreadPoolExecutor(1) as executor:
        assert parallel_map(math.sqrt, [4.0], executor=executor) == [2.0]
        assert executor.submit(math.sqrt, 9.0).result() == 3.0


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_in_the_work_is_raised(workers):
    with pytest.raises(ValueError, match=r"math domain|nonnegative"):
        parallel_map(math.sqrt, [1.0, -1.0], workers=workers)


def die(_):
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_worker_that_dies_is_one_line():
    with pytest.raises(WorkerError, match="one of 2 worker processes died") as caught:
        parallel_map(die, [1, 2], workers=2)
    assert "\n" not in str(caught.value)


def interrupt_is_held_back(_):
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, set())


def test_workers_leave_an_interrupt_to_the_parent():
    assert parallel_map(interrupt_is_held_back, [1, 2, 3], workers=2) == [True, True, True]
    assert not interrupt_is_held_back(None)
