"""Options of a sweep: worker processes, checkpoint and progress bars."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypedDict

from kneexo.sweeps.checkpoint import Checkpoint
from kneexo.sweeps.parallel import Item, Result, parallel_map, process_pool


class SweepOptions(TypedDict, total=False):
    """Keyword arguments that every study accepts."""

    workers: int | None
    """Number of processes. 1 (default): work in this process. None: one process for each core.
    Processes are spawned. So a script needs ``if __name__ == "__main__":`` unless this is 1."""
    executor: Executor | None
    """A `concurrent.futures.Executor` to use instead of ``workers``; `dask_cluster` yields one."""
    checkpoint: Checkpoint | None
    """`Checkpoint` that stores each result at once; stored results are not computed again."""
    progress: bool
    """Whether progress bars are shown; False by default."""


@dataclass(frozen=True)
class Sweep:
    """Workers, checkpoint and progress bars that several calls of `parallel_map` share."""

    executor: Executor | None
    checkpoint: Checkpoint | None
    progress: bool

    def map(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        description: str = "",
        weight: Callable[[Item], float] = lambda item: 1.0,
        group: Callable[[Item], Hashable] = lambda item: None,
    ) -> list[Result]:
        """Call `parallel_map` with the options of the sweep.

        A progress bar is shown if the sweep has ``progress`` and ``description`` is not empty.
        """
        return parallel_map(
            function,
            items,
            executor=self.executor,
            description=description if self.progress and description else None,
            weight=weight,
            group=group,
            checkpoint=self.checkpoint,
        )


@contextmanager
def open_sweep(
    *,
    workers: int | None = 1,
    executor: Executor | None = None,
    checkpoint: Checkpoint | None = None,
    progress: bool = False,
) -> Iterator[Sweep]:
    """Context manager: yield a `Sweep` with the given `SweepOptions`.

    The worker processes end when the body of the ``with`` statement ends.
    """
    with process_pool(workers, executor) as pool:
        yield Sweep(pool, checkpoint, progress)
