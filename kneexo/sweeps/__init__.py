"""Many runs: worker processes, checkpoints, progress."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kneexo.sweeps.checkpoint import Checkpoint
    from kneexo.sweeps.parallel import dask_cluster, parallel_map, process_pool

__all__ = [
    "Checkpoint",
    "dask_cluster",
    "parallel_map",
    "process_pool",
]

_MODULE_OF = {
    "Checkpoint": "kneexo.sweeps.checkpoint",
    "dask_cluster": "kneexo.sweeps.parallel",
    "parallel_map": "kneexo.sweeps.parallel",
    "process_pool": "kneexo.sweeps.parallel",
}

if not TYPE_CHECKING:  # mypy accepts every name of a module with a visible __getattr__

    def __getattr__(name: str) -> Any:
        """Import a public name at its first use."""
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
