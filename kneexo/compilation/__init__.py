"""Drake diagrams as machine code: any diagram of vectors, read off its symbolic form.

The equations are written once, in the leaf systems. `equations` reads them off the symbolic form
into a `graph`; `codegen` prints that as a module for numba, behind it the integrators of `loops`,
written out by `unroll`; `linear_parts` is what all models share; `cache` keeps the modules on disk.
`model` is what a user sees, `runner` one run of it, `compiled_system` the way back into Drake.
"""

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
