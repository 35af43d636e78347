"""Closed loops written by hand, in C and for numba, with the parameters of a kneexo scenario."""

from __future__ import annotations

import ctypes
import math
import os
import re
import shutil
import subprocess
import tempfile
from collections import namedtuple
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kneexo.geometry.rod_polynomial import controller_polynomial
from kneexo.parameters import Scenario
from kneexo.simulation.compiled import scenario_start, scenario_values

Array = NDArray[np.float64]

C_SOURCE = Path(__file__).with_name("complete_model.c")
C_FLAGS = ("-O3", "-march=native")


def _members() -> list[tuple[str, int]]:
    """Names and lengths of the members of the C struct, which every version takes as arguments."""
    struct = C_SOURCE.read_text(encoding="utf-8").split("typedef struct {")[1].split("}")[0]
    return [
        (name, int(size or 1)) for name, size in re.findall(r"double (\w+)(?:\[(\d+)\])?", struct)
    ]


MEMBERS = _members()
Parameters = namedtuple("Parameters", [name for name, _ in MEMBERS])
"""The C struct as a named tuple: floats, and arrays for the polynomials."""


def _member(path: str) -> str:
    """Name in the C struct of a Context parameter."""
    name = path.removeprefix("plant/").replace("controller/law.", "controller.")
    return name.removeprefix("controller/").replace(".", "_")


def parameters_of(scenario: Scenario) -> Parameters:
    """What the hand-written loops take, from the scenario's Context parameters; nan: not there.

    Raises `ValueError` for a scenario with a part that they leave out.
    """
    controller, plant = scenario.controller, scenario.plant
    missing = {
        "ramp of the reference": scenario.reference.kind != "sine" or scenario.reference.ramp_s,
        "shifted counts": scenario.encoder.phase_rad,
        "latency": scenario.bus.latency_samples,
        "rounded commands": scenario.bus.kind != "none",
        "full order": plant.full_order is not None,
        "ideal motor": plant.ideal_motor,
        "feedforward": controller.kind == "pid" and controller.velocity_feedforward,
        "signum or continuous law": controller.kind == "smc"
        and (controller.continuous or controller.switching != "saturation"),
        "estimator": controller.kind == "smc" and scenario.estimator.kind != "observer",
    }
    if left_out := [name for name, present in missing.items() if present]:
        raise ValueError(f"not written by hand: {', '.join(left_out)}")
    context = scenario_values(scenario)
    start = scenario_start(scenario)
    values: dict[str, Any] = {_member(path): value for path, value in context.items()} | {
        "sample_time_s": controller.sample_time_s,
        "cylinder_start_m": start["plant/cylinder.x[0]"],
        "cylinder_start_pa": 1e6 * start["plant/cylinder.x[2]"],
        "encoder_resolution_rad": scenario.encoder.resolution_rad,
        "table_1": np.array(controller_polynomial(scenario).p_si),
    }
    for group, name in enumerate(("knee_angle", "knee_encoder", "knee_arm"), 1):
        count = sum(key.startswith(f"plant/knee.{group}[") for key in context)
        values[name] = np.array([context[f"plant/knee.{group}[{i}]"] for i in range(count)])
    return Parameters(*(values.get(name, math.nan) for name, _ in MEMBERS))


# ------------------------------------------------------------------------------------ C


class NoCompilerError(RuntimeError):
    """There is no C compiler."""


def c_compiler() -> str:
    """The C compiler of the machine: ``$CC``, cc, gcc or clang."""
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        if name and (path := shutil.which(name)):
            return path
    raise NoCompilerError("no C compiler")


@cache
def c_library(compiler: str | None = None, flags: tuple[str, ...] = C_FLAGS) -> Any:
    """`complete_model.c`, compiled into a temporary directory."""
    compiler = compiler or c_compiler()
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "complete_model.so"
        command = [compiler, *flags, "-shared", "-fPIC", str(C_SOURCE), "-o", str(path), "-lm"]
        subprocess.run(command, check=True)
        return ctypes.CDLL(str(path))


def run_c(
    p: Parameters, *, pid: bool, loaded: bool, steps: int, samples: int, library: Any = None
) -> Array:
    """Rod extension and load pressure (samples + 1, 2) of the C program, by RK4."""
    library = library or c_library()
    values = np.concatenate([np.atleast_1d(value) for value in p])
    if values.nbytes != library.parameters_size():
        raise ValueError(
            "the scenario's polynomials have another degree than those of the C struct"
        )
    record = np.empty((samples + 1, 2))
    pointer = ctypes.POINTER(ctypes.c_double)
    failed = library.closed_loop(
        values.ctypes.data_as(pointer), pid, loaded, steps, samples, record.ctypes.data_as(pointer)
    )
    if failed >= 0:
        raise RuntimeError(f"the C program left its range at sample {failed}")
    return record
