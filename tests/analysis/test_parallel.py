import math
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from kneexo.analysis import parallel_map


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


def test_an_interrupt_ends_the_processes_at_once():
    code = (
        "import time\n"
        "from kneexo.analysis import parallel_map\n"
        "if __name__ == '__main__':\n"
        "    print('ready', flush=True)\n"
        "    parallel_map(time.sleep, [60.0, 60.0], workers=2)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stdout.readline() == b"ready\n"
    time.sleep(2.0)
    started = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)
    process.communicate(timeout=30)
    assert process.returncode != 0
    assert time.monotonic() - started < 10.0
