"""Run independent pieces of work in processes or on a cluster; Ctrl-C stops at once."""

from __future__ import annotations

import logging
import multiprocessing
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
)
from contextlib import contextmanager
from importlib import import_module
from queue import SimpleQueue
from typing import Any, TypeVar

from kneexo.compiler import available_cores
from kneexo.errors import WorkerError
from kneexo.interruption import interrupt_later
from kneexo.progress import progress_bar
from kneexo.simulation.coroutines import is_synchronous, map_concurrently
from kneexo.sweeps.checkpoint import Checkpoint, piece_keys
from kneexo.version import __version__

Item = TypeVar("Item")
Result = TypeVar("Result")

UNIT_S = 0.5
"""Small pieces go to a worker together, as many as it does in that time."""

CONNECT_S = 10.0
"""How long a Dask scheduler and its workers are waited for."""

LARGEST_LOT = 512
"""Largest number of calls that share batches of runs (`kneexo.simulation.needs_runs`)."""

_BLAS_THREADS = "OPENBLAS_NUM_THREADS"  # read when numpy is imported
_UNITS_PER_WORKER = 4  # under way at a time, so that no worker waits for this process
_FIRST_UNIT = 8  # calls that share batches; as many as a batch has lanes
_WORKERS = 250  # of an executor that does not say how many it has


@contextmanager
def process_pool(
    workers: int | None, executor: Executor | None = None
) -> Iterator[Executor | None]:
    """An executor of spawned processes, which die at once when the body fails or is interrupted.

    ``workers``: their number, None for all cores of this process; with 1 there is none, and
    `parallel_map` works in this process. An ``executor`` of the caller's replaces them.
    """
    if executor is not None:
        yield executor
        return
    count = available_cores() if workers is None else workers
    if count == 1:
        yield None
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(count, context, initializer=_end_with_parent)
    try:
        with _single_threaded_blas():
            yield pool
    except BaseException:  # KeyboardInterrupt too: nothing may go on working
        for process in list((pool._processes or {}).values()):
            process.kill()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _single_threaded_blas() -> Iterator[None]:
    """Processes that start meanwhile leave the other cores to each other.

    The matrices are so small that threads of OpenBLAS only wait for each other: on busy cores a
    least-squares fit of a cycle takes 13 ms with two of them, 0.2 ms with one.
    """
    before = os.environ.get(_BLAS_THREADS)
    os.environ[_BLAS_THREADS] = before or "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(_BLAS_THREADS, None)


@contextmanager
def dask_cluster(address: str) -> Iterator[Executor]:
    """An executor of the workers of a running Dask cluster, such as ``tcp://host:8786``.

    What a lost worker had is done again by the others; where all are lost, Dask waits for new
    ones. Raises `WorkerError` when the package ``distributed`` is missing, when within 10 s there
    is no scheduler at ``address`` or no worker, when a worker has another version of kneexo, when
    a piece of work kills one worker after another, and when the scheduler is lost.
    """
    try:
        distributed: Any = import_module("distributed")
    except ModuleNotFoundError:
        raise WorkerError(
            "a Dask cluster needs the package distributed: pip install 'kneexo[cluster]'"
        ) from None
    for name in ("distributed.client", "tornado.application"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what ends the work is raised
    try:
        distributed.comm.get_address_host_port(address, strict=True)
    except ValueError:
        raise WorkerError(f"Dask scheduler {address!r}: must be tcp://HOST:PORT") from None
    try:
        client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except OSError:
        raise WorkerError(
            f"there is no Dask scheduler at {address} (tried for {CONNECT_S:g} s)"
        ) from None
    try:
        _require_this_version(client, address)
        executor = client.get_executor(pure=False)
        executor._max_workers = sum(client.nthreads().values())
        yield executor
    except distributed.KilledWorker:
        raise WorkerError(
            f"a piece of work killed one worker after another of the Dask cluster {address} (out "
            f"of memory?)"
        ) from None
    except Exception:  # a lost scheduler shows in whatever was under way
        if client.status != "running":
            raise WorkerError(f"the Dask scheduler {address} was lost") from None
        raise
    finally:
        client.close()


def _require_this_version(client: Any, address: str) -> None:
    """Refuse workers that would compute something else, and a cluster without any."""

    def version() -> str:  # travels as code, because a worker may have no kneexo
        from kneexo.version import __version__

        return __version__

    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
    except TimeoutError:
        raise WorkerError(
            f"the Dask cluster {address} has no workers (waited for {CONNECT_S:g} s)"
        ) from None
    for worker, answer in client.run(version, on_error="return").items():
        if answer != __version__:
            has = f"kneexo {answer}" if isinstance(answer, str) else f"no kneexo ({answer})"
            raise WorkerError(
                f"the Dask worker {worker} has {has}: must have kneexo {__version__}, as this "
                f"process has"
            )


def _end_with_parent() -> None:
    """Make this worker process die as soon as its parent has died, however that came."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


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
    goes before ``workers``; any of the kind of ``concurrent.futures`` will do, such as
    `dask_cluster`'s. Small items go there together (`UNIT_S`). Calls of a function that
    `needs_runs` share batches of runs, with the same results as alone. ``description`` shows a
    progress bar that advances by ``weight(item)``. The first error ends the work and is raised;
    so does KeyboardInterrupt.

    With a ``checkpoint`` every result is kept there as soon as it is known, and what it has
    already is not computed again; ``function`` then returns plain JSON data.

    Raises `WorkerError` when a worker process dies.
    """
    keys = [] if checkpoint is None else piece_keys(function, items)
    results: dict[int, Result] = {}

    def keep(index: int, result: Result) -> None:
        results[index] = result if checkpoint is None else checkpoint.keep(keys[index], result)
        advance(index)

    def advance(index: int) -> None:
        bar.update(min(weight(items[index]), whole - bar.n))  # rounding must not pass the end

    whole = round(sum(weight(item) for item in items), 6)
    with (
        process_pool(workers, executor) as pool,
        progress_bar(whole, description) as bar,
    ):
        if checkpoint is not None:
            for index in (n for n, key in enumerate(keys) if key in checkpoint):
                results[index] = checkpoint[keys[index]]
                advance(index)
        order = sorted(set(range(len(items))) - set(results), key=lambda n: (-weight(items[n]), n))
        if pool is not None:
            _by_executor(function, items, order, pool, keep)
        elif is_synchronous(function):
            units = _Units(order, _first_unit(function, len(order), 1))
            while unit := units.take(LARGEST_LOT):
                end = time.perf_counter() + UNIT_S
                batch = [items[index] for index in unit]
                for position, result in map_concurrently(function, batch):
                    keep(unit[position], result)
                units.give_back([], len(unit), time.perf_counter() < end)
        else:
            for index in order:
                keep(index, function(items[index]))
    return [results[index] for index in range(len(items))]


class _Units:
    """Indices in units that grow until one runs out of time; what it leaves waits again."""

    def __init__(self, order: Iterable[int], size: int) -> None:
        self._waiting = deque(order)
        self._size = size

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def take(self, most: int = sys.maxsize) -> list[int]:
        """The next unit, of at most ``most``; empty when nothing waits."""
        size = min(self._size, most, len(self._waiting))
        return [self._waiting.popleft() for _ in range(size)]

    def give_back(self, left: Sequence[int], ended: int, in_time: bool) -> None:
        """What a unit has left, how many of it ended, and whether there was time for more."""
        self._waiting.extendleft(reversed(left))
        self._size = max(self._size, 2 * ended) if in_time else ended


def _first_unit(function: Callable[..., Any], count: int, workers: int) -> int:
    """Items of the first units: several if calls share batches and all workers still get work."""
    if not is_synchronous(function):
        return 1
    return max(1, min(_FIRST_UNIT, count // (_UNITS_PER_WORKER * workers)))


def _unit(function: Callable[[Item], Result], items: Sequence[Item]) -> tuple[list[Result], bool]:
    """Results of the first of ``items``, those begun within `UNIT_S`, and whether time is left."""
    end = time.perf_counter() + UNIT_S
    lot = LARGEST_LOT if is_synchronous(function) else 1
    results: dict[int, Result] = {}
    for first in range(0, len(items), lot):
        ended = map_concurrently(function, items[first : first + lot])
        results |= {first + n: result for n, result in ended}
        if time.perf_counter() >= end:
            return [results[n] for n in range(len(results))], False
    return [results[n] for n in range(len(results))], True


def _by_executor(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    order: Sequence[int],
    executor: Executor,
    keep: Callable[[int, Result], None],
) -> None:
    """Run the items of the indices ``order``; ``keep`` gets index and result of each."""
    workers = getattr(executor, "_max_workers", _WORKERS)
    most = _UNITS_PER_WORKER * workers
    units = _Units(order, _first_unit(function, len(order), workers))
    under_way: dict[Future[tuple[list[Result], bool]], list[int]] = {}
    ended: SimpleQueue[Future[tuple[list[Result], bool]]] = SimpleQueue()
    try:
        while units or under_way:
            with interrupt_later():
                while units and len(under_way) < most:
                    unit = units.take()
                    future = executor.submit(_unit, function, [items[index] for index in unit])
                    under_way[future] = unit
                    future.add_done_callback(ended.put)
            future = ended.get()
            unit = under_way.pop(future)
            results, in_time = future.result()
            units.give_back(unit[len(results) :], len(results), in_time)
            for index, result in zip(unit, results, strict=False):
                keep(index, result)
    except (BrokenExecutor, CancelledError):
        raise WorkerError("a worker process died (out of memory?); use fewer workers") from None
    finally:
        for future in under_way:  # none, unless there was an error or an interrupt
            future.cancel()
