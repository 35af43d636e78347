"""Makes many runs in parallel, with worker processes, checkpoints and progress bars."""

from kneexo.sweeps.checkpoint import Checkpoint as Checkpoint
from kneexo.sweeps.parallel import (
    dask_cluster as dask_cluster,
    parallel_map as parallel_map,
    process_pool as process_pool,
)
from kneexo.sweeps.sweep import (
    Sweep as Sweep,
    SweepOptions as SweepOptions,
    open_sweep as open_sweep,
)
