"""A model in C as a folder: sources, test vectors with a harness, build files.

The test vectors are steps of the compiled model: what the C code must give for the same inputs.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kneexo.compilation.c_printer import literal
from kneexo.compilation.c_source import CSource, Interface, filled
from kneexo.compilation.model import CompiledModel, DiagramModel, compile_diagram
from kneexo.compilation.runner import STEP_S, Array, InputTable
from kneexo.errors import CompilationError, OutputError

TOLERANCES = {"double": 1e-9, "float": 1e-3}
"""What the harness takes for equal, as a part of the largest value of an output."""

_BUILD = "build"  # where Makefile puts what it makes


@dataclass(frozen=True)
class Vectors:
    """Inputs of each step (steps, input elements), and outputs (steps, output elements)."""

    inputs: Array
    outputs: Array


def recorded_vectors(model: CompiledModel, source: CSource, inputs: Array) -> Vectors:
    """What the compiled model makes of the inputs of each step (steps, input elements).

    The outputs are those just before the next updates, with the inputs of the step. The integrator
    is RK4 with the steps of the source.
    """
    tick = source.sample_time_s
    steps = len(inputs)
    table = model.no_inputs
    if source.input_fields:
        breaks = tick * np.arange(1, steps + 1)
        table = InputTable(breaks, np.concatenate([inputs, inputs[-1:]])[:, :, None])
    state = model.initialized(source.parameters, source.state, table)
    ends = tick * np.arange(1, steps + 1)
    names = source.output_ports
    columns = []
    # At the end of a step an output that follows an input at once would see the next input.
    for times, direct in ((ends, False), (ends - 1e-6 * tick, True)):
        ports = [name for name in names if (name in model.feedthrough) == direct]
        if ports:
            run = model.simulate(
                source.parameters,
                state,
                steps * tick,
                outputs=ports,
                record_times_s=times,
                inputs=table,
                integrator="rk4",
                step_s=source.step_s,
            )
            columns += [(name, run[name]) for name in ports]
    by_name = dict(columns)
    return Vectors(inputs, np.hstack([by_name[name] for name in names]))


def files_of(source: CSource, vectors: Vectors) -> dict[str, str]:
    """Name and text of each file of the folder."""
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
    names = {"NAME": name, "UPPER": name.upper()}
    told = source.head

    def text(template: str, comment: str) -> str:
        return f"{comment}\n{filled(template, names, words, blocks, ())}\n"

    hashed = f"# {source.told}"
    return {
        **source.files(),
        f"{name}_vectors.h": text("vectors.h", told),
        f"{name}_vectors.c": _vectors_text(source, vectors),
        f"{name}_test.c": text("test.c", told),
        "Makefile": text("Makefile", hashed),
        "CMakeLists.txt": text("CMakeLists.txt", hashed),
    }


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
