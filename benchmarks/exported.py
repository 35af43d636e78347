"""Exported C, compiled for this machine and called from Python."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from hand_written import c_compiler
from numpy.typing import NDArray

from diagramc import read_diagram
from diagramc.c.interface import Field
from diagramc.c.source import CSource, source_of
from diagramc.c.vectors import recorded_vectors
from kneexo.export.firmware import loop_inputs
from kneexo.export.target import ENCODER_COUNT, Target, make_target
from kneexo.parameters import Scenario

Array = NDArray[np.float64]

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
REPLAY_C, LOOP_C = (Path(__file__).with_name(f"exported_{name}.c") for name in ("replay", "loop"))


@cache
def exported_source(
    scenario: Scenario,
    what: str,
    precision: str = "double",
    *,
    check_ranges: bool = True,
    outputs: Sequence[str] | None = None,
    integrator: str = "rk4",
    tolerance: float | None = None,
    step_s: float | None = None,
) -> tuple[Target, CSource]:
    """A target and its C, as `make_firmware` makes it, or with some of its outputs only.

    Without ``check_ranges`` the code takes any count: the range belongs to one geometry.
    """
    exported = make_target(scenario, what, counts=True)
    interface = exported.interface
    source = source_of(
        read_diagram(exported.diagram, inputs=exported.inputs),
        exported.what,
        precision=precision,
        outputs=outputs or exported.outputs,
        interface=interface if check_ranges else replace(interface, ranges={}),
        tick_s=exported.tick_s,
        integrator=integrator,
        tolerance=tolerance,
        step_s=step_s,
    )
    return exported, source


def real(source: CSource) -> type[np.floating]:
    """The type of the numbers in the structs."""
    return np.float32 if source.precision == "float" else np.float64


def params_of(source: CSource) -> NDArray[np.floating]:
    """The members of the struct of parameters, which all are numbers of one type."""
    groups = (source.parameters, source.state.continuous, source.state.discrete)
    return np.concatenate(groups).astype(real(source))


def structs(source: CSource, fields: Sequence[Field]) -> np.dtype:
    """The struct of inputs or of outputs."""
    members = [(field.name, np.int32 if field.is_integer else real(source)) for field in fields]
    return np.dtype(members or [("none", real(source))], align=True)


def inputs_of(source: CSource, rows: Array) -> NDArray[np.void]:
    """Rows of inputs (steps, elements) as an array of structs."""
    inputs = np.zeros(len(rows), structs(source, source.plan.inputs))
    for column, field in zip(rows.T, source.plan.inputs, strict=True):
        inputs[field.name] = column
    return inputs


def library(
    driver: Path, *sources: CSource, flags: Sequence[str] = FLAGS, compiler: str | None = None
) -> ctypes.CDLL:
    """The sources and a driver in C, compiled as a shared library.

    Raises `NoCompilerError` where there is no C compiler.
    """
    compiler = compiler or c_compiler()
    name = sources[0].name
    with tempfile.TemporaryDirectory() as directory:
        names = [str(driver)]
        for source in sources:
            for file, text in source.files().items():
                Path(directory, file).write_text(text, encoding="utf-8")
                names += [file] if file.endswith(".c") else []
        macros = ["-I.", f'-DHEADER="{name}.h"', f"-DOF(x)={name}_##x"]
        command = [compiler, *flags, *macros, "-shared", "-fPIC", *names, "-o", "exported.so"]
        subprocess.run([*command, "-lm"], cwd=directory, check=True)
        return ctypes.CDLL(str(Path(directory, "exported.so")))


def _call(function: Any, *arguments: Any) -> int:
    """Call a function of C; arrays go as pointers, integers as uint32_t."""
    function.restype = ctypes.c_uint32
    kinds = {int: ctypes.c_uint32, float: ctypes.c_double}
    return int(
        function(
            *(
                kinds[type(a)](a) if type(a) in kinds else ctypes.c_void_p(a.ctypes.data)
                for a in arguments
            )
        )
    )


class Replay:
    """An exported model that steps with given inputs."""

    def __init__(self, source: CSource, **options: Any) -> None:
        """``options``: of `library`."""
        self.source = source
        self._library = library(REPLAY_C, source, **options)
        exported_params = (ctypes.c_char * params_of(source).nbytes).in_dll(
            self._library, f"{source.name}_params"
        )
        assert bytes(exported_params) == params_of(source).tobytes()  # the order of the members

    def __call__(self, rows: Array, source: CSource | None = None) -> Array:
        """Outputs (steps, elements) for rows of inputs; parameters of another source if given.

        Raises `RuntimeError` when a step fails.
        """
        return self.from_start(rows, source)[1:]

    def from_start(self, rows: Array, source: CSource | None = None) -> Array:
        """The same with the outputs at the start, (steps + 1, elements)."""
        inputs = inputs_of(self.source, rows)
        outputs = np.zeros((len(rows) + 1, len(self.source.plan.outputs)), real(self.source))
        parameters = params_of(source or self.source)
        steps = _call(self._library.replay, parameters, inputs, len(rows), outputs)
        if steps < len(rows):
            raise RuntimeError(f"{self.source.name}: step {steps} fails")
        return outputs.astype(float)


class Loop:
    """An exported controller in closed loop with the exported plant, which is in double."""

    def __init__(self, scenario: Scenario, controller: CSource) -> None:
        self.scenario, self.controller = scenario, controller
        self._exported = make_target(scenario, "controller", counts=True)
        _, self.plant = exported_source(scenario, "plant")
        self._library = library(LOOP_C, controller, self.plant)

    def run(self, duration_s: float) -> dict[str, Array]:
        """Each output of the plant and of the controller at the samples, and the counts.

        Raises `RuntimeError` when a step fails.
        """
        samples = round(duration_s / self.controller.plan.schedule.tick_s) + 1
        rows = loop_inputs(self.scenario, self._exported, self.controller, samples)
        inputs = inputs_of(self.controller, rows)
        inputs[ENCODER_COUNT] = 0
        commands = np.zeros(samples, structs(self.controller, self.controller.plan.outputs))
        outputs = np.zeros(samples, structs(self.plant, self.plant.plan.outputs))
        last = _call(
            self._library.closed_loop,
            params_of(self.controller),
            params_of(self.plant),
            self.scenario.encoder.resolution_rad,
            samples,
            inputs,
            commands,
            outputs,
        )
        if last < samples:
            raise RuntimeError(f"closed loop in C: sample {last} fails")
        arrays = {name: outputs[name] for name in outputs.dtype.names or ()}
        arrays |= {name: commands[name].astype(float) for name in commands.dtype.names or ()}
        return arrays | {name: inputs[name].astype(float) for name in inputs.dtype.names or ()}


def without_kahan(source: CSource) -> CSource:
    """The same with plain sums of discrete states."""
    plain = replace(source)
    vars(plain)["plan"] = replace(source.plan, sums={})
    return plain


def replayed(scenario: Scenario, exported: Target, source: CSource, duration_s: float) -> Any:
    """Inputs of a target in its closed loop, and what the compiled target makes of them."""
    steps = round(duration_s / source.plan.schedule.tick_s)
    inputs = loop_inputs(scenario, exported, source, steps)
    return recorded_vectors(exported.diagram, source, inputs)
