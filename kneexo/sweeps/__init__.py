"""Makes many runs in parallel, with worker processes, checkpoints and progress bars."""

from kneexo.sweeps.checkpoint import Checkpoint
from kneexo.sweeps.parallel import dask_cluster, parallel_map, process_pool
from kneexo.sweeps.sweep import Sweep, SweepOptions, open_sweep

__all__ = [
    "Checkpoint",
    "Sweep",
    "SweepOptions",
    "dask_cluster",
    "open_sweep",
    "parallel_map",
    "process_pool",
]
