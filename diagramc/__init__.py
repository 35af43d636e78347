"""Compiles Drake diagrams of vectors with symbolic support to machine code, C or FMUs.

The equations are written once, in the leaf systems. They pass through these folders:

- ``equations/`` reads the equations from the symbolic form of a diagram into one graph, in which
  equal operations are stored once, and rewrites the graph for speed;
- ``native/`` turns the graph into machine code, stores the code on disk and runs it;
- ``c/`` and ``fmu/`` print the graph as C99 and pack it as an FMU;
- ``linear/`` makes linear models from the derivatives of the graph;
- ``identification/`` fits a compiled model to logs of a machine.

``testing.py`` tests leaf systems, also those that do not compile.

The names below are the whole interface. A name is imported when it is first used. So the command
line can use some names without loading NumPy or Drake.

diagramc reads three public attributes that a leaf system can have: ``margin``, ``check`` and
``parameter_names``; see `diagramc.equations.reader`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .version import __version__ as __version__

if TYPE_CHECKING:  # for mypy, which would accept any name of `__getattr__`, and for editors
    from .c.cross import PLATFORMS as PLATFORMS, require_platforms as require_platforms
    from .c.export import (
        REPLAY_TOLERANCES as REPLAY_TOLERANCES,
        Measurement as Measurement,
        export_c as export_c,
        require_export_folder as require_export_folder,
        write_c as write_c,
    )
    from .c.interface import Field as Field, Interface as Interface
    from .c.sil import (
        Sil as Sil,
        SilMeasurement as SilMeasurement,
        require_sil_folder as require_sil_folder,
        write_sil as write_sil,
    )
    from .c.source import CSource as CSource, source_of as source_of
    from .c.step_size import rk4_step_s as rk4_step_s
    from .c.vectors import Vectors as Vectors, recorded_vectors as recorded_vectors
    from .c.wasm import (
        WasmModule as WasmModule,
        wasm_files as wasm_files,
        wasm_module as wasm_module,
        wasm_table as wasm_table,
    )
    from .compiled_system import CompiledSystem as CompiledSystem
    from .diagram_equations import (
        DiagramEquations as DiagramEquations,
        ExpressionGraph as ExpressionGraph,
        read_diagram as read_diagram,
    )
    from .equations.comparison import (
        called_twice as called_twice,
        differ as differ,
        trust as trust,
    )
    from .equations.periods import sampled_leaves as sampled_leaves
    from .equations.truth import truth_of_scalars as truth_of_scalars
    from .errors import (
        CompilationError as CompilationError,
        DifferenceError as DifferenceError,
        Error as Error,
        LinearizationError as LinearizationError,
        NoEquilibriumError as NoEquilibriumError,
        OutputError as OutputError,
        ParameterError as ParameterError,
        ResultError as ResultError,
        SimulationError as SimulationError,
        StiffnessError as StiffnessError,
        UnstableStepError as UnstableStepError,
        escaped as escaped,
        shortened as shortened,
        shown as shown,
    )
    from .feedback import simulate_with_feedback as simulate_with_feedback
    from .files import (
        lock_file as lock_file,
        output_directory as output_directory,
        write_files as write_files,
    )
    from .fmu.export import (
        FmuFile as FmuFile,
        export_fmu as export_fmu,
        write_fmu as write_fmu,
    )
    from .fmu.fmu import FMI_VERSIONS as FMI_VERSIONS, Fmu as Fmu
    from .fmu.parameters import (
        context_parameters as context_parameters,
        initial_states as initial_states,
    )
    from .fmu.variables import FmuParameter as FmuParameter
    from .identification.fit import (
        Fit as Fit,
        identify as identify,
        sensitivities as sensitivities,
    )
    from .identification.log import Log as Log, Unknown as Unknown
    from .interruption import interrupt_later as interrupt_later
    from .linear.advice import Obstacle as Obstacle, advice as advice
    from .linear.equilibrium import find_equilibrium as find_equilibrium
    from .linear.linearize import linearize as linearize, linearize_at as linearize_at
    from .linear.loop_at import loop_at as loop_at
    from .linear.loops import (
        Transfer as Transfer,
        as_transfer as as_transfer,
        complementary_sensitivity as complementary_sensitivity,
        sensitivity as sensitivity,
    )
    from .linear.margins import LoopMargins as LoopMargins, margins as margins
    from .linear.model import (
        LinearModel as LinearModel,
        OperatingPoint as OperatingPoint,
        TickModel as TickModel,
    )
    from .linear.periodic import PeriodicLoop as PeriodicLoop
    from .linear.reading import read_for_linearization as read_for_linearization
    from .model import (
        CompiledModel as CompiledModel,
        DiagramModel as DiagramModel,
        Simulation as Simulation,
        compile_by_key as compile_by_key,
        compile_diagram as compile_diagram,
    )
    from .native.cache import (
        cache_directory as cache_directory,
        cache_entries as cache_entries,
        cache_size_limit as cache_size_limit,
        clear_cache as clear_cache,
    )
    from .native.cores import available_cores as available_cores
    from .native.runner import (
        ROUGH_STEP_S as ROUGH_STEP_S,
        STEP_S as STEP_S,
    )
    from .reductions import REDUCTIONS as REDUCTIONS, Reduction as Reduction
    from .run_data import (
        Array as Array,
        InputTable as InputTable,
        ResumableState as ResumableState,
        State as State,
    )
    from .testing import check_leaf as check_leaf
    from .trajectories import input_table as input_table, stack_tables as stack_tables
else:
    _NAMES = {
        "c.export": (
            *("REPLAY_TOLERANCES", "Measurement", "export_c", "require_export_folder", "write_c"),
        ),
        "c.cross": ("PLATFORMS", "require_platforms"),
        "c.interface": ("Field", "Interface"),
        "c.sil": ("Sil", "SilMeasurement", "require_sil_folder", "write_sil"),
        "c.source": ("CSource", "source_of"),
        "c.step_size": ("rk4_step_s",),
        "c.vectors": ("Vectors", "recorded_vectors"),
        "c.wasm": ("WasmModule", "wasm_files", "wasm_module", "wasm_table"),
        "compiled_system": ("CompiledSystem",),
        "diagram_equations": ("DiagramEquations", "ExpressionGraph", "read_diagram"),
        "equations.comparison": ("called_twice", "differ", "trust"),
        "equations.periods": ("sampled_leaves",),
        "equations.truth": ("truth_of_scalars",),
        "errors": (
            *("CompilationError", "DifferenceError", "Error", "LinearizationError"),
            "NoEquilibriumError",
            *("OutputError", "ParameterError", "ResultError", "SimulationError"),
            *("StiffnessError", "UnstableStepError", "escaped", "shortened", "shown"),
        ),
        "feedback": ("simulate_with_feedback",),
        "files": ("lock_file", "output_directory", "write_files"),
        "fmu.export": ("FmuFile", "export_fmu", "write_fmu"),
        "fmu.fmu": ("FMI_VERSIONS", "Fmu"),
        "fmu.parameters": ("context_parameters", "initial_states"),
        "fmu.variables": ("FmuParameter",),
        "identification.fit": ("Fit", "identify", "sensitivities"),
        "identification.log": ("Log", "Unknown"),
        "interruption": ("interrupt_later",),
        "linear.advice": ("Obstacle", "advice"),
        "linear.equilibrium": ("find_equilibrium",),
        "linear.linearize": ("linearize", "linearize_at"),
        "linear.loop_at": ("loop_at",),
        "linear.loops": (*("Transfer", "as_transfer", "complementary_sensitivity", "sensitivity"),),
        "linear.margins": ("LoopMargins", "margins"),
        "linear.model": ("LinearModel", "OperatingPoint", "TickModel"),
        "linear.periodic": ("PeriodicLoop",),
        "linear.reading": ("read_for_linearization",),
        "model": (
            *("CompiledModel", "DiagramModel", "Simulation", "compile_by_key", "compile_diagram"),
        ),
        "native.cache": (*("cache_directory", "cache_entries", "cache_size_limit", "clear_cache"),),
        "native.cores": ("available_cores",),
        "native.runner": ("ROUGH_STEP_S", "STEP_S"),
        "reductions": ("REDUCTIONS", "Reduction"),
        "run_data": ("Array", "InputTable", "ResumableState", "State"),
        "testing": ("check_leaf",),
        "trajectories": ("input_table", "stack_tables"),
    }
    _MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}
    __all__ = sorted(_MODULE_OF)

    def __getattr__(name: str) -> Any:
        """Import a name of the interface at its first use, and return its value."""
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
