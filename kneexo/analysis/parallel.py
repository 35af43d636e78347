"""Run independent pieces of work in processes, with a progress bar; Ctrl-C stops at once."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from typing import Any, TypeVar

from tqdm import tqdm

Item = TypeVar("Item")
Result = TypeVar("Result")


def parallel_map(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    workers: int | None = 1,
    executor: Executor | None = None,
    description: str | None = None,
    weight: Callable[[Item], float] = lambda item: 1.0,
) -> list[Result]:
    """``[function(item) for item in items]``, the heaviest items first.

    ``workers``: processes; 1 works in this process, None takes all cores. Processes are spawned,
    so with more than one a script needs ``if __name__ == "__main__":``. An ``executor`` of the
    caller's goes before ``workers``. ``description`` shows a progress bar that advances by
    ``weight(item)``. The first error ends the work and is raised; so does KeyboardInterrupt.
    """
    workers = os.cpu_count() or 1 if workers is None else workers
    order = sorted(range(len(items)), key=lambda index: -weight(items[index]))
    results: dict[int, Result] = {}
    with tqdm(
        total=round(sum(weight(item) for item in items), 6),
        desc=description,
        disable=description is None,
        mininterval=0.5,
        bar_format="{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}",
    ) as bar:
        if executor is None and workers == 1:
            for index in order:
                results[index] = function(items[index])
                bar.update(weight(items[index]))
            return [results[index] for index in range(len(items))]
        pool: Any = executor or ProcessPoolExecutor(
            workers, multiprocessing.get_context("spawn"), initializer=_die_on_interrupt
        )
        futures = {pool.submit(function, items[index]): index for index in order}
        try:
            for future in as_completed(futures):
                index = futures[future]
                results[index] = future.result()
                bar.update(weight(items[index]))
        except BaseException:
            for future in futures:
                future.cancel()
            if executor is None:
                for process in list(pool._processes.values()):
                    process.terminate()
            raise
        finally:
            if executor is None:
                pool.shutdown(cancel_futures=True)
    return [results[index] for index in range(len(items))]


def _die_on_interrupt() -> None:
    """Let Ctrl-C end a worker at once, without a traceback of its own."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
