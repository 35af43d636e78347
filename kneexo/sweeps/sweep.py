"""Options of a sweep: worker processes, checkpoint and progress bars."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TypedDict

from kneexo.errors import SimulationError
from kneexo.sweeps.checkpoint import Checkpoint
from kneexo.sweeps.parallel import Item, Result, parallel_map, process_pool


class SweepOptions(TypedDict, total=False):
    """Keyword arguments that every study accepts."""

    workers: int | None
    """Number of processes. 1 (default): work in this process. None: one process for each core.
    Other processes are spawned, for which a script needs ``if __name__ == "__main__":``."""
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
    failures: list[str] = field(default_factory=list)
    """Why each run has failed, or an empty text for a run that has not failed."""

    def map(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        description: str = "",
        weight: Callable[[Item], float] = lambda item: 1.0,
        group: Callable[[Item], Hashable] = lambda item: None,
    ) -> list[Result]:
        """Return ``[function(item) for item in items]``, computed by the workers of the sweep.

        A result that is a mapping with the key ``tracking_failure`` or ``failure`` is the result of
        a run. The run has failed unless the text at the key is empty.

        Parameters
        ----------
        function, items, weight, group
            As in `parallel_map`.
        description
            Text of the progress bar. Empty, or in a sweep without ``progress``: no progress bar.
        """
        results = parallel_map(
            function,
            items,
            executor=self.executor,
            description=description if self.progress and description else None,
            weight=weight,
            group=group,
            checkpoint=self.checkpoint,
        )
        for result in results:
            if isinstance(result, Mapping):
                reasons = [result[name] for name in _FAILURES if name in result]
                self.failures.extend(reasons[:1])
        return results


_FAILURES = ("tracking_failure", "failure")
"""Keys of the reason why a run has failed. In a result with both keys the first key counts."""


@contextmanager
def open_sweep(
    *,
    workers: int | None = 1,
    executor: Executor | None = None,
    checkpoint: Checkpoint | None = None,
    progress: bool = False,
) -> Iterator[Sweep]:
    """Context manager: yield a `Sweep`, whose calls share workers, checkpoint and progress bars.

    The worker processes end when the body of the ``with`` statement ends.

    Parameters
    ----------
    workers, executor, checkpoint, progress
        As in `SweepOptions`.

    Raises
    ------
    SimulationError
        Every run of the sweep has failed. Raised at the end of the ``with`` statement.
    """
    with process_pool(workers, executor) as pool:
        sweep = Sweep(pool, checkpoint, progress)
        yield sweep
    if sweep.failures and all(sweep.failures):
        raise SimulationError(
            f"all {len(sweep.failures)} runs fail; the first: {sweep.failures[0]}"
        )
