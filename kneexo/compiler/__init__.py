"""Drake diagrams as machine code: any diagram of vectors, read off its symbolic form.

The equations are written once, in the leaf systems. A diagram passes through these layers:

- `equations` reads them off the symbolic form into a `graph` of shared operations;
- `passes` rewrites the graph for speed and says what belongs to which function;
- `printer` writes nodes as LLVM IR by means of `ir` and `elementary`, for one lane of a vector or
  several; `integrators`, `exact_hold` and `time_loop` put the run around them;
- `native` makes machine code of the text, `cache` keeps it on disk, `machine_code` joins both;
- `c_source` prints a model as C99 by means of `c_printer` and `c_functions`, `c_export` makes a
  folder of it, `c_build` asks compilers about it;
- `runner` is one run, `model` what a user sees, `compiled_system` the way back into Drake, and
  `trajectories` makes what open inputs follow.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

_MODULE_OF = {
    "CompiledModel": "model",
    "DiagramModel": "model",
    "InputTable": "native.runner",
    "Simulation": "model",
    "State": "native.runner",
    "cache_directory": "native.cache",
    "compile_diagram": "model",
    "export_c": "c.export",
    "input_table": "trajectories",
    "stack_tables": "trajectories",
}

if TYPE_CHECKING:  # for mypy, which would accept every name of a visible __getattr__, and editors
    from .model import (
        CompiledModel as CompiledModel,
        DiagramModel as DiagramModel,
        Simulation as Simulation,
        compile_diagram as compile_diagram,
    )
    from .native.cache import cache_directory as cache_directory
    from .native.runner import InputTable as InputTable, State as State
    from .trajectories import (
        input_table as input_table,
        stack_tables as stack_tables,
    )
else:
    __all__ = sorted(_MODULE_OF)

    def __getattr__(name: str) -> Any:
        """Import a public name at its first use: the cache alone needs no NumPy and no Drake."""
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
