"""Builds and runs exported C on this machine, and measures its size on microcontrollers."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import CompilationError
from ..files import temporary_folder

COMPILERS = ("cc", "gcc", "clang")
"""Names of C compilers for this machine. The first name that is found on the PATH is used."""

# The M4F has hardware for float alone: double takes 28 times the instructions there.
TARGETS = {
    "Cortex-M4F": "-mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16",
    "Cortex-M7": "-mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-d16",
}
"""Dictionary from the name of a microcontroller core to the options of arm-none-eabi-gcc."""

REQUIRED_FLAGS = ("-std=c99", "-ffp-contract=off")
"""Flags that all exported code needs. With the second flag, gcc and clang round a product and a sum
separately, as the compiled diagram does."""

FLAGS = (*REQUIRED_FLAGS, "-O2")
"""Flags of the C compiler for this machine and for microcontrollers."""

USUAL_FLAGS = ("-O2", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic")
"""Further flags of the exported build files. The Makefile replaces them by the user's CFLAGS."""


class BuildError(CompilationError):
    """A compiler is missing or fails, so the code cannot be measured."""


@dataclass(frozen=True)
class Replay:
    """Comparison of the outputs of the C code with the test vectors.

    ``difference`` maps an output to the largest difference, ``largest`` maps an output to the
    largest magnitude in the vectors. ``passed`` is True if no step failed and no difference is
    above the tolerance.
    """

    difference: dict[str, float]
    largest: dict[str, float]
    passed: bool


@dataclass(frozen=True)
class CodeSize:
    """Size of exported code on a microcontroller in bytes, without the C library."""

    flash: int
    """Code and constants, including the parameter values."""
    stack: int
    """Stack of a step: the sum of the stack frames of all functions that a step may call."""


def replay(name: str, files: Mapping[str, str]) -> Replay:
    """Compile the test harness for this machine and run it. Return the comparison.

    Raises `BuildError` if there is no C compiler or the build fails, and `CompilationError` if the
    harness prints no differences.
    """
    compiler = native_compiler()
    if compiler is None:
        raise BuildError(f"this machine has no C compiler ({', '.join(COMPILERS)})")
    with temporary_folder(files) as folder:
        _run(folder, compiler, *FLAGS, *_sources(files), "-o", "harness", "-lm")
        process = _finished(folder, str(folder / "harness"))
    rows = re.findall(
        r"^(\w+): difference (\S+), largest value (\S+)$", process.stdout, re.MULTILINE
    )
    if not rows:
        raise CompilationError(f"{name}: the harness printed no difference")
    return Replay(
        {field: float(difference) for field, difference, _ in rows},
        {field: float(largest) for field, _, largest in rows},
        process.returncode == 0,
    )


def shared_library(name: str, files: Mapping[str, str], *compiler: str) -> bytes:
    """Compile C files to a shared library with the file name ``name``. Return its bytes.

    ``compiler`` is the command of the C compiler, such as ``("gcc",)``. The library exports the
    functions that the C code marks as visible, and hides all other functions. Raises `BuildError`
    if the build fails.
    """
    return linked(name, files, *compiler, *FLAGS, "-shared", "-fPIC", "-fvisibility=hidden", "-s")


def linked(name: str, files: Mapping[str, str], *command: str) -> bytes:
    """Compile and link C files to a file ``name``, and return the bytes of this file.

    Raises `BuildError` if the build fails.
    """
    with temporary_folder(files) as folder:
        _run(folder, *command, *_sources(files), "-o", name, "-lm")
        return (folder / name).read_bytes()


def native_compiler() -> str | None:
    """Return the path of the C compiler for this machine, or None if the PATH has none."""
    return next(filter(None, map(shutil.which, COMPILERS)), None)


def _sources(files: Mapping[str, str]) -> list[str]:
    return sorted(file for file in files if file.endswith(".c"))


def code_sizes(name: str, files: Mapping[str, str]) -> dict[str, CodeSize]:
    """Compile the model ``name`` for each core in `TARGETS`; return the sizes by core.

    Raises `BuildError` if arm-none-eabi-gcc is missing or fails.
    """
    compiler, size = map(shutil.which, ("arm-none-eabi-gcc", "arm-none-eabi-size"))
    if compiler is None or size is None:
        raise BuildError("this machine has no arm-none-eabi-gcc")
    sizes = {}
    for target, options in TARGETS.items():
        with temporary_folder(files) as folder:
            objects = []
            for source in (f"{name}.c", f"{name}_params.c"):
                flags = (*FLAGS, *options.split(), "-fstack-usage")
                _run(folder, compiler, *flags, "-c", source)
                objects.append(source.replace(".c", ".o"))
            _, *rows = _run(folder, size, *objects).splitlines()
            usage = (folder / f"{name}.su").read_text()
        frames = {}  # a line of the file is "NAME.c:LINE:COLUMN:FUNCTION\tBYTES\tKIND"
        for line in usage.splitlines():
            place, frame_bytes, _ = line.split("\t")
            frames[place.split(":")[3]] = int(frame_bytes)
        outside_step = (f"{name}_init", f"{name}_update_parameters", f"{name}_outputs")
        sizes[target] = CodeSize(
            sum(int(row.split()[0]) for row in rows),  # the column "text"
            sum(frame for function, frame in frames.items() if function not in outside_step),
        )
    return sizes


def _run(folder: Path, *command: str) -> str:
    """Run a command in a folder; return its output. Raise `BuildError` if the command fails."""
    process = _finished(folder, *command)
    if process.returncode:
        lines = process.stderr.splitlines() or ["no message"]
        reason = next((line for line in lines if "error" in line.lower()), lines[0])
        raise BuildError(f"{_program(command)}: {reason.strip()}")
    return process.stdout


def _program(command: Sequence[str]) -> str:
    """Return the name of the program in a command, such as ziglang for ``python -m ziglang cc``."""
    return command[2] if command[1:2] == ("-m",) else Path(command[0]).name


def _finished(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder to its end. Raise `BuildError` if the command cannot start."""
    try:
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    except OSError as error:
        raise BuildError(f"{_program(command)}: {error.strerror}") from None
