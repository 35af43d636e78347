"""What every study takes to run its pieces of work: workers, checkpoint, progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypedDict

from kneexo.sweeps.checkpoint import Checkpoint
from kneexo.sweeps.parallel import Item, Result, parallel_map, process_pool


class SweepOptions(TypedDict, total=False):
    """Keyword arguments of every study."""

    workers: int | None
    """Processes; 1, the default, works in this one, None takes all cores. With more than one a
    script needs ``if __name__ == "__main__":``, because processes are spawned."""
    executor: Executor | None
    """Replaces ``workers``: any of the kind of ``concurrent.futures``, such as `dask_cluster`'s."""
    checkpoint: Checkpoint | None
    """Keeps each result as soon as it is known; what it has already is not computed again."""
    progress: bool
    """Whether bars show the progress; default: False."""


@dataclass(frozen=True)
class Sweep:
    """Open workers, a checkpoint and the choice of progress bars, for several maps."""

    executor: Executor | None
    checkpoint: Checkpoint | None
    progress: bool

    def map(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        description: str = "",
        weight: Callable[[Item], float] = lambda item: 1.0,
    ) -> list[Result]:
        """`parallel_map`; a bar needs a ``description``."""
        return parallel_map(
            function,
            items,
            executor=self.executor,
            description=description if self.progress and description else None,
            weight=weight,
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
    """A `Sweep` with the `SweepOptions`; its worker processes end with the body."""
    with process_pool(workers, executor) as pool:
        yield Sweep(pool, checkpoint, progress)
