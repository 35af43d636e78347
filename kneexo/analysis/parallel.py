"""Run independent pieces of work in processes, with a progress bar; Ctrl-C stops at once."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from typing import TypeVar

from tqdm import tqdm

from kneexo.analysis.checkpoint import Checkpoint, piece_key
from kneexo.errors import WorkerError

Item = TypeVar("Item")
Result = TypeVar("Result")


@contextmanager
def process_pool(workers: int | None) -> Iterator[Executor | None]:
    """An executor of spawned processes, which die at once when the body fails or is interrupted.

    ``workers``: their number, None for all cores of this process; with 1 there is none, and
    `parallel_map` works in this process. Raises `WorkerError` when a process dies.
    """
    count = len(os.sched_getaffinity(0)) if workers is None else workers
    if count == 1:
        yield None
        return
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"))
    try:
        yield pool
    except BaseException as error:  # KeyboardInterrupt too: nothing may go on working
        for process in list((pool._processes or {}).values()):
            process.terminate()
        if isinstance(error, BrokenExecutor):
            raise WorkerError(
                f"one of {count} worker processes died (out of memory?); use fewer workers"
            ) from None
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _interrupt_later() -> Iterator[None]:
    """Hold Ctrl-C back. Processes that start meanwhile inherit that: only this one answers it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def parallel_map(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    workers: int | None = 1,
    executor: Executor | None = None,
    description: str | None = None,
    weight: Callable[[Item], float] = lambda item: 1.0,
    checkpoint: Checkpoint | None = None,
) -> list[Result]:
    """``[function(item) for item in items]``, the heaviest items first.

    ``workers``: see `process_pool`; with more than one a script needs
    ``if __name__ == "__main__":``, because processes are spawned. An ``executor`` of the caller's
    goes before ``workers``. ``description`` shows a progress bar that advances by
    ``weight(item)``. The first error ends the work and is raised; so does KeyboardInterrupt.

    With a ``checkpoint`` every result is kept there as soon as it is known, and what it has
    already is not computed again; ``function`` then returns plain JSON data.
    """
    if executor is None and workers != 1:
        with process_pool(workers) as pool:
            return parallel_map(
                function,
                items,
                executor=pool,
                description=description,
                weight=weight,
                checkpoint=checkpoint,
            )
    keys = [] if checkpoint is None else [piece_key(function, item) for item in items]
    results: dict[int, Result] = {}

    def done(index: int, result: Result) -> None:
        results[index] = result if checkpoint is None else checkpoint.keep(keys[index], result)
        bar.update(weight(items[index]))

    with tqdm(
        total=round(sum(weight(item) for item in items), 6),
        desc=description,
        disable=description is None,
        mininterval=0.5,
        bar_format="{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}",
    ) as bar:
        if checkpoint is not None:
            for index in (n for n, key in enumerate(keys) if key in checkpoint):
                results[index] = checkpoint[keys[index]]
                bar.update(weight(items[index]))
        order = sorted(set(range(len(items))) - set(results), key=lambda n: (-weight(items[n]), n))
        if executor is None:
            for index in order:
                done(index, function(items[index]))
        else:
            with _interrupt_later():
                futures = {executor.submit(function, items[index]): index for index in order}
            try:
                for future in as_completed(futures):
                    done(futures[future], future.result())
            except BaseException:  # KeyboardInterrupt too; raised again
                for future in futures:
                    future.cancel()
                raise
    return [results[index] for index in range(len(items))]
