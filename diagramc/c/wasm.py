"""Compiles exported C to a WebAssembly module without imports, which runs in a browser.

The host can write the parameters of the module, which are a vector. One call runs many ticks.
``templates/wasm.c`` defines the functions of the module.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from ..errors import CompilationError
from ..native.cache import load, store
from .build import REQUIRED_FLAGS, linked
from .cross import zig_command
from .source import CSource
from .template import rendered

_TARGET = ("-target", "wasm32-wasi", "-mexec-model=reactor")  # a reactor has no main
_STACK_BYTES = 2**24  # what Zig chooses too
_FLAGS = (*REQUIRED_FLAGS, "-O3", "-s", f"-Wl,-z,stack-size={_STACK_BYTES}")


@dataclass(frozen=True)
class WasmModule:
    """A model as a WebAssembly module, with the layout of its memory."""

    code: bytes
    """The binary module. The same C and the same version of Zig give the same bytes."""
    table: dict[str, Any]
    """Dictionary of the module's layout; JSON can represent it.

    ``sample_time_s`` is the duration of a tick, and ``rk4_steps_per_tick`` the number of steps of
    RK4 in a tick. ``rosenbrock_tolerance`` is the tolerance of the Rosenbrock method, or None.
    ``params``, ``inputs``, ``outputs``, ``states`` and ``discrete`` are lists of names in the order
    of the memory. ``params`` ends with the initial states. ``defaults`` has the values of
    ``params``. The first ``stack_bytes`` of the memory are the stack, which is empty between two
    calls. ``sha256`` is the checksum of the module.
    """


def wasm_files(source: CSource) -> dict[str, str]:
    """Return the C files of a module as a dictionary from file name to text.

    Raises `CompilationError` in single precision.
    """
    # The host reads and writes parameters, inputs and outputs as vectors of doubles.
    if source.precision != "double":
        raise CompilationError(
            f"precision = {source.precision!r}: must be double for a WebAssembly module"
        )
    # A struct without parameters has the unused member ``none``, because C allows no empty struct.
    data = source.template_data | {"params": max(1, len(source.struct_values))}
    name = f"{source.name}_wasm.c"
    return source.files() | {name: rendered(__package__, "wasm.c", **data)}


def wasm_table(source: CSource) -> dict[str, Any]:
    """Return the layout of the memory of the WebAssembly module that ``source`` gives.

    The result is the `WasmModule.table` of the module, without ``sha256``.
    """
    schedule, equations = source.plan.schedule, source.equations
    return {
        "sample_time_s": schedule.tick_s,
        "rk4_steps_per_tick": source.rk4_steps,
        "rosenbrock_tolerance": source.rosenbrock_tolerance,
        "params": list(source.struct_values),
        "defaults": [float(text) for text in source.struct_values.values()],
        "inputs": [field.name for field in source.plan.inputs],
        "outputs": [field.name for field in source.plan.outputs],
        "states": list(equations.states),
        "discrete": list(equations.discrete),
        "stack_bytes": _STACK_BYTES,
    }


def wasm_module(source: CSource) -> WasmModule:
    """Compile a model in C to a WebAssembly module by Zig.

    The cache of compiled models stores the module. A later call with the same C and the same
    version of Zig returns the stored module.

    Raises `CompilationError` in single precision, and its subclass `BuildError` if Zig is not
    installed or fails.
    """
    files, name = wasm_files(source), f"{source.name}.wasm"
    command = (*zig_command("WebAssembly"), *_TARGET, *_FLAGS)
    # Without the path of Python, so that all environments of a user share the modules.
    key = json.dumps([_zig_version(), *command[1:], files])
    code = load(key)
    if code is None:
        code = linked(name, files, *command)
        store(key, code)
    return WasmModule(code, wasm_table(source) | {"sha256": hashlib.sha256(code).hexdigest()})


def _zig_version() -> str:
    """Return the version of the package ``ziglang``, or an empty text if it has no metadata."""
    try:
        return version("ziglang")
    except PackageNotFoundError:
        return ""
