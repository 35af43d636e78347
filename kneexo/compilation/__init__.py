"""Drake diagrams as machine code: any diagram of vectors, read off its symbolic form.

The equations are written once, in the leaf systems. `equations` reads them off the symbolic form
into a `graph`; `codegen` prints that as a module for numba, behind it the integrators of `loops`,
written out by `unroll`; `linear_parts` is what all models share; `cache` keeps the modules on disk.
`model` is what a user sees, `runner` one run of it, `compiled_system` the way back into Drake.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kneexo.compilation.cache import cache_directory
    from kneexo.compilation.model import (
        CompiledModel,
        DiagramModel,
        Simulation,
        compile_diagram,
    )
    from kneexo.compilation.runner import InputTable, State

__all__ = [
    "CompiledModel",
    "DiagramModel",
    "InputTable",
    "Simulation",
    "State",
    "cache_directory",
    "compile_diagram",
]

_MODULE_OF = {
    "CompiledModel": "model",
    "DiagramModel": "model",
    "InputTable": "runner",
    "Simulation": "model",
    "State": "runner",
    "cache_directory": "cache",
    "compile_diagram": "model",
}

if not TYPE_CHECKING:  # mypy accepts every name of a module with a visible __getattr__

    def __getattr__(name: str) -> Any:
        """Import a public name at its first use: the cache alone needs no NumPy and no Drake."""
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
