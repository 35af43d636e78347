"""Writes a folder with a model in C: sources, test vectors, test harness, build files, README."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import System

from ..diagram_equations import read_diagram
from ..errors import CompilationError, OutputError, shown
from ..files import require_empty, write_files
from ..rosenbrock import MOST_SUBSTEPS
from ..run_data import Array
from .build import (
    REQUIRED_FLAGS,
    USUAL_FLAGS,
    BuildError,
    CodeSize,
    Replay,
    code_sizes,
    replay,
)
from .checks import distinct_names, require_type
from .interface import INT32, Field, Interface, require_model_name
from .manifest import FILE as MANIFEST, exported_name, manifest
from .printer import literal
from .source import CSource, source_of
from .template import rendered
from .traceability import FILE as TRACEABILITY, Trace
from .vectors import Vectors, recorded_vectors

REPLAY_TOLERANCES = {"double": 1e-9, "float": 1e-3}
"""Largest difference of an output by rounding, divided by the output's largest magnitude.

The commands of 200 controllers of the knee differ by at most 9.6e-14 in double and 4.0e-5 in float.
A plant in float can differ by more, where its encoder reads a count one sample earlier or later.
"""

_MANY_SUBSTEPS, _ROUGH = 1e5, 1e-2
"""Accepted error of the Rosenbrock method in a replay, divided by its tolerance, and its limit.

Both are relative to the output's largest magnitude. The errors of many substeps add up. Those of
small pressures that oscillate reach 5e4 tolerances.
"""

_MOST_VECTORS = 1_000_000  # test vectors are C code


@dataclass(frozen=True)
class Measurement:
    """Cost of exported code, and results of compiling the code on this machine."""

    operations: dict[str, int]
    """Dictionary from an operator or C library function to its number of executions in a step."""
    state_bytes: int
    """Size of the C struct ``NAME_state_t`` in bytes."""
    replay: Replay | None
    """Result of running the test vectors; None if the test harness cannot be built."""
    code_sizes: dict[str, CodeSize]
    """Flash and stack of the code for each core in `TARGETS`; empty if they cannot be measured."""
    not_measured: dict[str, str]
    """Dictionary from a missing result, ``differences`` or ``flash and stack``, to the reason."""


def export_c(
    diagram: System,
    directory: str | os.PathLike[str],
    *,
    name: str,
    inputs: Iterable[str] = (),
    samples: Array | Sequence[Sequence[float]] | None = None,
    steps: int = 1000,
    context: Any = None,
    outputs: Sequence[str] | None = None,
    interface: Interface | None = None,
    tick_s: float | None = None,
    **options: Any,
) -> Measurement:
    """Write a diagram as C99 into a folder, with test vectors, harness and build files.

    Parameters
    ----------
    diagram
        A Diagram or leaf system that `compile_diagram` accepts.
    directory
        The folder. A missing folder is created. Files of an earlier export are replaced.
    name
        Prefix of all C names and file names, a C identifier of up to 31 characters.
    inputs
        Names of the input ports of the diagram that become inputs of the C code. All other input
        ports count as unconnected.
    samples
        Inputs in each step of the test vectors, (steps, elements of all inputs); zeros by default.
        The inputs are finite, within the ranges of ``interface``, and whole numbers for an int32_t.
    steps
        Number of test vectors if ``samples`` is missing.
    context
        Context with the values of parameters and states; by default the diagram's default Context.
        The fastest mode at these values determines the default step of RK4.
    outputs
        Names of the output ports to export; all by default.
    interface
        Names, types and ranges of the ports in C.
    tick_s
        Time in s that a step covers, required for a diagram without a sample time. Otherwise a step
        covers the largest time that divides all sample times and ``tick_s``.
    options
        Further options of `CSource`: ``precision``, ``integrator`` with ``step_s`` or
        ``tolerance``, ``look_up`` for tables in place of formulas, and ``subject`` and ``origin``,
        which the files name as what the code is and where it comes from.

    Raises
    ------
    CompilationError
        The diagram cannot be compiled to C, or an argument is wrong.
    OutputError
        The folder has files but no export, or an export of a model with another name. Or the
        folder cannot be written.
    SimulationError
        The compiled diagram runs to make the test vectors, and this run fails.
    """
    require_model_name(name)
    require_export_folder(directory, name)
    read = read_diagram(diagram, inputs=distinct_names("inputs", inputs))
    options |= {"outputs": outputs, "tick_s": tick_s}
    options["interface"] = Interface() if interface is None else interface
    source = source_of(read, name, context, **options)
    rows = _rows(samples, steps, source.plan.inputs)
    return write_c(directory, source, recorded_vectors(diagram, source, rows))


def _rows(samples: Any, steps: int, inputs: Sequence[Field]) -> Array:
    """Return the inputs of the test vectors, (steps, inputs). For the arguments see `export_c`."""
    require_type("steps", steps, int, "a whole number")
    if not 1 <= steps <= _MOST_VECTORS:
        raise CompilationError(
            f"steps = {shown(steps)}: must be at least 1, for test vectors, and at most "
            f"{_MOST_VECTORS}"
        )
    try:
        rows = np.array(np.zeros((steps, len(inputs))) if samples is None else samples, dtype=float)
    except (TypeError, ValueError):
        raise CompilationError(
            f"samples: must be an array of numbers of the shape (steps, {len(inputs)})"
        ) from None
    if rows.ndim != 2 or rows.shape[1] != len(inputs) or not len(rows):
        raise CompilationError(
            f"samples has the shape {rows.shape}: must be (steps, {len(inputs)})"
        )
    for column, field in zip(rows.T, inputs, strict=True):
        low, high = field.range or (INT32 if field.is_integer else (-math.inf, math.inf))
        wrong = ~(np.isfinite(column) & (low <= column) & (column <= high))
        if field.is_integer:
            wrong |= column != np.floor(column)
        if wrong.any():
            row = int(np.argmax(wrong))
            words = "a whole number" if field.is_integer else "finite"
            place = f" in {low:g} … {high:g}" if math.isfinite(low) else ""
            raise CompilationError(
                f"samples: {field.name} = {column[row]:g} in step {row}: must be {words}{place}"
            )
    return rows


def require_export_folder(directory: str | os.PathLike[str], name: str) -> None:
    """Raise `OutputError` unless a directory is missing or empty, or has an export of ``name``.

    So an export is never mixed with the sources of a user or with the export of another model.
    """
    require_type("directory", directory, (str, os.PathLike), "a path")
    folder = Path(directory)
    earlier = exported_name(folder)
    if earlier is None:
        require_empty(folder)
    elif earlier != name:
        raise OutputError(
            f"directory {shown(folder)}: has the export of {shown(earlier)!r}; choose another "
            f"directory for {name!r}"
        )


def write_c(directory: str | os.PathLike[str], source: CSource, vectors: Vectors) -> Measurement:
    """Build, run and measure a model in C, write its folder, and return the measurements.

    Files of an earlier export in the directory are replaced, and other files stay. After an error
    all earlier files are still there.

    Parameters
    ----------
    directory
        The folder to write. A missing folder is created.
    source
        The model in C.
    vectors
        Test vectors with which the built model is run.

    Raises
    ------
    OutputError
        `require_export_folder` refuses the folder, or a file cannot be written.
    """
    files, measurement = exported(source, vectors)
    require_export_folder(directory, source.name)
    write_files(directory, files)
    return measurement


def exported(source: CSource, vectors: Vectors) -> tuple[dict[str, str], Measurement]:
    """Build, run and measure the code. Return the files (texts by name) and the measurements."""
    files = files_of(source, vectors)
    differences, sizes, not_measured = None, {}, {}
    try:
        differences = replay(source.name, files)
    except BuildError as error:
        not_measured["differences"] = str(error)
    try:
        sizes = code_sizes(source.name, files)
    except BuildError as error:
        not_measured["flash and stack"] = str(error)
    operations = dict(source.operations)
    measurement = Measurement(operations, source.state_bytes, differences, sizes, not_measured)
    data = source.template_data | {
        "vectors": vectors.inputs,
        "library": source.functions.library,
        "origin": source.origin[0] if source.origin else "",
        "tables": len(source.plan.tables),
        "trace": Trace(
            source.plan, source.equations, source.output_ports, files[f"{source.name}.c"]
        ),
        "measured": [*_stability(source, vectors), *_measured(source.name, measurement)],
    }
    for file in ("README.md", TRACEABILITY):
        files[file] = rendered(__package__, file, **data)
    if source.origin and source.origin_text:
        files[source.origin[0]] = source.origin_text
    files |= {path: data.decode(errors="surrogateescape") for path, data in source.beside.items()}
    content = {
        "name": source.name,
        "precision": source.precision,
        "tick_s": source.plan.schedule.tick_s,
        "rk4_steps_per_tick": source.rk4_steps,
        "rosenbrock_tolerance": source.rosenbrock_tolerance,
        "sha256": source.checksums,
        "origin": source.origin[0] if source.origin else None,
    }
    return files | {MANIFEST: manifest(source.first_line, source.tool, content, files)}, measurement


def replay_tolerance(source: CSource) -> float:
    """Return the largest accepted difference of an output in the replay of the test vectors.

    The difference is divided by the output's largest magnitude. The Rosenbrock method and the
    integrator that made the vectors differ by the sum of the errors of many substeps.
    """
    rounding = REPLAY_TOLERANCES[source.precision]
    if source.rosenbrock_tolerance is None:
        return rounding
    return min(_ROUGH, max(rounding, _MANY_SUBSTEPS * source.rosenbrock_tolerance))


def files_of(source: CSource, vectors: Vectors) -> dict[str, str]:
    """Return a dictionary from file name to text: the sources, test vectors and build files."""
    plan = source.plan
    rows = zip(vectors.inputs.tolist(), vectors.outputs.tolist(), strict=True)
    data = source.template_data | {
        "tolerance": replay_tolerance(source),
        "flags": {"required": REQUIRED_FLAGS, "usual": USUAL_FLAGS},
        "vectors": [
            (_values(source, plan.inputs, inputs), _values(source, plan.outputs, outputs))
            for inputs, outputs in rows
        ],
    }
    templates = {
        f"{source.name}_{template}": template for template in ("vectors.h", "vectors.c", "test.c")
    }
    templates |= {template: template for template in ("Makefile", "CMakeLists.txt")}
    return source.files() | {
        file: rendered(__package__, template, **data) for file, template in templates.items()
    }


def _values(source: CSource, fields: Sequence[Field], values: Sequence[float]) -> list[str]:
    """Return each of ``values`` as C text, in the C type of its element in ``fields``.

    A number that is too small to be a normal number of the precision becomes zero.
    """
    real = source.plan.real
    return [
        str(round(value))
        if field.is_integer
        else literal(value if abs(value) >= real.smallest else 0.0, real)
        for field, value in zip(fields, values, strict=True)
    ]


def _stability(source: CSource, vectors: Vectors) -> Iterator[tuple[str, str]]:
    """Yield the row of the fastest mode in the README's section Numbers, if there are modes."""
    if not source.equations.states:
        return
    mode = f"{vectors.fastest_per_s:.3g} 1/s"
    if source.plan.integrator == "rk4":
        product = source.plan.schedule.step_s * vectors.fastest_per_s
        mode += f", times the step of RK4 {product:.2g}; RK4 is accurate to 0.2 and stable to 2.6"
    else:
        mode += (
            f"; the Rosenbrock method is stable with any step, and chooses its substeps by the "
            f"tolerance {source.rosenbrock_tolerance:g}, at most {MOST_SUBSTEPS} in a step"
        )
    yield "fastest mode, at the recorded steps and at random states in their ranges", mode


def _measured(name: str, measurement: Measurement) -> Iterator[tuple[str, str]]:
    """Yield the rows (quantity, value) of the table in the README's section Numbers, as text."""
    operations = measurement.operations
    counts = ", ".join(f"{count} {operation}" for operation, count in operations.items())
    yield "operations in a step", f"{sum(operations.values())}: {counts}"
    yield f"RAM of `{name}_state_t`", f"{measurement.state_bytes} bytes"
    if measurement.replay:
        for field, difference in measurement.replay.difference.items():
            largest = measurement.replay.largest[field]
            yield f"difference of `{field}`", f"{difference:.3g}, where it goes up to {largest:.6g}"
    for target, size in measurement.code_sizes.items():
        without = "without the C library, -O2"
        yield f"{target}: flash, code and parameters, {without}", f"{size.flash} bytes"
        yield f"{target}: stack of a step, {without}", f"{size.stack} bytes"
    for quantity, reason in measurement.not_measured.items():
        yield quantity, f"not measured: {reason.replace('|', '/')}"
