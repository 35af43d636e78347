"""Maps a function over items in worker processes or on a Dask cluster."""

from __future__ import annotations

import logging
import multiprocessing
import os
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
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

from diagramc import available_cores, interrupt_later
from kneexo.common.progress import progress_bar
from kneexo.errors import ParameterError, WorkerError
from kneexo.law.decision import makers_called_once
from kneexo.simulation.lockstep import is_in_lockstep, map_in_lockstep
from kneexo.sweeps.checkpoint import Checkpoint, UnknownLawError, piece_keys
from kneexo.version import __version__

Item = TypeVar("Item")
Result = TypeVar("Result")

UNIT_S = 0.5
"""Target duration in s of a unit of work, after which a worker returns its results.

A unit contains as many calls of the mapped function as a worker finishes in about this time.
"""

CONNECT_S = 10.0
"""Largest time in s to wait for a Dask scheduler, and then for its first worker."""

# 512 calls fill 16 batches of `LARGEST_BATCH` runs, so that batches are full also where the calls
# have runs of several structures.
LARGEST_LOT = 512
"""Largest number of calls in lockstep, which share batches of runs."""

_BLAS_THREADS = "OPENBLAS_NUM_THREADS"  # NumPy reads it when it is imported
_UNITS_PER_WORKER = 4  # units submitted per worker, so that no worker runs out of work
_FIRST_UNIT = 8  # size of the first units of calls that share batches: the lanes of a vector
_GROWTH = 8.0  # largest growth of a unit to the next; few calls fill few lanes
_LAST_UNIT = 32  # size down to which the last units shrink, so that all workers end together
_WORKERS = 250  # assumed workers of an executor that does not say how many it has


@contextmanager
def process_pool(
    workers: int | None, executor: Executor | None = None
) -> Iterator[Executor | None]:
    """Context manager: yield an executor of spawned processes, or None for a single worker.

    ``workers`` is the number of processes. None means one process for each core that this process
    can use. If the number is 1, `parallel_map` computes in this process. An ``executor`` is yielded
    unchanged, and ``workers`` then has no effect. The spawned processes are killed when the body
    raises an exception, also KeyboardInterrupt.
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
    except BaseException:  # KeyboardInterrupt too: no process may continue
        for process in list((pool._processes or {}).values()):
            process.kill()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _single_threaded_blas() -> Iterator[None]:
    """Context manager: processes started in its body use one BLAS thread each.

    If the environment sets the number of threads, this number is kept. One thread is faster,
    because the matrices are small and several threads wait for each other. On busy cores the
    least-squares fit of a cycle takes 13 ms with two threads and 0.2 ms with one thread.
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
    """Context manager: yield an executor of the workers of a running Dask cluster.

    ``address`` is the address of the scheduler, such as ``tcp://host:8786``. If a worker is lost,
    other workers repeat its work. If all workers are lost, Dask waits for new workers.

    Raises `WorkerError` when the package ``distributed`` is missing, when no scheduler or no worker
    is found within 10 s, when a worker has another version of kneexo, when the same work kills
    several workers, and when the connection to the scheduler is lost.
    """
    try:
        distributed: Any = import_module("distributed")
    except ModuleNotFoundError:
        raise WorkerError(
            "a Dask cluster needs the package distributed: pip install distributed"
        ) from None
    for name in ("distributed.client", "tornado.application"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # errors are raised, no need to log them
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
    except Exception:  # any call may fail when the scheduler is lost
        if client.status != "running":
            raise WorkerError(f"the Dask scheduler {address} was lost") from None
        raise
    finally:
        client.close()


def _require_this_version(client: Any, address: str) -> None:
    """Raise `WorkerError` if a worker has another version or the cluster has no workers."""

    def version() -> str:  # sent as code, because a worker may not have kneexo
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
    """Start a thread that ends this worker process as soon as its parent process has ended."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@makers_called_once()
def parallel_map(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    workers: int | None = 1,
    executor: Executor | None = None,
    description: str | None = None,
    weight: Callable[[Item], float] = lambda item: 1.0,
    group: Callable[[Item], Hashable] = lambda item: None,
    checkpoint: Checkpoint | None = None,
) -> list[Result]:
    """Return ``[function(item) for item in items]``, computed in parallel.

    Calls of a function with the decorator `kneexo.simulation.needs_runs` share batches of runs,
    which does not change the results. The first exception of a call, and KeyboardInterrupt,
    ends the map and is raised.

    Parameters
    ----------
    function, items
        Function and items. Both must be picklable if there is more than one worker.
    workers
        Number of processes, as in `process_pool`. Processes are spawned. So a script needs
        ``if __name__ == "__main__":`` if there is more than one process.
    executor
        A `concurrent.futures.Executor` to use instead of ``workers``. `dask_cluster` yields such an
        executor.
    description
        Text of a progress bar. None: no progress bar.
    weight
        Cost of an item in any unit. The items with the largest weights are computed first, and the
        progress bar advances by the weights.
    group
        Items of equal weight and group are computed one after the other. Runs can share a batch
        only if their equations are the same, so a group should stand for equations.
    checkpoint
        `Checkpoint` that stores each result as soon as it is computed. Results in the checkpoint
        are not computed again. The function must then return plain JSON data.

    Raises
    ------
    ParameterError
        ``workers`` is less than 1.
    WorkerError
        A worker process died.
    """
    if workers is not None and workers < 1:
        raise ParameterError(f"workers = {workers}: must be >= 1, or None for one for each core")
    try:
        keys = [] if checkpoint is None else piece_keys(function, items)
    except UnknownLawError as error:
        warnings.warn(f"checkpoint: {error}", stacklevel=2)
        checkpoint, keys = None, []
    results: dict[int, Result] = {}

    def keep(index: int, result: Result) -> None:
        results[index] = result if checkpoint is None else checkpoint.keep(keys[index], result)
        advance(index)

    def advance(index: int) -> None:
        bar.update(
            min(weight(items[index]), total_weight - bar.n)
        )  # rounding must not exceed the total

    total_weight = round(sum(weight(item) for item in items), 6)
    with (
        process_pool(workers, executor) as pool,
        progress_bar(total_weight, description) as bar,
    ):
        if checkpoint is not None:
            for index, key in enumerate(keys):
                if key in checkpoint:
                    results[index] = checkpoint[key]
                    advance(index)
        group_ranks: dict[Hashable, int] = {}
        # The longest first: short items then fill the time in which the last long one ends.
        sort_keys = [
            (-weight(item), group_ranks.setdefault(group(item), len(group_ranks))) for item in items
        ]
        waiting = (index for index in range(len(items)) if index not in results)
        order = sorted(waiting, key=sort_keys.__getitem__)
        if pool is not None:
            _by_executor(function, items, order, pool, keep)
        else:
            units = _Units(order, _first_unit(function, len(order), 1))
            while unit := units.take(LARGEST_LOT):
                begin = time.perf_counter()
                for position, result in _as_completed(function, [items[index] for index in unit]):
                    keep(unit[position], result)
                units.give_back([], len(unit), time.perf_counter() - begin)
    return [results[index] for index in range(len(items))]


class _Units:
    """Queue of item indices, split into units of work whose size adapts to the limit `UNIT_S`."""

    def __init__(self, order: Iterable[int], size: int) -> None:
        self._waiting = deque(order)
        self._size = size

    def __len__(self) -> int:
        return len(self._waiting)

    def take(self, most: int) -> list[int]:
        """Remove the next unit of work from the front of the queue and return its indices.

        The unit has at most ``most`` indices. An empty queue gives an empty list.
        """
        size = min(self._size, most, len(self._waiting))
        return [self._waiting.popleft() for _ in range(size)]

    def give_back(self, unfinished: Sequence[int], finished: int, elapsed_s: float) -> None:
        """Put the unfinished indices of a unit back at the front of the queue; adapt the size.

        ``finished`` is the number of finished indices, and ``elapsed_s`` the duration of the unit.
        The next units have as many indices as fit into `UNIT_S` at this rate, at most `_GROWTH`
        times ``finished``. After a unit that took longer they have ``finished`` indices.
        """
        self._waiting.extendleft(reversed(unfinished))
        growth = min(_GROWTH, UNIT_S / max(elapsed_s, 1e-9))
        self._size = max(self._size, int(growth * finished)) if growth > 1.0 else finished


def _first_unit(function: Callable[..., Any], count: int, workers: int) -> int:
    """Return the size of the first units of work, if there are ``count`` items in total.

    The size is 1 unless calls of ``function`` share batches and there are at least 8 items for
    each worker.
    """
    if not is_in_lockstep(function):
        return 1
    return max(1, min(_FIRST_UNIT, count // (_UNITS_PER_WORKER * workers)))


def _as_completed(
    function: Callable[[Item], Result], items: Sequence[Item]
) -> Iterator[tuple[int, Result]]:
    """Yield the index of each item and ``function(item)``, as soon as the call ends."""
    if is_in_lockstep(function):
        return map_in_lockstep(function, items)
    return enumerate(map(function, items))


@makers_called_once()
def _unit(function: Callable[[Item], Result], items: Sequence[Item]) -> tuple[list[Result], float]:
    """Call ``function`` for ``items`` until `UNIT_S` has elapsed; run in a worker process.

    Calls that have begun before this time are finished. Returns the results of the finished calls
    in the order of ``items``, and the elapsed time in s.
    """
    begin = time.perf_counter()
    lot = LARGEST_LOT if is_in_lockstep(function) else 1
    results: dict[int, Result] = {}
    for first in range(0, len(items), lot):
        for position, result in _as_completed(function, items[first : first + lot]):
            results[first + position] = result
        if time.perf_counter() - begin >= UNIT_S:
            break
    return [results[n] for n in range(len(results))], time.perf_counter() - begin


def _by_executor(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    order: Sequence[int],
    executor: Executor,
    keep: Callable[[int, Result], None],
) -> None:
    """Let an executor compute ``function(items[index])`` for the indices in ``order``.

    When a unit of work ends, this process calls ``keep`` with the index and the result of each of
    its items. Raises `WorkerError` when a worker process dies.
    """
    workers = getattr(executor, "_max_workers", _WORKERS)
    most = _UNITS_PER_WORKER * workers
    units = _Units(order, _first_unit(function, len(order), workers))
    under_way: dict[Future[tuple[list[Result], float]], list[int]] = {}
    ended: SimpleQueue[Future[tuple[list[Result], float]]] = SimpleQueue()
    try:
        while units or under_way:
            with interrupt_later():
                while units and len(under_way) < most:
                    # Half of an equal share of the rest for each worker, so that units shrink
                    # towards the end.
                    unit = units.take(max(_LAST_UNIT, len(units) // (2 * workers)))
                    future = executor.submit(_unit, function, [items[index] for index in unit])
                    under_way[future] = unit
                    future.add_done_callback(ended.put)
            future = ended.get()
            unit = under_way.pop(future)
            results, elapsed_s = future.result()
            units.give_back(unit[len(results) :], len(results), elapsed_s)
            for index, result in zip(unit, results, strict=False):
                keep(index, result)
    except (BrokenExecutor, CancelledError):
        raise WorkerError(
            "a worker process died: out of memory (use fewer workers), or a script whose calls do "
            'not stand below if __name__ == "__main__":'
        ) from None
    finally:
        for future in under_way:  # empty, unless there was an error or an interrupt
            future.cancel()
