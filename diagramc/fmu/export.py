"""Writes a diagram that compiles as a functional mock-up unit (FMU), with binaries."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import Any

from pydrake.systems.framework import System

from ..c.checks import distinct_names, require_type
from ..c.cross import require_platforms, shared_libraries
from ..c.interface import require_model_name
from ..c.source import source_of
from ..diagram_equations import read_diagram
from ..errors import shown
from ..files import write_files
from .fmu import Fmu, require_fmi
from .parameters import chosen_parameters
from .variables import FmuParameter


@dataclass(frozen=True)
class FmuFile:
    """Summary of a written FMU."""

    path: str
    sample_time_s: float
    """Time in s; each communication step is a whole multiple of this time."""
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    platforms: tuple[str, ...]
    """Platforms of the binaries, such as ``x86_64-linux``; empty if the FMU has sources alone."""


def export_fmu(
    diagram: System,
    directory: str | os.PathLike[str],
    *,
    name: str,
    inputs: Iterable[str] = (),
    tick_s: float | None = None,
    version: int = 3,
    parameters: Iterable[FmuParameter | str] | None = None,
    platforms: str | Iterable[str] | None = None,
    context: Any = None,
    starts: Mapping[str, float] | None = None,
    stop_s: float = 1.0,
    description: str = "",
    **options: Any,
) -> FmuFile:
    """Write a diagram as FMU for co-simulation to the file ``NAME.fmu`` in a directory.

    Parameters
    ----------
    diagram
        A Diagram or leaf system that `compile_diagram` accepts.
    directory
        The directory. A missing directory is created. An FMU of an earlier export is replaced.
    name
        Model identifier and file name, a C identifier of up to 31 characters.
    inputs
        Names of the input ports of the diagram that become inputs of the FMU.
    tick_s
        The sample time of the FMU in s is the largest time that divides all sample times of the
        diagram and ``tick_s``. Each communication step is a whole multiple of it. A diagram without
        a sample time requires ``tick_s``.
    version
        Version of the FMI standard: 2 or 3.
    parameters
        Parameters of the FMU, as `FmuParameter` or by name. By default, each Context parameter and
        each start value of a state is a parameter: see `context_parameters` and `initial_states`.
    platforms
        Names of the platforms for which Zig compiles a binary, or ``all``: see `require_platforms`.
        By default, the C compiler of this machine compiles a binary for this machine. Without a C
        compiler, or on a machine other than Linux on x86-64 or aarch64, the FMU has C sources
        alone.
    context
        Context with the values of parameters and states; by default the diagram's default Context.
    starts
        Start values of inputs by their names in the FMU; every other input starts at zero.
    stop_s
        Default end of a run in s.
    description
        A short text about the model.
    options
        Options of `CSource`: ``outputs`` (names of output ports; all by default), ``interface``
        (names and ranges of ports), ``integrator``, ``tolerance``, ``step_s``, ``subject``.

    Raises
    ------
    CompilationError
        The diagram cannot be compiled to C, or an argument is wrong. Its subclass ``BuildError``
        says that Zig is not installed, or that a compiler fails.
    OutputError
        The file cannot be written. No file is written after an error.
    """
    require_model_name(name)
    require_fmi("version", version)
    require_type("directory", directory, (str, os.PathLike), "a path")
    require_type("starts", starts, (Mapping, NoneType), "a dictionary")
    if platforms is not None:
        platforms = require_platforms(platforms)
    file = Path(directory) / f"{name}.fmu"
    read = read_diagram(diagram, inputs=distinct_names("inputs", inputs))
    source = source_of(read, name, context, tick_s=tick_s, **options)
    chosen = chosen_parameters(source, parameters)
    fmu = Fmu(source, chosen, version, description, dict(starts or {}), stop_s)
    return write_fmu(file, fmu, platforms)


def write_fmu(
    file: str | os.PathLike[str], fmu: Fmu, platforms: str | Iterable[str] | None = None
) -> FmuFile:
    """Compile the binaries of an FMU and write its file, whole or not at all.

    Parameters
    ----------
    file
        Path of the file. Missing directories are created.
    fmu
        The FMU without binaries.
    platforms
        Platforms of the binaries, as in `export_fmu`.

    Raises
    ------
    CompilationError
        A platform is unknown, or a compiler fails.
    OutputError
        The file cannot be written.
    """
    path = Path(file)
    libraries = shared_libraries(fmu.name, fmu.sources, platforms)
    write_files(path.parent, {path.name: fmu.archive(libraries)}, f"file {shown(path)}")
    plan = fmu.source.plan
    return FmuFile(
        str(path),
        plan.schedule.tick_s,
        tuple(field.name for field in plan.inputs),
        tuple(field.name for field in plan.outputs),
        tuple(parameter.name for parameter in fmu.table.parameters),
        tuple(libraries),
    )
