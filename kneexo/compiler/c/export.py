"""A model in C as a folder: sources, test vectors with a harness, build files.

The test vectors are steps of the compiled model: what the C code must give for the same inputs.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import ZeroOrderHold

from ..errors import CompilationError, OutputError, shown
from ..model import DiagramModel, compile_diagram
from ..run_data import Array, InputTable, State
from .build import BuildError, CodeSize, Replay, code_sizes, replay
from .printer import literal
from .source import MARK, CSource
from .template import filled

TOLERANCES = {"double": 1e-9, "float": 1e-3}
"""What the harness takes for equal, as a part of the largest value of an output."""

_BUILD = "build"  # where Makefile puts what it makes


@dataclass(frozen=True)
class Vectors:
    """Inputs of each step (steps, input elements), and outputs (steps, output elements)."""

    inputs: Array
    outputs: Array


def recorded_vectors(diagram: System, source: CSource, inputs: Array) -> Vectors:
    """What the compiled diagram makes of the inputs of each step (steps, input elements).

    Inputs are held over a step; the outputs are those just before the next one. The integrator is
    RK4 with the steps of the source.
    """
    tick, steps = source.sample_time_s, len(inputs)
    ends: Array = tick * np.arange(1.0, steps + 1.0)
    equations, ports = source.equations, tuple(source.equations.inputs)
    state = source.state
    if equations.states and ports:
        # The stages of RK4 at the end of a step would see the next input.
        if equations.updates and np.ptp(inputs, axis=0).any():
            raise CompilationError(
                f"{source.name}: has continuous states, sample times and inputs; test vectors need "
                f"inputs that are constant"
            )
        if not equations.updates:
            diagram = _with_holds(diagram, ports, tick)
            state = State(state.continuous, np.concatenate([state.discrete, inputs[0]]))
    model = compile_diagram(diagram, inputs=ports)
    table = model.no_inputs
    if ports:
        table = InputTable(ends, np.concatenate([inputs, inputs[-1:]])[:, :, None])
    options: dict[str, Any] = {
        "inputs": table,
        "integrator": "rk4",
        "step_s": source.largest_step_s,
    }
    options |= {"outputs": source.output_ports}
    state = model.initialized(source.parameters, state, table)
    if equations.states:
        options |= {"record_period_s": tick}
    else:
        # At the end of a step an output that follows an input at once would see the next input.
        options |= {"record_times_s": ends - 1e-6 * tick}
    run = model.simulate(source.parameters, state, steps * tick, **options)
    outputs = np.hstack([run[name] for name in source.output_ports])
    return Vectors(inputs, outputs[-steps:])


def _with_holds(diagram: System, ports: Sequence[str], tick_s: float) -> System:
    """The same with a zero-order hold before each of its inputs."""
    builder = DiagramBuilder()
    model = builder.AddNamedSystem("model", diagram.Clone())
    for name in ports:
        port = model.GetInputPort(name)
        hold = builder.AddNamedSystem(f"hold_{name}", ZeroOrderHold(tick_s, port.size()))
        builder.Connect(hold.get_output_port(), port)
        builder.ExportInput(hold.get_input_port(), name)
    for index in range(model.num_output_ports()):
        port = model.get_output_port(index)
        builder.ExportOutput(port, port.get_name())
    return builder.Build()


@dataclass(frozen=True)
class Measurement:
    """What is known of exported code, and what the compilers of this machine say."""

    operations: dict[str, int]
    """Operators and library functions of one step, as often as they are computed."""
    state_bytes: int
    replay: Replay | None
    """None where no C compiler builds the harness."""
    code_sizes: dict[str, CodeSize]
    """Of each of `TARGETS`; empty where arm-none-eabi-gcc builds nothing."""
    not_measured: dict[str, str]
    """What of the last two is missing, ``differences`` or ``flash and stack``, and why."""


def exported(source: CSource, vectors: Vectors) -> tuple[dict[str, str], Measurement]:
    """Name and text of each file of the folder, and its measurement."""
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
    return files | {"README.md": _readme(source, vectors, measurement)}, measurement


def files_of(source: CSource, vectors: Vectors) -> dict[str, str]:
    """Name and text of each file but the README."""
    name = source.name
    fields = [field for _, field in source.output_fields]
    words = {
        "vectors": str(len(vectors.inputs)),
        "fields": str(len(fields)),
        "tolerance": str(TOLERANCES[source.precision]),
    }
    blocks = {
        "names": [f'    "{field}",' for field in fields],
        "values": [
            f"    values[{i}] = (double)outputs->{field};" for i, field in enumerate(fields)
        ],
    }

    def text(template: str, comment: str) -> str:
        return f"{comment}\n{filled(f'c/templates/{template}', source.names, words, blocks, ())}\n"

    script = f"# {source.first_line}"
    return {
        **source.files(),
        f"{name}_vectors.h": text("vectors.h", source.head),
        f"{name}_vectors.c": _vectors_text(source, vectors),
        f"{name}_test.c": text("test.c", source.head),
        "Makefile": text("Makefile", script),
        "CMakeLists.txt": text("CMakeLists.txt", script),
    }


def _readme(source: CSource, vectors: Vectors, measurement: Measurement) -> str:
    integers = source.interface.integers
    rows = []
    for port, field in source.input_fields:
        kind = "int32_t" if port in integers else source.precision
        allowed = " … ".join(
            source.limits(port, field) or ["all" if port in integers else "finite"]
        )
        rows.append(f"| `{field}` | {kind} | {allowed} |")
    functions = sorted(source.functions.printer.functions)
    words = {
        "told": source.first_line.replace("-->", "-- >"),
        "what": f"{source.precision.capitalize()} precision, from a Drake diagram.",
        "vectors": str(len(vectors.inputs)),
        "sample_time": f"{source.sample_time_s:g}",
        "rate": f"{1.0 / source.sample_time_s:g}",
        "functions": ", ".join(f"`{function}`" for function in functions) or "no function",
        "kahan": ", and the compensation of rounding errors" if source.accumulators else "",
    }
    blocks = {
        "example": [f"    inputs.{field} = ...;" for _, field in source.input_fields],
        "send": [f"    /* use outputs.{field} */" for _, field in source.output_fields[:1]],
        "inputs": rows,
        "outputs": [f"| `{field}` | {port} |" for port, field in source.output_fields],
        "numbers": [f"| {what} | {value} |" for what, value in _numbers(source.name, measurement)],
    }
    return f"{filled('c/templates/README.md', source.names, words, blocks, ())}\n"


def _numbers(name: str, measurement: Measurement) -> Iterator[tuple[str, str]]:
    """Rows of the README: operations, memory, differences, size on targets."""
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
    for what, reason in measurement.not_measured.items():
        yield what, f"not measured: {reason.replace('|', '/')}"


def _vectors_text(source: CSource, vectors: Vectors) -> str:
    name, real = source.name, source.real
    integers = [port in source.interface.integers for port, _ in source.input_fields]
    lines = [source.head, f'#include "{name}_vectors.h"', ""]
    lines.append(f"const {name}_vector_t {name}_vectors[{name.upper()}_VECTORS] = {{")
    for row, results in zip(vectors.inputs.tolist(), vectors.outputs.tolist(), strict=True):
        inputs = [
            str(round(value)) if whole else literal(_normal(value, source), real)
            for value, whole in zip(row, integers, strict=True)
        ]
        outputs = [literal(_normal(value, source), real) for value in results]
        groups = (f"{{{', '.join(group) or '0'}}}" for group in (inputs, outputs))
        lines.append(f"    {{{', '.join(groups)}}},")
    return "\n".join([*lines, "};"]) + "\n"


def _normal(value: float, source: CSource) -> float:
    """A number that the precision holds: what is smaller than all normal ones is zero."""
    return value if abs(value) >= source.real.smallest else 0.0


# ----------------------------------------------------------------------------------- folders


def export_c(
    diagram: System,
    directory: str | os.PathLike[str],
    *,
    name: str,
    inputs: Iterable[str] = (),
    samples: Array | Sequence[Sequence[float]] | None = None,
    steps: int = 1000,
    context: Any = None,
    **options: Any,
) -> Measurement:
    """Write a diagram as C99 into a folder, with test vectors, harness and build files.

    Parameters
    ----------
    diagram
        What `compile_diagram` takes.
    directory
        Made when it is missing. Files in it are replaced when an export wrote them.
    name
        Beginning of all names and files.
    inputs
        Input ports that stay open.
    samples
        Inputs of each step of the test vectors (steps, elements of all inputs); zeros by default.
    steps
        Number of test vectors, without ``samples``.
    context
        Values of parameters and states; the default Context by default. Steps of RK4 follow the
        fastest mode there, unless ``step_s`` tells them.
    options
        Of `CSource`: ``precision``, ``outputs``, ``interface``, ``tick_s``, ``step_s``, ``told``.

    Raises
    ------
    CompilationError
        The diagram has no equations to print; an option is wrong.
    OutputError
        The folder has files that no export wrote, or cannot be written.
    """
    require_folder(directory)
    model = compile_diagram(diagram, inputs=inputs)
    source = source_of(model, name, context, **options)
    sizes = sum(source.equations.inputs.values())
    rows = np.zeros((steps, sizes)) if samples is None else np.array(samples, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != sizes or not len(rows):
        raise CompilationError(f"samples has the shape {rows.shape}: must be (steps, {sizes})")
    files, measurement = exported(source, recorded_vectors(diagram, source, rows))
    write_folder(directory, files)
    return measurement


def source_of(model: DiagramModel, name: str, context: Any = None, **options: Any) -> CSource:
    """The C source of a compiled diagram; ``options`` are those of `CSource`."""
    equations = model.code.program.equations
    return CSource(equations, name, model.parameters(context), model.state(context), **options)


def require_folder(directory: str | os.PathLike[str]) -> None:
    """Raise `OutputError` for a folder with files that no export wrote."""
    folder = Path(directory)
    for file in sorted(folder.iterdir()) if folder.is_dir() else ():
        if not (file.name == _BUILD or _is_unfinished(file) or _is_export(file)):
            raise OutputError(
                f"--out {shown(folder)}: {shown(file.name)} is not of an export; choose another "
                f"directory"
            )


def write_folder(directory: str | os.PathLike[str], files: Mapping[str, str]) -> None:
    """Write files in the place of those of the last export.

    Raises `OutputError` as `require_folder`, and where the folder cannot be written; then the files
    of the last export stay.
    """
    require_folder(directory)
    folder = Path(directory)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=f"{_BUILD}-") as new:
            for name, text in files.items():
                Path(new, name).write_text(text, encoding="utf-8")
            for name in files:
                os.replace(Path(new, name), folder / name)
        for file in folder.iterdir():
            if _is_unfinished(file):
                shutil.rmtree(file)
            elif file.is_file() and file.name not in files:
                file.unlink()
    except OSError as error:
        reason = error.strerror or error
        raise OutputError(f"--out {shown(folder)}: cannot write there ({reason})") from None


def _is_unfinished(file: Path) -> bool:
    """Whether this is what a killed export has left."""
    return file.is_dir() and file.name.startswith(f"{_BUILD}-")


def _is_export(file: Path) -> bool:
    """Whether an export wrote this file: its first line says so."""
    if not file.is_file():
        return False
    with file.open(encoding="utf-8", errors="replace") as stream:
        return MARK in stream.readline(200)
