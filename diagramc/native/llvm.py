"""Compiles LLVM IR text to object code, and loads object code; no other module calls LLVM."""

from __future__ import annotations

import ctypes
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import llvmlite
import llvmlite.binding as llvm

from ..root import variable

LANES = 8
"""Number of runs that one call of the machine code makes in a batch, one run in each lane.

Eight doubles fill one vector of AVX-512. They fill two vectors of AVX2, and the processor works on
the two vectors at the same time. A run of 10 s of the default knee in a batch takes 0.79 ms with 4
lanes, 0.71 ms with 8 and 1.25 ms with 16; one of preset ``leg`` 7.7, 7.0 and 7.7 ms (AVX-512).
"""


@dataclass(frozen=True)
class Processor:
    """A processor that machine code is made for. LLVM defines the texts of name and features.

    ``level`` is LLVM's optimization level. All levels give the same bits. Level 0 compiles about
    ten times as fast as level 3, but its code runs about half as fast.
    """

    name: str
    features: str
    level: int = 3

    @cached_property
    def key(self) -> str:
        """Text that names LLVM's version, the processor and the level.

        Equal texts mean equal machine code.
        """
        versions = f"llvmlite {llvmlite.__version__}, LLVM {llvm.llvm_version_info}"
        triple = llvm.get_process_triple()
        return f"{versions}, {triple}, {self.name}, {self.features}, level {self.level}"


@cache
def _start() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()


@cache
def processor() -> Processor:
    """Return the processor that ``DIAGRAMC_CPU`` names, or this machine's processor by default.

    A name is, for example, x86-64-v3. ``DIAGRAMC_LLVM_LEVEL=0`` chooses level 0, for the tests, in
    which most models run once.
    """
    _start()
    # At level 3 LLVM took 62 s of processor time for the 449 models of the tests.
    level = 0 if os.environ.get(variable("LLVM_LEVEL")) == "0" else 3
    chosen = os.environ.get(variable("CPU"))
    if chosen:
        return Processor(chosen, "", level)
    # The features too, because a virtual machine can hide some of those that the name implies.
    return Processor(llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten(), level)


def compile_text(text: str, target: Processor | None = None) -> bytes:
    """Compile an IR text for the processor ``target``, by default `processor`; return object code.

    Warns if the processor has no instruction for fused multiply-add. The code then calls the C
    library's ``fma``, which gives the same bits, but is many times slower.
    """
    target = target or processor()
    machine = _machine(target)
    module = llvm.parse_assembly(text)
    module.triple = machine.triple
    module.data_layout = str(machine.target_data)
    options = llvm.create_pipeline_tuning_options(speed_level=target.level)
    # The lanes are vectors already. With this pass a run of a single lane by RK4 takes 6 to 9 %
    # longer (30 s of the default knee: 5.7 in place of 5.3 ms), and LLVM takes 6 % longer.
    options.slp_vectorization = False
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    code = bytes(machine.emit_object(module))
    if b"\0fma\0" in code:  # a symbol of the C library
        warnings.warn(
            "this processor has no fused multiply-add (FMA); compiled models run slowly",
            stacklevel=2,
        )
    return code


@cache
def _machine(target: Processor) -> Any:
    _start()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=target.name,
        features=target.features,
        opt=target.level,
        reloc="pic",  # a later process loads the object file at another address
        codemodel="small",
    )


class Library:
    """Object code loaded into this process.

    The code stays loaded as long as Python refers to the library or to one of its functions.
    """

    def __init__(self, code: bytes) -> None:
        _start()
        machine = llvm.Target.from_default_triple().create_target_machine(jit=True)
        # MCJIT wants a module, although all code comes from the object file.
        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        self._engine.finalize_object()
        self._functions: dict[str, Callable[..., None]] = {}

    def function(self, name: str, arguments: int) -> Callable[..., None]:
        """Return the emitted function ``name`` as a function that Python can call.

        The function expects as many addresses as ``arguments`` says, returns None, and runs without
        the GIL.
        """
        if name not in self._functions:
            address = self._engine.get_function_address(name)
            assert address, name
            made = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * arguments)(address)
            # The function keeps the library, whose code it is; mypy knows no such attribute.
            made.library = self  # type: ignore[attr-defined]
            self._functions[name] = made
        return self._functions[name]
